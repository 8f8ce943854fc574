"""The last metre to the goal: where exactly to stop, then onto it and to its heading."""

import math
from dataclasses import dataclass

from trolley.config import PlannerConfig
from trolley.geometry import Pose2D, Twist2D, wrap_angle
from trolley_planner.context.motion_state import ControlInput
from trolley_planner.context.planning_context import PlanningContext
from trolley_planner.control.controller import Motion, limited_change, safe_command
from trolley_planner.control.robot_motion import Limits, allowed_speed
from trolley_planner.goals import Tolerances, nearest_free_pose


@dataclass(frozen=True, slots=True)
class AlignmentParams:
    """How the robot drives the last decimetres; all by hand."""

    start_m: float = 0.3
    """The alignment takes over this near to the goal."""
    least_mps: float = 0.03
    """Speed below which a command does not move a real robot."""
    least_radps: float = 0.12
    """Turn rate below which a command does not move a real robot."""
    speed_gain: float = 3.0
    """Speed per distance that is left [1/s]."""
    turn_gain: float = 3.0
    """Turn rate per heading error [1/s]."""
    braking_share: float = 0.7
    """Share of the robot's braking that is planned with: the rest makes up for what comes late."""
    face_rad: float = 0.35
    """The robot faces the goal first if it looks farther past it than this."""
    reverse_m: float = 0.25
    """A goal behind the robot and nearer than this is reached backwards."""
    close_m: float = 0.005
    """A robot that still comes nearer drives on until so little is left ahead of it [m]."""
    settle_s: float = 6.0
    """After this time a place within the full tolerances is good enough."""


ALIGNMENT = AlignmentParams()


class FinalAlignment:
    """Brings the robot from a few decimetres away onto the goal.

    Position first, then heading; aims at half the tolerances, so that noise of the pose does not
    undo what was reached, and is content with the full ones once `ALIGNMENT.settle_s` have passed.

    Args:
        tolerances: how near is near enough.
        is_reverse: drive onto the goal backwards from any distance.
    """

    def __init__(self, tolerances: Tolerances, is_reverse: bool = False) -> None:
        self._tolerances = tolerances
        self._is_reverse = is_reverse
        self._is_turning = False
        self._is_facing = False
        self._elapsed_s = 0.0

    def command(
        self, motion: Motion, goal: Pose2D, limits: Limits, elapsed_s: float
    ) -> Twist2D | None:
        """Return the velocity to drive now, None once the robot has arrived and stands still.

        Args:
            motion: of the robot, in the frame of `goal`.
            goal: the pose to reach.
            limits: of the robot.
            elapsed_s: since the last command.
        """
        self._elapsed_s += elapsed_s
        distance, turn = self._errors(motion, goal)
        aim = 1.0 if self._elapsed_s > ALIGNMENT.settle_s else 0.5
        near = aim * min(self._tolerances.xy, 0.1)
        turned = abs(turn) <= aim * min(self._tolerances.yaw, 0.3) or self._tolerances.any_heading
        if self._is_turning:
            # Noise of the pose must not send it back to driving.
            self._is_turning = distance <= max(0.9 * self._tolerances.xy, near)
        else:
            is_done = aim == 1.0 or not self._comes_nearer(motion, goal)
            self._is_turning = distance <= near and is_done
        if not self._is_turning:
            return self._drive(motion, goal, distance, limits)
        if turned:
            is_standing = abs(motion.twist.vx) < 0.02 and abs(motion.twist.wz) < 0.05
            return None if is_standing else Twist2D.zero()
        return Twist2D(0.0, 0.0, turn_rate(turn, limits))

    def _errors(self, motion: Motion, goal: Pose2D) -> tuple[float, float]:
        """Return the distance [m] and the turn that is left [rad]."""
        turn = 0.0 if self._tolerances.any_heading else wrap_angle(goal.yaw - motion.pose.yaw)
        return motion.pose.distance_to(goal), turn

    def _comes_nearer(self, motion: Motion, goal: Pose2D) -> bool:
        """Say whether driving straight on brings the robot nearer to the goal.

        Where it stops at once, it stands at the edge of the tolerance.
        """
        ahead = motion.pose.inverse() @ goal
        return (
            ahead.x * motion.twist.vx > 0.0
            and abs(ahead.x) > ALIGNMENT.close_m
            and abs(ahead.y) < ALIGNMENT.face_rad * abs(ahead.x)
        )

    def _drive(self, motion: Motion, goal: Pose2D, distance: float, limits: Limits) -> Twist2D:
        """Return the velocity towards the goal's position."""
        ahead = motion.pose.inverse() @ goal
        bearing = math.atan2(ahead.y, ahead.x)
        direction = 1.0
        is_near = distance < ALIGNMENT.reverse_m and limits.max_reverse > 0.0
        if abs(bearing) > 0.5 * math.pi and (self._is_reverse or is_near):
            bearing, direction = wrap_angle(bearing + math.pi), -1.0
        # With some hysteresis, else it would keep switching between driving and turning.
        self._is_facing = abs(bearing) > (0.3 if self._is_facing else 1.0) * ALIGNMENT.face_rad
        if self._is_facing and distance > 0.01:
            return Twist2D(0.0, 0.0, turn_rate(bearing, limits))
        braking = braking_speed(limits.deceleration, distance)
        highest = limits.max_speed if direction > 0.0 else limits.max_reverse
        speed = max(
            min(braking, ALIGNMENT.speed_gain * distance + 0.02, highest),
            min(ALIGNMENT.least_mps, highest),
        )
        # Very near, the bearing is mostly noise.
        steer = ALIGNMENT.turn_gain * bearing * min(1.0, distance / 0.08)
        return Twist2D(direction * speed, 0.0, _clipped(steer, limits.max_turn))


