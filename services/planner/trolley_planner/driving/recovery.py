"""What keeps the robot from its goal, how that is noticed, and what it does about it.

It waits while a person who came to it touches it. Where it does not get nearer it recovers: by
actions of rising effort, each bounded; it gives up when none has helped.
"""

import math
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from trolley import codes
from trolley.config import PlannerConfig
from trolley.geometry import Pose2D, Twist2D, wrap_angle
from trolley.geometry.polygon import distance_to_outline
from trolley_planner.control.rollout import Limits
from trolley_planner.costmap.footprint import Footprint
from trolley_planner.people import TrackedPerson
from trolley_planner.sensing.beams import DX, DY, ECHO, X, Y


@dataclass(frozen=True, slots=True)
class ProgressParams:
    """What counts as progress, and as trouble; all by hand."""

    turn_rad: float = 0.5
    """A turn by this much is progress, too,"""
    most_turn_rad: float = 3.0 * math.pi
    """but not without end."""
    slip_wheels_m: float = 0.3
    """Wheels that drove this far"""
    slip_share: float = 0.3
    """while the robot moved less than this share of it are slipping."""
    oscillation_m: float = 1.0
    """A robot that drove this far without getting nearer goes back and forth."""


PROGRESS = ProgressParams()


@dataclass(slots=True)
class _Mark:
    """What was measured when the robot last got nearer."""

    since_ns: int
    remaining_m: float
    pose: Pose2D
    odom: Pose2D
    travelled_m: float = 0.0
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
        """Begin anew, as with a new path or after a try to get free."""
        self._mark = None
        self._last = None

    def check(
        self, now_ns: int, remaining_m: float, frame_T_base: Pose2D, odom_T_base: Pose2D
    ) -> str | None:
        """Return None while all is well, else the code of what is wrong.

        Args:
            now_ns: robot time.
            remaining_m: what is left of the path.
            frame_T_base: where the robot is by all that is known.
            odom_T_base: where its wheels say it is.
        """
        mark, last = self._mark, self._last
        self._last = (frame_T_base, odom_T_base)
        if mark is None or last is None:
            self._mark = _Mark(now_ns, remaining_m, frame_T_base, odom_T_base, yaw=frame_T_base.yaw)
            return None
        mark.travelled_m += last[0].distance_to(frame_T_base)
        mark.wheels_m += last[1].distance_to(odom_T_base)
        turn = abs(wrap_angle(frame_T_base.yaw - last[0].yaw))
        mark.turned_rad += turn
        if mark.remaining_m - remaining_m >= self._distance_m:
            self._mark = _Mark(now_ns, remaining_m, frame_T_base, odom_T_base, yaw=frame_T_base.yaw)
            return None
        turned = abs(wrap_angle(frame_T_base.yaw - mark.yaw))
        if turned >= PROGRESS.turn_rad and mark.turned_rad < PROGRESS.most_turn_rad:
            mark.yaw, mark.since_ns = frame_T_base.yaw, now_ns
        return self._trouble(mark) if now_ns - mark.since_ns > self._time_ns else None

    def _trouble(self, mark: _Mark) -> str:
        """Say why the robot did not get nearer since `mark`."""
        if self._last is None:
            return codes.BLOCKED
        moved = mark.pose.distance_to(self._last[0])
        driven = mark.odom.distance_to(self._last[1])
        if driven >= PROGRESS.slip_wheels_m and moved < PROGRESS.slip_share * driven:
            return codes.SLIP
        return codes.OSCILLATION if mark.wheels_m >= PROGRESS.oscillation_m else codes.BLOCKED


@dataclass(frozen=True, slots=True)
class ContactParams:
    """When the robot stands still because somebody touches it; by hand."""

    touch_m: float = 0.06
    """Something nearer to the outline than this counts as touching: it includes the lidar's
    noise."""
    came_m: float = 0.4
    """Whoever moved this near to the outline"""
    lately_s: float = 1.0
    """within this time is taken to be who touches it now,"""
    same_m: float = 0.3
    """if what touches it is this near to where they were, and not a wall beside the robot."""


CONTACT = ContactParams()


class ContactHold:
    """Tells people who came to the robot from what the robot drove up to.

    People who walked into a robot step around it when it stands, and walk into it again when it
    moves: so it waits for them to leave. It does not wait for what it drove up to, nor forever.

    Args:
        footprint: of the robot.
        patience_s: how long it stands for the same touch at most.
    """

    def __init__(self, footprint: Footprint, patience_s: float) -> None:
        self._footprint = footprint
        self._patience_ns = round(patience_s * 1e9)
        self._came_ns: int | None = None
        self._came = np.empty((0, 2))
        self._since_ns: int | None = None
        self._is_touched = False

    def update(
        self, now_ns: int, beams: NDArray[np.float64], people: Sequence[TrackedPerson], pose: Pose2D
    ) -> None:
        """Take a new scan in.

        Args:
            now_ns: robot time.
            beams: (n, 6) of the scan in `grid` (columns: sensing.beams).
            people: who moves according to it, in `grid`.
            pose: of the robot, in `grid`.
        """
        came = [one.points for one in people if self._is_within(CONTACT.came_m, one.points, pose)]
        if came:
            self._came_ns, self._came = now_ns, np.concatenate(came)
        seen = beams[beams[:, ECHO] > 0.0]
        points = seen[:, [X, Y]] + seen[:, ECHO, None] * seen[:, [DX, DY]]
        self._is_touched = self._is_within(CONTACT.touch_m, self._of_who_came(points), pose)
        if not self._is_touched:
            self._since_ns = None
        elif self._since_ns is None and self._has_come(now_ns):
            self._since_ns = now_ns

    def must_stand(self, now_ns: int) -> bool:
        """Say whether the robot had better stand."""
        since_ns = self._since_ns
        return since_ns is not None and now_ns - since_ns < self._patience_ns

    def _of_who_came(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return those of some points (n, 2) in `grid` where somebody came to the robot."""
        if len(self._came) == 0:
            return self._came
        first, last = self._came.min(axis=0), self._came.max(axis=0)
        near = points >= first - CONTACT.same_m
        return points[(near & (points <= last + CONTACT.same_m)).all(axis=1)]

    def _has_come(self, now_ns: int) -> bool:
        return self._came_ns is not None and now_ns - self._came_ns < CONTACT.lately_s * 1e9

    def _is_within(self, reach_m: float, points: NDArray[np.float64], pose: Pose2D) -> bool:
        """Say whether one of some points (n, 2) in `grid` is so near to the outline."""
        around = self._footprint.circumscribed_m + reach_m
        near = points[np.hypot(points[:, 0] - pose.x, points[:, 1] - pose.y) < around]
        if len(near) == 0:
            return False
        local = pose.inverse().transform_points(near)
        return float(distance_to_outline(self._footprint.polygon, local).min()) < reach_m


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
