"""`trolley setup` at the ports of an emulated robot, and a person who answers."""

import os
import pty
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path

import pytest
from support.metal import make_hall, settings
from support.processes import Process, own_router, write_config
from support.waiting import PATIENCE_S, wait_until

from trolley import codes, requests, topics
from trolley.client import Robot
from trolley.codes import Refused
from trolley.config import load_config
from trolley.geometry import Pose2D
from trolley.messages import SetupQuestion, SetupState
from trolley.messages.request_params import AnswerSetup
from trolley_base.emulators import EmulatedRobot, Mount, RobotInWorld
from trolley_base.world.world_file import load_world

pytestmark = pytest.mark.slow

MOUNT = Pose2D(0.08, -0.03, 2.0)
COMMAND = [str(Path(sys.executable).with_name("trolley")), "setup"]
LINOROBOT = "linorobot"


class Person:
    """Starts the command, reads what it says, and types."""

    def __init__(self, config: Path, *arguments: str) -> None:
        self._terminal, theirs = pty.openpty()
        self.process = subprocess.Popen(
            [*COMMAND, *arguments, "--config", str(config)],
            stdin=theirs,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            env={**os.environ, "TROLLEY_STATE": str(config.parent / "state")},
            start_new_session=True,
        )
        os.close(theirs)
        self._said = b""
        self._reader = threading.Thread(target=self._read)
        self._reader.start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        while data := os.read(self.process.stdout.fileno(), 4096):
            self._said += data

    @property
    def said(self) -> str:
        """All that the command has printed."""
        return self._said.decode("utf-8", "replace")

    def wait_for(self, words: str, times: int = 1) -> None:
        wait_until(
            lambda: self.said.count(words) >= times or self.process.poll() is not None,
            lambda: f"it says {words!r}: {self.said}",
            3 * PATIENCE_S,
        )
        assert self.said.count(words) >= times, self.said

    def type(self, text: str) -> None:
        os.write(self._terminal, text.encode())

    def answer(self, question: str, text: str, times: int = 1) -> None:
        self.wait_for(question, times)
        self.type(f"{text}\n")

    def end(self) -> int:
        code = self.process.wait(3 * PATIENCE_S)
        self._reader.join()
        return code

    def close(self) -> None:
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait()
        self._reader.join()
        assert self.process.stdout is not None
        self.process.stdout.close()
        os.close(self._terminal)


class Rig:
    """An emulated robot, its robot.toml, and people who set it up."""

    def __init__(self, folder: Path, robot: EmulatedRobot, *, is_mirrored: bool) -> None:
        self.folder = folder
        self.robot = robot
        self.is_mirrored = is_mirrored
        more = 'imu_axes = ["x", "y", "z"]  # as the chip has them'
        text = settings(folder / "ports", LINOROBOT, "ld19", more)
        self.config = write_config(folder / "robot.toml", "tcp/127.0.0.1:7999", "tester", text)
        self.before = self.config.read_text()

    @contextmanager
    def setup(self, *arguments: str) -> Iterator[Person]:
        person = Person(self.config, *arguments)
        try:
            yield person
        finally:
            person.close()

    def stands(self) -> bool:
        twist = self.robot.truth().twist
        return abs(twist.vx) < 0.005 and abs(twist.wz) < 0.01


@pytest.fixture
def rig(tmp_path: Path) -> Iterator[Rig]:
    world = load_world(make_hall(tmp_path))
    body = RobotInWorld(world, 3, start=Pose2D(0.3, 0.1, 0.4), mount=Mount(MOUNT, reversed=True))
    devices = [f"{LINOROBOT}:quiet,exact", "ld19"]
    with EmulatedRobot(devices, body, tmp_path / "ports") as robot:
        yield Rig(tmp_path, robot, is_mirrored=True)


def lift(rig: Rig) -> None:
    rig.robot.fault(f"{LINOROBOT}:lifted")


def try_wheels(person: Person) -> None:
    person.answer("Do the wheels hang free?", "y")
    person.answer("Answer:", "f")
    person.answer("Answer:", "r", times=2)
    person.wait_for("count as they should")


def try_wheels_and_turn(rig: Rig, person: Person) -> None:
    """Try the wheels of a robot that is lifted, set it down, and let it drive until it turns."""
    try_wheels(person)
    person.wait_for("may it drive?")
    rig.robot.fault(f"{LINOROBOT}:ok")
    person.type("y\n")
    wait_until(lambda: abs(rig.robot.truth().twist.wz) > 0.1, "it turns")


