"""Base as a real process on the ports of an emulated robot, and somebody who drives it by hand."""

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from support.processes import Process, write_config
from support.waiting import PATIENCE_S, wait_until
from trolley import codes, topics
from trolley.client import Robot
from trolley.config import load_config
from trolley.connection import Connection, RobotUnreachable
from trolley.geometry import Pose2D, Twist2D, footprint_from_box
from trolley.gridmap import FREE, OCCUPIED, GridMap, save_map
from trolley.messages import BaseState
from trolley.runtime import codec
from trolley.runtime.bus import Sample
from trolley_base.emulators import EmulatedRobot, Mount, RobotInWorld
from trolley_base.emulators.device import ReceivedCommand
from trolley_base.world.world_file import load_world

NAME = "tester"
NUM_AFTER = 10
"""Commands on the line by which it is judged that a zero was for good."""
LATE_S = 0.1
"""So late, the emulated wheels may seem not to turn as they are told."""
TABLES = {
    "arduino_bridge": """
[base.chassis.wheels]
ticks_per_revolution = 1550
diameter_m = 0.10
track_m = 0.20
""",
    "hoverboard": "[base.chassis.settings]\ndiameter_m = 0.165\ntrack_m = 0.34\n",
    "waveshare_ugv": '[base.chassis.settings]\ntype = "ugv_rover"\n',
}
"""What boards need to know of the robot."""


def make_hall(folder: Path) -> Path:
    """A world of 8 x 4 m around the origin; the robot stands 3 m before its east wall."""
    cells = np.full((84, 164), OCCUPIED, dtype=np.int8)
    cells[2:-2, 2:-2] = FREE
    save_map(GridMap("hall", 0.05, Pose2D(-4.1, -2.1, 0.0), cells), folder / "hall.yaml")
    world = folder / "hall.toml"
    world.write_text('map = "hall.yaml"\nstart = {x = 1.0, y = 0.0, yaw = 0.0}\n')
    return world


def settings(ports: Path, board: str, lidar: str, more: str = "", lidar_more: str = "") -> str:
    """The `[base]` part of robot.toml for devices on these ports."""
    return f"""
[base]
driver = "hardware"

[base.chassis]
board = "{board}"
port = "{ports / board}"
{more}
{TABLES.get(board, "")}
[base.lidar]
model = "{lidar}"
port = "{ports / lidar}"
{lidar_more}
"""


