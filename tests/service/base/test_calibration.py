"""The calibration's drive with base and localizer in lock-step: it finds errors that were planted.

Slip and the spread of the default world stay on.
"""

import math
from collections.abc import Iterator
from pathlib import Path

import pytest
from bench.harness.drives import make_config
from msgspec.structs import replace
from support.samples import make_estimate

from trolley import codes, requests, topics
from trolley.config import RobotConfig
from trolley.geometry import Pose2D, Twist2D
from trolley.messages import BaseState, Odometry, PoseEstimate, VelocityCommand
from trolley.messages.mapping import PoseState
from trolley.runtime.lockstep import Lockstep
from trolley.runtime.service import Service, every, on
from trolley_base.calibration import (
    CalibrationDrive,
    Comparison,
    Correction,
    Leg,
    Return,
    benchmark,
    combined,
    estimate,
    square,
    squares_both_ways,
)
from trolley_base.odometry.wheel_scales import WheelScales, scales_of
from trolley_base.service import BaseService
from trolley_localizer.service import LocalizerService

WORLDS = Path(__file__).resolve().parents[3] / "worlds"
START = Pose2D(-2.2, -1.8, 0.0)
TRACK_M = 0.2
SIDE_M = 1.0


class Calibrating(Service):
    """What the command line does, in lock-step."""

    name = "calibrating"

    def __init__(self, drive: CalibrationDrive, comparison: Comparison | None = None) -> None:
        self.drive = drive
        self.comparison = comparison
        self.is_on = False

    @on(topics.ODOM)
    def update_odometry(self, odometry: Odometry) -> None:
        self.drive.update_odometry(odometry)
        if self.comparison is not None:
            self.comparison.update_odometry(odometry)

    @on(topics.POSE)
    def update_pose(self, pose: PoseEstimate) -> None:
        self.drive.update_pose(pose)
        if self.comparison is not None:
            self.comparison.update_pose(pose)

    @on(topics.BASE)
    def update_base(self, state: BaseState) -> None:
        self.drive.update_base(state)

    @every(0.05)
    def step(self) -> None:
        if self.is_on and not self.drive.has_ended:
            twist = self.drive.step(self.stamp_ns)
            command = VelocityCommand(stamp_ns=self.stamp_ns, twist=twist, valid_for=0.3)
            self.publish(topics.COMMAND, command, "calibrate")


class Room:
    """Base, localizer and the calibration in the room, with planted errors."""

    def __init__(
        self,
        folder: Path,
        seed: int,
        wheels: dict[str, float],
        odometry: dict[str, float] | None = None,
        start: Pose2D = START,
        things: str = "",
    ) -> None:
        exact = {"scale_std": 0.0, "turn_scale_std": 0.0}  # slip stays on
        errors = "\n".join(f"{name} = {value}" for name, value in (exact | wheels).items())
        world = folder / "wrong.toml"
        world.write_text(
            f'map = "{WORLDS / "room.yaml"}"\n'
            f"start = {{ x = {start.x}, y = {start.y}, yaw = {start.yaw} }}\n"
            f"{things}[wheels]\n{errors}\n"
        )
        scales = "\n".join(f"{name} = {value}" for name, value in (odometry or {}).items())
        rest = f'[base.simulated]\nworld = "{world}"\nseed = {seed}\n[base.odometry]\n{scales}\n'
        self.config: RobotConfig = make_config(WORLDS / "room.yaml", start, rest)
        self.lockstep = Lockstep(self.config.robot.name, seed)
        self.truths = self.lockstep.record(topics.SIM_TRUTH)
        self.poses = self.lockstep.record(topics.POSE)
        self.states = self.lockstep.record(topics.BASE)
        self.driven = self.lockstep.record(topics.CMD_VEL)
        self.base = self.lockstep.add(BaseService(self.config))
        self.lockstep.add(LocalizerService(self.config))
        is_localized = self.lockstep.run_until(
            lambda: bool(self.poses) and self.poses[-1].state == "localized", 20.0
        )
        assert is_localized

    def calibrate(
        self, drive: CalibrationDrive, comparison: Comparison | None = None
    ) -> Calibrating:
        service = self.lockstep.add(Calibrating(drive, comparison))
        self.lockstep.run(0.5)
        service.is_on = True
        return service


def true_scales(wheels: dict[str, float]) -> WheelScales:
    """What a perfect calibration of such wheels says."""
    left, right = wheels.get("left_scale", 1.0), wheels.get("right_scale", 1.0)
    mean = 0.5 * (1.0 / left + 1.0 / right)
    return WheelScales(
        linear=mean,
        angular=mean / wheels.get("turn_scale", 1.0),
        wheel_ratio=left / right,
        track_m=TRACK_M,
    )


