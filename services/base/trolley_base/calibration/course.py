"""Where the calibration drives: places to drive to and to turn to, and whether there is room."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D, Twist2D, distance_to_segments, wrap_angle
from trolley_base.calibration.umbmark import Direction

QUARTER = 0.5 * math.pi


@dataclass(frozen=True, slots=True)
class CourseParams:
    """How the course is steered; set by hand."""

    clearance_m: float = 0.10
    """Room beside the robot, for a heading that is corrected late [m]."""
    deceleration: float = 0.15
    """Deceleration at the end of a straight, slow enough for base and a scan's delay [m/s^2]."""
    angular_deceleration: float = 0.6
    """Deceleration at the end of a turn, slow enough for base and a scan's delay [rad/s^2]."""
    min_speed: float = 0.03
    """Speed at the end of a straight [m/s]."""
    min_wz: float = 0.08
    """Turn rate at the end of a turn [rad/s]."""
    max_wz: float = 0.7
    """Fastest turn [rad/s]."""
    xy_tolerance: float = 0.008
    """Distance within which a place is reached [m]."""
    yaw_tolerance: float = 0.012
    """Angle within which a heading is reached [rad]."""
    cross_track_gain: float = 6.0
    """Turn rate per metre aside and per m/s [rad/m^2]."""
    heading_gain: float = 1.5
    """Turn rate per radian off the line's direction [1/s]."""


PARAMS = CourseParams()


@dataclass(frozen=True, slots=True)
class Place:
    """Drive straight to a pose, or turn to it.

    Attributes:
        pose: start_T_base at its end, where `start` is the pose at the beginning of the course.
        drives: whether it lies ahead; else only the heading changes.
    """

    pose: Pose2D
    drives: bool

    def is_near(self, place_T_base: Pose2D, metres: float, radians: float) -> bool:
        """Say whether so little is left that the robot may rest here."""
        return -place_T_base.x < metres if self.drives else abs(place_T_base.yaw) < radians

    def command(self, place_T_base: Pose2D, speed_mps: float) -> Twist2D | None:
        """Return the velocity towards the place, None where the robot is there.

        Args:
            place_T_base: where the robot is, seen from the place.
            speed_mps: on the straight.
        """
        if not self.drives:
            left = -place_T_base.yaw
            if abs(left) < PARAMS.yaw_tolerance:
                return None
            rate = min(PARAMS.max_wz, math.sqrt(2.0 * PARAMS.angular_deceleration * abs(left)))
            return Twist2D(0.0, 0.0, math.copysign(max(PARAMS.min_wz, rate), left))
        ahead = -place_T_base.x
        if ahead < PARAMS.xy_tolerance:
            return None
        speed = max(PARAMS.min_speed, min(speed_mps, math.sqrt(2.0 * PARAMS.deceleration * ahead)))
        turn = (
            -PARAMS.cross_track_gain * speed * place_T_base.y
            - PARAMS.heading_gain * place_T_base.yaw
        )
        return Twist2D(speed, 0.0, max(-PARAMS.max_wz, min(PARAMS.max_wz, turn)))


def square(side_m: float, direction: Direction, begin: Pose2D | None = None) -> list[Place]:
    """Return the eight places of a square that begins along x of `begin` and ends there.

    Args:
        side_m: of a side.
        direction: which way round.
        begin: start_T_begin; at the start if not given.
    """
    at = begin or Pose2D.identity()
    turn = QUARTER if direction == "ccw" else -QUARTER
    places: list[Place] = []
    for _ in range(4):
        at = at @ Pose2D(side_m, 0.0, 0.0)
        places.append(Place(at, drives=True))
        at = Pose2D(at.x, at.y, wrap_angle(at.yaw + turn))
        places.append(Place(at, drives=False))
    return places


@dataclass(frozen=True, slots=True)
class Course:
    """Places, and which of the rests at them begin and end a square.

    Attributes:
        places: one after the other.
        squares: direction, and the numbers of the rests before and after; rest 0 is the start.
    """

    places: list[Place]
    squares: list[tuple[Direction, int, int]]


def squares_both_ways(side_m: float, runs: int) -> Course:
    """Return squares in alternating directions, all on the floor ahead to the left."""
    aside = Pose2D(0.0, 0.0, QUARTER)
    places: list[Place] = []
    squares: list[tuple[Direction, int, int]] = []
    for _ in range(runs):
        squares.append(("ccw", len(places), len(places) + 8))
        places += [*square(side_m, "ccw"), Place(aside, drives=False)]
        squares.append(("cw", len(places), len(places) + 8))
        places += [*square(side_m, "cw", aside), Place(Pose2D.identity(), drives=False)]
    return Course(places, squares)


def find_obstacle(
    points_start: NDArray[np.float64], places: list[Place], radius_m: float
) -> tuple[float, float] | None:
    """Return the nearest echo that blocks a course, None if there is none.

    Rough: what is hidden behind something else cannot be seen from the start.

    Args:
        points_start: (n, 2) echoes x, y [m], seen from the start; not finite ones are left out.
        places: of the course.
        radius_m: of the robot.
    """
    points = points_start[np.isfinite(points_start).all(axis=1)]
    # What the lidar sees of the robot itself does not stand in its way.
    points = points[np.hypot(points[:, 0], points[:, 1]) > radius_m]
    if len(points) == 0:
        return None
    corners = np.array([(0.0, 0.0), *((place.pose.x, place.pose.y) for place in places)])
    gaps = distance_to_segments(points, corners[:-1], corners[1:])
    nearest = int(np.argmin(gaps))
    if gaps[nearest] > radius_m + PARAMS.clearance_m:
        return None
    return float(points[nearest, 0]), float(points[nearest, 1])
