"""`trolley demo`: all services on a simulated robot, or on a recorded drive."""

import os
import tempfile
import time
from collections.abc import Generator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import click

from trolley import ports
from trolley.cli import exits
from trolley.cli.demo_recording import with_recorded
from trolley.cli.demo_robot import (
    NAME,
    PORTS,
    TOUR_NAME,
    Choices,
    emulator_command,
    pose_option,
    write_settings,
)
from trolley.cli.demo_run import (
    LOCALIZED_WITHIN_S,
    describe_localized,
    drive_tour,
    play_recording,
    store_places,
    wait_for_localized,
    wait_for_ports,
    wait_for_services,
)
from trolley.cli.options import FloatRange, robot_name_option
from trolley.cli.printing import say
from trolley.cli.robots import reports_errors
from trolley.cli.running import (
    MQTT,
    VIEWER,
    announce_viewer,
    check_port,
    compile_if_new,
    installed_services,
    say_ended,
    supervised,
)
from trolley.client import Robot
from trolley.config import ConfigError, load_config
from trolley.connection import Connection
from trolley.drivers import BOARDS, LIDARS, Driver, Drivers
from trolley.interrupts import Interrupts
from trolley.runtime.zenoh_bus import open_router

DEFAULT_VIZ_PORT = 8080
FOXGLOVE_PORT = 8765


def _devices_option(
    _context: click.Context, _parameter: click.Parameter, text: str | None
) -> tuple[str, str] | None:
    if text is None:
        return None
    board, _, lidar = text.partition(",")
    for name, group in ((board, BOARDS), (lidar, LIDARS)):
        known = Drivers(Driver, group).names
        if name not in known:
            raise click.BadParameter(
                f"give a board and a lidar, such as linorobot,ld19; {name!r} is not one of "
                f"{', '.join(known)}"
            )
    return board, lidar


FILE = click.Path(exists=True, dir_okay=False, path_type=Path)


@click.command(name="demo")
@click.option("--headless", is_flag=True, help="Do not start the viewer.")
@click.option("--tour", is_flag=True, help="Drive the tour, then exit.")
@click.option(
    "--speed", type=FloatRange(0.1, 20.0), default=1.0, help="Simulated seconds per second."
)
@click.option("--seed", type=click.IntRange(0, 2**31 - 1), default=0, help="Fixes the world.")
@click.option(
    "--name",
    default=NAME,
    show_default=True,
    callback=robot_name_option,
    help="The robot's name.",
)
@click.option(
    "--port",
    type=click.IntRange(1, 65535),
    default=ports.ROUTER_PORT,
    show_default=True,
    help="The router's port.",
)
@click.option(
    "--viz-port",
    type=click.IntRange(1, 65535),
    help=f"The viewer's port [default: the first free from {DEFAULT_VIZ_PORT} on].",
)
@click.option(
    "--foxglove",
    "foxglove_port",
    type=click.IntRange(1, 65535),
    is_flag=False,
    flag_value=FOXGLOVE_PORT,
    metavar="[PORT]",
    help=f"Let Foxglove connect, too [port: {FOXGLOVE_PORT}].",
)
@click.option("--state", type=click.Path(path_type=Path), help="Keep the state in this folder.")
@click.option("--world", help="A world file, or the name of one that ships with Trolley.")
@click.option("--recording", type=FILE, help="Play a recorded drive (mcap, npz) instead.")
@click.option(
    "--map",
    "map_file",
    type=FILE,
    help="The map of the recorded drive, if not the one it contains (mcap).",
)
@click.option("--start", callback=pose_option, metavar="X,Y,YAW", help="Where the robot starts.")
@click.option(
    "--emulate",
    "devices",
    callback=_devices_option,
    metavar="BOARD,LIDAR",
    help="Emulate these devices on serial ports, and drive them as real ones (linorobot,ld19).",
)
@click.option("-v", "--verbose", is_flag=True, help="Show everything that the services log.")
@reports_errors
def demo_command(headless: bool, tour: bool, verbose: bool, **options: Any) -> None:
    """Run all services on a simulated robot in an apartment, until Ctrl-C.

    With --tour it visits corridor, entrance and kitchen and then ends; the exit code is 0 only if
    all stops were reached without a collision. With --recording it plays a recorded drive; with
    --headless it ends when the recording does.
    """
    state: Path | None = options.pop("state")
    viz_port: int | None = options.pop("viz_port")
    if not headless and VIEWER not in installed_services():
        say("The viewer is not installed; continuing without it.", err=True, fg="yellow")
        headless = True
    choices = Choices(viz_port=None if headless else _viz_port(viz_port), **options)
    if choices.foxglove_port is not None:
        if headless:
            raise ConfigError("--foxglove is served by the viewer, so it needs one")
        check_port(choices.foxglove_port, "choose another one with --foxglove PORT")
    if choices.devices is not None and (choices.speed != 1.0 or choices.recording is not None):
        raise ConfigError("--emulate plays real devices, at --speed 1 and without --recording")
    if tour and not choices.has_places:
        raise ConfigError(f"--tour drives the tour {TOUR_NAME}, which belongs to the apartment")
    check_port(choices.port, "choose another one with --port (and --name for a second robot)")
    compile_if_new()
    interrupts = Interrupts()
    try:
        with (
            interrupts.handled(),
            _scene(choices, state, verbose=verbose) as (environment, config),
        ):
            _run(interrupts, choices, environment, config, tour=tour, headless=headless)
    except KeyboardInterrupt:
        say_ended(interrupts, "The demo has ended.")
        if tour:
            raise


