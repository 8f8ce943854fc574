"""The example's base in the place of Trolley's, which none of the others notices."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.examples import load_example

from trolley import codes, requests, topics
from trolley.codes import Refused
from trolley.config import ConfigError, FootprintConfig, MapSection, RobotConfig, RobotSection
from trolley.config.robot import PoseConfig, StartSection
from trolley.geometry import Pose2D, Twist2D
from trolley.messages import VelocityCommand
from trolley.messages.request_params import Capture, SendGoal
from trolley.runtime.lockstep import Lockstep
from trolley_localizer.service import LocalizerService
from trolley_planner.service import PlannerService
from trolley_tour.service import TourService

WORLDS = Path(__file__).resolve().parents[3] / "worlds"
EXAMPLE: Any = load_example("own_base")
ROUND = FootprintConfig(radius_m=0.15)
START = PoseConfig(x=-2.2, y=-1.8, yaw=0.0)
AHEAD = Twist2D(0.3, 0.0, 0.0)


def config_of(footprint: FootprintConfig = ROUND, start: PoseConfig | None = START) -> RobotConfig:
    """A robot in the room of 6 x 5 m that ships with Trolley."""
    return RobotConfig(
        robot=RobotSection(name="trolley", footprint=footprint),
        map=MapSection(file=str(WORLDS / "room.yaml")),
        start=StartSection(pose=start),
    )


class Stage:
    """The example's base in lock-step, and what it says."""

    def __init__(self, folder: Path) -> None:
        self.lockstep = Lockstep(state=folder, seed=1)
        self.states = self.lockstep.record(topics.BASE)
        self.clocks = self.lockstep.record(topics.CLOCK)
        self.odometry = self.lockstep.record(topics.ODOM)
        self.begin()

    def begin(self, start: PoseConfig = START) -> None:
        """Start the base, perhaps again."""
        self.base = self.lockstep.add(EXAMPLE.OwnBase(config_of(start=start)))

    @property
    def twist(self) -> Twist2D:
        """What the wheels do."""
        return self.base.hardware.twist

    def command(
        self,
        twist: Twist2D = AHEAD,
        source: str = "teleop",
        valid_for: float = 0.3,
        age_s: float = 0.0,
    ) -> None:
        """Send one command and let two periods pass."""
        stamp_ns = self.base.stamp_ns - round(age_s * 1e9)
        message = VelocityCommand(stamp_ns=stamp_ns, twist=twist, valid_for=valid_for)
        self.lockstep.publish(topics.COMMAND, message, source)
        self.lockstep.run(0.04)

    def drive(self, seconds: float, twist: Twist2D = AHEAD) -> None:
        """Send commands for a while."""
        for _ in range(round(seconds / 0.04)):
            self.command(twist)


@pytest.fixture
def stage(tmp_path: Path) -> Iterator[Stage]:
    """A robot near a corner of the room, looking along its wall."""
    made = Stage(tmp_path)
    yield made
    made.lockstep.close()


def test_a_base_of_one_s_own_is_driven_to_a_saved_place(stage: Stage) -> None:
    goals = stage.lockstep.record(topics.GOAL)
    poses = stage.lockstep.record(topics.POSE)
    for service in (LocalizerService, PlannerService, TourService):
        stage.lockstep.add(service(config_of()))
    run_until = stage.lockstep.run_until
    assert run_until(lambda: bool(poses) and poses[-1].state == "localized", 10.0)
    stage.lockstep.ask(requests.POSE_CAPTURE, Capture(name="home"))
    away = Pose2D(-1.6, -1.0, 0.5)
    for goal in (SendGoal(pose=away), SendGoal(name="home")):
        stage.lockstep.ask(requests.GOAL_SEND, goal)
        assert run_until(lambda: goals[-1].state == "arrived", 30.0)
        there = goal.pose or START.as_pose()
        true = START.as_pose() @ stage.base.hardware.odom_T_base
        assert true.distance_to(there) < 0.08
        assert poses[-1].pose is not None
        assert poses[-1].pose.distance_to(true) < 0.03
    stage.lockstep.ask(requests.GOAL_SEND, SendGoal(pose=away))
    assert run_until(lambda: not stage.twist.is_zero, 5.0)
    stage.lockstep.kill("planner")
    stage.lockstep.run(0.25)  # the planner's commands hold for 0.15 s
    assert stage.twist.is_zero
    assert (stage.states[-1].mode, stage.states[-1].source) == ("ok", None)


