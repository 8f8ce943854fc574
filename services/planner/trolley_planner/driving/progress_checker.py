"""Whether the robot gets nearer to its goal, and what is wrong if it does not."""

import math
from dataclasses import dataclass

from trolley import codes
from trolley.config import PlannerConfig
from trolley.geometry import Pose2D, wrap_angle


@dataclass(frozen=True, slots=True)
class ProgressParams:
    """What counts as progress, and as trouble; all by hand."""

    turn_rad: float = 0.5
    """Turn that counts as progress."""
    most_turn_rad: float = 3.0 * math.pi
    """Total turn after which turning no longer counts as progress."""
    slip_wheels_m: float = 0.3
    """Distance driven by the wheels over which slip is judged."""
    slip_share: float = 0.3
    """Share of that distance below which the robot's own motion means that the wheels slip."""
    slow_factor: float = 2.0
    """A robot that is told to drive or turn slowly has this many times as long as that takes."""
    oscillation_m: float = 1.0
    """Distance driven without getting nearer from which on the robot oscillates."""


PROGRESS = ProgressParams()


@dataclass(slots=True)
class _Mark:
    """What was measured when the robot last got nearer."""

    since_ns: int
    remaining_m: float
    pose: Pose2D
    odom: Pose2D
    wheels_m: float = 0.0
    turned_rad: float = 0.0
    yaw: float = 0.0


class ProgressChecker:
    """Compares what is left of the path with what was left some seconds ago."""

    def __init__(self, config: PlannerConfig) -> None:
        self._distance_m = config.progress_distance_m
        self._time_ns = round(config.progress_s * 1e9)
        self._mark: _Mark | None = None
        self._last: tuple[Pose2D, Pose2D] | None = None

    def reset(self) -> None:
        """Start over, as with a new path or after recovery."""
        self._mark = None
        self._last = None

    def check(
        self,
        now_ns: int,
        remaining_m: float,
        frame_T_base: Pose2D,
        odom_T_base: Pose2D,
        max_speed: float = math.inf,
        max_turn: float = math.inf,
    ) -> str | None:
        """Return None while all is well, else the code of what is wrong.

        Args:
            now_ns: robot time.
            remaining_m: what is left of the path.
            frame_T_base: where the robot is by all that is known.
            odom_T_base: where its wheels say it is.
            max_speed: that it may drive at [m/s].
            max_turn: that it may turn at [rad/s].
        """
        mark, last = self._mark, self._last
        self._last = (frame_T_base, odom_T_base)
        if mark is None or last is None:
            self._mark = _Mark(now_ns, remaining_m, frame_T_base, odom_T_base, yaw=frame_T_base.yaw)
            return None
        mark.wheels_m += last[1].distance_to(odom_T_base)
        turn = abs(wrap_angle(frame_T_base.yaw - last[0].yaw))
        mark.turned_rad += turn
        if mark.remaining_m - remaining_m >= self._distance_m:
            self._mark = _Mark(now_ns, remaining_m, frame_T_base, odom_T_base, yaw=frame_T_base.yaw)
            return None
        turned = abs(wrap_angle(frame_T_base.yaw - mark.yaw))
        if turned >= PROGRESS.turn_rad and mark.turned_rad < PROGRESS.most_turn_rad:
            mark.yaw, mark.since_ns = frame_T_base.yaw, now_ns
        # As much to the wrong side first is still progress.
        least_s = max(self._distance_m / max_speed, 2.0 * PROGRESS.turn_rad / max_turn)
        is_late = now_ns - mark.since_ns > max(self._time_ns, PROGRESS.slow_factor * least_s * 1e9)
        return self._trouble(mark) if is_late else None

    def _trouble(self, mark: _Mark) -> str:
        """Say why the robot did not get nearer since `mark`."""
        if self._last is None:
            return codes.BLOCKED
        moved = mark.pose.distance_to(self._last[0])
        driven = mark.odom.distance_to(self._last[1])
        if driven >= PROGRESS.slip_wheels_m and moved < PROGRESS.slip_share * driven:
            return codes.SLIP
        return codes.OSCILLATION if mark.wheels_m >= PROGRESS.oscillation_m else codes.BLOCKED
