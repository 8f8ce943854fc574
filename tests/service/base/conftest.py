"""The base service alone, in lock-step, in small worlds of its own."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from trolley import topics
from trolley.config import RobotConfig
from trolley.geometry import Pose2D, Twist2D
from trolley.gridmap import FREE, OCCUPIED, GridMap, save_map
from trolley.messages import BaseState, Odometry, Truth, VelocityCommand
from trolley.runtime.lockstep import Lockstep
from trolley_base.service import BaseService

EXACT = """
[wheels]
scale_std = 0.0
turn_scale_std = 0.0
slip_per_m = 0.0
yaw_slip_per_m = 0.0
yaw_slip_per_rad = 0.0
[lidar]
noise_m = 0.0
noise_share = 0.0
drop_out = 0.0
invalid = 0.0
"""
REAL = ""

MakeConfig = Callable[..., RobotConfig]


@pytest.fixture
def make_config(tmp_path: Path) -> MakeConfig:
    """Configurations of a 0.30 x 0.24 m robot in a room of 6 x 4 m around the origin."""
    cells = np.full((84, 124), OCCUPIED, dtype=np.int8)
    cells[2:-2, 2:-2] = FREE
    save_map(GridMap("hall", 0.05, Pose2D(-3.1, -2.1, 0.0), cells), tmp_path / "hall.yaml")

    def make(
        things: str = "",
        errors: str = EXACT,
        seed: int = 1,
        name: str = "trolley",
        base: dict[str, Any] | None = None,
        simulated: dict[str, Any] | None = None,
        robot: dict[str, Any] | None = None,
    ) -> RobotConfig:
        text = f'map = "hall.yaml"\nstart = {{x = 0.0, y = 0.0, yaw = 0.0}}\n{things}\n{errors}'
        (tmp_path / "hall.toml").write_text(text)
        plain = {
            "robot": {"name": name, "footprint": {"length_m": 0.3, "width_m": 0.24}}
            | (robot or {}),
            "base": {"simulated": {"world": "hall", "seed": seed} | (simulated or {})}
            | (base or {}),
            "folder": str(tmp_path),
        }
        return msgspec.convert(plain, RobotConfig)

    return make


class Rig:
    """Base in lock-step, with everything it says written down."""

    def __init__(self, config: RobotConfig, state: Path) -> None:
        self.config = config
        self.lockstep = Lockstep(config.robot.name, state=state)
        self.states: list[BaseState] = self.lockstep.record(topics.BASE)
        self.truths: list[Truth] = self.lockstep.record(topics.SIM_TRUTH)
        self.odometry: list[Odometry] = self.lockstep.record(topics.ODOM)
        self.driven: list[VelocityCommand] = self.lockstep.record(topics.CMD_VEL)
        self.base = self.lockstep.add(BaseService(config))

    @property
    def truth(self) -> Truth:
        return self.truths[-1]

    @property
    def state(self) -> BaseState:
        return self.states[-1]

    @property
    def counters(self) -> dict[str, int]:
        return self.lockstep.counters("base")

    @property
    def now_ns(self) -> int:
        """Robot time."""
        return self.base.stamp_ns

    def send(
        self, twist: Twist2D, source: str = "teleop", valid_for: float = 0.3, stamp_ns: int = -1
    ) -> None:
        """One command, stamped now."""
        command = VelocityCommand(
            stamp_ns=self.now_ns if stamp_ns < 0 else stamp_ns, twist=twist, valid_for=valid_for
        )
        self.lockstep.publish(topics.COMMAND, command, source)

    def drive(self, seconds: float, vx: float, wz: float = 0.0, source: str = "teleop") -> None:
        """A source that commands at 10 Hz."""
        for _ in range(round(seconds * 10)):
            self.send(Twist2D(vx, 0.0, wz), source)
            self.run(0.1)

    def run(self, seconds: float) -> None:
        self.lockstep.run(seconds)

    def restart(self, config: RobotConfig | None = None) -> None:
        """As after SIGKILL."""
        self.lockstep.kill("base")
        self.base = self.lockstep.add(BaseService(config or self.config))


MakeRig = Callable[..., Rig]


@pytest.fixture
def make_rig(make_config: MakeConfig, tmp_path: Path) -> Iterator[MakeRig]:
    rigs: list[Rig] = []

    def make(**settings: Any) -> Rig:
        rig = Rig(make_config(**settings), tmp_path / "state")
        rigs.append(rig)
        rig.run(0.2)
        return rig

    yield make
    for rig in rigs:
        rig.lockstep.close()


@pytest.fixture
def rig(make_rig: MakeRig) -> Rig:
    """A robot without errors in the empty room, a moment after its start."""
    return make_rig()