class Hand:
    """Drives by `cmd_vel/teleop`, 20 times a second, until it lets go."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._wanted: Twist2D | None = None
        self.num_sent = 0
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def drive(self, twist: Twist2D) -> None:
        self._wanted = twist

    @property
    def is_driving(self) -> bool:
        """Whether it has not let go."""
        return self._wanted is not None

    def let_go(self) -> None:
        """Send nothing more."""
        self._wanted = None

    def close(self) -> None:
        self._end.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._end.wait(0.05):
            wanted = self._wanted
            if wanted is not None:
                try:
                    self._robot.drive(wanted, valid_for=0.2)
                except RobotUnreachable:  # base's clock was late: a hand would press on
                    continue
                self.num_sent += 1


class Metal:
    """An emulated robot and base on its ports."""

    def __init__(
        self,
        folder: Path,
        endpoint: str,
        board: str,
        lidar: str,
        more: str = "",
        lidar_more: str = "",
        udp: int | None = None,
    ) -> None:
        """`udp`: the port of this computer that the board calls, in place of a serial one."""
        world = load_world(make_hall(folder))
        self.ports = folder / "ports"
        self.board, self.lidar = board, lidar
        self._folder = folder
        text = settings(self.ports, board, lidar, more, lidar_more)
        network = {} if udp is None else {board: f"udp:{udp}"}
        if udp is not None:
            text = text.replace(str(self.ports / board), f"udp://:{udp}")
        self._config = write_config(folder / "robot.toml", endpoint, NAME, text)
        mount = Mount(load_config(self._config).base.lidar.pose.as_pose())
        body = RobotInWorld(world, 3, footprint=footprint_from_box(0.4, 0.3), mount=mount)
        self.emulated = EmulatedRobot([board, lidar], body, self.ports, network=network)
        self.base: Process | None = None
        self._connection = Connection([endpoint], PATIENCE_S)
        self.states: list[BaseState] = []
        """All that base has said of itself."""

    def start_base(self) -> Process:
        environment = {"TROLLEY_STATE": str(self._folder / "state")}
        arguments = ["-m", "trolley_base", "--config", str(self._config)]
        self.base = Process(arguments, self._folder / "base.log", environment)
        return self.base

    @contextmanager
    def running(self) -> Iterator["Metal"]:
        with self.emulated, self._connection:
            self.robot = Robot.over(self._connection, NAME)
            self._connection.listen(topics.BASE.key(NAME), self._hear)
            self.start_base()
            self.hand = Hand(self.robot)
            try:
                yield self
            finally:
                self.hand.close()
                if self.base is not None:
                    self.base.kill()

    @property
    def state(self) -> BaseState | None:
        """What base said last."""
        return self.states[-1] if self.states else None

    def wait_for(self, mode: str, reason: str = "", **links: str) -> BaseState:
        """Wait until base says this of itself, and of its links where they are named."""

        def is_so() -> BaseState | None:
            state = self.state
            if state is None or (state.mode, state.reason) != (mode, reason):
                return None
            found = {link.name: link.state for link in state.links}
            return state if found.items() >= links.items() else None

        found = wait_until(is_so, lambda: f"base is {mode} {reason} {links}: {self.state}")
        assert found is not None
        return found

    @property
    def speed(self) -> float:
        """How fast it really moves [m/s]."""
        return self.emulated.truth().twist.speed

    @property
    def last_command(self) -> ReceivedCommand | None:
        """The newest command that has come over the line."""
        return next(reversed(self.emulated.commands()), None)

    def start_driving(self, twist: Twist2D, at_least: float = 0.08) -> None:
        """Set off and return when it moves.

        Where this computer was too busy to turn the wheels, base says that they did not obey, and
        a person lets it drive again.
        """
        self.hand.drive(twist)
        late_s = 0.0

        def moves() -> bool:
            nonlocal late_s
            truth, state = self.emulated.truth(), self.state
            late_s = max(late_s, (time.monotonic_ns() - truth.stamp_ns) * 1e-9)
            if state is not None and state.reason == codes.DOES_NOT_OBEY and late_s > LATE_S:
                late_s = 0.0
                self.robot.resume()
            return truth.twist.speed > at_least

        wait_until(moves, lambda: f"it moves: {self.state}; the world was {late_s:.2f} s late")

    def wait_for_standing(self) -> None:
        """Wait until it does not move."""
        wait_until(lambda: self.speed < 0.005, "it stands")

    def wait_for_zero(self) -> None:
        """Wait until a zero has come over the line."""
        wait_until(
            lambda: (last := self.last_command) is not None and last.twist.is_zero, "a zero command"
        )

    def check_that_it_stays(self) -> None:
        """Fail where the next commands on the line, whenever they come, move it after a zero.

        A hand that has not let go goes on meanwhile.
        """
        self.wait_for_zero()
        zero, num_sent = self.last_command, self.hand.num_sent
        assert zero is not None

        def after() -> list[Twist2D]:
            return [one.twist for one in self.emulated.commands() if one.at_ns > zero.at_ns]  # pyrefly: ignore[missing-attribute]

        wait_until(lambda: len(after()) >= NUM_AFTER, "commands after the zero")
        if self.hand.is_driving:
            wait_until(lambda: self.hand.num_sent >= num_sent + NUM_AFTER, "the hand goes on")
        assert [twist for twist in after() if not twist.is_zero] == []
        self.wait_for_standing()

    def _hear(self, sample: Sample) -> None:
        self.states.append(codec.decode(BaseState, sample.payload, sample.encoding))
