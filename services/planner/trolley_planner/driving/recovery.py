"""Getting free: tries in rising order, each bounded; the robot gives up when none has helped."""

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum

from trolley.config import PlannerConfig
from trolley.geometry import Pose2D, Twist2D, wrap_angle
from trolley_planner.control.rollout import Limits

CRUMB_M = 0.03


TRAIL_M = 3.0


FREE_AFTER_M = 0.5
"""Who got this much nearer than ever before is free, and the tries begin anew."""


DETOUR_M = 2.0


MAX_DETOURS = 2


MAX_TRIES = 15


EXCUSED = 5
"""After so many times `give_up_s` it gives up, however often it only stood for somebody."""


class Try(Enum):
    """The rungs of the ladder."""

    WAIT = "wait"
    CLEAR = "clear"
    BACK_UP = "back up"
    TURN = "turn"
    REROUTE = "another route"
    WAIT_LONGER = "wait longer"


LADDER = (Try.WAIT, Try.CLEAR, Try.BACK_UP, Try.TURN, Try.REROUTE, Try.WAIT_LONGER)


MOVES = (Try.BACK_UP, Try.TURN, Try.REROUTE)
"""These are tried only where they are possible."""


BACK_SPEED = 0.12


TURN_RATE = 0.7


LOOKBACK_M = 0.12


STUCK_S = 1.0
"""A try that was held up for this long is over,"""


MAX_S = 12.0
"""and each is after this long."""


STANDING_SPEED, STANDING_TURN = 0.02, 0.1


@dataclass(slots=True)
class Trail:
    """The way that the robot came, as odometry poses: it was free a moment ago."""

    crumbs: deque[Pose2D] = field(
        default_factory=lambda: deque[Pose2D](maxlen=round(TRAIL_M / CRUMB_M))
    )

    def drop(self, odom_T_base: Pose2D) -> None:
        """Remember where the robot is."""
        if not self.crumbs or self.crumbs[-1].distance_to(odom_T_base) >= CRUMB_M:
            self.crumbs.append(odom_T_base)

    def back(self, odom_T_base: Pose2D, ahead_m: float) -> Pose2D | None:
        """Return the crumb to steer for on the way back, None at the trail's end.

        Crumbs that were passed again are picked up.
        """
        while self.crumbs and self.crumbs[-1].distance_to(odom_T_base) < ahead_m:
            self.crumbs.pop()
        return self.crumbs[-1] if self.crumbs else None


class Recovery:
    """Which try comes next, and when to give up."""

    def __init__(self, config: PlannerConfig) -> None:
        self._give_up_ns = round(config.give_up_s * 1e9)
        self._patience_ns = round(config.patience_s * 1e9)
        self._rung = -1
        self._since_ns: int | None = None
        self._excused_ns = 0
        self._began_ns = 0
        self._best_m = float("inf")
        self._detours = 0
        self._spent = 0
        self.count = 0
        """Tries since the goal was sent, waits included."""
        self.current: Try | None = None
        """What is being tried."""

    def note_remaining(self, remaining_m: float) -> None:
        """Take what is left of the way: whoever gets on is free."""
        if remaining_m < self._best_m - FREE_AFTER_M:
            self._rung, self._since_ns, self._excused_ns = -1, None, 0
            self._best_m = remaining_m
        elif self._best_m == float("inf"):
            self._best_m = remaining_m

    def note_path(self, remaining_m: float) -> None:
        """Take the length of a new way: a long detour is measured by itself, but not for ever."""
        if remaining_m > self._best_m + DETOUR_M and self._detours < MAX_DETOURS:
            self._detours += 1
            self._best_m = remaining_m

    def begin(self, now_ns: int, is_possible: Callable[[Try], bool]) -> Try | None:
        """Begin the next try that is possible; None when it is time to give up.

        Args:
            now_ns: robot time.
            is_possible: asked before a try that moves the robot or changes its way.
        """
        if self._since_ns is None:
            self._since_ns = now_ns
        lasted_ns = now_ns - self._since_ns
        own_ns = lasted_ns - self._excused_ns
        is_enough = own_ns > self._give_up_ns or lasted_ns > EXCUSED * self._give_up_ns
        if is_enough or self._spent >= MAX_TRIES:
            return None
        self._rung = min(self._rung + 1, len(LADDER) - 1)
        while LADDER[self._rung] in MOVES and not is_possible(LADDER[self._rung]):
            self._rung += 1
        self._began_ns = now_ns
        self.count += 1
        self._spent += 1
        self.current = LADDER[self._rung]
        return self.current

    def end(self) -> None:
        """End the current try."""
        self.current = None

    def forgive(self, now_ns: int) -> None:
        """End a wait for something that went away by itself: it was no try, nor is its time."""
        self._spent -= 1
        self._rung -= 1
        self.excuse(now_ns - self._began_ns)
        self.end()

    def excuse(self, time_ns: int) -> None:
        """Leave out a time in which the robot stood for somebody."""
        if self._since_ns is not None:
            self._excused_ns += time_ns

    def elapsed_s(self, now_ns: int) -> float:
        """Return how long the current try has lasted [s]."""
        return (now_ns - self._began_ns) * 1e-9

    def is_patient(self, now_ns: int) -> bool:
        """Say whether the current wait goes on."""
        factor = 2 if self.current is Try.WAIT_LONGER else 1
        return now_ns - self._began_ns < factor * self._patience_ns


