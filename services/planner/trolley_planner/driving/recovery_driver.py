"""How the robot drives during recovery: it waits, clears the costmap, backs up, turns."""

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

from trolley.config import PlannerConfig
from trolley.geometry import Pose2D, Twist2D, wrap_angle
from trolley_planner.context.motion_state import ControlInput
from trolley_planner.context.planning_context import PlanningContext
from trolley_planner.control.controller import limited_change, safe_command
from trolley_planner.control.robot_motion import Limits
from trolley_planner.driving.recovery import Recovery, RecoveryAction
from trolley_planner.driving.route import Route


@dataclass(frozen=True, slots=True)
class BehaviorParams:
    """How the robot moves during recovery; all by hand."""

    crumb_m: float = 0.03
    """Distance between two remembered poses of the robot's track."""
    track_m: float = 3.0
    """Length of the track that is remembered."""
    settle_s: float = 0.5
    """Least duration of a wait or of clearing the costmap: time for about two scans."""
    backing_mps: float = 0.12
    """Speed when backing up."""
    lookback_m: float = 0.12
    """Distance behind the robot of the point on its track that it backs up towards."""
    spin_radps: float = 0.7
    """Turn rate of a spin."""
    stalled_s: float = 1.0
    """Time without motion after which a behaviour ends."""
    longest_s: float = 12.0
    """Longest duration of a behaviour."""
    standing_mps: float = 0.02
    """Speed below which the robot may count as held up."""
    standing_radps: float = 0.1
    """Turn rate below which the robot may count as held up."""
    forget_radius_m: float = 1.5
    """Radius around the robot within which obstacles are cleared from the costmap."""
    closed_radius_m: float = 0.2
    """Radius of the part of the path that is closed where the robot did not get through."""


BEHAVIORS = BehaviorParams()


@dataclass(slots=True)
class Breadcrumbs:
    """The robot's recent track as odometry poses, along which it can back up."""

    crumbs: deque[Pose2D] = field(
        default_factory=lambda: deque[Pose2D](maxlen=round(BEHAVIORS.track_m / BEHAVIORS.crumb_m))
    )

    def drop(self, odom_T_base: Pose2D) -> None:
        """Remember where the robot is."""
        if not self.crumbs or self.crumbs[-1].distance_to(odom_T_base) >= BEHAVIORS.crumb_m:
            self.crumbs.append(odom_T_base)

    def backtrack(self, odom_T_base: Pose2D, ahead_m: float) -> Pose2D | None:
        """Return the crumb to steer for on the way back, None at the track's end.

        Crumbs that were passed again are picked up.
        """
        while self.crumbs and self.crumbs[-1].distance_to(odom_T_base) < ahead_m:
            self.crumbs.pop()
        return self.crumbs[-1] if self.crumbs else None


@dataclass(frozen=True, slots=True)
class Wait:
    """Stands until the path is free, or the robot has waited long enough."""

    is_blocked: bool
    """Whether something kept the robot from driving on when the wait began."""


@dataclass(frozen=True, slots=True)
class LookAgain:
    """Stands until new scans have filled the costmap that was cleared."""


class StallDetector:
    """Detects that a motion is held up, or takes too long.

    Args:
        longest_s: how long it may take.
    """

    def __init__(self, longest_s: float) -> None:
        self._longest_s = longest_s
        self._stalled_s = 0.0
        self._elapsed_s = 0.0

    def update(self, driven: Twist2D, elapsed_s: float) -> None:
        """Note what of a command was safe to drive."""
        is_standing = (
            abs(driven.vx) < BEHAVIORS.standing_mps and abs(driven.wz) < BEHAVIORS.standing_radps
        )
        self._stalled_s = self._stalled_s + elapsed_s if is_standing else 0.0
        self._elapsed_s += elapsed_s

    @property
    def is_over(self) -> bool:
        """Whether the motion must end."""
        return self._stalled_s > BEHAVIORS.stalled_s or self._elapsed_s > self._longest_s


