"""Generated buildings and drives through them: a judge must not err itself."""

import math
from dataclasses import replace

import numpy as np
import pytest
from bench.mapper.buildings import Drive, Plan, draw_building, driven_path, record, sampled, wheels
from bench.mapper.house_tours import BASE_T_LASER
from bench.mapper.map_metrics import revisits, way_m

from trolley.geometry import Pose2D
from trolley_mapper.slam.pose_graph import between

PLAN = Plan((2, 1), people=0, glass_share=0.0)
DRIVE = Drive(way_m=80.0, distance_error=0.0, turn_error=0.0, noise=0.0)


def test_the_same_seed_gives_the_same_drive() -> None:
    building = draw_building(PLAN, 1)
    one, other = (record(building, DRIVE, 1) for _ in range(2))
    assert one.ranges.tobytes() == other.ranges.tobytes()
    assert one.odom.tobytes() == other.odom.tobytes()
    assert record(building, DRIVE, 2).ranges.tobytes() != one.ranges.tobytes()


def test_a_drive_stays_on_the_floor_and_comes_back() -> None:
    building = draw_building(PLAN, 1)
    drive = record(building, DRIVE, 1)
    cells = building.grid.world_to_cell(drive.reference[:, :2])
    assert np.all(building.grid.cells[cells[:, 0], cells[:, 1]] == 0)
    assert way_m(drive.reference)[-1] > 80.0
    assert len(revisits(drive.reference, drive.reference).scans) > 10


def test_scans_are_as_far_apart_as_asked() -> None:
    drive = record(draw_building(PLAN, 1), DRIVE, 1)
    steps = between(drive.reference[:-1], drive.reference[1:])
    assert np.hypot(steps[:, 0], steps[:, 1]).max() < 1.1
    assert np.abs(steps[:, 2]).max() < 0.7 + 0.15
    assert drive.ranges.shape[1] == 180
    assert np.all(np.diff(drive.stamps) > 0.0)


def test_echoes_lie_on_walls() -> None:
    building = draw_building(PLAN, 1)
    drive = record(building, DRIVE, 1)
    far = 0.0
    for row in range(0, len(drive.stamps), 10):
        echoes = np.isfinite(drive.ranges[row])
        angles = drive.angle_min + drive.angle_increment * np.arange(180)[echoes]
        ends = drive.ranges[row][echoes, None] * np.column_stack([np.cos(angles), np.sin(angles)])
        placed = (drive.reference_at(row) @ BASE_T_LASER).transform_points(ends.astype(np.float64))
        walls = building.grid.cell_to_world(np.column_stack(np.nonzero(building.solid)))
        away = np.abs(placed[:, None] - walls[None]).max(axis=2).min(axis=1)
        far = max(far, float(np.quantile(away, 0.9)))
    # Half a cell, and twice the noise.
    assert far < 0.05 + 0.08


def test_wheels_without_errors_follow_the_path() -> None:
    drive = record(draw_building(PLAN, 1), DRIVE, 1)
    start = drive.reference_at(0)
    for row in range(len(drive.stamps)):
        there = start @ drive.odom_at(row)
        assert there.distance_to(drive.reference_at(row)) < 1e-6


def test_a_missed_turn_is_one_that_was_driven() -> None:
    square = [(0.0, 0.0), (40.0, 0.0), (40.0, 40.0), (0.0, 40.0)]
    path = driven_path(np.array(square))
    seen = wheels(path, replace(DRIVE, missed_turns=1), np.random.default_rng(1))
    driven = math.degrees(path[-1, 2] - path[0, 2])
    reported = math.degrees(math.remainder(seen[-1, 2] - seen[0, 2], 2.0 * math.pi))
    assert driven == pytest.approx(180.0, abs=2.0)
    assert 8.0 < reported < 102.0


def test_wheels_err_by_what_is_asked() -> None:
    path = driven_path(np.array([(0.0, 0.0), (20.0, 0.0)]))
    seen = wheels(path, replace(DRIVE, distance_error=0.05), np.random.default_rng(1))
    assert abs(seen[-1, 0] / way_m(path)[-1] - 1.0) == pytest.approx(0.05)


def test_a_covered_lidar_sees_only_its_cover_for_so_long() -> None:
    drive = record(draw_building(PLAN, 1), replace(DRIVE, covered_s=20.0), 1)
    covered = np.all(drive.ranges == np.float32(0.1), axis=1)
    spent = drive.stamps[covered]
    assert 15.0 < spent[-1] - spent[0] <= 20.0
    assert np.all(np.diff(np.flatnonzero(covered)) == 1)


def test_beams_pass_glass_but_robots_do_not() -> None:
    building = draw_building(replace(PLAN, glass_share=1.0), 1)
    middles = 0.5 * (building.panes[:, :2] + building.panes[:, 2:])
    cells = building.grid.world_to_cell(middles)
    assert len(middles) > 10
    assert np.all(building.solid[cells[:, 0], cells[:, 1]] == 0)
    assert np.all(building.grid.cells[cells[:, 0], cells[:, 1]] == 100)
    assert not building.house.reachable[cells[:, 0], cells[:, 1]].any()


def test_wings_alike_have_the_same_walls() -> None:
    plan = replace(PLAN, is_alike=True, clutter_per_m2=0.0)
    building = draw_building(plan, 1)
    first, second = (round(10 * x) for x in building.crossings[0, :2, 0])
    width = round(10 * plan.block_m[0])
    low = round(10 * building.crossings[0, 0, 1]) + 10
    rows = slice(low, low + round(10 * plan.block_m[1]))
    one = building.solid[rows, first + 10 : first + 10 + width]
    assert np.array_equal(one, building.solid[rows, second + 10 : second + 10 + width])
    other = draw_building(replace(plan, is_alike=False), 1).solid
    assert not np.array_equal(
        other[rows, first + 10 : first + 10 + width],
        other[rows, second + 10 : second + 10 + width],
    )


def test_a_robot_that_turns_back_turns_on_the_spot() -> None:
    path = driven_path(np.array([(0.0, 0.0), (5.0, 0.0), (0.0, 0.0)]))
    steps = np.abs(np.diff(path[:, 2]))
    assert steps.max() < 0.11
    assert steps.sum() == pytest.approx(math.pi, abs=0.01)
    kept = sampled(path, 1.0, 0.7)
    turning = Pose2D.from_array(path[kept[0]]).distance_to(Pose2D.from_array(path[kept[-1]]))
    assert turning < 1.0
