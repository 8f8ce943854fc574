"""`trolley setup --page`: the setup, answered at a page of the viewer.

Base cannot serve it: setup has the devices to itself, and there may be no robot.toml yet to start
base with. So the command itself is on the wire in base's place, as a guest: it publishes `setup`,
answers `setup/answer`, and stops on `base/stop`, which every page, phone and program may send.
"""

import os
import secrets
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple, NoReturn

from trolley import codes, ports, requests, topics
from trolley.cli import exits
from trolley.cli.printing import say, say_block
from trolley.cli.running import (
    VIEWER,
    announce_viewer,
    installed_services,
    listening,
    security_for,
    supervised,
)
from trolley.config import ConfigError, RobotConfig, load_config
from trolley.interrupts import Interrupts
from trolley.messages import BaseState, Robot, SetupChoice, SetupState
from trolley.messages.request_params import AnswerSetup, Nothing
from trolley.runtime.endpoints import is_of_this_host
from trolley.runtime.guest import guest
from trolley.runtime.log import set_up_logging
from trolley.runtime.service import Service, answers, every
from trolley.runtime.zenoh_bus import NotConnected, open_router
from trolley.security.host_keys import KeysError, keys_for
from trolley.start import program
from trolley_base.commands.setup_desk import SetupDesk
from trolley_base.commands.setup_dialogue import EVERYWHERE, STEPS, USUAL_NAME, SetupDialogue
from trolley_base.setup.person import StoppedByHand
from trolley_base.setup.record import SetupRefused

CLI = "trolley.cli"
PERIOD_S = 0.5
KNOWN_WITHIN_S = 6.0
"""How long it may take until it is known what else of the robot runs: two gets [s]."""
FAREWELL_S = 0.6
"""How long the last word may take to the pages [s]."""
LINKS_TRIES = 10
LINKS_PERIOD_S = 0.5
FIRST_FILE = f"""\
[robot]
name = "{USUAL_NAME}"
footprint = {{ length_m = 0.3, width_m = 0.3 }}

[viz]
host = "{EVERYWHERE}"
"""
"""What the viewer runs with until there is a robot.toml."""

AGAIN = SetupChoice(answer="again", label="Try this step again")
BEGIN = SetupChoice(answer="again", label="Begin anew")
UNDO = SetupChoice(answer="undo", label="Take everything back")
START = SetupChoice(answer="start", label="Start the robot")
END = SetupChoice(answer="end", label="End the setup")
STARTS = (
    "The robot starts, and this page comes back in a few seconds. If it does not, `trolley "
    "viewer-link --qr` on the robot prints its link."
)


class SetupService(Service):
    """The wire's end of the desk."""

    name = "setup"

    def __init__(self) -> None:
        self.desk = SetupDesk(secrets.token_hex(4), len(STEPS), self._changed)
        self.others: list[str] = []
        """What else of this robot runs and has its devices."""
        self.knows_others = threading.Event()
        """Set once that is known; nothing is published before."""

    def start(self) -> None:
        """Ask whether the robot is in use."""

        def heard_base(found: dict[tuple[str, ...], Robot]) -> None:
            self.others += ["base"] if found else []
            self.get(topics.SETUP, then=heard_setup)

        def heard_setup(found: dict[tuple[str, ...], SetupState]) -> None:
            self.others += ["another `trolley setup`"] if found else []
            self.knows_others.set()

        self.get(topics.ROBOT, then=heard_base)

    @every(PERIOD_S, clock="local")
    def tell(self) -> None:
        """Publish how far it is."""
        if self.knows_others.is_set() and not self.others:
            self.publish(topics.SETUP, self.desk.state)

    @answers(requests.SETUP_ANSWER)
    def answer(self, params: AnswerSetup) -> SetupState:
        """Take an answer."""
        return self.desk.answer(params)

    @answers(requests.BASE_STOP)
    def stop_wheels(self, _: Nothing) -> BaseState:
        """Stop, in base's place."""
        self.desk.stop()
        return BaseState(stamp_ns=0, mode="stopped", reason=codes.BUTTON)

    def _changed(self) -> None:
        self.call_soon(self.tell)


def run_on_page(path: Path, make: Callable[[SetupDesk], SetupDialogue], *, again: bool) -> int:
    """Let the setup of a file be answered at the viewer's page; returns the exit code.

    Args:
        path: the robot.toml, which need not be there.
        make: the dialogue with a person.
        again: whether to begin with the first step.
    """
    code = _serve(path, make, again=again)
    if code is None:
        _start_robot(path)
    return code