def test_a_robot_sets_itself_up_and_takes_it_back(rig: Rig) -> None:
    lift(rig)
    rig.robot.fault(f"{LINOROBOT}:gyro")  # upside down
    with rig.setup("--short") as person:
        try_wheels(person)
        person.wait_for("may it drive?")
        rig.robot.fault(f"{LINOROBOT}:ok")
        rig.robot.fault(f"{LINOROBOT}:gyro")
        person.type("y\n")
        person.answer("Write this to robot.toml?", "y")
        assert person.end() == 0, person.said
    base = load_config(rig.config).base
    found = base.lidar.pose.as_pose()
    assert found.distance_to(MOUNT) < 0.01
    assert abs(found.yaw - MOUNT.yaw) < 0.01
    assert base.lidar.upside_down
    assert base.chassis.imu_axes == ("x", "-y", "-z")
    usual_s = base.chassis.usual_delay_s
    assert usual_s is not None
    assert usual_s <= (base.chassis.delay_s or 0.0) < 0.35
    assert base.odometry.linear_scale == pytest.approx(1.0, abs=0.02)
    assert "# as the chip has them" in rig.config.read_text()
    assert rig.robot.truth().collisions == 0
    with rig.setup("--undo") as person:
        assert person.end() == 0
    assert rig.config.read_text() == rig.before


def test_any_key_stops_and_the_next_call_goes_on_from_there(rig: Rig) -> None:
    lift(rig)
    with rig.setup("--short") as person:
        try_wheels_and_turn(rig, person)
        person.type(" ")
        assert person.end() == 130
    assert "Stopped." in person.said
    wait_until(rig.stands, "it stands")
    assert rig.config.read_text() == rig.before
    # The wheels need not be tried again; killed at the worst moment, it stands as well.
    with rig.setup("--short") as person:
        person.answer("may it drive?", "y")
        assert "hang free" not in person.said
        wait_until(lambda: abs(rig.robot.truth().twist.wz) > 0.1, "it turns")
        person.process.send_signal(signal.SIGKILL)
        person.end()
    wait_until(rig.stands, "it stands")
    assert rig.config.read_text() == rig.before


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_command_that_is_told_to_end_stops_the_robot_itself(
    rig: Rig, number: signal.Signals
) -> None:
    """As when the terminal is closed; the board's watchdog may be seconds long."""
    lift(rig)
    with rig.setup("--short") as person:
        try_wheels_and_turn(rig, person)
        person.process.send_signal(number)
        assert person.end() == 130, person.said
    wait_until(rig.stands, "it stands")


def test_ctrl_c_ends_each_step_and_loses_nothing(rig: Rig) -> None:
    def interrupt(person: Person) -> None:
        person.process.send_signal(signal.SIGINT)
        assert person.end() == 130, person.said
        assert "goes on with this step" in person.said
        wait_until(rig.stands, "it stands")
        assert rig.config.read_text() == rig.before

    lift(rig)
    with rig.setup("--short") as person:
        person.wait_for("Do the wheels hang free?")
        interrupt(person)
    with rig.setup("--short") as person:
        person.answer("Do the wheels hang free?", "y")
        person.wait_for("The wheels go ahead")
        interrupt(person)
    with rig.setup("--short") as person:
        try_wheels(person)
        person.wait_for("may it drive?")
        interrupt(person)
    rig.robot.fault(f"{LINOROBOT}:ok")
    with rig.setup("--short") as person:
        person.answer("may it drive?", "y")
        wait_until(lambda: abs(rig.robot.truth().twist.wz) > 0.1, "it turns")
        interrupt(person)
    with rig.setup("--short") as person:
        person.answer("may it drive?", "y")
        person.wait_for("Write this to robot.toml?")
        interrupt(person)


def test_power_cuts_cost_only_the_step_that_was_begun(rig: Rig) -> None:
    lift(rig)
    with rig.setup("--short") as person:
        person.answer("Do the wheels hang free?", "y")
        person.wait_for("The wheels go ahead")
        person.process.send_signal(signal.SIGKILL)
        person.end()
    assert rig.config.read_text() == rig.before
    with rig.setup("--short") as person:
        try_wheels(person)
        person.wait_for("may it drive?")
        person.process.send_signal(signal.SIGKILL)
        person.end()
    assert rig.config.read_text() == rig.before
    with rig.setup("--short") as person:
        person.answer("may it drive?", "n")
        assert person.end() == 1, person.said
    assert "hang free" not in person.said
    with rig.setup("--undo") as person:
        assert person.end() == 0
    assert rig.config.read_text() == rig.before


