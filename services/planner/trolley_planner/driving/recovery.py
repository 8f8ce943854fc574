"""Recovery: actions of rising effort, each bounded; the robot gives up when none has helped."""

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum

from trolley.config import PlannerConfig
from trolley.geometry import Pose2D, Twist2D, wrap_angle
from trolley_planner.control.rollout import Limits


@dataclass(frozen=True, slots=True)
class RecoveryParams:
    """Bounds of recovery, and how the robot moves meanwhile; all by hand."""

    crumb_m: float = 0.03
    """Distance between two remembered poses of the robot's track."""
    track_m: float = 3.0
    """Length of the track that is remembered."""
    free_after_m: float = 0.5
    """A robot that got this much nearer to the goal than ever is free: the actions start over."""
    detour_m: float = 2.0
    """A new path longer by this is a detour, on which progress is measured anew,"""
    most_detours: int = 2
    """at most this often."""
    most_actions: int = 15
    """Actions for one goal; then it has failed."""
    excused_factor: int = 5
    """After this many times `give_up_s` the goal fails, even if the robot only stood for people."""
    settle_s: float = 0.5
    """A wait, or a second look, lasts at least this long: time for two scans or so."""
    backing_mps: float = 0.12
    """Speed of backing up."""
    lookback_m: float = 0.12
    """Backing up steers for the track this far behind."""
    spin_radps: float = 0.7
    """Turn rate of a spin."""
    stalled_s: float = 1.0
    """A motion that was held up for this long is over,"""
    longest_s: float = 12.0
    """and each is after this long."""
    standing_mps: float = 0.02
    """A motion is held up while the robot is slower than this"""
    standing_radps: float = 0.1
    """and turns slower than this."""


RECOVERY = RecoveryParams()


class RecoveryAction(Enum):
    """What is tried to get free."""

    WAIT = "wait"
    CLEAR = "clear"
    BACK_UP = "back up"
    TURN = "turn"
    REROUTE = "another route"
    WAIT_LONGER = "wait longer"


RECOVERY_SEQUENCE = (
    RecoveryAction.WAIT,
    RecoveryAction.CLEAR,
    RecoveryAction.BACK_UP,
    RecoveryAction.TURN,
    RecoveryAction.REROUTE,
    RecoveryAction.WAIT_LONGER,
)
"""The order in which they are tried; the last is repeated."""
MOVES = (RecoveryAction.BACK_UP, RecoveryAction.TURN, RecoveryAction.REROUTE)
"""These are left out where they are not possible."""


@dataclass(slots=True)
class Breadcrumbs:
    """The robot's track as odometry poses: it was free a moment ago."""

    crumbs: deque[Pose2D] = field(
        default_factory=lambda: deque[Pose2D](maxlen=round(RECOVERY.track_m / RECOVERY.crumb_m))
    )

    def drop(self, odom_T_base: Pose2D) -> None:
        """Remember where the robot is."""
        if not self.crumbs or self.crumbs[-1].distance_to(odom_T_base) >= RECOVERY.crumb_m:
            self.crumbs.append(odom_T_base)

    def backtrack(self, odom_T_base: Pose2D, ahead_m: float) -> Pose2D | None:
        """Return the crumb to steer for on the way back, None at the track's end.

        Crumbs that were passed again are picked up.
        """
        while self.crumbs and self.crumbs[-1].distance_to(odom_T_base) < ahead_m:
            self.crumbs.pop()
        return self.crumbs[-1] if self.crumbs else None


class Recovery:
    """Which recovery action comes next, and when to give up."""

    def __init__(self, config: PlannerConfig) -> None:
        self._give_up_ns = round(config.give_up_s * 1e9)
        self._patience_ns = round(config.patience_s * 1e9)
        self._step = -1
        self._since_ns: int | None = None
        self._excused_ns = 0
        self._began_ns = 0
        self._best_m = math.inf
        self._num_detours = 0
        self._num_spent = 0
        self.count = 0
        """Actions since the goal was sent, waits included."""
        self.current: RecoveryAction | None = None
        """What is being tried."""

    def update_remaining(self, remaining_m: float) -> None:
        """Note the length of the path that is left: a robot that gets on is free."""
        if remaining_m < self._best_m - RECOVERY.free_after_m:
            self._step, self._since_ns, self._excused_ns = -1, None, 0
            self._best_m = remaining_m
        elif math.isinf(self._best_m):
            self._best_m = remaining_m

    def update_path_length(self, remaining_m: float) -> None:
        """Note the length of a new path: a long detour is measured by itself, but not forever."""
        is_detour = remaining_m > self._best_m + RECOVERY.detour_m
        if is_detour and self._num_detours < RECOVERY.most_detours:
            self._num_detours += 1
            self._best_m = remaining_m

    def begin_next(
        self, now_ns: int, is_possible: Callable[[RecoveryAction], bool]
    ) -> RecoveryAction | None:
        """Begin the next action that is possible; None when it is time to give up.

        Args:
            now_ns: robot time.
            is_possible: asked before an action that moves the robot or changes its path.
        """
        if self._since_ns is None:
            self._since_ns = now_ns
        lasted_ns = now_ns - self._since_ns
        own_ns = lasted_ns - self._excused_ns
        longest_ns = RECOVERY.excused_factor * self._give_up_ns
        is_enough = own_ns > self._give_up_ns or lasted_ns > longest_ns
        if is_enough or self._num_spent >= RECOVERY.most_actions:
            return None
        self._step = min(self._step + 1, len(RECOVERY_SEQUENCE) - 1)
        while RECOVERY_SEQUENCE[self._step] in MOVES and not is_possible(
            RECOVERY_SEQUENCE[self._step]
        ):
            self._step += 1
        self._began_ns = now_ns
        self.count += 1
        self._num_spent += 1
        self.current = RECOVERY_SEQUENCE[self._step]
        return self.current

    def end(self) -> None:
        """End the current action."""
        self.current = None

    def forgive(self, now_ns: int) -> None:
        """End a wait for something that went away by itself: neither it nor its time counts."""
        self._num_spent -= 1
        self._step -= 1
        self.excuse(now_ns - self._began_ns)
        self.end()

    def excuse(self, time_ns: int) -> None:
        """Leave out a time in which the robot stood for somebody."""
        if self._since_ns is not None:
            self._excused_ns += time_ns

    def elapsed_s(self, now_ns: int) -> float:
        """Return how long the current action has lasted [s]."""
        return (now_ns - self._began_ns) * 1e-9

    def is_patient(self, now_ns: int) -> bool:
        """Say whether the current wait goes on."""
        factor = 2 if self.current is RecoveryAction.WAIT_LONGER else 1
        return now_ns - self._began_ns < factor * self._patience_ns