class Hold:
    """Notices that a try does not get on."""

    def __init__(self) -> None:
        self._held_s = 0.0
        self._elapsed_s = 0.0

    def note(self, driven: Twist2D, elapsed_s: float) -> None:
        """Take what of a command was safe to drive."""
        stands = abs(driven.vx) < STANDING_SPEED and abs(driven.wz) < STANDING_TURN
        self._held_s = self._held_s + elapsed_s if stands else 0.0
        self._elapsed_s += elapsed_s

    @property
    def is_over(self) -> bool:
        """Whether it was held up for too long, or takes too long."""
        return self._held_s > STUCK_S or self._elapsed_s > MAX_S


def free_turn(can_turn: Callable[[float], bool], bearing: float) -> float | None:
    """Return by how much to turn to look round [rad], begun towards a bearing; None for no room.

    Args:
        can_turn: says whether there is room for a turn by an angle [rad].
        bearing: of the way that is left, from the robot's heading [rad].
    """
    for size in (2.0 * math.pi, math.pi, 0.5 * math.pi):
        for turn in (math.copysign(size, bearing), -math.copysign(size, bearing)):
            if can_turn(turn):
                return turn
    return None


class BackUp:
    """Drives backwards the way the robot came.

    Args:
        start: odom_T_base at the beginning.
        length_m: how far at most.
    """

    def __init__(self, start: Pose2D, length_m: float) -> None:
        self._start = start
        self._length_m = length_m
        self._hold = Hold()

    def command(self, odom_T_base: Pose2D, trail: Trail, limits: Limits) -> Twist2D | None:
        """Return the velocity to drive now, None when it is over."""
        if odom_T_base.distance_to(self._start) >= self._length_m or self._hold.is_over:
            return None
        crumb = trail.back(odom_T_base, LOOKBACK_M)
        if crumb is None:
            return None
        behind = odom_T_base.inverse() @ crumb
        bearing = wrap_angle(math.atan2(behind.y, behind.x) + math.pi)
        if abs(bearing) > 0.5 * math.pi:
            return None  # The trail lies ahead: there is no way back along it.
        turn = min(max(1.5 * bearing, -0.5), 0.5)
        return Twist2D(-min(BACK_SPEED, limits.max_reverse), 0.0, turn)

    def note(self, driven: Twist2D, elapsed_s: float) -> None:
        """Take what of the command was safe to drive."""
        self._hold.note(driven, elapsed_s)


class TurnRound:
    """Turns in place by a given angle.

    Args:
        start: odom_T_base at the beginning.
        angle: to turn by [rad], positive to the left.
    """

    def __init__(self, start: Pose2D, angle: float) -> None:
        self._last_yaw = start.yaw
        self._angle = angle
        self._turned = 0.0
        self._hold = Hold()

    def command(self, odom_T_base: Pose2D, limits: Limits) -> Twist2D | None:
        """Return the velocity to drive now, None when it is over."""
        self._turned += wrap_angle(odom_T_base.yaw - self._last_yaw)
        self._last_yaw = odom_T_base.yaw
        left = abs(self._angle) - math.copysign(1.0, self._angle) * self._turned
        if left <= 0.05 or self._hold.is_over:
            return None
        rate = min(TURN_RATE, limits.max_turn, max(0.15, 1.5 * left))
        return Twist2D(0.0, 0.0, math.copysign(rate, self._angle))

    def note(self, driven: Twist2D, elapsed_s: float) -> None:
        """Take what of the command was safe to drive."""
        self._hold.note(driven, elapsed_s)
