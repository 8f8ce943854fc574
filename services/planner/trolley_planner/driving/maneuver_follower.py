"""Following a maneuver: line by line and turn by turn."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D, Twist2D, wrap_angle, wrap_angles
from trolley_planner.control.controller import Motion
from trolley_planner.control.robot_motion import Limits
from trolley_planner.costmap.footprint import Body, Field
from trolley_planner.driving.goal_approach import braking_speed, turn_rate
from trolley_planner.paths.hybrid_astar.centering import recentered
from trolley_planner.paths.hybrid_astar.motion_primitives import FORWARDS, TURNING, Maneuver


@dataclass(frozen=True, slots=True)
class FollowerParams:
    """How a maneuver is followed; all by hand."""

    stalled_s: float = 1.5
    """Time without progress after which a maneuver is given up."""
    stalled_m: float = 0.015
    """Progress below which the robot counts as held up, turns counted by `turn_as_m`."""
    short_m: float = 0.23
    """Distance of a robot's outermost point up to which `settle_rad` and `look_m` hold; what
    reaches farther swings farther, and is led more exactly in proportion."""
    settle_rad: float = 0.03
    """Distance to the end of a turn at which it is over."""
    settle_last_rad: float = 0.015
    """The same of a turn at the maneuver's end."""
    track_m: float = 0.16
    """An error beside the maneuver decays over this distance."""
    look_s: float = 0.35
    """Time ahead over which the curvature is read, since the robot does not turn at once."""
    look_m: float = 0.1
    """Least distance ahead over which it is read."""
    near_end_m: float = 0.05
    """Distance along a line to its end within which it may be over."""
    strayed_m: float = 0.05
    """Distance from the maneuver's nearest pose beyond which the robot needs another one."""
    strayed_rad: float = 0.25
    """Heading error beyond which the robot needs another maneuver."""
    late_m: float = 0.3
    """Most by which the robot is behind the place that it is led from, since it obeys late."""
    bend_ahead_m: float = 0.3
    """Distance before a bend at which the robot slows down, since it cannot turn at once."""
    creep_mps: float = 0.04
    """Speed at the end of a line."""
    arrived_m: float = 0.008
    """Distance to the end of a line at which it is over."""
    nearest_of: int = 8
    """Number of poses from the last one on among which the robot's place is found."""
    turn_as_m: float = 0.3
    """A turn by one radian that is left counts as this distance."""


FOLLOWER = FollowerParams()


class Place(NamedTuple):
    """Where the robot is beside a line of its maneuver."""

    at_m: float
    """From the maneuver's beginning, without turns."""
    aside_m: float
    """To the left of the line."""
    off_rad: float
    """Its heading against that of the line."""


