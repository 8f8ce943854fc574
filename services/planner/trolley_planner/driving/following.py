"""Following a person: whom, where behind them, how fast, and when they are lost.

Everything is in the frame of the goals, which outlives costmaps.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D, Twist2D, wrap_angle
from trolley_planner.context.planning_context import PlanningContext
from trolley_planner.control.robot_motion import Limits
from trolley_planner.goals import Goal, Tolerances
from trolley_planner.people.tracker import Track


@dataclass(frozen=True, slots=True)
class FollowingParams:
    """How a person is picked, followed and given up; all by hand."""

    pick_m: float = 0.6
    """Distance from the chosen point within which a person is picked."""
    ahead_rad: float = 0.8
    """Angle to either side of straight ahead within which the nearest person is picked."""
    most_size_m: float = 0.7
    """Largest extent of the echoes of a standing person."""
    lost_s: float = 3.0
    """Time out of sight after which a person is lost."""
    unseen_s: float = 0.5
    """Time out of sight after which the robot drives to where it last saw the person."""
    walks_on_s: float = 1.0
    """Time for which a person out of sight is taken to walk on."""
    astray_m: float = 0.35
    """Radius in which a person is searched for when just out of sight."""
    astray_mps: float = 0.5
    """Growth of that radius with the time out of sight."""
    footstep_m: float = 0.1
    """Distance between two remembered positions of the person."""
    trail_m: float = 6.0
    """Length of the track that is remembered."""
    moved_m: float = 0.15
    """The place to drive to moves in steps no smaller than this."""
    closer_m: float = 0.4
    """Distance by which the target lies nearer to the person than the distance to keep."""
    lead_s: float = 1.5
    """Time for which the person's walk moves the target farther on, since the controller slows down
    before it."""
    beside_m: float = 0.45
    """Least distance from the robot's outline to the centre of the person."""
    set_off_m: float = 0.2
    """Distance beyond the one to keep at which a standing robot sets off."""
    slack_m: float = 0.3
    """Distance short of the one to keep at which the robot stops behind a walking person; until
    then it only slows down."""
    catch_up_per_s: float = 0.6
    """How much faster than the person the robot drives, per metre that it lags behind [1/s]."""
    least_mps: float = 0.1
    """Slowest speed while it catches up."""
    face_rad: float = 0.3
    """Bearing of the person beyond which a standing robot turns towards them."""
    turn_gain: float = 1.5
    """Turn rate per bearing [1/s]."""


FOLLOWING = FollowingParams()
BEHIND = Tolerances(0.3, math.pi)
"""Near enough to the place behind them; any heading."""


def pick_person(
    tracks: Sequence[Track], here: Pose2D, point: tuple[float, float] | None
) -> Track | None:
    """Return whom to follow, None if nobody is there.

    Without a point those who walk go before what only has the size of a person.

    Args:
        tracks: in the frame of `here`.
        here: pose of the robot.
        point: near the person [m], None for the nearest ahead.
    """
    people = [one for one in tracks if _may_be_person(one)]
    if point is not None:
        near = [one for one in people if math.dist(one.place, point) < FOLLOWING.pick_m]
        return min(near, key=lambda one: math.dist(one.place, point), default=None)
    ahead = [one for one in people if abs(_bearing(here, one.place)) < FOLLOWING.ahead_rad]
    return min(
        ahead,
        key=lambda one: (not one.is_moving, math.dist(one.place, (here.x, here.y))),
        default=None,
    )