def braking_speed(deceleration: float, distance: float) -> float:
    """Return the speed from which the robot stops within a distance, or the same of a turn."""
    return math.sqrt(2.0 * ALIGNMENT.braking_share * deceleration * distance)


def turn_rate(turn: float, limits: Limits) -> float:
    """Return the turn rate that ends after `turn` [rad] without overshooting."""
    size = abs(turn)
    braking = braking_speed(limits.turn_acceleration, size)
    rate = max(
        min(braking, ALIGNMENT.turn_gain * size, limits.max_turn),
        min(ALIGNMENT.least_radps, limits.max_turn),
    )
    return math.copysign(rate, turn)


def _clipped(value: float, size: float) -> float:
    return min(max(value, -size), size)


@dataclass(frozen=True, slots=True)
class ApproachParams:
    """Where to stop near the goal; all by hand."""

    turn_as_m: float = 0.3
    """A turn by one radian that is left at the goal counts as this distance."""
    goal_clearance_m: float = 0.005
    """Least clearance of the final pose at a tight goal."""
    beside_m: float = 0.02
    """Least clearance of the pose that replaces a goal with less than `goal_clearance_m`."""
    window_edge_m: float = 0.6
    """The goal is checked once it lies this far inside the local costmap."""


APPROACH = ApproachParams()