def _serve(path: Path, make: Callable[[SetupDesk], SetupDialogue], *, again: bool) -> int | None:
    """Do it; returns the exit code, None to start the robot."""
    set_up_logging()
    interrupts = Interrupts()
    try:
        with (
            interrupts.handled(),
            tempfile.TemporaryDirectory(prefix="trolley-setup-") as folder,
            _viewer(path, Path(folder), interrupts) as viewer,
        ):
            config = viewer.config
            service = SetupService()
            try:
                keys = keys_for(config.zenoh.connect, config.path(config.zenoh.keys))
            except KeysError as error:
                raise ConfigError(str(error)) from error
            with guest(service, config.robot.name, config.zenoh.connect, keys):
                _refuse_others(service)
                dialogue = make(service.desk)
                ended = _talk(service.desk, dialogue, again=again, may_start=viewer.is_own)
                service.desk.set_outcome("ended")
                time.sleep(FAREWELL_S)
                return ended
    except NotConnected as error:
        raise ConfigError(str(error)) from error
    except KeyboardInterrupt:
        say("Stopped. `trolley setup` goes on with this step.", err=True)
        return exits.INTERRUPTED


def _start_robot(path: Path) -> NoReturn:
    """Go on as `trolley up`."""
    say(f"`trolley viewer-link --qr --config {path}` prints the page's link again.")
    sys.stdout.flush()
    os.execv(sys.executable, program(CLI, "up", "--config", str(path)))


def _talk(desk: SetupDesk, dialogue: SetupDialogue, *, again: bool, may_start: bool) -> int | None:
    """Go through the steps until somebody ends it.

    Args:
        desk: where pages answer.
        dialogue: the steps.
        again: whether to begin with the first.
        may_start: whether the robot may be started in the end.

    Returns:
        The exit code, None to start the robot.
    """
    while True:
        desk.set_outcome("running")
        try:
            dialogue.run(again=again)
            desk.set_outcome("done")
            desk.tell("All is written. Next comes the robot's first map.")
            choices, code = [*([START] if may_start else []), END, UNDO], exits.OK
        except (SetupRefused, ConfigError) as refusal:
            desk.set_outcome("interrupted")
            desk.tell(str(refusal))
            choices, code = [AGAIN, UNDO, END], exits.FAILED
        except StoppedByHand:
            desk.set_outcome("interrupted")
            desk.tell(desk.why_stopped)
            choices, code = [AGAIN, UNDO, END], exits.INTERRUPTED
        again = False
        chosen = desk.choose("What next?", choices)
        if chosen == UNDO.answer:
            try:
                desk.tell(dialogue.undo())
            except ConfigError as error:
                desk.tell(str(error))
            chosen = desk.choose("What next?", [BEGIN, END])
        if chosen == START.answer:
            desk.tell(STARTS)
            return None
        if chosen == END.answer:
            return code


def _refuse_others(service: SetupService) -> None:
    """Refuse to set up a robot that is in use.

    Raises:
        ConfigError: It is, or the router does not answer.
    """
    if not service.knows_others.wait(KNOWN_WITHIN_S):
        raise ConfigError("the router does not answer")
    if service.others:
        raise ConfigError(
            f"{service.others[0]} of the robot {service.robot} is running: end it first, such as "
            "`trolley up` with Ctrl-C, or with `sudo systemctl stop trolley-base`"
        )


class Viewer(NamedTuple):
    """The viewer that shows the setup."""

    config: RobotConfig
    """What it runs with."""
    is_own: bool
    """Whether the setup has started it, and the router: both end with it."""


@contextmanager
def _viewer(path: Path, folder: Path, interrupts: Interrupts) -> Generator[Viewer]:
    """A router and a viewer, as far as they do not run yet."""
    if not path.exists():
        path = folder / "robot.toml"
        path.write_text(FIRST_FILE, encoding="utf-8")
    config = load_config(path)
    endpoint = config.zenoh.connect[0]
    port = ports.port_of(endpoint)
    router = None
    if is_of_this_host(endpoint) and port is not None and ports.is_free(port):
        zenoh = config.zenoh
        security = security_for(config.path(zenoh.keys), [endpoint, *zenoh.uplink])
        router = open_router(
            listening(security, [endpoint]), zenoh.uplink, security, zenoh.downsample
        )
    modules = {VIEWER: installed_services()[VIEWER]}
    if not ports.is_free(config.viz.port):
        say(f"The setup is shown by the viewer that runs already, at port {config.viz.port}.")
        modules = {}
    environment = {"TROLLEY_CONFIG": str(path.resolve()), "TROLLEY_LOG": "warning"}
    with supervised(interrupts, modules, environment, router):
        if modules:
            announce_viewer(config)
            _print_links(path)
        where = ", on a phone too," if config.viz.is_reachable else " on this computer,"
        say(f"Open the page{where} and follow it. Ctrl-C ends the setup.")
        yield Viewer(config, bool(modules) and router is not None)


def _print_links(path: Path) -> None:
    """Print the links with which other devices get in."""
    command = program(CLI, "viewer-link", "--config", str(path))
    if sys.stdout.isatty():
        command.append("--qr")
    left = LINKS_TRIES
    while (done := _run(command)).returncode != 0 and left > 0:
        left -= 1
        time.sleep(LINKS_PERIOD_S)  # the viewer has yet to save the tokens
    if done.stdout:
        say_block(done.stdout.rstrip())
    if done.stderr:
        say_block(done.stderr.rstrip(), err=True)


def _run(command: list[str]) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command, check=False, capture_output=True, text=True)