@pytest.mark.parametrize(
    ("break_it", "words"),
    [
        (lambda rig: None, "Lift it"),
        (lambda rig: rig.robot.fault(f"{LINOROBOT}:encoder=left"), "left wheel counts nothing"),
    ],
)
def test_wheels_that_are_not_right_end_it(
    rig: Rig, break_it: Callable[[Rig], None], words: str
) -> None:
    if words != "Lift it":
        lift(rig)
    break_it(rig)
    with rig.setup() as person:
        person.answer("Do the wheels hang free?", "y")
        assert person.end() == 1
    assert words in person.said
    wait_until(rig.stands, "it stands")
    assert rig.config.read_text() == rig.before


def test_swapped_sides_are_told_by_a_person_and_nothing_drives_on(rig: Rig) -> None:
    lift(rig)
    with rig.setup() as person:
        person.answer("Do the wheels hang free?", "y")
        person.answer("Answer:", "f")
        person.answer("Answer:", "l", times=2)
        assert person.end() == 1
    assert "Left and right are swapped" in person.said
    assert rig.config.read_text() == rig.before


def test_what_only_the_owner_knows_is_asked(tmp_path: Path) -> None:
    world = load_world(make_hall(tmp_path))
    ports, path = tmp_path / "ports", tmp_path / "robot.toml"
    with EmulatedRobot(["arduino_bridge", "ld19"], RobotInWorld(world, 3), ports):
        devices = [str(ports / name) for name in ("arduino_bridge", "ld19")]
        with closing(Person(path, *devices)) as person:
            person.answer("Name", "Karl")
            person.answer("Error: A robot's name has 1 to 32 of a-z", "karl")
            person.answer("Length", "wide")
            person.answer("Error: Please answer with a number.", "0.3")
            person.answer("Width", "0.24")
            person.answer("open the robot's page?", "n")
            person.answer("Are these the devices of this robot?", "y")
            person.answer("ticks_per_revolution:", "0")
            person.answer("Error: It must be above 0.", "1550")
            person.answer("diameter_m:", "0.1")
            person.answer("track_m:", "0.2")
            person.answer("Do the wheels hang free?", "n")
            assert person.end() == 1, person.said
    chassis = load_config(path).base.chassis
    assert chassis.board == "arduino_bridge"
    assert chassis.wheels is not None
    assert chassis.wheels.ticks_per_revolution == 1550.0
    with closing(Person(path, "--undo")) as person:
        assert person.end() == 0
    assert not path.exists()


class Phone:
    """Answers `trolley setup --page` over the wire, as a page of the viewer does."""

    def __init__(self, robot: Robot, who: str) -> None:
        self.robot = robot
        self.who = who
        self._is_there = threading.Event()
        self._hand: threading.Thread | None = None

    @property
    def state(self) -> SetupState:
        state = self.robot.latest(topics.SETUP)
        assert state is not None
        return state

    def wait_for(self, words: str) -> SetupQuestion:
        def is_asked() -> bool:
            question = self.state.question
            return question is not None and words in question.text

        wait_until(is_asked, lambda: f"it asks {words!r}: {self.state}", 3 * PATIENCE_S)
        question = self.state.question
        assert question is not None
        return question

    def answer(self, words: str, answer: str) -> None:
        self.say(self.wait_for(words), answer)

    def say(self, question: SetupQuestion, answer: str) -> SetupState:
        params = AnswerSetup(
            run=self.state.run, question=question.number, answer=answer, who=self.who
        )
        return self.robot.ask(requests.SETUP_ANSWER, params)

    def hold(self) -> None:
        """Hold whenever that is asked for, until `leave`."""
        self._is_there.set()
        self._hand = threading.Thread(target=self._hold)
        self._hand.start()

    def _hold(self) -> None:
        while self._is_there.is_set():
            state = self.robot.latest(topics.SETUP)
            question = None if state is None else state.question
            if question is not None and question.kind == "hold":
                with suppress(Refused, AssertionError):  # it has ended meanwhile
                    self.say(question, "hold")
            time.sleep(0.1)

    def leave(self) -> None:
        self._is_there.clear()
        if self._hand is not None:
            self._hand.join()