PLANTED = {
    "left": {"left_scale": 1.05},
    "right": {"right_scale": 1.05},
    "both": {"left_scale": 0.95, "right_scale": 0.95},
    "turn": {"turn_scale": 1.05},
    "all": {"left_scale": 1.05, "right_scale": 0.97, "turn_scale": 0.95},
}


def check(scales: WheelScales, wheels: dict[str, float]) -> None:
    true = true_scales(wheels)
    assert scales.linear == pytest.approx(true.linear, abs=0.01)
    assert scales.angular == pytest.approx(true.angular, abs=0.01)
    assert scales.wheel_ratio == pytest.approx(true.wheel_ratio, abs=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("kind", PLANTED)
def test_squares_find_the_planted_errors_within_a_hundredth(tmp_path: Path, kind: str) -> None:
    room, course = Room(tmp_path, 7, PLANTED[kind]), squares_both_ways(SIDE_M, 1)
    drive = CalibrationDrive(course.places, 0.2)
    with room.lockstep:
        room.calibrate(drive)
        assert room.lockstep.run_until(lambda: drive.has_ended, 600.0)
    assert drive.problem is None
    found = estimate(drive.legs())
    check(combined(found.correction, WheelScales(track_m=TRACK_M)), PLANTED[kind])
    assert room.truths[-1].collisions == 0
    # The squares' ends were apart by odometry and are together after the correction.
    before, after = (
        benchmark(
            [
                Return(direction, moved, correction.integrate(steps))
                for direction, first, last in course.squares
                for steps, moved in [drive.between(first, last)]
                if moved is not None
            ],
            SIDE_M,
        )
        for correction in (Correction(), found.correction)
    )
    assert after.largest_m < 0.08
    if kind != "both":  # the size of a square does not move its end
        assert after.largest_m < 0.4 * before.largest_m


@pytest.mark.slow
def test_a_second_calibration_finds_what_the_first_left(tmp_path: Path) -> None:
    """Scales in force are half right; what is found is joined with them."""
    wheels = PLANTED["all"]
    half = {"linear_scale": 1.01, "angular_scale": 1.02, "wheel_ratio": 1.04, "track_m": TRACK_M}
    room, course = Room(tmp_path, 3, wheels, half), squares_both_ways(SIDE_M, 2)
    drive = CalibrationDrive(course.places, 0.2)
    with room.lockstep:
        room.calibrate(drive)
        assert room.lockstep.run_until(lambda: drive.has_ended, 600.0)
    assert drive.problem is None
    check(combined(estimate(drive.legs()).correction, scales_of(room.config)), wheels)


@pytest.mark.slow
def test_listening_to_a_drive_finds_the_planted_errors(tmp_path: Path) -> None:
    wheels = PLANTED["turn"] | {"left_scale": 1.03}
    room, comparison = Room(tmp_path, 5, wheels), Comparison()
    drive = CalibrationDrive(squares_both_ways(1.5, 2).places, 0.4)
    with room.lockstep:
        room.calibrate(drive, comparison)
        assert room.lockstep.run_until(lambda: drive.has_ended, 900.0)
    found = estimate(comparison.legs)
    check(combined(found.correction, WheelScales(track_m=TRACK_M)), wheels)
    assert max(found.linear_std, found.angular_std) < 0.01


@pytest.mark.slow
def test_squares_measured_by_hand_find_turn_and_bend(tmp_path: Path) -> None:
    """By odometry alone; the truth stands in for the tape measure, and gives no heading."""
    wheels = {"left_scale": 1.02, "turn_scale": 1.02}
    legs: list[Leg] = []
    for seed, direction in enumerate(("ccw", "cw") * 3):
        start = START if direction == "ccw" else START @ Pose2D(0.0, 1.2, 0.0)
        room = Room(tmp_path, seed, wheels, start=start)
        drive = CalibrationDrive(square(1.2, direction), 0.2, uses_map=False)
        with room.lockstep:
            mark = room.truths[-1].pose
            room.calibrate(drive)
            assert room.lockstep.run_until(lambda d=drive: d.has_ended, 200.0)
            end = mark.inverse() @ room.truths[-1].pose
        assert drive.problem is None
        steps, moved = drive.between(0, 8)
        assert moved is None
        legs.append(Leg(steps, end, 0.01, math.inf))
    found = estimate(legs, by_hand=True).correction
    true = true_scales(wheels)
    assert found.angular == pytest.approx(true.angular, abs=0.01)
    scales = combined(found, WheelScales(track_m=TRACK_M))
    assert scales.wheel_ratio == pytest.approx(true.wheel_ratio, abs=0.005)


def test_motors_that_do_not_turn_slowly_hold_nothing_up(tmp_path: Path) -> None:
    """The last tenth of each turn is too slow for them."""
    room = Room(tmp_path, 1, {}, things="[motors]\ndead_band_mps = 0.03\n")
    drive = CalibrationDrive(squares_both_ways(0.5, 1).places[:3], 0.2)
    with room.lockstep:
        room.calibrate(drive)
        assert room.lockstep.run_until(lambda: drive.has_ended, 100.0)
    assert drive.problem is None


@pytest.mark.parametrize(
    ("share_seen", "why"),
    [
        pytest.param(1.0, "sees the robot drive 90° to the left", id="its lidar is turned"),
        pytest.param(0.0, "the lidar sees no motion", id="something holds it"),
    ],
)
def test_a_robot_that_does_not_go_where_its_wheels_take_it_is_stopped(
    share_seen: float, why: str
) -> None:
    assert why in went_aside(share_seen)


def went_aside(share_seen: float, state: PoseState = "localized") -> str:
    """Why a drive is given up on which the localizer sees the robot go to the left, if at all."""
    drive = CalibrationDrive(squares_both_ways(SIDE_M, 1).places, 0.2)
    counted, now_ns, twist = 0.0, 0, Twist2D.zero()
    while not drive.has_ended and counted < SIDE_M:
        now_ns, counted = now_ns + 50_000_000, counted + 0.05 * twist.vx
        drive.update_odometry(
            Odometry(stamp_ns=now_ns, pose=Pose2D(counted, 0.0, 0.0), twist=twist)
        )
        seen = Pose2D(0.0, share_seen * counted, 0.0)
        is_seen = not drive.stops or counted < 0.1
        said = replace(make_estimate(now_ns), pose=seen, state="localized" if is_seen else state)
        drive.update_pose(said)
        twist = drive.step(now_ns)
    assert twist.is_zero
    assert counted < 0.6
    return drive.problem or ""


@pytest.mark.parametrize("share_seen", [1.0, 0.0])
def test_a_pose_that_is_unsure_blames_neither_lidar_nor_wheels(share_seen: float) -> None:
    assert "is not sure where it is" in went_aside(share_seen, "unsure")


class Driving:
    """A calibration under way in the room."""

    def __init__(self, folder: Path) -> None:
        self.room = Room(folder, 1, {})
        self.drive = CalibrationDrive(squares_both_ways(SIDE_M, 1).places, 0.2)
        self.room.calibrate(self.drive)
        self.room.lockstep.run(5.0)
        assert self.room.driven[-1].twist.vx > 0.1

    def ends(self, seconds: float) -> str | None:
        """Let time pass until it is given up and the robot stands; the reason."""
        assert self.room.lockstep.run_until(lambda: self.drive.has_ended, seconds)
        self.room.lockstep.run(1.0)
        assert self.room.truths[-1].twist.vx == pytest.approx(0.0, abs=0.01)
        return self.drive.problem


@pytest.fixture
def driving(tmp_path: Path) -> Iterator[Driving]:
    made = Driving(tmp_path)
    yield made
    made.room.lockstep.close()


def test_a_hand_on_teleop_ends_it(driving: Driving) -> None:
    room = driving.room
    stamp_ns = room.base.stamp_ns
    command = VelocityCommand(stamp_ns=stamp_ns, twist=Twist2D.zero(), valid_for=0.5)
    room.lockstep.publish(topics.COMMAND, command, "teleop")
    assert driving.ends(1.0) == "teleop has taken over"


def test_a_stop_ends_it(driving: Driving) -> None:
    driving.room.lockstep.ask(requests.BASE_STOP)
    assert "Stopped" in (driving.ends(1.0) or "")


def test_a_lost_pose_ends_it(driving: Driving) -> None:
    driving.room.lockstep.kill("localizer")
    assert driving.ends(4.0) == "the robot is not sure where it is"


def test_silent_odometry_ends_it(driving: Driving) -> None:
    driving.room.lockstep.kill("base")
    driving.room.lockstep.run(0.5)
    for _ in range(40):
        twist = driving.drive.step(driving.room.base.stamp_ns + 2_000_000_000)
    assert twist.is_zero
    assert driving.drive.problem == "the odometry fell silent"


def test_what_stands_in_the_way_ends_it(tmp_path: Path) -> None:
    box = "[[box]]\nx = -1.4\ny = -1.8\nlength_m = 0.2\nwidth_m = 0.2\n"
    room = Room(tmp_path, 1, {}, things=box)
    drive = CalibrationDrive(squares_both_ways(SIDE_M, 1).places, 0.2)
    with room.lockstep:
        room.calibrate(drive)
        assert room.lockstep.run_until(lambda: drive.has_ended, 30.0)
    assert drive.problem == codes.SENTENCES[codes.STOP_FIELD]
    assert room.truths[-1].collisions == 0