class BackUp:
    """Drives backwards along the robot's own track.

    Args:
        start: odom_T_base at the beginning.
        length_m: how far at most.
    """

    def __init__(self, start: Pose2D, length_m: float) -> None:
        self._start = start
        self._length_m = length_m
        self._stall = StallDetector(BEHAVIORS.longest_s)

    def command(self, odom_T_base: Pose2D, trail: Breadcrumbs, limits: Limits) -> Twist2D | None:
        """Return the velocity to drive now, None when it is over."""
        if odom_T_base.distance_to(self._start) >= self._length_m or self._stall.is_over:
            return None
        crumb = trail.backtrack(odom_T_base, BEHAVIORS.lookback_m)
        if crumb is None:
            return None
        behind = odom_T_base.inverse() @ crumb
        bearing = wrap_angle(math.atan2(behind.y, behind.x) + math.pi)
        if abs(bearing) > 0.5 * math.pi:
            return None  # The track lies ahead: there is no way back along it.
        most_turn = min(0.5, limits.max_turn)
        turn = min(max(1.5 * bearing, -most_turn), most_turn)
        return Twist2D(-min(BEHAVIORS.backing_mps, limits.max_reverse), 0.0, turn)

    def update(self, driven: Twist2D, elapsed_s: float) -> None:
        """Note what of the command was safe to drive."""
        self._stall.update(driven, elapsed_s)


class Spin:
    """Turns in place by a given angle.

    Args:
        start: odom_T_base at the beginning.
        angle: to turn by [rad], positive to the left.
        longest_s: how long it may take.
    """

    def __init__(self, start: Pose2D, angle: float, longest_s: float = BEHAVIORS.longest_s) -> None:
        self._last_yaw = start.yaw
        self._angle = angle
        self._turned = 0.0
        self._stall = StallDetector(longest_s)

    def command(self, odom_T_base: Pose2D, limits: Limits) -> Twist2D | None:
        """Return the velocity to drive now, None when it is over."""
        self._turned += wrap_angle(odom_T_base.yaw - self._last_yaw)
        self._last_yaw = odom_T_base.yaw
        left = abs(self._angle) - math.copysign(1.0, self._angle) * self._turned
        if left <= 0.05 or self._stall.is_over:
            return None
        rate = min(BEHAVIORS.spin_radps, limits.max_turn, max(0.15, 1.5 * left))
        return Twist2D(0.0, 0.0, math.copysign(rate, self._angle))

    def update(self, driven: Twist2D, elapsed_s: float) -> None:
        """Note what of the command was safe to drive."""
        self._stall.update(driven, elapsed_s)