class GoalApproach:
    """Drives near the goal.

    It aims at the goal, or beside it where something stands on it, and comes onto it where there is
    room; where there is little, a way with headings leads there. All poses are in `grid`.

    Args:
        context: costmaps and planner.
        config: of the planner.
        goal: where to.
        tolerances: how near is near enough.
    """

    def __init__(
        self, context: PlanningContext, config: PlannerConfig, goal: Pose2D, tolerances: Tolerances
    ) -> None:
        self._context = context
        self._config = config
        self._goal = goal
        self._tolerances = tolerances
        self._alignment: FinalAlignment | None = None
        self.aim: Pose2D = goal
        """Where to drive now."""
        self.is_occupied = False
        """Whether something stands on the goal and on all places within its tolerance."""
        self.is_enclosed = False
        """Whether that was seen from all sides: no way leads near the goal."""
        self.has_arrived = False

    @property
    def is_active(self) -> bool:
        """Whether it drives now."""
        return self._alignment is not None

    @property
    def near(self) -> Tolerances:
        """Tolerances around `aim` within which the robot is at the goal."""
        xy, yaw = self._tolerances.xy, self._tolerances.yaw
        moved = self.aim.distance_to(self._goal)
        is_any = self._tolerances.any_heading
        turned = 0.0 if is_any else abs(wrap_angle(self.aim.yaw - self._goal.yaw))
        return Tolerances(xy - moved, yaw - turned)

    def is_there(self, pose: Pose2D) -> bool:
        """Say whether a pose is within the tolerances of the goal."""
        if pose.distance_to(self._goal) > self._tolerances.xy:
            return False
        turn = abs(wrap_angle(pose.yaw - self._goal.yaw))
        return self._tolerances.any_heading or turn <= self._tolerances.yaw

    def let_go(self) -> None:
        """Hand driving back to the controller."""
        self._alignment = None

    def left_m(self, pose: Pose2D) -> float:
        """Return what is left to do [m]: at the goal the turn counts, too."""
        distance = pose.distance_to(self.aim)
        if self._tolerances.any_heading:
            return distance
        return distance + APPROACH.turn_as_m * abs(wrap_angle(self.aim.yaw - pose.yaw))

    def update_aim(self, pose: Pose2D, is_blocked: bool) -> bool:
        """Aim beside an occupied goal; True if the aim was moved.

        Args:
            pose: of the robot; the local costmap must be centred on it.
            is_blocked: no path leads to the aim by what is seen, as into what stands around it.
        """
        context, enough = self._context, APPROACH.beside_m
        far_m, goal_m = context.half_m - APPROACH.window_edge_m, pose.distance_to(self._goal)
        is_far = goal_m > far_m
        # Where no path leads on it may have to stop farther off.
        if is_far and not (is_blocked and goal_m < context.half_m):
            return False
        self.is_occupied &= is_far
        self.is_enclosed = False
        # The best of several bad places may be a little worse with the next scan.
        least_m = APPROACH.goal_clearance_m if self.aim == self._goal else 0.0
        is_free = context.clearance_within(self.aim, enough) >= least_m
        if is_free and not is_blocked:
            return False
        floor = context.floor_around(pose) if is_blocked else None
        if is_free and floor is not None and floor.leads_to(self.aim):
            return False

        def clearance(candidate: Pose2D) -> float:
            if floor is not None and not floor.leads_to(candidate):
                return -1.0
            if is_far and pose.distance_to(candidate) > far_m:
                return -1.0
            return context.clearance_within(candidate, enough)

        found = nearest_free_pose(self._goal, self._tolerances, clearance, enough)
        if found is None:
            self.is_occupied |= not is_far
            self.is_enclosed = not is_far and floor is not None and floor.encloses(self._goal)
            return False
        if found == self.aim:
            return False
        self.aim = found
        self._alignment = None
        return True

    def takes_over(self, pose: Pose2D, remaining_m: float) -> bool:
        """Say whether the final approach takes over: near the goal, nothing in between.

        Args:
            pose: of the robot.
            remaining_m: what is left of the path.
        """
        distance = pose.distance_to(self.aim)
        if self._alignment is not None:
            stays = distance < 2.0 * ALIGNMENT.start_m
            self._alignment = self._alignment if stays else None
            return stays
        if distance > ALIGNMENT.start_m or remaining_m > 2.0 * ALIGNMENT.start_m:
            return False
        bearing = math.atan2(self.aim.y - pose.y, self.aim.x - pose.x)
        for share in (0.25, 0.5, 0.75):
            x = pose.x + share * (self.aim.x - pose.x)
            y = pose.y + share * (self.aim.y - pose.y)
            clearance = self._context.seen_clearance(Pose2D(x, y, bearing), 0.1)
            if clearance < self._config.clearance_m and distance > 0.1:
                return False
        facing = wrap_angle(bearing - pose.yaw)
        is_behind = abs(facing) > 0.5 * math.pi
        clearance = self._config.clearance_m
        is_reverse = is_behind and not self._context.can_turn_by(pose, facing, clearance)
        self._alignment = FinalAlignment(self.near, is_reverse)
        return True

    def command(self, now: ControlInput) -> Twist2D:
        """Return the velocity of the final approach."""
        context, alignment = self._context, self._alignment
        if alignment is None:
            return Twist2D.zero()
        room = context.seen_clearance(self.aim, now.limits.caution_m)
        here = context.seen_clearance(now.motion.pose, now.limits.caution_m)
        place = now.motion.pose
        speed = allowed_speed(context.local_costmap.field, now.limits, place.x, place.y, here)
        # A goal that was taught beside a wall must be reachable, too.
        tight = min(now.limits.clearance_m, max(APPROACH.goal_clearance_m, room - 0.01))
        sees_behind = context.local_costmap.known_floor.sees_behind(place)
        backwards = now.limits.max_reverse if sees_behind else 0.0
        limits = now.limits._replace(
            max_speed=speed, max_reverse=min(backwards, speed), clearance_m=tight
        )
        steady = Motion(now.steady, now.motion.twist)
        wanted = alignment.command(steady, self.aim, limits, now.elapsed_s)
        if wanted is None:
            self.has_arrived = True
            return Twist2D.zero()
        wanted = limited_change(now.motion.twist, wanted, limits, now.elapsed_s)
        return safe_command(now.motion, wanted, context.local_costmap, limits)
