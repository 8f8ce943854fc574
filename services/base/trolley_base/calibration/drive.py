"""Drives a course, rests at each of its places, and notes where the robot was there.

It steers by the map where a localizer knows it: with wheels five per cent unequal a square of one
metre by odometry ends half a metre beside its start, and the next one in the furniture. What the
odometry made of each piece is compared all the same. Where a person measures, the odometry steers.
"""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley import codes
from trolley.geometry import Pose2D, Twist2D, wrap_angle
from trolley.messages import BaseState, Odometry, PoseEstimate
from trolley_base.calibration.course import Place
from trolley_base.upkeep.legs import Leg, OdometryLog

SOURCE = "calibrate"


@dataclass(frozen=True, slots=True)
class CalibrationDriveParams:
    """How long the drive rests, and when it gives up; set by hand."""

    settle_ns: int = 1_000_000_000
    """Time at each place until robot and localizer have settled [ns]."""
    measure_ns: int = 1_000_000_000
    """Time after that over which the mean of the poses is taken [ns]."""
    min_estimates: int = 5
    """Number of poses that a mean needs."""
    still_speed: float = 0.005
    """Speed below which the robot counts as standing [m/s]."""
    still_wz: float = 0.01
    """Turn rate below which the robot counts as standing [rad/s]."""
    map_error_m: float = 0.012
    """Standard deviation of a mean of the localizer's positions at rest [m]."""
    map_error_rad: float = 0.010
    """Standard deviation of a mean of the localizer's headings at rest [rad]."""
    silence_ns: int = 1_000_000_000
    """Longest silence of the odometry [ns]."""
    unsure_ns: int = 2_000_000_000
    """Longest time without a pose that is `localized` [ns]."""
    follow_ns: int = 1_500_000_000
    """Longest time in which base does not take the commands [ns]."""
    max_place_ns: int = 60_000_000_000
    """A place takes longer only when something holds the robot [ns]."""
    stalled_ns: int = 1_000_000_000
    """A robot that is told to move and stands for so long moves no further [ns] ..."""
    stalled_m: float = 0.05
    """... as motors do when told to turn slowly: this near to a place it has reached it [m]."""
    stalled_rad: float = 0.3
    """The same for a heading [rad]."""
    compare_m: float = 0.25
    """Distance after which wheels and localizer are asked in which direction it went [m]."""
    aside_rad: float = 0.8
    """They may differ by this much, as with unequal wheels [rad]."""


PARAMS = CalibrationDriveParams()
SURE = ("localized", "unsure")


@dataclass(frozen=True, slots=True)
class Stop:
    """A rest: a moment in the middle of it, and map_T_base, None without a localizer."""

    stamp_ns: int
    map_T_base: Pose2D | None


