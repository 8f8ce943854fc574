"""The robot's own image: where a mirror hangs."""

import math

import numpy as np
import pytest
from bench.mapper.perfect_robot import CLEARANCE, LIMITS
from numpy.typing import NDArray

from trolley.geometry import Pose2D
from trolley.gridmap import FREE, OCCUPIED, GridMap, cast_rays
from trolley_mapper.explore.exploration_goal import Scene
from trolley_mapper.explore.explorer import Explorer
from trolley_mapper.explore.own_image import OwnImage

MIRROR_X = 6.0
BODY_M = 0.15
"""Radius of the robot as its image shows it [m]."""
BEAMS = 360
START = Pose2D(3.0, 1.0, 0.6)
NO_MIRRORS = np.empty((0, 4))


def make_hall() -> GridMap:
    """A hall of 6 x 4 m and, beyond the mirror at its end, its image."""
    cells = np.full((84, 244), OCCUPIED, np.int8)
    cells[2:-2, 2:-2] = FREE
    for left, low in ((30, 60), (60, 12)):
        cells[low : low + 8, left : left + 10] = OCCUPIED
        cells[low : low + 8, 244 - left - 10 : 244 - left] = OCCUPIED
    return GridMap("hall", 0.05, Pose2D(-0.1, -0.1, 0.0), cells)


def make_corridor() -> GridMap:
    """A corridor of 20 x 1.6 m with nothing in it."""
    cells = np.full((36, 404), OCCUPIED, np.int8)
    cells[2:-2, 2:-2] = FREE
    return GridMap("corridor", 0.05, Pose2D(-4.1, -0.1, 0.0), cells)


def see(
    place: Pose2D,
    thing: tuple[float, float],
    rng: np.random.Generator,
    hall: GridMap | None = None,
) -> NDArray[np.float64]:
    """What the lidar measures with something round standing in the hall."""
    hall = hall or make_hall()
    angles = place.yaw + beam_angles()
    at = hall.origin.inverse() @ place
    ranges = cast_rays(hall.occupied_mask(), hall.resolution, (at.x, at.y), angles, 12.0)
    dx, dy = thing[0] - place.x, thing[1] - place.y
    along = dx * np.cos(angles) + dy * np.sin(angles)
    aside = dx * np.sin(angles) - dy * np.cos(angles)
    is_met = (np.abs(aside) < BODY_M) & (along > 0.0)
    met = along - np.sqrt(np.maximum(BODY_M**2 - aside**2, 0.0))
    return np.where(is_met, np.minimum(met, ranges), ranges) + 0.01 * rng.standard_normal(BEAMS)


def beam_angles() -> NDArray[np.float64]:
    return np.linspace(-math.pi, math.pi, BEAMS, endpoint=False, dtype=np.float64)


def image(place: Pose2D) -> tuple[float, float]:
    return 2.0 * MIRROR_X - place.x, place.y


def drive(*, is_mirror: bool, mirrors: NDArray[np.float64] = NO_MIRRORS) -> list[Pose2D]:
    """Drive towards the end of the hall, aslant; return the mirrors that are found."""
    own_image, rng = OwnImage(), np.random.default_rng(1)
    found: list[Pose2D] = []
    for way_m in np.arange(0.0, 1.5, 0.06).tolist():
        place = START @ Pose2D(way_m, 0.0, 0.0)
        thing = image(place) if is_mirror else image(START)
        ranges = see(place, thing, rng)
        mirror = own_image.update(place, ranges, beam_angles(), mirrors)
        if mirror is not None:
            found.append(mirror)
    return found


def test_a_mirror_is_found_from_the_robots_own_image() -> None:
    found = drive(is_mirror=True)
    assert found
    for mirror in found:
        # Before the mirror by half of what the image's face is nearer than its middle.
        assert mirror.x == pytest.approx(MIRROR_X - 0.5 * BODY_M, abs=0.05)
        assert mirror.yaw == pytest.approx(0.0, abs=0.1)


def test_a_thing_that_stands_still_is_no_image() -> None:
    assert drive(is_mirror=False) == []


def test_somebody_who_comes_down_a_corridor_as_fast_as_the_robot_is_no_image() -> None:
    own_image, rng, corridor = OwnImage(), np.random.default_rng(1), make_corridor()
    for way_m in np.arange(0.0, 3.0, 0.06).tolist():
        place = Pose2D(2.5 + way_m, 0.8, 0.0)
        ranges = see(place, image(place), rng, corridor)
        assert own_image.update(place, ranges, beam_angles(), NO_MIRRORS) is None


def test_where_a_mirror_would_have_shown_the_image_before_there_is_none() -> None:
    own_image, rng = OwnImage(), np.random.default_rng(1)
    far_off = (-3.0, 1.0)
    for way_m in np.arange(0.0, 1.5, 0.06).tolist():
        place = START @ Pose2D(way_m, 0.0, -START.yaw)
        thing = image(place) if way_m > 0.6 else far_off
        ranges = see(place, thing, rng)
        assert own_image.update(place, ranges, beam_angles(), NO_MIRRORS) is None


def test_what_is_seen_in_a_mirror_that_is_known_proves_no_other() -> None:
    known = np.array([[MIRROR_X, 0.0, MIRROR_X, 4.0]])
    assert drive(is_mirror=True, mirrors=known) == []


def test_a_mirror_is_a_barrier_for_the_explorer_before_the_robot_has_stood() -> None:
    explorer, rng = Explorer("run", CLEARANCE, LIMITS), np.random.default_rng(1)
    explorer.begin(None, None)
    for number in range(25):
        place = START @ Pose2D(0.06 * number, 0.0, 0.0)
        ranges = see(place, image(place), rng)
        explorer.hear_scan(place, ranges, beam_angles(), NO_MIRRORS)
        explorer.step(Scene(make_hall(), place, False, False, (), START), None, 0.1 * number)
    assert explorer.barriers
    xs = [x for zone in explorer.barriers for x, _ in zone.points]
    assert xs == pytest.approx([MIRROR_X - 0.5 * BODY_M] * len(xs), abs=0.15)
    assert explorer.wants_survey(2.5)
