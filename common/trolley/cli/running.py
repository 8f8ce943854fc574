"""`trolley up`, `trolley router` and `trolley run`: the processes themselves."""

import signal
import subprocess
import time
from collections.abc import Collection, Generator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from importlib.metadata import entry_points
from pathlib import Path

import click

from trolley import ports, warmup
from trolley.cli import exits
from trolley.cli.options import config_option, given
from trolley.cli.printing import say
from trolley.cli.robots import reports_errors
from trolley.config import (
    ConfigError,
    RobotConfig,
    ZenohSection,
    find_config,
    load_config,
    load_host_config,
)
from trolley.config.mqtt import BROKER_VARIABLE, split_broker
from trolley.interrupts import Interrupts
from trolley.runtime.endpoints import is_of_this_host
from trolley.runtime.process import main as run_process
from trolley.runtime.router import run_router
from trolley.runtime.supervisor import Supervisor
from trolley.runtime.zenoh_bus import NotConnected, open_router
from trolley.security.access import Security, security_of
from trolley.security.host_keys import (
    DEFAULT_FOLDER,
    KeysError,
    find_keys,
    keys_for,
)
from trolley.start import program

SERVICES = "trolley.services"
VIEWER = "viz"
FOR_OTHERS = f"tls/0.0.0.0:{ports.ROUTER_TLS_PORT}"
"""Where a router with keys for it listens for other hosts."""
MQTT = "mqtt"
CHECK_PERIOD_S = 0.2
URL_PATIENCE_S = 30.0


def installed_services() -> dict[str, str]:
    """The packages of the installed services, by the service's name."""
    found = {entry.name: entry.module for entry in entry_points(group=SERVICES)}
    return {name: module.partition(".")[0] for name, module in sorted(found.items())}


def find_settings() -> tuple[Path, RobotConfig]:
    """The configuration file and what it says.

    Raises:
        ConfigError: There is none, or it cannot be used.
    """
    path = find_config(given("config"))
    if path is None:
        raise ConfigError(
            "there is no robot.toml: give --config, set TROLLEY_CONFIG, or write one with "
            "`trolley init`; `trolley demo` needs none"
        )
    return path, load_config(path)


def check_port(port: int, option: str) -> None:
    """Refuse a port that is taken.

    Raises:
        ConfigError: Saying who has it and what to do.
    """
    if not ports.is_free(port):
        if (ports.owner(port) or "").startswith(ports.ROS_ROUTER):
            ours = "nodes of ROS 2 use Trolley's router as well (docs/ros2.md)"
            option = f"end it, since {ours}, or {option}"
        raise ConfigError(f"{ports.taken(port)}; {option}")


@contextmanager
def supervised(
    interrupts: Interrupts,
    modules: Mapping[str, str | Sequence[str]],
    environment: Mapping[str, str],
    router: AbstractContextManager[None] | None,
    held: Collection[str] = (),
) -> Generator[Supervisor]:
    """A `router` (None: somebody else's) and the services as children.

    Those in `held` are started later, by `Supervisor.release`. All have ended when this ends,
    whenever the person loses patience.

    Raises:
        ConfigError: The port is taken, or a service cannot run with this configuration.
    """
    stack, supervisor = ExitStack(), None
    try:
        with interrupts.held():
            if router is not None:
                try:
                    stack.enter_context(router)
                except NotConnected as error:
                    raise ConfigError(str(error)) from error
            supervisor = stack.enter_context(Supervisor(modules, environment, _warn, held))
        yield supervisor
    except KeyboardInterrupt:
        if supervisor is not None and supervisor.failure is not None:
            raise ConfigError(supervisor.failure) from None
        raise
    finally:
        with interrupts.held():
            stack.close()


def _warn(text: str) -> None:
    with suppress(OSError):  # the terminal may be gone; the children are ended all the same
        say(text, err=True, fg="yellow")


def say_ended(interrupts: Interrupts, text: str) -> None:
    """Say that all was ended on demand, where the terminal is there to say so.

    Raises:
        SystemExit: It is not: it was closed.
    """
    if interrupts.number == signal.SIGHUP:
        raise SystemExit(exits.HUNG_UP)
    say(text)


def announce_viewer(config: RobotConfig) -> None:
    """Print the viewer's URL once it answers there, and Foxglove's."""
    deadline_s = time.monotonic() + URL_PATIENCE_S
    host = "127.0.0.1" if config.viz.host in ("0.0.0.0", "") else config.viz.host
    while not ports.is_listening(config.viz.port):
        if time.monotonic() > deadline_s:
            say("The viewer did not start.", err=True, fg="yellow")
            return
        time.sleep(CHECK_PERIOD_S)
    say(f"Viewer: http://{host}:{config.viz.port}")
    if config.viz.foxglove_port is not None:
        say(f"Foxglove: ws://{config.viz.foxglove_host}:{config.viz.foxglove_port}")


def _broker_option(
    _context: click.Context, _parameter: click.Parameter, broker: str | None
) -> str | None:
    try:
        if broker is not None:
            split_broker(broker)
    except ValueError as problem:
        raise click.BadParameter(str(problem)) from problem
    return broker


def _complete(_context: click.Context, _parameter: click.Parameter, typed: str) -> list[str]:
    return [name for name in installed_services() if name.startswith(typed)]


def _check_installed(*services: str) -> None:
    known = installed_services()
    for name in services:
        if name not in known:
            names = ", ".join(known) or "none"
            raise click.BadParameter(f"{name!r} is not installed; installed are: {names}")