class RecoveryDriver:
    """Carries out the recovery behaviours along a route.

    Args:
        context: costmaps and planners.
        config: of the planner.
        route: to the goal.
    """

    def __init__(self, context: PlanningContext, config: PlannerConfig, route: Route) -> None:
        self.sequence = Recovery(config)
        """Which action is tried, and which comes next."""
        self._context = context
        self._config = config
        self._route = route
        self._trail = Breadcrumbs()
        self._behavior: Wait | LookAgain | BackUp | Spin | None = None

    def drop_crumb(self, odom_T_base: Pose2D) -> None:
        """Remember where the robot is: it can back up to there."""
        self._trail.drop(odom_T_base)

    def begin_next(self, now: ControlInput, *, is_blocked: bool, left_m: float) -> bool:
        """Begin the next behaviour; False when it is time to give up.

        Args:
            now: where the robot is.
            is_blocked: whether something keeps it from driving on.
            left_m: how far it is to the goal.
        """
        self._behavior = None
        chosen = self.sequence.begin_next(
            now.now_ns, lambda action: self._prepare(action, now, left_m)
        )
        if chosen is None:
            self.sequence.end()
            return False
        if chosen in (RecoveryAction.WAIT, RecoveryAction.WAIT_LONGER):
            self._behavior = Wait(is_blocked)
        elif chosen in (RecoveryAction.CLEAR, RecoveryAction.REROUTE):
            self._behavior = LookAgain()
        if chosen is RecoveryAction.CLEAR:
            pose, obstacles = now.motion.pose, self._context.costmap.obstacle_layer
            obstacles.forget_around(pose.x, pose.y, BEHAVIORS.forget_radius_m)
        return True

    def end(self) -> None:
        """Drive on."""
        self.sequence.end()
        self._behavior = None

    def has_lost_patience(self, now_ns: int, *, is_path_free: bool) -> bool:
        """Say whether a wait has lasted long enough; end it if the path is free."""
        if not isinstance(self._behavior, Wait):
            return False
        if is_path_free and self._has_settled(now_ns):
            if self._behavior.is_blocked:
                self.sequence.forgive(now_ns)
            self.end()
            return False
        return not self.sequence.is_patient(now_ns)

    def command(self, now: ControlInput) -> Twist2D:
        """Return the velocity of the current behaviour, and end it when it is done."""
        wanted: Twist2D | None = Twist2D.zero()
        match self._behavior:
            case LookAgain() if self._has_settled(now.now_ns):
                self.end()
            case BackUp() as back_up:
                wanted = back_up.command(now.odom_T_base, self._trail, now.limits)
            case Spin() as spin:
                wanted = spin.command(now.odom_T_base, now.limits)
            case _:
                pass
        if wanted is None:
            self.end()
            return self.stand(now)
        return self._made_safe(wanted, now)

    def stand(self, now: ControlInput) -> Twist2D:
        """Return the velocity that brings the robot to a stop."""
        return self._made_safe(Twist2D.zero(), now)

    def _made_safe(self, wanted: Twist2D, now: ControlInput) -> Twist2D:
        wanted = limited_change(now.motion.twist, wanted, now.limits, now.elapsed_s)
        return safe_command(now.motion, wanted, self._context.local_costmap, now.limits)

    def update(self, driven: Twist2D, elapsed_s: float) -> None:
        """Note what of a command was safe to drive."""
        if isinstance(self._behavior, BackUp | Spin):
            self._behavior.update(driven, elapsed_s)

    def point_ahead(self) -> tuple[float, float]:
        """Return the point of the path right ahead of the robot, x, y in `grid` [m]."""
        path = self._route.path
        x, y = path.points[path.ahead(self._route.index, self._ahead_m)]
        return float(x), float(y)

    @property
    def _ahead_m(self) -> float:
        """How far ahead on the path a place is closed [m]."""
        return self._context.footprint.circumscribed_m + BEHAVIORS.closed_radius_m + 0.1

    def _has_settled(self, now_ns: int) -> bool:
        return self.sequence.elapsed_s(now_ns) > BEHAVIORS.settle_s

    def _prepare(self, action: RecoveryAction, now: ControlInput, left_m: float) -> bool:
        """Prepare a behaviour that moves the robot; say whether there is room for it."""
        pose, context, clearance_m = now.motion.pose, self._context, now.limits.clearance_m
        if action is RecoveryAction.BACK_UP:
            self._behavior = BackUp(now.odom_T_base, self._config.back_up_m)
            first = self._trail.backtrack(now.odom_T_base, BEHAVIORS.lookback_m)
            if first is None or self._config.back_up_m == 0.0:
                return False
            place = pose @ now.odom_T_base.inverse() @ first
            least = min(clearance_m, context.seen_clearance(pose, clearance_m))
            return context.seen_clearance(place, clearance_m) >= least
        self._behavior = None
        if action is RecoveryAction.TURN:
            turn = free_turn(
                lambda angle: context.can_turn_by(pose, angle, clearance_m),
                self._bearing_of_path(pose),
            )
            self._behavior = None if turn is None else Spin(now.odom_T_base, turn)
            return turn is not None
        return self._close_path_ahead(now, left_m)

    def _close_path_ahead(self, now: ControlInput, left_m: float) -> bool:
        """Close the path right ahead if there is another one; say whether there is."""
        costmap, pose = self._context.costmap, now.motion.pose
        if left_m < self._ahead_m + 2.0 * BEHAVIORS.closed_radius_m:
            return False
        x, y = self.point_ahead()
        costmap.close(x, y, BEHAVIORS.closed_radius_m, now.now_ns)
        costmap.refresh()
        start, weights = (pose.x, pose.y), costmap.weights
        places = [(place.x, place.y) for place in self._route.targets]
        if self._context.planner.plan(start, places, weights, costmap.distance_m) is not None:
            return True
        costmap.reopen()
        return False

    def _bearing_of_path(self, pose: Pose2D) -> float:
        """Return the bearing of the path ahead, from the robot's heading [rad]."""
        ahead = self._route.path.points[self._route.path.ahead(self._route.index, 0.5)]
        bearing = math.atan2(float(ahead[1]) - pose.y, float(ahead[0]) - pose.x)
        return wrap_angle(bearing - pose.yaw)


def free_turn(can_turn: Callable[[float], bool], bearing: float) -> float | None:
    """Return the turn for looking around [rad], towards a bearing first; None without room.

    Args:
        can_turn: says whether there is room for a turn by an angle [rad].
        bearing: of the path ahead, from the robot's heading [rad].
    """
    for size in (2.0 * math.pi, math.pi, 0.5 * math.pi):
        for turn in (math.copysign(size, bearing), -math.copysign(size, bearing)):
            if can_turn(turn):
                return turn
    return None