@pytest.mark.parametrize(
    ("topic", "missing"),
    [
        (topics.CLOCK, ["clock", "scan"]),
        (topics.ROBOT, ["robot"]),
        (topics.TF, ["tf/laser", "pose"]),
        (topics.SCAN, ["scan", "pose"]),
        (topics.ODOM, ["odom", "pose"]),
        (topics.BASE, []),
        (topics.CMD_VEL, []),
    ],
    ids=lambda one: getattr(one, "name", ""),
)
def test_what_the_page_says_is_needed_is_needed(
    tmp_path: Path, topic: topics.Topic[Any], missing: list[str]
) -> None:
    class Without(EXAMPLE.OwnBase):
        def publish(self, which: Any, message: Any, *parts: str, robot: str | None = None) -> None:
            if which is not topic:
                super().publish(which, message, *parts, robot=robot)

    with Lockstep(state=tmp_path, seed=1) as lockstep:
        base = lockstep.add(Without(config_of()))
        for service in (LocalizerService, PlannerService):
            lockstep.add(service(config_of()))
        lockstep.run(3.0)
        goal = SendGoal(pose=Pose2D(-1.6, -1.0, 0.5))
        if missing:
            with pytest.raises(Refused) as refused:
                lockstep.ask(requests.GOAL_SEND, goal)
            assert refused.value.details["missing"] == missing
        else:
            lockstep.ask(requests.GOAL_SEND, goal)
            assert lockstep.run_until(lambda: not base.hardware.twist.is_zero, 2.0)


def test_silence_stops_it(stage: Stage) -> None:
    stage.drive(0.4)
    assert stage.twist.vx > 0.2
    stage.lockstep.run(0.35)
    assert stage.twist.is_zero
    stage.command(valid_for=60.0)
    stage.lockstep.run(0.44)
    assert not stage.twist.is_zero
    stage.lockstep.run(0.06)
    assert stage.twist.is_zero


def test_it_stands_when_it_ends(stage: Stage) -> None:
    stage.drive(0.4)
    stage.lockstep.nodes.pop("base").close()
    assert stage.twist.is_zero
    assert stage.states[-1].reason == codes.SHUTDOWN


def test_a_stop_is_latched_over_a_restart_until_it_is_resumed(stage: Stage) -> None:
    stage.drive(0.4)
    stopped = stage.lockstep.ask(requests.BASE_STOP)
    assert (stopped.mode, stopped.message) == ("stopped", EXAMPLE.STOPPED)
    assert stage.twist.is_zero
    stage.drive(0.2)
    assert stage.twist.is_zero
    stage.lockstep.kill("base")
    stage.begin()
    stage.drive(0.2)
    assert stage.twist.is_zero
    assert stage.lockstep.ask(requests.BASE_RESUME).mode == "ok"
    stage.lockstep.run(0.1)
    assert stage.twist.is_zero  # what was commanded before does not come back
    stage.drive(0.2)
    assert not stage.twist.is_zero


def test_a_wildcard_stops_it_too(stage: Stage) -> None:
    stage.lockstep.get("trolley/*/@do/base/stop")
    assert stage.states[-1].mode == "stopped"


def test_robot_time_never_goes_back(stage: Stage) -> None:
    stage.lockstep.run(5.0)
    stage.lockstep.kill("base")
    last = stage.clocks[-1]
    stage.begin()
    assert stage.clocks[-1].epoch > last.stamp_ns > last.epoch
    assert stage.odometry[-1].stamp_ns >= stage.clocks[-1].epoch