@click.command(name="up")
@click.option(
    "--without",
    multiple=True,
    metavar="SERVICE",
    shell_complete=_complete,
    help="Do not start this service, such as a base that is your own (may be repeated).",
)
@click.option("--no-viz", is_flag=True, help="Do not start the viewer; as --without viz.")
@click.option("--no-router", is_flag=True, help="Use a router that is already running.")
@click.option("-q", "--quiet", is_flag=True, help="Show warnings only.")
@click.option(
    "--mqtt",
    metavar="HOST[:PORT]",
    callback=_broker_option,
    help="Report to this MQTT broker, and through it to Home Assistant.",
)
@config_option
@reports_errors
def up_command(
    without: tuple[str, ...], no_viz: bool, no_router: bool, quiet: bool, mqtt: str | None
) -> None:
    """Run the router and all installed services of a robot until Ctrl-C.

    Needs a configuration file. A service that ends is restarted.
    """
    _check_installed(*without)
    path, config = find_settings()
    modules = installed_services()
    for service in (*without, *([VIEWER] if no_viz else ())):
        modules.pop(service, None)
    endpoint = config.zenoh.connect[0]
    port = ports.port_of(endpoint)
    router = None if no_router or not is_of_this_host(endpoint) else endpoint
    if port is not None and router is not None:
        check_port(port, "use it with --no-router, or change `[zenoh] connect`")
    if VIEWER in modules:
        check_port(config.viz.port, "change `[viz] port`, or leave the viewer out with --no-viz")
    environment = {"TROLLEY_CONFIG": str(path.resolve())}
    if quiet:
        environment["TROLLEY_LOG"] = "warning"
    carried = None if router is None else _router_of(config, router)
    if mqtt is not None:
        environment[BROKER_VARIABLE] = mqtt
    else:
        modules = {name: one for name, one in modules.items() if name not in config.idle_services}
    compile_if_new()
    say(f"Robot {config.robot.name}: {', '.join(modules)}. Ctrl-C ends all.")
    interrupts = Interrupts()
    try:
        with interrupts.handled(), supervised(interrupts, modules, environment, carried):
            if VIEWER in modules:
                announce_viewer(config)
            interrupts.wait()
    except KeyboardInterrupt:
        say_ended(interrupts, "All services have stopped.")


def compile_if_new() -> None:
    """Compile the kernels where Trolley was just installed: services would take a minute to start.

    Raises:
        ConfigError: They cannot be compiled.
    """
    if not warmup.nothing_is_compiled():
        return
    say("Compiling the kernels, once after the installation; on a small computer it takes minutes.")
    done = subprocess.run(program(warmup.__name__), check=False)
    if done.returncode != 0:
        raise ConfigError("the kernels cannot be compiled; what of stands above")


def _router_of(config: RobotConfig, local: str) -> AbstractContextManager[None]:
    """The router of a configured host, at the endpoint `local` and for others where it may."""
    zenoh = config.zenoh
    security = security_for(config.path(zenoh.keys), [local, *zenoh.uplink])
    return open_router(listening(security, [local]), zenoh.uplink, security, zenoh.downsample)


def security_for(folder: Path, endpoints: Sequence[str]) -> Security | None:
    """What the keys in a folder stand for, None where there are none and none are needed.

    Raises:
        ConfigError: The keys are needed and missing, or they cannot be used.
    """
    try:
        keys = keys_for(endpoints, folder) or find_keys(folder)
        return None if keys is None else security_of(keys)
    except KeysError as error:
        raise ConfigError(str(error)) from error


def listening(security: Security | None, local: Sequence[str]) -> list[str]:
    """Where a router listens: for its own host and, where it lets others in, for them too."""
    others = security is not None and security.access_control is not None
    return [*local, FOR_OTHERS] if others else list(local)


@click.command(name="router")
@click.option(
    "--listen",
    multiple=True,
    metavar="ENDPOINT",
    help="An endpoint to listen at (may be repeated).",
)
@click.option("--uplink", multiple=True, metavar="ENDPOINT", help="A home router to link to.")
@click.option(
    "--keys",
    "folder",
    type=click.Path(file_okay=False, path_type=Path),
    help="The folder with this host's keys; else `[zenoh] keys`, else /etc/trolley/keys.",
)
@config_option
@reports_errors
def router_command(listen: tuple[str, ...], uplink: tuple[str, ...], folder: Path | None) -> None:
    """Run the router that services and tools connect to.

    It listens at the configuration file's endpoints, or else at port 7447 for this host only. With
    keys made by `trolley keys router` it also accepts other hosts, over TLS at port 7448.
    """
    path = find_config(given("config"))
    config = None if path is None else load_host_config(path)
    zenoh = ZenohSection() if config is None else config.zenoh
    local = [one for one in zenoh.connect if is_of_this_host(one)]
    if folder is None:
        folder = DEFAULT_FOLDER if config is None else config.path(zenoh.keys)
    links = list(uplink) or zenoh.uplink
    security = security_for(folder, [*listen, *links])
    endpoints = list(listen) or listening(security, local)
    if not endpoints:
        raise ConfigError("`[zenoh] connect` names no endpoint of this host: give --listen")
    for endpoint in endpoints:
        port = ports.port_of(endpoint)
        if port is not None:
            check_port(port, "listen elsewhere with --listen tcp/127.0.0.1:PORT")
    try:
        run_router(endpoints, links, security, zenoh.downsample)
    except NotConnected as error:
        raise ConfigError(str(error)) from error


@click.command(name="run")
@click.argument("service", shell_complete=_complete)
@config_option
@reports_errors
def run_command(service: str) -> None:
    """Run one SERVICE (base, localizer, mapper, mqtt, planner, tour, viz) in the foreground.

    Needs a configuration file and a router. Exit code 3 means that it is already running somewhere.
    """
    _check_installed(service)
    path, _ = find_settings()
    run_process(entry_points(group=SERVICES)[service].load(), ["--config", str(path)])