@dataclass(frozen=True, slots=True)
class Wait:
    """Stands until the path is free, or patience ends."""

    is_blocked: bool
    """Whether something kept the robot from driving on when the wait began."""


@dataclass(frozen=True, slots=True)
class LookAgain:
    """Stands until scans show what is really there."""


class StallDetector:
    """Notices that a motion is held up, or takes too long."""

    def __init__(self) -> None:
        self._stalled_s = 0.0
        self._elapsed_s = 0.0

    def update(self, driven: Twist2D, elapsed_s: float) -> None:
        """Note what of a command was safe to drive."""
        stands = abs(driven.vx) < RECOVERY.standing_mps and abs(driven.wz) < RECOVERY.standing_radps
        self._stalled_s = self._stalled_s + elapsed_s if stands else 0.0
        self._elapsed_s += elapsed_s

    @property
    def is_over(self) -> bool:
        """Whether the motion must end."""
        return self._stalled_s > RECOVERY.stalled_s or self._elapsed_s > RECOVERY.longest_s


class BackUp:
    """Drives backwards along the robot's own track.

    Args:
        start: odom_T_base at the beginning.
        length_m: how far at most.
    """

    def __init__(self, start: Pose2D, length_m: float) -> None:
        self._start = start
        self._length_m = length_m
        self._stall = StallDetector()

    def command(self, odom_T_base: Pose2D, trail: Breadcrumbs, limits: Limits) -> Twist2D | None:
        """Return the velocity to drive now, None when it is over."""
        if odom_T_base.distance_to(self._start) >= self._length_m or self._stall.is_over:
            return None
        crumb = trail.backtrack(odom_T_base, RECOVERY.lookback_m)
        if crumb is None:
            return None
        behind = odom_T_base.inverse() @ crumb
        bearing = wrap_angle(math.atan2(behind.y, behind.x) + math.pi)
        if abs(bearing) > 0.5 * math.pi:
            return None  # The track lies ahead: there is no way back along it.
        turn = min(max(1.5 * bearing, -0.5), 0.5)
        return Twist2D(-min(RECOVERY.backing_mps, limits.max_reverse), 0.0, turn)

    def update(self, driven: Twist2D, elapsed_s: float) -> None:
        """Note what of the command was safe to drive."""
        self._stall.update(driven, elapsed_s)


class Spin:
    """Turns in place by a given angle.

    Args:
        start: odom_T_base at the beginning.
        angle: to turn by [rad], positive to the left.
    """

    def __init__(self, start: Pose2D, angle: float) -> None:
        self._last_yaw = start.yaw
        self._angle = angle
        self._turned = 0.0
        self._stall = StallDetector()

    def command(self, odom_T_base: Pose2D, limits: Limits) -> Twist2D | None:
        """Return the velocity to drive now, None when it is over."""
        self._turned += wrap_angle(odom_T_base.yaw - self._last_yaw)
        self._last_yaw = odom_T_base.yaw
        left = abs(self._angle) - math.copysign(1.0, self._angle) * self._turned
        if left <= 0.05 or self._stall.is_over:
            return None
        rate = min(RECOVERY.spin_radps, limits.max_turn, max(0.15, 1.5 * left))
        return Twist2D(0.0, 0.0, math.copysign(rate, self._angle))

    def update(self, driven: Twist2D, elapsed_s: float) -> None:
        """Note what of the command was safe to drive."""
        self._stall.update(driven, elapsed_s)


def free_turn(can_turn: Callable[[float], bool], bearing: float) -> float | None:
    """Return by how much to turn to look around [rad], towards a bearing first; None for no room.

    Args:
        can_turn: says whether there is room for a turn by an angle [rad].
        bearing: of the path ahead, from the robot's heading [rad].
    """
    for size in (2.0 * math.pi, math.pi, 0.5 * math.pi):
        for turn in (math.copysign(size, bearing), -math.copysign(size, bearing)):
            if can_turn(turn):
                return turn
    return None