def test_the_source_of_the_highest_priority_drives(stage: Stage) -> None:
    stage.command(Twist2D(0.0, 0.0, 1.0), "planner")
    assert stage.states[-1].source == "planner"
    stage.command(source="teleop")
    stage.command(Twist2D(0.0, 0.0, 1.0), "planner")
    assert stage.states[-1].source == "teleop"


@pytest.mark.parametrize(
    ("why", "command"),
    [
        ("unknown_source", {"source": "stranger"}),
        ("not_valid", {"valid_for": 0.0}),
        ("old", {"age_s": 0.51}),
        ("ahead", {"age_s": -0.3}),
    ],
)
def test_a_command_that_does_not_count_moves_nothing(
    stage: Stage, why: str, command: dict[str, Any]
) -> None:
    stage.lockstep.run(0.6)
    stage.command(**command)
    assert stage.twist.is_zero
    assert stage.lockstep.counters("base")[f"cmd_vel/{why}"] == 1


def test_a_command_that_is_repeated_does_not_hold_for_longer(stage: Stage) -> None:
    message = VelocityCommand(stamp_ns=stage.base.stamp_ns, twist=AHEAD, valid_for=0.2)
    for _ in range(3):
        stage.lockstep.publish(topics.COMMAND, message, "teleop")
        stage.lockstep.run(0.1)
    assert stage.twist.is_zero
    assert stage.lockstep.counters("base")["cmd_vel/out_of_order"] == 2


def test_limits_are_kept(stage: Stage) -> None:
    driven: list[Twist2D] = []
    for _ in range(20):
        stage.command(Twist2D(50.0, 3.0, 150.0))
        driven.append(stage.twist)
    limits = config_of().base.limits
    assert all(one.vx <= limits.max_speed_mps and one.vy == 0.0 for one in driven)
    assert max(one.wz for one in driven) == pytest.approx(limits.max_wz_radps)
    rises = np.diff([0.0, *(one.vx for one in driven)])
    assert rises.max() <= limits.acceleration_mps2 * 0.04 + 1e-9


def test_it_stops_before_a_wall_and_may_drive_back(stage: Stage) -> None:
    stage.drive(15.0, Twist2D(0.5, 0.0, 0.0))
    assert stage.states[-1].reason == codes.STOP_FIELD
    ahead = float(stage.base.hardware.read_lidar()[0])
    assert 0.15 < ahead < 0.15 + 0.05 + 0.05
    stage.drive(0.5, Twist2D(-0.3, 0.0, 0.0))
    assert stage.twist.vx < -0.1


def test_a_wall_close_beside_it_does_not_stop_it(stage: Stage) -> None:
    stage.lockstep.kill("base")
    stage.begin(PoseConfig(x=-2.2, y=-2.5 + 0.15 + 0.03, yaw=0.0))
    stage.drive(1.0)
    assert stage.twist == AHEAD


def test_a_silent_lidar_stops_it(stage: Stage, monkeypatch: pytest.MonkeyPatch) -> None:
    stage.drive(0.4)
    monkeypatch.setattr(stage.base.hardware, "read_lidar", lambda: None)
    stage.drive(0.4)
    assert not stage.twist.is_zero
    stage.drive(0.3)
    assert stage.twist.is_zero
    assert (stage.states[-1].mode, stage.states[-1].reason) == ("held", codes.SCAN_LOST)


def test_a_robot_that_it_cannot_be_is_refused() -> None:
    with pytest.raises(ConfigError, match="radius_m"):
        EXAMPLE.OwnBase(config_of(footprint=FootprintConfig(length_m=0.3, width_m=0.2)))
    with pytest.raises(ConfigError, match="start"):
        EXAMPLE.OwnBase(config_of(start=None))
