"""Driving where the heading of the footprint matters: along maneuvers of the pose search.

In open floor the controller does without. Where there is little room along the path, where the
robot has no room to turn, and at a goal that it must come to exactly, a maneuver is searched on
what is seen just now and followed: forwards, backwards and on the spot, with as much clearance as
there is.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley.config import PlannerConfig
from trolley.geometry import Pose2D, Twist2D, integrate_twist, wrap_angle
from trolley_planner.context.motion_state import ControlInput
from trolley_planner.context.planning_context import PlanningContext
from trolley_planner.control.controller import Motion, limited_change, safe_command
from trolley_planner.control.known_floor import BACK_STEPS_M
from trolley_planner.control.local_costmap import TIGHT_CLEARANCE_M
from trolley_planner.control.robot_motion import Limits, caution_speed
from trolley_planner.driving.goal_approach import GoalApproach
from trolley_planner.driving.maneuver_follower import FOLLOWER, ManeuverFollower
from trolley_planner.driving.route import Route
from trolley_planner.paths.hybrid_astar.motion_primitives import BACKWARDS, FORWARDS, Maneuver
from trolley_planner.paths.hybrid_astar.pose_search import Task


@dataclass(frozen=True, slots=True)
class ManeuverParams:
    """Where maneuvers are searched; all by hand."""

    room_m: float = 0.08
    """Clearance on both sides below which a place is tight."""
    aside_m: float = 0.08
    """Distance beside the path at which more clearance makes a place no longer tight."""
    turn_mean_s: float = 0.3
    """Time over which the clearance of what is left of a turn is averaged."""
    more_m: float = 0.02
    """Clearance beyond the configured one from which on a maneuver is no better with more. A turn
    on the spot with less is tight: the controller hardly turns where it must keep its own."""
    begin_m: float = 0.5
    """Distance to a tight place at which a maneuver is searched."""
    begin_goal_m: float = 2.2
    """Distance to a goal with little room at which a maneuver is searched."""
    beyond_m: float = 0.25
    """Length of path behind a tight place that the maneuver still covers, so that the footprint is
    out of it."""
    least_m: float = 0.9
    """Least length of path that a maneuver covers."""
    reach_m: float = 1.6
    """Greatest length of path that a maneuver covers."""
    go_on_m: float = 0.5
    """Distance to the end of a maneuver at which the next one is searched."""
    farther_m: float = 0.25
    """Length of path that the next maneuver must cover beyond the present one."""
    longer_m: float = 0.3
    """Most by which the next maneuver may be longer than what is left, turns counted."""
    near_goal_m: float = 0.4
    """Length of path behind a maneuver's end within which the maneuver leads to the goal itself."""
    far_goal_m: float = 2.2
    """The same within which that is tried first where no tight place lies in between."""
    far_retry_s: float = 5.0
    """Time between two such tries after one that found nothing."""
    half_m: float = 2.4
    """Half the edge of the square around the robot that a maneuver keeps within."""
    loose_m: float = 0.1
    """Tolerance of the position at which a maneuver ends on the path."""
    loose_rad: float = 0.2
    """Tolerance of the heading at the end of a maneuver where the robot cannot turn."""
    free_rad: float = 0.9
    """Tolerance of the heading at the end of a maneuver where the robot can turn."""
    most_mps: float = 0.5
    """Highest speed: an error beside a maneuver decays over a distance, and commands act late."""
    standing_mps: float = 0.1
    """Speed above which a maneuver begins where the robot will have stopped."""
    delay_s: float = 0.15
    """Time from the decision to the start of the braking."""
    lead_step_m: float = 0.025
    """Greatest distance between two poses of the way to where the robot will have stopped."""
    brisk: float = 2.0
    """Factor on the speed beside obstacles where the maneuver keeps the wanted clearance: it is
    known how near they come. Less with less clearance, down to 1 with `TIGHT_CLEARANCE_M`."""
    briskest: float = 3.0
    """The same where it keeps `spare_m` more."""
    spare_m: float = 0.02
    """Clearance beyond the wanted one that lets it drive at its briskest."""
    wary: float = 0.5
    """Factor on the speed beside obstacles where the measurements leave no clearance."""
    begin_people_m: float = 0.8
    """Distance to a moving person within which no maneuver begins."""
    stand_people_m: float = 0.3
    """Distance to a moving person within which the robot stands still."""
    retry_s: float = 1.0
    """Time between two searches after one that found nothing."""
    held_s: float = 5.0
    """Time for which a maneuver without backing is preferred, after the robot was held up backing:
    `base` may know of less floor behind it."""
    blocked_scans: int = 3
    """Number of scans in a row that must show an obstacle on a maneuver before it is given up."""
    blocked_m: float = 0.01
    """Depth by which an obstacle must reach into a maneuver: nearly a fine cell, and poses out of
    view err."""
    aside_rad: float = 0.5
    """Angle between heading and path above which the robot must turn first."""
    points_ahead: int = 6
    """The path's direction where the robot is leads to the point so many on."""
    bearing_m: float = 0.1
    """Distance to that point below which it tells no direction."""
    points_before: int = 4
    """The path's direction at a point ahead leads there from the point so many before."""
    tolerance_share: float = 0.5
    """Share of the goal's tolerances within which a maneuver to it ends."""
    goal_m: float = 0.03
    """Most by which it may miss the goal's place."""
    goal_rad: float = 0.05
    """Most by which it may miss the goal's heading."""
    still_mps: float = 0.02
    """Speed below which a robot at the goal has arrived."""
    still_radps: float = 0.05
    """Turn rate below which it has."""


