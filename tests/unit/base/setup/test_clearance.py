"""What is too near on the way that a command leads."""

import math

import numpy as np
import pytest

from trolley.geometry import Twist2D, footprint_from_box
from trolley_base.setup.clearance import Body, Mount
from trolley_base.setup.record import SetupRefused

BODY = Body(footprint_from_box(0.30, 0.24))
MOUNT = Mount(axle=np.zeros(2), ahead=np.array([1.0, 0.0]))
RADIUS_M = 0.45
LEFT, RIGHT = Twist2D(0.5, 0.0, 0.5 / RADIUS_M), Twist2D(0.5, 0.0, -0.5 / RADIUS_M)


def thing(x: float, y: float) -> np.ndarray:
    return np.array([[x, y], [x, y], [x, y]])


def on_circle(twist: Twist2D, ahead_m: float, inside_m: float = 0.0) -> np.ndarray:
    """What stands so far ahead on the circle, and so far within it."""
    angle, radius_m = ahead_m / RADIUS_M, RADIUS_M - inside_m
    side = math.copysign(1.0, twist.wz)
    return thing(radius_m * math.sin(angle), side * (RADIUS_M - radius_m * math.cos(angle)))


@pytest.mark.parametrize("twist", [LEFT, RIGHT])
def test_what_stands_on_the_circle_is_in_the_way(twist: Twist2D) -> None:
    with pytest.raises(SetupRefused, match="nearer than it may be"):
        BODY.refuse_obstacle(on_circle(twist, 0.24), MOUNT, twist)
    BODY.refuse_obstacle(on_circle(twist, 0.40), MOUNT, twist)


@pytest.mark.parametrize(("twist", "other"), [(LEFT, RIGHT), (RIGHT, LEFT)])
def test_what_stands_on_the_other_circle_is_not(twist: Twist2D, other: Twist2D) -> None:
    thing_there = on_circle(other, 0.26, 0.16)
    with pytest.raises(SetupRefused):
        BODY.refuse_obstacle(thing_there, MOUNT, other)
    BODY.refuse_obstacle(thing_there, MOUNT, twist)


def test_what_stands_straight_ahead_is_in_the_way_of_a_stroke_and_not_behind() -> None:
    ahead, back = Twist2D(0.5, 0.0, 0.0), Twist2D(-0.5, 0.0, 0.0)
    with pytest.raises(SetupRefused):
        BODY.refuse_obstacle(thing(0.25, 0.0), MOUNT, ahead)
    BODY.refuse_obstacle(thing(0.25, 0.0), MOUNT, back)
    with pytest.raises(SetupRefused):
        BODY.refuse_obstacle(thing(-0.25, 0.0), MOUNT, back)


def test_a_robot_that_stops_late_keeps_a_greater_distance() -> None:
    BODY.refuse_obstacle(thing(0.35, 0.0), MOUNT, Twist2D(0.5, 0.0, 0.0))
    with pytest.raises(SetupRefused):
        BODY.refuse_obstacle(thing(0.35, 0.0), MOUNT, Twist2D(0.5, 0.0, 0.0), stopping_m=0.25)


def test_a_lidar_that_sees_as_in_a_mirror_looks_at_the_right_side() -> None:
    mirrored = Mount(axle=np.zeros(2), ahead=np.array([1.0, 0.0]), sign=-1.0)
    seen = on_circle(LEFT, 0.26, 0.16) * (1.0, -1.0)
    with pytest.raises(SetupRefused):
        BODY.refuse_obstacle(seen, mirrored, LEFT)
    BODY.refuse_obstacle(seen, mirrored, RIGHT)