class ManeuverFollower:
    """Follows one maneuver: line by line and turn by turn.

    Args:
        maneuver: the maneuver, in the frame of the poses given later.
        reach_m: distance of the robot's outermost point from its origin: the farther, the more
            exactly it is led.
        onward_m: how far the robot drives on behind its end; 0: it stops there, and looks along
            the maneuver.
    """

    def __init__(self, maneuver: Maneuver, reach_m: float, onward_m: float = 0.0) -> None:
        self._poses, self._motions = maneuver.poses.copy(), maneuver.motions
        self._kept = maneuver.kept
        self.end = maneuver.end
        """Where it ends."""
        self._along, self._left = _measured(maneuver)
        self._onward_m = onward_m
        share = FOLLOWER.short_m / max(reach_m, FOLLOWER.short_m)
        self._settle_rad, self._look_m = share * FOLLOWER.settle_rad, share * FOLLOWER.look_m
        self._index = 0
        self._run_end = self._end_of_run(0)
        self._yaw: float | None = None
        self._begins_run = False
        self._stalled_s = 0.0
        self._stalled_at = Pose2D(*self._poses[0].tolist())

    @property
    def left_m(self) -> float:
        """What is left of it [m]; turns count, too."""
        return float(self._left[self._index])

    @property
    def sense(self) -> int:
        """How it drives now: FORWARDS, BACKWARDS or TURNING."""
        return int(self._motions[self._run_end])

    def recenter(self, field: Field, body: Body) -> None:
        """Bend the present drive, if it leads forwards, to the middle of what is seen by now."""
        if self.sense != FORWARDS or self._index < self._kept:
            return
        drive = slice(self._index, self._run_end + 1)
        self._poses[drive] = recentered(self._poses[drive], field, body)
        self._along, self._left = _measured(Maneuver(self._poses, self._motions))

    def poses_ahead(self, length_m: float) -> NDArray[np.float64]:
        """Return the poses (n, 3) of this length of the maneuver from the robot on."""
        wanted_m = float(self._along[self._index]) + length_m
        end = int(np.searchsorted(self._along, wanted_m, side="right"))
        return self._poses[self._index : max(end, self._index + 1)]

    def poses_from(self, pose: Pose2D, length_m: float) -> NDArray[np.float64]:
        """Return where the robot comes from a pose: it turns where it stands, and steers back.

        Behind the next change between lines and turns it goes on from where that finds it.
        """
        ahead, sense = self.poses_ahead(length_m), self.sense
        if sense == TURNING:
            return ahead + np.array([pose.x - ahead[0, 0], pose.y - ahead[0, 1], 0.0])
        place = self._place(pose)
        run = np.minimum(np.arange(self._index, self._index + len(ahead)), self._run_end)
        # `_line` lets an error beside the line decay as a critically damped spring.
        along = np.maximum(self._along[run] - place.at_m, 0.0)
        decay = np.exp(-along / FOLLOWER.track_m)
        rise = sense * place.off_rad + place.aside_m / FOLLOWER.track_m
        asides = decay * (place.aside_m + rise * along)
        offs = decay * (place.off_rad - sense * rise * along / FOLLOWER.track_m)
        yaws = self._poses[run, 2]
        return ahead + np.column_stack([-asides * np.sin(yaws), asides * np.cos(yaws), offs])

    def run_ahead(self, length_m: float) -> NDArray[np.float64]:
        """Return the poses (n, 3) of this length of it, no farther than its next change."""
        ahead = self.poses_ahead(length_m)
        return ahead[: max(self._run_end - self._index + 1, 1)]

    def pop_turn(self, pose: Pose2D) -> float:
        """Return the angle of a turn on the spot that follows a line and begins now, once [rad]."""
        begins, self._begins_run = self._begins_run, False
        if not begins or self.sense != TURNING:
            return 0.0
        first, last = float(self._poses[self._index, 2]), float(self._poses[self._run_end, 2])
        return last - first - wrap_angle(pose.yaw - first)

    def turn_to_go(self, pose: Pose2D) -> float:
        """Return the angle that is left of a turn on the spot, 0 along a line [rad]."""
        if self._yaw is None or self.sense != TURNING:
            return 0.0
        return float(self._poses[self._run_end, 2]) - self._yaw - wrap_angle(pose.yaw - self._yaw)

    def has_strayed(self, pose: Pose2D) -> bool:
        """Say whether the robot is too far off its maneuver."""
        turns = self.sense == TURNING
        first = int(np.searchsorted(self._along, self._along[self._index] - FOLLOWER.late_m))
        near = self._poses[first : (self._run_end if turns else self._index + 1) + 1]
        off_m = np.hypot(near[:, 0] - pose.x, near[:, 1] - pose.y)
        off_rad = np.abs(wrap_angles(near[:, 2] - pose.yaw))
        nearest = int(np.argmin(off_m + FOLLOWER.turn_as_m * off_rad))
        is_turned = not turns and off_rad[nearest] > FOLLOWER.strayed_rad
        return bool(off_m[nearest] > FOLLOWER.strayed_m or is_turned)

    def is_stalled(self, pose: Pose2D, elapsed_s: float) -> bool:
        """Record the pose; say whether the robot has been held up for long, for any reason."""
        moved_m = pose.distance_to(self._stalled_at)
        moved_m += FOLLOWER.turn_as_m * abs(wrap_angle(pose.yaw - self._stalled_at.yaw))
        if moved_m > FOLLOWER.stalled_m:
            self._stalled_at, self._stalled_s = pose, 0.0
        self._stalled_s += elapsed_s
        return self._stalled_s > FOLLOWER.stalled_s

    def command(self, motion: Motion, limits: Limits) -> Twist2D | None:
        """Return the velocity to drive now, None at the maneuver's end.

        Args:
            motion: of the robot.
            limits: of the robot, those of the place included.
        """
        pose = motion.pose
        while self._index < len(self._poses) - 1:
            turns = self.sense == TURNING
            twist = self._turn(pose, limits) if turns else self._line(motion, limits)
            if twist is not None:
                return twist
            self._index = self._run_end
            self._run_end = self._end_of_run(self._index)
            self._yaw = None
            self._begins_run = True
        return self._turn(pose, limits) if self._onward_m == 0.0 else None

    def _end_of_run(self, first: int) -> int:
        """Return the last pose that is reached by the same motion as the one after `first`."""
        if first >= len(self._poses) - 1:
            return first
        same = self._motions[first + 1 :] == self._motions[first + 1]
        other = np.flatnonzero(~same)
        return first + (int(other[0]) if len(other) else len(same))

    def _turn(self, pose: Pose2D, limits: Limits) -> Twist2D | None:
        """Return the velocity of a turn on the spot, None when it is over."""
        goal = float(self._poses[self._run_end, 2])
        has_more = self._run_end < len(self._poses) - 1
        # The turn that is free may be the longer one.
        near = float(self._poses[self._index, 2]) if self._yaw is None else self._yaw
        self._yaw = near + wrap_angle(pose.yaw - near)
        left = goal - self._yaw
        if abs(left) < (self._settle_rad if has_more else FOLLOWER.settle_last_rad):
            return None
        if not has_more:
            return Twist2D(0.0, 0.0, turn_rate(left, limits))
        # What is missed is steered away on the line that follows.
        rate = min(braking_speed(limits.turn_acceleration, abs(left)), limits.max_turn)
        return Twist2D(0.0, 0.0, math.copysign(rate, left))

    def _line(self, motion: Motion, limits: Limits) -> Twist2D | None:
        """Return the velocity along a line or curve, None at its end."""
        pose, sense = motion.pose, self.sense
        self._advance(pose)
        last = self._poses[self._run_end]
        cos, sin = math.cos(float(last[2])), math.sin(float(last[2]))
        left = sense * ((float(last[0]) - pose.x) * cos + (float(last[1]) - pose.y) * sin)
        place, decay = self._place(pose), FOLLOWER.track_m
        along = float(self._along[self._run_end]) - place.at_m
        if along < FOLLOWER.near_end_m and left < FOLLOWER.arrived_m:
            return None
        look_m = max(FOLLOWER.look_s * abs(motion.twist.vx), self._look_m)
        bend = self._bend(place.at_m, look_m)
        bend -= sense * place.aside_m / decay**2 + 2.0 * place.off_rad / decay
        speed = limits.max_speed if sense > 0 else limits.max_reverse
        speed = min(speed, limits.max_turn / max(abs(bend), 1e-3), self._bend_speed(limits))
        rest = max(left, 0.0) if along < 2.0 * decay else along
        if sense > 0 and self._run_end == len(self._poses) - 1:
            rest += self._onward_m
        braking = braking_speed(limits.deceleration, rest)
        speed = min(speed, max(braking, FOLLOWER.creep_mps))
        return Twist2D(sense * speed, 0.0, bend * speed)

    def _bend_speed(self, limits: Limits) -> float:
        """Return the speed from which the robot can slow down for the bends right ahead [m/s]."""
        reach_m = float(self._along[self._index]) + FOLLOWER.bend_ahead_m
        end = min(int(np.searchsorted(self._along, reach_m)), self._run_end)
        if end - self._index < 2:
            return math.inf
        part = slice(self._index, end + 1)
        along = self._along[part]
        turns = np.abs(np.diff(self._poses[part, 2])) / np.maximum(np.diff(along), 1e-3)
        # Two neighbours are half a bend each: headings come in steps.
        bends = 0.5 * (turns[1:] + turns[:-1])
        there = 0.5 * limits.max_turn / np.maximum(bends, 1e-3)
        before_m = along[1:-1] - along[0]
        return float(np.sqrt(there**2 + 2.0 * limits.deceleration * before_m).min())

    def _advance(self, pose: Pose2D) -> None:
        """Go on to the last pose of the present line that the robot has passed."""
        near = self._poses[self._index : self._run_end + 1][: FOLLOWER.nearest_of]
        nearest = int(np.argmin(np.hypot(near[:, 0] - pose.x, near[:, 1] - pose.y)))
        x, y, yaw = near[nearest].tolist()
        ahead_m = (pose.x - x) * math.cos(yaw) + (pose.y - y) * math.sin(yaw)
        is_passed = self.sense * ahead_m >= 0.0
        self._index += nearest if is_passed else max(nearest - 1, 0)

    def _place(self, pose: Pose2D) -> Place:
        """Return where the robot is beside the present line."""
        first, last = self._index, min(self._index + 1, self._run_end)
        x, y, yaw = self._poses[first].tolist()
        step_x, step_y, turn = (self._poses[last] - self._poses[first]).tolist()
        length = math.hypot(step_x, step_y)
        share = 0.0
        if length > 0.0:
            share = ((pose.x - x) * step_x + (pose.y - y) * step_y) / length**2
            share = min(max(share, 0.0), 1.0)
        x, y, yaw = x + share * step_x, y + share * step_y, yaw + share * turn
        aside = -(pose.x - x) * math.sin(yaw) + (pose.y - y) * math.cos(yaw)
        return Place(float(self._along[first]) + share * length, aside, wrap_angle(pose.yaw - yaw))

    def _bend(self, at_m: float, look_m: float) -> float:
        """Return how the heading changes along the present line in front of a place [rad/m]."""
        part = slice(self._index, self._run_end + 1)
        ends = np.interp((at_m, at_m + look_m), self._along[part], self._poses[part, 2])
        return float(ends[1] - ends[0]) / look_m


def _measured(maneuver: Maneuver) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return what lies before each pose (n,) and what is left behind it [m]; turns count there."""
    steps: NDArray[np.float64] = np.diff(maneuver.poses, axis=0)
    lengths = np.hypot(steps[:, 0], steps[:, 1])
    turns = np.where(maneuver.motions[1:] == TURNING, np.abs(steps[:, 2]), 0.0)
    left = lengths + FOLLOWER.turn_as_m * turns
    return np.append(0.0, np.cumsum(lengths)), np.append(np.cumsum(left[::-1])[::-1], 0.0)