MANEUVER = ManeuverParams()


class Pause:
    """Some seconds in which something is not tried again, or rather something else."""

    def __init__(self, seconds: float) -> None:
        self._length_ns = round(seconds * 1e9)
        self._end_ns = 0

    def begin(self, now_ns: int) -> None:
        """Begin it anew."""
        self._end_ns = now_ns + self._length_ns

    def end(self) -> None:
        """End it early."""
        self._end_ns = 0

    def lasts(self, now_ns: int) -> bool:
        """Say whether it is not over yet."""
        return now_ns < self._end_ns


@dataclass(slots=True)
class Driven:
    """The maneuver that is driven, and what is known of it."""

    follower: ManeuverFollower
    to_goal: bool
    """Whether it leads to the goal; else it leads along the path."""
    rest_m: float
    """What is left of the path behind its end [m], a turn to look along the path included."""
    num_blocked: int = 0
    """Number of scans in a row that have shown an obstacle on it."""
    turn_room_m: float = MANEUVER.more_m
    """Clearance of what is left of the present turn, on average."""

    @property
    def left_m(self) -> float:
        """What is left of it and of the path behind its end [m]; turns count, too."""
        return self.follower.left_m + self.rest_m


class Maneuvering:
    """Drives along maneuvers where the path ahead needs one.

    Args:
        context: costmaps and planner.
        config: of the planner.
    """

    def __init__(self, context: PlanningContext, config: PlannerConfig) -> None:
        self._context = context
        self._config = config
        self._wanted_m = config.clearance_m + MANEUVER.more_m
        self._driven: Driven | None = None
        self._search_pause = Pause(MANEUVER.retry_s)
        """After a search that found nothing."""
        self._far_pause = Pause(MANEUVER.far_retry_s)
        """After a search for a maneuver to a goal farther off that found nothing."""
        self._backing_pause = Pause(MANEUVER.held_s)
        """After the robot was held up backing."""
        self.has_arrived = False
        """Whether a maneuver had led to the goal at the last command."""
        self.is_tight_ahead = False
        """Whether there is little room somewhere along the path ahead."""

    @property
    def is_active(self) -> bool:
        """Whether it drives now."""
        return self._driven is not None

    @property
    def left_m(self) -> float:
        """What is left of the maneuver and of the path behind its end [m]; turns count, too."""
        return 0.0 if self._driven is None else self._driven.left_m

    def stop(self) -> None:
        """Hand driving back to the controller."""
        self._driven = None

    def update(self, motion: Motion, route: Route, approach: GoalApproach, now_ns: int) -> None:
        """Search for a maneuver where one is needed; drop one that is blocked or leads elsewhere.

        Args:
            motion: of the robot; the local costmap must be centred on it.
            route: to the goal.
            approach: tells where to stand in the end, and how near to that.
            now_ns: robot time.
        """
        pose, local_costmap = motion.pose, self._context.local_costmap
        # The controller knows how to pass people, and to stand aside for them; a maneuver does not.
        is_anyone_coming = local_costmap.is_anyone_coming(pose.x, pose.y)
        if is_anyone_coming:
            self.stop()
        needed = self._needed_until(pose, route, approach)
        self.is_tight_ahead = needed is not None
        if self._driven is not None:
            self._driven.follower.recenter(local_costmap.field, local_costmap.body)
            is_over = needed is None and self._is_through(self._driven, pose)
            if self._is_useless(self._driven, pose, route, approach) or is_over:
                self.stop()
        if needed is None or self._search_pause.lasts(now_ns):
            return
        if self._driven is not None and _goes_on(self._driven, route, needed):
            return
        if is_anyone_coming or self._is_anyone_near(pose, MANEUVER.begin_people_m):
            return
        self._search_pause.begin(now_ns)
        found = self._search(self._lead(motion), route, approach, needed, now_ns)
        if found is None:
            return
        if self._driven is not None and found.left_m > self.left_m + MANEUVER.longer_m:
            return  # From the end of this maneuver it is nearer than from here.
        self._driven = found
        self._search_pause.end()

    def command(self, now: ControlInput, approach: GoalApproach) -> Twist2D:
        """Return the velocity along the maneuver; it may be over then."""
        driven, local_costmap = self._driven, self._context.local_costmap
        self.has_arrived = False
        if driven is None:
            return Twist2D.zero()
        pose, follower = now.motion.pose, driven.follower
        limits, give_m = self._limits(now, follower)
        wanted = follower.command(Motion(now.steady, now.motion.twist), limits)
        if wanted is None:
            self._end(driven, now, approach)
        elif not self._has_room_to_turn(driven, pose, now.elapsed_s):
            self.stop()  # It has come a little beside its maneuver; from here another may do.
            wanted = None
        if wanted is None:
            return limited_change(now.motion.twist, Twist2D.zero(), limits, now.elapsed_s)
        backs = wanted.vx < 0.0
        is_known = not backs or local_costmap.known_floor.sees_along(
            follower.run_ahead(BACK_STEPS_M[-1])
        )
        if not is_known or self._is_anyone_near(pose, MANEUVER.stand_people_m):
            wanted = Twist2D.zero()  # All of it: turning alone leads off the maneuver.
        wanted = limited_change(now.motion.twist, wanted, limits, now.elapsed_s)
        safe = safe_command(now.motion, wanted, local_costmap, limits, give_m, may_back=is_known)
        if follower.is_stalled(pose, now.elapsed_s):
            if backs:
                self._backing_pause.begin(now.now_ns)
            self.stop()
        return safe

    def _limits(self, now: ControlInput, follower: ManeuverFollower) -> tuple[Limits, float]:
        """Return the limits of the place, and how much closer the robot may come where it is.

        It keeps as much clearance as the place has, as far as it is wanted.
        """
        context, pose, limits = self._context, now.motion.pose, now.limits
        wanted_m = max(limits.clearance_m, 2.0 * TIGHT_CLEARANCE_M)
        kept_m = (0.0, TIGHT_CLEARANCE_M, wanted_m, wanted_m + MANEUVER.spare_m)
        factors = (MANEUVER.wary, 1.0, MANEUVER.brisk, MANEUVER.briskest)
        here_m = context.seen_clearance(pose, limits.caution_m)
        ahead = follower.poses_from(pose, MANEUVER.begin_m)
        least_m = min(here_m, context.least_clearance(ahead, kept_m[-1]))
        slow_speed = float(np.interp(least_m, kept_m, factors)) * limits.slow_speed
        floor_m = min(limits.clearance_m, max(least_m - TIGHT_CLEARANCE_M, 0.0))
        limits = limits._replace(clearance_m=floor_m, slow_speed=min(slow_speed, limits.max_speed))
        speed = min(caution_speed(limits, here_m), context.zone_speed(pose), MANEUVER.most_mps)
        sees_back = context.costmap.obstacle_layer.looks_all_round
        backwards = speed if sees_back else min(speed, limits.max_reverse)
        # Noise may take that much of the floor, but not more each time that it is asked.
        left_m = here_m - (floor_m - TIGHT_CLEARANCE_M)
        give_m = max(min(left_m, TIGHT_CLEARANCE_M), 0.0)
        return limits._replace(max_speed=speed, max_reverse=backwards), give_m

    def _has_room_to_turn(self, driven: Driven, pose: Pose2D, elapsed_s: float) -> bool:
        """Say whether a turn on the spot that begins is free, and what is left of one, on average.

        What is measured errs by more than a corner may need, now too near, now too far.
        """
        context, begins = self._context, driven.follower.pop_turn(pose)
        if begins != 0.0 and not context.can_turn_by(pose, begins, TIGHT_CLEARANCE_M):
            return False
        turn, most_m = driven.follower.turn_to_go(pose), MANEUVER.more_m
        if turn == 0.0:
            driven.turn_room_m = most_m
            return True
        share = min(elapsed_s / MANEUVER.turn_mean_s, 1.0)
        seen_m = context.turn_clearance(pose, turn, most_m)
        driven.turn_room_m += share * (seen_m - driven.turn_room_m)
        return driven.turn_room_m >= 0.0

    def _end(self, driven: Driven, now: ControlInput, approach: GoalApproach) -> None:
        """End the maneuver: if it led to the goal and the robot stands, it has arrived."""
        twist = now.motion.twist
        is_still = abs(twist.vx) < MANEUVER.still_mps and abs(twist.wz) < MANEUVER.still_radps
        if driven.to_goal and not is_still:
            return
        self.has_arrived = driven.to_goal and approach.is_there(now.steady)
        if not self.has_arrived:
            self.stop()

    def _is_through(self, driven: Driven, pose: Pose2D) -> bool:
        """Say whether the robot drives forwards with clearance: the controller does better."""
        if driven.to_goal or driven.follower.sense != FORWARDS:
            return False
        return self._context.seen_clearance(pose, MANEUVER.room_m) >= MANEUVER.room_m

    def _is_useless(
        self, driven: Driven, pose: Pose2D, route: Route, approach: GoalApproach
    ) -> bool:
        """Say whether an obstacle is on the maneuver, counting scans, or it leads elsewhere."""
        follower = driven.follower
        if driven.to_goal:
            is_wrong = follower.end.distance_to(approach.aim) > approach.near.xy
        else:
            off_m = _distances(route, follower.end)
            is_wrong = float(off_m.min()) > 2.0 * MANEUVER.loose_m + MANEUVER.beyond_m
        ahead = follower.poses_ahead(MANEUVER.reach_m)
        is_blocked = self._context.least_clearance(ahead, 0.0) <= -MANEUVER.blocked_m
        driven.num_blocked = driven.num_blocked + 1 if is_blocked else 0
        is_off = driven.num_blocked >= MANEUVER.blocked_scans or follower.has_strayed(pose)
        # At its end no other one leads nearer: the robot would have to leave and come back.
        return is_wrong or (is_off and follower.left_m > 0.0)

    def _lead(self, motion: Motion) -> Maneuver:
        """Return the drive to where the robot can stop, since maneuvers may begin with a turn."""
        twist, speed, poses = motion.twist, abs(motion.twist.vx), [motion.pose]
        stretch_m = speed * (0.5 * speed / self._config.acceleration_mps2 + MANEUVER.delay_s)
        is_moving = speed >= MANEUVER.standing_mps
        count = math.ceil(stretch_m / MANEUVER.lead_step_m) if is_moving else 0
        for _ in range(count):
            poses.append(integrate_twist(poses[-1], twist, stretch_m / speed / count))
        lead = np.array([(pose.x, pose.y, pose.yaw) for pose in poses])
        if self._context.least_clearance(lead, TIGHT_CLEARANCE_M) < TIGHT_CLEARANCE_M:
            lead = lead[:1]
        sense = FORWARDS if twist.vx > 0.0 else BACKWARDS
        return Maneuver(lead, np.full(len(lead), sense, np.int8))

    def _is_anyone_near(self, pose: Pose2D, within_m: float) -> bool:
        within_m += self._context.footprint.circumscribed_m
        return self._context.local_costmap.is_anyone_near(pose, within_m)

    def _needed_until(self, pose: Pose2D, route: Route, approach: GoalApproach) -> int | None:
        """Return the index of the path up to which a maneuver is needed, None if none is.

        The last index stands for the goal itself.
        """
        path, first = route.path, route.index
        last = path.ahead(first, MANEUVER.reach_m)
        if not route.vias_left and float(path.remaining_m[first]) < MANEUVER.begin_goal_m:
            last = len(path.points) - 1
        is_goal = not route.vias_left and last == len(path.points) - 1
        if route.vias_left:
            last = min(last, path.vias[0])
        points = path.points[first : last + 1]
        along = float(path.remaining_m[first]) - path.remaining_m[first : last + 1]
        # Within the local costmap only, and where it says something of headings.
        is_tight = self._context.tight_places(points, MANEUVER.room_m, MANEUVER.aside_m)
        near = bool((is_tight & (along < MANEUVER.begin_m)).any())
        if is_goal and self._is_tight_goal(pose, points, approach):
            is_tight[-1] = True
            near |= float(along[-1]) < MANEUVER.begin_goal_m
        if not near and not self._must_turn_in_little_room(pose, points):
            return None
        tight = np.flatnonzero(is_tight)
        if is_goal and not (is_tight & (along > MANEUVER.beyond_m)).any():
            return last  # Nothing is in between: the goal's heading comes on the way.
        end = path.ahead(first + int(tight[-1]) if len(tight) else first, MANEUVER.beyond_m)
        return min(end, last)

    def _is_tight_goal(
        self, pose: Pose2D, points: NDArray[np.float64], approach: GoalApproach
    ) -> bool:
        """Say whether the clearance at the goal is small, to stand there or to turn."""
        context, aim = self._context, approach.aim
        if context.seen_clearance(aim, MANEUVER.room_m) < MANEUVER.room_m:
            return True
        if approach.near.any_heading:
            return False
        facing = pose.yaw
        if pose.distance_to(aim) > MANEUVER.loose_m and len(points) > 1:
            before = points[max(len(points) - 1 - MANEUVER.points_before, 0)]
            facing = _bearing(before, np.array([aim.x, aim.y]))
        turn = wrap_angle(facing - aim.yaw)
        return not context.can_turn_by(aim, turn, self._wanted_m)

    def _must_turn_in_little_room(self, pose: Pose2D, points: NDArray[np.float64]) -> bool:
        """Say whether the robot must turn to the path and lacks the clearance for it."""
        here = np.array([pose.x, pose.y])
        ahead = points[min(len(points) - 1, MANEUVER.points_ahead)]
        if math.dist(here, ahead) < MANEUVER.bearing_m:
            return False
        turn = wrap_angle(_bearing(here, ahead) - pose.yaw)
        is_aside = abs(turn) > MANEUVER.aside_rad
        return is_aside and not self._context.can_turn_by(pose, turn, self._wanted_m)

    def _search(
        self, lead: Maneuver, route: Route, approach: GoalApproach, until: int, now_ns: int
    ) -> Driven | None:
        """Return a maneuver to a point of the path or beyond, or to the goal if that is near.

        Args:
            lead: what it begins with.
            route: to the goal.
            approach: tells where to stand in the end.
            until: index of the point of the path.
            now_ns: robot time.
        """
        path = route.path
        last, until = len(path.points) - 1, max(until, path.ahead(route.index, MANEUVER.least_m))
        rest_m = math.inf if route.vias_left else float(path.remaining_m[until])
        is_near = rest_m < MANEUVER.near_goal_m or (until == last and not route.vias_left)
        is_far = rest_m < MANEUVER.far_goal_m and not is_near and self._is_open(route)
        if is_near or (is_far and not self._far_pause.lasts(now_ns)):
            found = self._search_to_goal(lead, approach, now_ns)
            if is_near or found is not None:
                return found
            self._far_pause.begin(now_ns)
        if route.vias_left:
            until = min(until, path.vias[0])
        return self._search_to_path(lead, route, until, now_ns)

    def _is_open(self, route: Route) -> bool:
        """Say whether no tight place lies on the path, except where the robot is and at its end."""
        first = route.path.ahead(route.index, MANEUVER.begin_m)
        points = route.path.points[first:-1]
        is_tight = self._context.tight_places(points, MANEUVER.room_m, MANEUVER.aside_m)
        return not is_tight.any()

    def _search_to_goal(self, lead: Maneuver, approach: GoalApproach, now_ns: int) -> Driven | None:
        near, share = approach.near, MANEUVER.tolerance_share
        missed = min(share * near.xy, MANEUVER.goal_m), min(share * near.yaw, MANEUVER.goal_rad)
        task = Task(lead.end, approach.aim, near.any_heading, *missed, self._wanted_m)
        maneuver = self._find(task, now_ns)
        if maneuver is None:
            return None
        reach_m = self._context.footprint.circumscribed_m
        return Driven(ManeuverFollower(maneuver.after(lead), reach_m), to_goal=True, rest_m=0.0)

    def _search_to_path(
        self, lead: Maneuver, route: Route, until: int, now_ns: int
    ) -> Driven | None:
        points = route.path.points
        yaw = _bearing(points[max(until - MANEUVER.points_before, 0)], points[until])
        end = Pose2D(float(points[until, 0]), float(points[until, 1]), yaw)
        is_free = self._context.can_turn_by(end, 2.0 * math.pi, self._wanted_m)
        missed = MANEUVER.loose_m, MANEUVER.free_rad if is_free else MANEUVER.loose_rad
        task = Task(lead.end, end, False, *missed, self._wanted_m, else_any=True)
        maneuver = self._find(task, now_ns)
        if maneuver is None:
            return None
        turn = max(abs(wrap_angle(maneuver.end.yaw - yaw)) - missed[1], 0.0)
        rest_m = float(route.path.remaining_m[until]) + FOLLOWER.turn_as_m * turn
        reach_m = self._context.footprint.circumscribed_m
        follower = ManeuverFollower(maneuver.after(lead), reach_m, rest_m)
        return Driven(follower, to_goal=False, rest_m=rest_m)

    def _find(self, task: Task, now_ns: int) -> Maneuver | None:
        """Return a maneuver, rather one without backing where that was not possible lately."""
        if self._backing_pause.lasts(now_ns):
            found = self._context.find_maneuver(task, MANEUVER.half_m, may_back=False)
            if found is not None:
                return found
        return self._context.find_maneuver(task, MANEUVER.half_m)


def _goes_on(driven: Driven, route: Route, needed: int) -> bool:
    """Say whether a maneuver is long, or leads as far along the path as is needed."""
    if driven.to_goal or driven.follower.left_m > MANEUVER.go_on_m:
        return True
    end = route.index + int(np.argmin(_distances(route, driven.follower.end)))
    left_m = route.path.remaining_m
    return float(left_m[end] - left_m[needed]) < MANEUVER.farther_m


def _distances(route: Route, pose: Pose2D) -> NDArray[np.float64]:
    """Return how far the points of the path ahead (n,) are from a place [m]."""
    points = route.path.points[route.index :]
    return np.hypot(points[:, 0] - pose.x, points[:, 1] - pose.y)


def _bearing(here: NDArray[np.float64], there: NDArray[np.float64]) -> float:
    """Return the direction from a point (2,) to another [rad]."""
    return math.atan2(float(there[1] - here[1]), float(there[0] - here[0]))