@contextmanager
def paged(rig: Rig, *arguments: str) -> Iterator[tuple[Process, Robot]]:
    """`trolley setup --page` at a router of the test's, without a viewer."""
    with own_router() as endpoint, occupied_port() as viz_port:
        text = rig.before.replace("tcp/127.0.0.1:7999", endpoint)
        rig.config.write_text(f"{text}\n[viz]\nport = {viz_port}\n")
        rig.before = rig.config.read_text()
        command = ["-m", "trolley.cli", "setup", "--page", "--config", str(rig.config)]
        process = Process([*command, *arguments], rig.config.with_name("page.log"))
        with closing(Robot("tester", endpoint, connect_timeout=PATIENCE_S)) as robot:
            try:
                wait_until(
                    lambda: robot.latest(topics.SETUP) is not None or not process.is_running,
                    lambda: f"it is on the wire: {process.log}",
                )
                assert process.is_running, process.log
                yield process, robot
            finally:
                process.kill()


@contextmanager
def occupied_port() -> Iterator[int]:
    """A port at which somebody listens, as a viewer that runs already."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        yield server.getsockname()[1]


def test_a_page_that_is_closed_stops_the_robot_and_the_next_one_goes_on(rig: Rig) -> None:
    lift(rig)
    with paged(rig, "--short") as (process, robot):
        anna, ben = Phone(robot, "anna"), Phone(robot, "ben")
        asked = anna.wait_for("Do the wheels hang free?")
        for rubbish in ("maybe", "", "\0", "y" * 1000):
            with pytest.raises(Refused) as refused:
                anna.say(asked, rubbish)
            assert refused.value.code == codes.BAD_REQUEST
        anna.hold()
        anna.answer("hang free?", "yes")
        anna.answer("told to go ahead", "f")
        anna.answer("told to turn to the left", "r")
        anna.wait_for("may it drive?")
        assert ben.state.sight is not None
        assert len(ben.state.sight.points) > 50
        rig.robot.fault(f"{LINOROBOT}:ok")
        anna.answer("may it drive?", "yes")
        wait_until(lambda: abs(rig.robot.truth().twist.wz) > 0.1, "it turns")
        # Ben's page looks on, which is no hand on Stop.
        held = ben.state.question
        assert held is not None
        with pytest.raises(Refused):
            ben.say(held, "hold")
        anna.leave()
        wait_until(rig.stands, "it stands")
        asked = ben.wait_for("What next?")
        assert "closed or hidden" in ben.state.said[-1]
        assert ben.state.outcome == "interrupted"
        ben.hold()
        ben.say(asked, "again")
        ben.answer("may it drive?", "yes")
        wait_until(lambda: abs(rig.robot.truth().twist.wz) > 0.1, "it turns")
        robot.stop()  # anybody's Stop
        wait_until(rig.stands, "it stands")
        asked = ben.wait_for("What next?")
        assert ben.state.said[-1] == "Stopped."
        assert rig.config.read_text() == rig.before
        ben.say(asked, "again")
        ben.answer("may it drive?", "yes")
        wait_until(lambda: abs(rig.robot.truth().twist.wz) > 0.1, "it turns")
        process.send(signal.SIGINT)
        assert process.wait() == 130, process.log
        wait_until(rig.stands, "it stands")
        ben.leave()
    assert rig.config.read_text() == rig.before


def test_a_robot_whose_base_runs_is_not_set_up(rig: Rig) -> None:
    with own_router() as endpoint:
        text = rig.before.replace("tcp/127.0.0.1:7999", endpoint)
        simulated = rig.config.with_name("simulated.toml")
        write_config(simulated, endpoint)
        rig.config.write_text(text)
        base = Process(["-m", "trolley_base", "--config", str(simulated)], rig.folder / "base.log")
        try:
            with closing(Robot("tester", endpoint, connect_timeout=PATIENCE_S)) as robot:
                wait_until(lambda: robot.latest(topics.ROBOT) is not None, "base is there")
            with occupied_port() as port:
                rig.config.write_text(f"{text}\n[viz]\nport = {port}\n")
                command = ["-m", "trolley.cli", "setup", "--page", "--config", str(rig.config)]
                setup = Process(command, rig.folder / "page.log")
                assert setup.wait() != 0
            assert "base of the robot tester is running" in setup.log
        finally:
            base.kill()
