"""In the open the path itself is followed, and only there."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from support.flatland import empty_room, with_block

from trolley.config import PlannerConfig
from trolley.geometry import Pose2D, Twist2D, integrate_twist
from trolley.gridmap import GridMap
from trolley_planner.context.planning_context import PlanningContext
from trolley_planner.control.controller import Motion, limits_of, state_of
from trolley_planner.control.critics import Target
from trolley_planner.control.path_tracking import carrot_of, track_into
from trolley_planner.control.rollout import Scene
from trolley_planner.costmap.footprint import Footprint

FOOTPRINT = Footprint.from_polygon([(0.15, 0.12), (-0.15, 0.12), (-0.15, -0.12), (0.15, -0.12)])
CONFIG = PlannerConfig()
LIMITS = limits_of(CONFIG, 0.5, 1.5, 1.0)
Floats = NDArray[np.float64]
START = Pose2D(5.03, 5.01, 0.35)


def straight(start: Pose2D, length_m: float = 3.0) -> Floats:
    along = np.arange(0.0, length_m, 0.05)
    ahead = math.cos(start.yaw), math.sin(start.yaw)
    return np.array([start.x, start.y]) + along[:, None] * ahead


def tracked(
    room: GridMap, start: Pose2D, path: Floats, walkers: Floats | None = None
) -> tuple[bool, Floats]:
    context = PlanningContext(room, FOOTPRINT, CONFIG, 0.5)
    context.local_costmap.update(start.x, start.y)
    field = context.local_costmap.field
    if walkers is not None:
        field = field._replace(walkers=walkers)
    scene = Scene(field, context.local_costmap.body, LIMITS, Target(0.0, 0.0, 0.1, goes_on=True))
    controls = np.zeros((24, 2))
    state = state_of(Motion(start, Twist2D(0.5, 0.0, 0.0)))
    return track_into(controls, state, scene, path), controls


def off_line(start: Pose2D, pose: Pose2D) -> float:
    """How far a pose is to the left of the line ahead of another [m]."""
    return (start.inverse() @ pose).y


@pytest.mark.parametrize("yaw", [0.0, 0.35, 0.6, -0.4, 2.8])
@pytest.mark.parametrize("aside_m", [-0.06, 0.0, 0.04])
def test_a_straight_path_is_come_back_to_and_kept(yaw: float, aside_m: float) -> None:
    start = Pose2D(5.03, 5.01, yaw)
    begin = start @ Pose2D(0.0, aside_m, 0.0)
    is_open, controls = tracked(empty_room(10.0, 10.0), begin, straight(start))
    assert is_open
    pose, off_m = begin, []
    for v, w in controls.tolist():
        pose = integrate_twist(pose, Twist2D(v, 0.0, w), LIMITS.dt)
        off_m.append(off_line(start, pose))
    swing_m = 0.05 * abs(aside_m) + 1e-6
    assert max(off_m) < max(aside_m, 0.0) + swing_m
    assert min(off_m) > min(aside_m, 0.0) - swing_m
    assert abs(off_m[-1]) < 0.01
    assert controls[:, 0].min() > 0.49


def test_it_is_left_to_the_other_controllers_where_something_is_near() -> None:
    room, path = empty_room(10.0, 10.0), straight(START)
    assert tracked(room, START, path)[0]
    side = START @ Pose2D(1.0, 0.5, 0.0)
    assert not tracked(with_block(room, side.x, side.y, 0.2, 0.2), START, path)[0]


def test_it_is_left_to_them_where_somebody_walks() -> None:
    far = np.array([[9.0, 9.0, 0.0, 0.5, 0.25, 0.05, math.inf]])
    assert not tracked(empty_room(10.0, 10.0), START, straight(START), far)[0]


def test_it_is_left_to_them_before_the_end_of_the_path() -> None:
    assert tracked(empty_room(10.0, 10.0), START, straight(START, 2.0))[0]
    assert not tracked(empty_room(10.0, 10.0), START, straight(START, 1.2))[0]
    assert not tracked(empty_room(10.0, 10.0), START, np.empty((0, 2)))[0]


def test_it_is_left_to_them_at_corners_and_looking_elsewhere() -> None:
    room, path = empty_room(10.0, 10.0), straight(START)
    corner = straight(START @ Pose2D(0.6, 0.0, 1.5))
    assert not tracked(room, START, np.concatenate([straight(START, 0.6), corner]))[0]
    assert not tracked(room, START @ Pose2D(0.0, 0.0, 0.6), path)[0]
    assert not tracked(room, START @ Pose2D(0.0, 0.3, 0.0), path)[0]


def test_the_carrot_lies_so_far_along_the_path() -> None:
    path = np.array([(0.0, 0.0), (1.0, 0.0), (1.0, 0.0), (1.0, 1.0)])
    assert carrot_of(path, 0, 0.2, 0.1, 0.5) == (0, pytest.approx(0.7), 0.0)
    assert carrot_of(path, 0, 0.8, -0.1, 0.5) == (0, 1.0, pytest.approx(0.3))
    assert carrot_of(path, 0, -0.5, 0.0, 0.5) == (0, 0.5, 0.0)
    assert carrot_of(path, 0, 1.1, 0.8, 0.5)[0] == -1