class Following:
    """One person, while they are followed.

    Args:
        person: whom to follow.
        here: pose of the robot.
        distance_m: how far behind them to stay, from middle to middle.
        now_ns: robot time.
    """

    def __init__(self, person: Track, here: Pose2D, distance_m: float, now_ns: int) -> None:
        self._distance_m = distance_m
        self._identity = person.identity
        self._trail = [np.array([here.x, here.y]), person.place]
        self._place, self._velocity = person.place, person.velocity
        self._seen_ns = now_ns
        self._stands = False

    @property
    def person(self) -> tuple[float, float]:
        """Where they were seen last."""
        return float(self._place[0]), float(self._place[1])

    def update(self, tracks: Sequence[Track], now_ns: int) -> None:
        """Find the person in a scan.

        Args:
            tracks: of the newest scan.
            now_ns: robot time.
        """
        found = next((one for one in tracks if one.identity is self._identity), None)
        found = self._found_again(tracks, now_ns) if found is None else found
        if found is None:
            return
        self._identity, self._seen_ns = found.identity, now_ns
        self._place, self._velocity = found.place, found.velocity
        if math.dist(self._trail[-1], found.place) >= FOLLOWING.footstep_m:
            self._trail.append(found.place)
        most = round(FOLLOWING.trail_m / FOLLOWING.footstep_m)
        del self._trail[:-most]

    def unseen_s(self, now_ns: int) -> float:
        """Return for how long they have been out of sight [s]."""
        return (now_ns - self._seen_ns) * 1e-9

    def is_in_sight(self, now_ns: int) -> bool:
        """Say whether the robot sees them, or did a moment ago."""
        return self.unseen_s(now_ns) < FOLLOWING.unseen_s

    def is_lost(self, now_ns: int) -> bool:
        """Say whether they have been out of sight for too long."""
        return self.unseen_s(now_ns) >= FOLLOWING.lost_s

    def place_behind(self, now_ns: int) -> Pose2D:
        """Return where the robot is to be: on their track, or where they were seen last."""
        if not self.is_in_sight(now_ns):
            return Pose2D(*self.person, 0.0)
        walked_m = FOLLOWING.lead_s * math.hypot(*self._velocity)
        left = self._distance_m - FOLLOWING.closer_m - walked_m
        later = self._place
        for place in reversed(self._trail):
            step = math.dist(place, later)
            if step >= max(left, 1e-6):
                x, y = later + (max(left, 0.0) / step) * (place - later)
                return Pose2D(float(x), float(y), 0.0)
            left, later = left - step, place
        return Pose2D(float(later[0]), float(later[1]), 0.0)

    def moved_goal(self, goal: Goal, now_ns: int) -> Goal | None:
        """Return the goal moved behind the person, None if it is near enough already."""
        place = self.place_behind(now_ns)
        is_near = goal.pose.distance_to(place) < FOLLOWING.moved_m
        return None if is_near else replace(goal, pose=place)

    def speed(self, here: Pose2D, now_ns: int) -> float | None:
        """Return the highest speed now [m/s], None for any: no faster than catches up gently."""
        if not self.is_in_sight(now_ns):
            return None
        away = self._place - (here.x, here.y)
        gap = max(math.hypot(*away), 1e-6)
        walking = max(float(self._velocity @ away) / gap, 0.0)
        lag = gap - self._distance_m
        return max(walking + FOLLOWING.catch_up_per_s * lag, FOLLOWING.least_mps)

    def must_stand(self, here: Pose2D, circumscribed_m: float, now_ns: int) -> bool:
        """Say whether the robot is near enough, with some hysteresis.

        Args:
            here: pose of the robot.
            circumscribed_m: of its outline.
            now_ns: robot time.
        """
        slack_m = FOLLOWING.slack_m if self._velocity.any() else 0.0
        near_m = max(self._distance_m - slack_m, circumscribed_m + FOLLOWING.beside_m)
        near_m += FOLLOWING.set_off_m if self._stands else 0.0
        gap_m = math.dist(self._place, (here.x, here.y))
        self._stands = self.is_in_sight(now_ns) and gap_m < near_m
        return self._stands

    def turn_to(self, here: Pose2D, limits: Limits) -> Twist2D:
        """Return the velocity that turns a standing robot towards the person."""
        bearing = _bearing(here, self._place)
        if abs(bearing) < FOLLOWING.face_rad:
            return Twist2D.zero()
        rate = FOLLOWING.turn_gain * bearing
        return Twist2D(0.0, 0.0, min(max(rate, -limits.max_turn), limits.max_turn))

    def _found_again(self, tracks: Sequence[Track], now_ns: int) -> Track | None:
        """Return the track nearest to the predicted position, None if none is near."""
        unseen_s = self.unseen_s(now_ns)
        expected = self._place + min(unseen_s, FOLLOWING.walks_on_s) * self._velocity
        reach_m = FOLLOWING.astray_m + FOLLOWING.astray_mps * unseen_s
        near = [
            one
            for one in tracks
            if math.dist(one.place, expected) < reach_m and _may_be_person(one)
        ]
        return min(near, key=lambda one: math.dist(one.place, expected), default=None)


def tracks_in_frame(tracks: Sequence[Track], frame_T_grid: Pose2D) -> list[Track]:
    """Return tracks of `grid` in the frame of the goals."""
    turn = Pose2D(0.0, 0.0, frame_T_grid.yaw)
    return [
        one._replace(
            place=frame_T_grid.transform_points(one.place[None])[0],
            velocity=turn.transform_points(one.velocity[None])[0],
        )
        for one in tracks
    ]


def tracks_seen(context: PlanningContext) -> list[Track]:
    """Return who and what moves or has a person's size now, in the frame of the goals."""
    costmap = context.costmap
    return tracks_in_frame(costmap.moving.tracks, costmap.frame_T_grid)


def _may_be_person(one: Track) -> bool:
    return one.is_moving or one.size_m < FOLLOWING.most_size_m


def _bearing(here: Pose2D, place: NDArray[np.float64]) -> float:
    """Return the direction of a place from the robot's heading [rad]."""
    away = math.atan2(float(place[1]) - here.y, float(place[0]) - here.x)
    return wrap_angle(away - here.yaw)
