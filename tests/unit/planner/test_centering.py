"""Maneuvers bent to the middle of narrow places."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from support.all_poses import box
from support.fine_grids import fine_grid
from support.flatland import empty_room, two_rooms
from support.maneuvers import SHORT_M

from trolley.gridmap import GridMap
from trolley.gridmap.distance import distance_transform
from trolley_planner.costmap.footprint import NO_LIMITS, Field, Footprint, clearance_at
from trolley_planner.driving.maneuver_follower import ManeuverFollower
from trolley_planner.paths.hybrid_astar.centering import CENTERING, centered, recentered
from trolley_planner.paths.hybrid_astar.motion_primitives import (
    BACKWARDS,
    FORWARDS,
    TURNING,
    Maneuver,
)
from trolley_planner.paths.hybrid_astar.search_space import IN_SIGHT, NEVER_SEEN

HOBBY = Footprint.from_polygon(box(0.35, 0.30, 0.175))
REAR = Footprint.from_polygon(box(0.60, 0.42, 0.10))
DOOR = 4.0, 2.975
"""Middle of a door of 0.35 m between the two rooms [m]."""


def straight(aside_m: float, yaw: float = 0.0, motion: int = FORWARDS) -> Maneuver:
    """Through the door from left to right, this far beside its middle."""
    along = np.arange(-0.8, 0.8, 0.025)
    poses = np.column_stack([
        DOOR[0] + along * math.cos(yaw),
        DOOR[1] + aside_m + along * math.sin(yaw),
        np.full(len(along), yaw if motion == FORWARDS else yaw + math.pi),
    ])  # fmt: skip
    return Maneuver(poses, np.full(len(poses), motion, dtype=np.int8))


def turning_into_door(aside_m: float, first: float, last: float) -> NDArray[np.float64]:
    """Towards the door with one heading, turning on an arc, and through it with another."""
    along = np.arange(-1.2, 0.6, 0.025)
    yaws = last + (first - last) * np.clip((-0.45 - along) / 0.33, 0.0, 1.0)
    steps = np.column_stack([np.cos(yaws), np.sin(yaws)]) * 0.025
    places = np.cumsum(steps, axis=0)
    places += (DOOR[0], DOOR[1] + aside_m) - places[np.argmin(np.abs(along))]
    return np.column_stack([places, yaws])


def with_stray_echoes(field: Field, rng: np.random.Generator) -> Field:
    """Walls as a scan shows them: here and there a cell nearer."""
    solid = field.distance_m <= 0.0
    on_face = ~solid & (field.distance_m <= 1.1 * field.fine_m)
    seen = solid | (on_face & (rng.random(solid.shape) < 0.15))
    return field._replace(distance_m=distance_transform(seen, field.fine_m).astype(np.float32))


def bent(
    maneuver: Maneuver, grid: GridMap, unseen: NDArray[np.uint8] | None = None
) -> NDArray[np.float64]:
    fine = fine_grid(grid, HOBBY)
    known = np.full(fine.mask.shape, IN_SIGHT, np.uint8) if unseen is None else unseen
    found = centered(maneuver, fine, known, HOBBY.body)
    assert np.array_equal(found.motions, maneuver.motions)
    return found.poses


def in_door(poses: NDArray[np.float64]) -> NDArray[np.float64]:
    return poses[np.abs(poses[:, 0] - DOOR[0]) < 0.15]


def field_of(grid: GridMap, footprint: Footprint = HOBBY) -> Field:
    fine = fine_grid(grid, footprint)
    return Field(
        fine.distance_m, NO_LIMITS, NO_LIMITS, fine.x, fine.y, fine.fine_m, 1.0, grid.resolution
    )


def least_clearance_in(field: Field, footprint: Footprint, poses: NDArray[np.float64]) -> float:
    return min(clearance_at(field, footprint.body, x, y, yaw, 1.0) for x, y, yaw in poses.tolist())


def least_clearance(poses: NDArray[np.float64], grid: GridMap) -> float:
    return least_clearance_in(field_of(grid), HOBBY, poses)


@pytest.mark.parametrize("motion", [FORWARDS, BACKWARDS])
@pytest.mark.parametrize("aside_m", [-0.015, 0.02])
def test_a_door_is_passed_in_its_middle(aside_m: float, motion: int) -> None:
    poses = bent(straight(aside_m, motion=motion), two_rooms(0.35))
    assert np.abs(in_door(poses)[:, 1] - DOOR[1]).max() < 0.008


def test_a_door_is_passed_straighter_than_the_search_led_through_it() -> None:
    poses = bent(straight(0.0, yaw=0.1), two_rooms(0.35))
    assert np.abs(in_door(poses)[:, 2]).max() < 0.075


def test_a_drive_begins_and_ends_where_it_did() -> None:
    before = straight(0.02)
    poses = bent(before, two_rooms(0.35))
    assert np.allclose(poses[[0, -1]], before.poses[[0, -1]])


def test_headings_follow_the_path() -> None:
    for motion in (FORWARDS, BACKWARDS):
        poses = bent(straight(0.02, motion=motion), two_rooms(0.35))
        steps = motion * np.diff(poses[:, :2], axis=0)
        middle = 0.5 * (poses[1:, 2] + poses[:-1, 2])
        off = np.arctan2(steps[:, 1], steps[:, 0]) - middle
        assert np.abs((off + math.pi) % (2.0 * math.pi) - math.pi).max() < 0.02


def test_turns_on_the_spot_stay_where_they_are() -> None:
    before = straight(0.02)
    yaws = np.linspace(0.0, 1.0, 10)[1:, None]
    turn = np.column_stack([np.repeat(before.poses[-1:, :2], len(yaws), axis=0), yaws])
    whole = Maneuver(
        np.concatenate([before.poses, turn]),
        np.concatenate([before.motions, np.full(len(turn), TURNING, np.int8)]),
    )
    assert np.allclose(bent(whole, two_rooms(0.35))[len(before.poses) :], turn)


def test_in_open_floor_nothing_is_bent() -> None:
    before = straight(0.02)
    assert np.array_equal(bent(before, empty_room()), before.poses)


def test_nothing_is_bent_onto_floor_that_was_never_seen() -> None:
    before, grid = straight(0.015, motion=BACKWARDS), two_rooms(0.35)
    fine = fine_grid(grid, HOBBY)
    unseen = np.full(fine.mask.shape, IN_SIGHT, np.uint8)
    unseen[: math.floor((DOOR[1] + 0.015 - 0.152) / fine.fine_m)] = NEVER_SEEN
    assert np.array_equal(bent(before, grid, unseen), before.poses)


def test_what_was_free_stays_free() -> None:
    rng = np.random.default_rng(3)
    num_free = 0
    for width_m in (0.35, 0.4, 0.45, 0.6):
        grid = two_rooms(width_m)
        for _ in range(8):
            before = straight(float(rng.uniform(-0.06, 0.08)), float(rng.uniform(-0.2, 0.2)))
            if least_clearance(before.poses, grid) >= 0.0:
                num_free += 1
                assert least_clearance(bent(before, grid), grid) >= 0.0
    assert num_free > 10


def test_a_post_is_passed_no_nearer_for_the_sake_of_the_rest() -> None:
    """The front of a robot whose axle is at the rear swings far as it turns into a door."""
    rng = np.random.default_rng(5)
    walls, num_tight = field_of(two_rooms(0.52), REAR), 0
    for _ in range(60):
        drive = turning_into_door(*rng.uniform((-0.02, 0.5, -0.15), (0.02, 0.9, 0.0)))
        field = with_stray_echoes(walls, rng)
        was_m = least_clearance_in(field, REAR, drive)
        if 0.0 <= was_m < CENTERING.kept_m:
            num_tight += 1
            after_m = least_clearance_in(field, REAR, recentered(drive, field, REAR.body))
            assert after_m >= was_m - 1e-6
    assert num_tight > 10


def test_what_is_seen_later_moves_the_rest_of_a_drive_to_the_middle() -> None:
    maneuver = straight(0.015)
    follower = ManeuverFollower(maneuver, SHORT_M)
    before_m = follower.left_m
    for _ in range(3):  # as many scans
        follower.recenter(field_of(two_rooms(0.35)), HOBBY.body)
    poses = follower.poses_ahead(2.0)
    assert np.abs(in_door(poses)[:, 1] - DOOR[1]).max() < 0.008
    assert np.allclose(poses[[0, -1]], maneuver.poses[[0, -1]])
    assert follower.left_m == pytest.approx(before_m, abs=0.01)
    assert np.array_equal(maneuver.poses, straight(0.015).poses)


def test_a_drive_backwards_stays_as_it_was_searched() -> None:
    maneuver = straight(0.015, motion=BACKWARDS)
    follower = ManeuverFollower(maneuver, SHORT_M)
    follower.recenter(field_of(two_rooms(0.35)), HOBBY.body)
    assert np.array_equal(follower.poses_ahead(2.0), maneuver.poses)


@pytest.mark.parametrize("first", [0, 30, 63])
def test_what_lies_out_of_the_local_costmap_stays(first: int) -> None:
    drive, field = straight(0.015).poses[first:], field_of(two_rooms(0.35))
    cols = round((DOOR[0] + 0.3) / field.fine_m)
    distance_m = np.ascontiguousarray(field.distance_m[:, :cols])
    found = recentered(drive, field._replace(distance_m=distance_m), HOBBY.body)
    is_out = drive[:, 0] > cols * field.fine_m - HOBBY.circumscribed_m
    assert np.allclose(found[is_out], drive[is_out])