def _viz_port(wanted: int | None) -> int:
    if wanted is None:
        return ports.first_free(DEFAULT_VIZ_PORT)
    check_port(wanted, "choose another one with --viz-port")
    return wanted


@contextmanager
def _scene(
    choices: Choices, state: Path | None, *, verbose: bool
) -> Generator[tuple[dict[str, str], Path]]:
    """A folder for the demo's robot.toml and, where none is named, its state."""
    with tempfile.TemporaryDirectory(prefix="trolley-demo-") as name:
        folder = Path(name)
        named = state or (Path(os.environ["TROLLEY_STATE"]) if _names_state() else None)
        kept = (named or folder / "state").resolve()
        try:
            kept.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ConfigError(
                f"--state: {kept} is not a folder, and none can be made there"
            ) from error
        config = write_settings(with_recorded(choices, folder), folder)
        load_config(config)
        environment = {
            "TROLLEY_CONFIG": str(config),
            "TROLLEY_STATE": str(kept),
            "TROLLEY_LOG": "info" if verbose else "warning",
        }
        yield environment, config


def _names_state() -> bool:
    return bool(os.environ.get("TROLLEY_STATE"))


def _run(
    interrupts: Interrupts,
    choices: Choices,
    environment: dict[str, str],
    config: Path,
    *,
    tour: bool,
    headless: bool,
) -> None:
    modules = installed_services()
    modules.pop(MQTT, None)
    if headless:
        modules.pop(VIEWER, None)
    settings = load_config(config)
    say(f"Starting robot {choices.name}: {', '.join(modules)} ...")
    held = ["base"] if choices.recording is not None or choices.devices is not None else []
    children: dict[str, str | Sequence[str]] = {}
    if choices.devices is not None:  # first, since base waits for its ports
        children["emulator"] = emulator_command(choices, config)
    children |= modules
    router = open_router([choices.endpoint])
    with supervised(interrupts, children, environment, router, held) as supervisor:
        if not headless:
            announce_viewer(settings)
        started_s = time.monotonic()
        with ExitStack() as stack:
            with interrupts.held():  # a session that is lost while it is made hangs at the end
                connection = stack.enter_context(Connection([choices.endpoint]))
            robot = Robot.over(connection, choices.name)
            assert settings.map.file is not None
            for name in held:
                _wait_for_what_it_needs(choices, config, robot, set(modules) - {name})
                supervisor.release(name)
            code = _show(choices, robot, Path(settings.map.file).stem, started_s, tour=tour)
            if code is not None:
                raise SystemExit(code)
            if choices.recording is not None:
                play_recording(robot, choices.recording)
                if headless:
                    return
        if choices.has_places:
            at = "" if choices.port == ports.ROUTER_PORT else f" --connect {choices.endpoint}"
            say(f"Start the tour in the viewer, or: trolley tour start {TOUR_NAME}{at}")
        say("Ctrl-C ends the demo.")
        interrupts.wait()


def _wait_for_what_it_needs(choices: Choices, config: Path, robot: Robot, others: set[str]) -> None:
    """Wait until base may begin.

    Emulated devices are plugged in first: it would warn of ports that are not there. A recording
    does not wait for anybody, so it begins when all others listen.
    """
    if choices.devices is not None:
        wait_for_ports([config.parent / PORTS / name for name in choices.devices])
    else:
        wait_for_services(robot, others)


def _show(
    choices: Choices, robot: Robot, map_name: str, started_s: float, *, tour: bool
) -> int | None:
    """Localize, store the places, drive the tour if asked: then its exit code."""
    if choices.has_places:
        store_places(robot, map_name)
    if choices.recording is not None:
        return None
    estimate = wait_for_localized(robot, LOCALIZED_WITHIN_S if tour else None)
    if estimate is None:
        say("The robot could not work out where it is.", err=True, fg="red")
        return exits.FAILED
    say(describe_localized(estimate, started_s))
    return drive_tour(robot) if tour else None