class CalibrationDrive:
    """Turns what the robot says into velocities, until the course is driven or given up.

    Args:
        places: one after the other, seen from where the robot stands at the beginning.
        speed_mps: on straights.
        uses_map: whether the localizer's poses steer and measure; else only odometry is used.
    """

    def __init__(self, places: Sequence[Place], speed_mps: float, *, uses_map: bool = True) -> None:
        self.log = OdometryLog()
        self.stops: list[Stop] = []
        """The rest before the first place, and one at each."""
        self.problem: str | None = None
        """Why it was given up."""
        self._places = list(places)
        self._speed_mps = speed_mps
        self._uses_map = uses_map
        self._odometry: Odometry | None = None
        self._base: BaseState | None = None
        self._world_T_odom = Pose2D.identity()
        self._world_T_start: Pose2D | None = None
        self._estimates: deque[tuple[int, Pose2D]] = deque(maxlen=200)
        self._sure_ns: int | None = None
        self._begun_ns: int | None = None
        self._still_ns: int | None = None
        self._leg_ns = 0
        self._is_driving = False
        self._followed_ns: int | None = None
        self._moved_ns = 0

    @property
    def has_ended(self) -> bool:
        """Whether the drive is over."""
        return self.problem is not None or len(self.stops) > len(self._places)

    @property
    def progress(self) -> str:
        """Return the progress, for people."""
        place = max(1, min(len(self.stops), len(self._places)))
        return f"place {place} of {len(self._places)}"

    def update_odometry(self, odometry: Odometry) -> None:
        """Take a message of `odom`."""
        self._odometry = odometry
        self.log.add(odometry)

    def update_base(self, state: BaseState) -> None:
        """Take a message of `base`."""
        self._base = state

    def update_pose(self, estimate: PoseEstimate) -> None:
        """Take a message of `pose`."""
        if not self._uses_map or estimate.pose is None or estimate.state not in SURE:
            return
        if self.log.latest_ns is None:
            return
        if estimate.state == "localized":
            self._sure_ns = estimate.stamp_ns
            self._estimates.append((estimate.stamp_ns, estimate.pose))
        self._world_T_odom = estimate.pose @ self.log.pose_at(estimate.stamp_ns).inverse()
        if self._is_driving:
            problem = self._compare_directions(estimate.stamp_ns, estimate.pose)
            if problem is not None and estimate.state != "localized":
                problem = "the robot is not sure where it is: its pose does not fit its wheels"
            self.problem = self.problem or problem

    def give_up(self, problem: str) -> None:
        """End it, with the reason."""
        self.problem = self.problem or problem

    def step(self, now_ns: int) -> Twist2D:
        """Return the velocity until the next step; zero once it has ended.

        Args:
            now_ns: robot time.
        """
        if self._begun_ns is None:
            self._begun_ns = self._leg_ns = now_ns
        problem = self._find_problem(now_ns)
        if problem is not None:
            self.give_up(problem)
        if self.has_ended or self._odometry is None:
            return Twist2D.zero()
        if not self._is_driving:
            self._rest(now_ns, self._odometry)
            return Twist2D.zero()
        command = self._steer(now_ns, self._odometry)
        if command is None:
            self._is_driving, self._still_ns = False, None
            return Twist2D.zero()
        return command

    def legs(self) -> list[Leg]:
        """Return the pieces between two rests that the localizer measured."""
        found: list[Leg] = []
        for index in range(len(self.stops) - 1):
            steps, moved = self.between(index, index + 1)
            if moved is not None:
                found.append(Leg(steps, moved, PARAMS.map_error_m, PARAMS.map_error_rad))
        return found

    def between(self, first: int, last: int) -> tuple[NDArray[np.float64], Pose2D | None]:
        """Return the odometry between two rests, by their numbers, and what the localizer says.

        The odometry as small arcs (n, 3) x, y [m], turn [rad]; the pose of the last rest seen from
        the first, None without a localizer.
        """
        before, after = self.stops[first], self.stops[last]
        steps = self.log.steps(before.stamp_ns, after.stamp_ns)
        if before.map_T_base is None or after.map_T_base is None:
            return steps, None
        return steps, before.map_T_base.inverse() @ after.map_T_base

    def _compare_directions(self, stamp_ns: int, pose: Pose2D) -> str | None:
        """Say why the robot does not go where its wheels take it: it would go on for long."""
        begin = self.stops[-1]
        assert begin.map_T_base is not None  # set by the rest
        counted = self.log.pose_at(begin.stamp_ns).inverse() @ self.log.pose_at(stamp_ns)
        seen = begin.map_T_base.inverse() @ pose
        counted_m, seen_m = math.hypot(counted.x, counted.y), math.hypot(seen.x, seen.y)
        if counted_m > 2.0 * PARAMS.compare_m > 4.0 * seen_m:
            return (
                "the wheels turn, but the lidar sees no motion: something holds the robot, or "
                "lifts its wheels"
            )
        if min(counted_m, 2.0 * seen_m) < PARAMS.compare_m:
            return None
        aside = wrap_angle(math.atan2(seen.y, seen.x) - math.atan2(counted.y, counted.x))
        if abs(aside) <= PARAMS.aside_rad:
            return None
        side = "left" if aside > 0.0 else "right"
        return (
            f"the lidar sees the robot drive {math.degrees(abs(aside)):.0f}° to the {side} of "
            "where its wheels take it. The lidar's yaw in robot.toml is wrong, or how the "
            "motors are connected; `trolley setup` tells which"
        )

    def _steer(self, now_ns: int, odometry: Odometry) -> Twist2D | None:
        place = self._places[len(self.stops) - 1]
        assert self._world_T_start is not None  # set by the first rest
        world_T_place = self._world_T_start @ place.pose
        place_T_base = world_T_place.inverse() @ self._world_T_odom @ odometry.pose
        if not self._stands(odometry):
            self._moved_ns = now_ns
        if now_ns - self._moved_ns > PARAMS.stalled_ns and place.is_near(
            place_T_base, PARAMS.stalled_m, PARAMS.stalled_rad
        ):
            return None
        return place.command(place_T_base, self._speed_mps)

    @staticmethod
    def _stands(odometry: Odometry) -> bool:
        twist = odometry.twist
        return twist.speed <= PARAMS.still_speed and abs(twist.wz) <= PARAMS.still_wz

    def _rest(self, now_ns: int, odometry: Odometry) -> None:
        """Wait until the robot stands, measure, and go on to the next place."""
        if not self._stands(odometry):
            self._still_ns = None
            return
        if self._still_ns is None:
            self._still_ns = odometry.stamp_ns
        from_ns = self._still_ns + PARAMS.settle_ns
        if odometry.stamp_ns < from_ns + PARAMS.measure_ns:
            return
        poses = [pose for stamp_ns, pose in self._estimates if stamp_ns >= from_ns]
        if self._uses_map and len(poses) < PARAMS.min_estimates:
            return
        mean = _mean(poses) if self._uses_map else None
        self.stops.append(Stop((from_ns + odometry.stamp_ns) // 2, mean))
        if self._world_T_start is None:
            self._world_T_start = odometry.pose if mean is None else mean
        self._is_driving, self._leg_ns, self._followed_ns = True, now_ns, None
        self._moved_ns = now_ns

    def _find_problem(self, now_ns: int) -> str | None:
        """Say why the drive cannot go on, None if it can."""
        assert self._begun_ns is not None
        heard_ns = max(self._begun_ns, self.log.latest_ns or 0)
        if now_ns - heard_ns > PARAMS.silence_ns:
            return "the odometry fell silent"
        if self._uses_map and now_ns - max(self._begun_ns, self._sure_ns or 0) > PARAMS.unsure_ns:
            return "the robot is not sure where it is"
        if now_ns - self._leg_ns > PARAMS.max_place_ns:
            return "the robot makes no progress: something holds it, or it never comes to rest"
        return self._find_base_problem(now_ns)

    def _find_base_problem(self, now_ns: int) -> str | None:
        base = self._base
        if base is None:
            return None
        if base.source not in (None, SOURCE):
            return f"{base.source} has taken over"
        if base.reason == codes.COMMAND_LOST:  # of who drove before
            return None
        if base.mode != "ok":
            return base.message or base.reason or base.mode
        if not self._is_driving:
            return None
        if base.source == SOURCE or self._followed_ns is None:
            self._followed_ns = now_ns
        if now_ns - self._followed_ns > PARAMS.follow_ns:
            return 'base does not accept the commands: is "calibrate" in [base.sources]?'
        return None


def _mean(poses: Sequence[Pose2D]) -> Pose2D:
    count, first = len(poses), poses[0]
    return Pose2D(
        math.fsum(pose.x for pose in poses) / count,
        math.fsum(pose.y for pose in poses) / count,
        wrap_angle(
            first.yaw + math.fsum(wrap_angle(pose.yaw - first.yaw) for pose in poses) / count
        ),
    )
