"""The judge of maps: what it says of maps whose faults are known."""

import math

import numpy as np
import pytest
from bench.mapper.map_metrics import (
    Poses,
    errors_m,
    relative_error_m,
    relative_errors,
    revisits,
    way_m,
)


def round_trip(rounds: int = 2, edge_m: float = 10.0) -> Poses:
    """A pose each metre round a square, counter-clockwise from the origin."""
    poses: list[tuple[float, float, float]] = []
    x, y, yaw = 0.0, 0.0, 0.0
    for side in range(4 * rounds):
        yaw = side * math.pi / 2
        for _ in range(round(edge_m)):
            poses.append((x, y, yaw))
            x, y = x + math.cos(yaw), y + math.sin(yaw)
    return np.array([*poses, (x, y, yaw)])


def carried(poses: Poses, x: float, y: float, yaw: float) -> Poses:
    """The same poses in another frame."""
    cos, sin = math.cos(yaw), math.sin(yaw)
    places = poses[:, :2] @ np.array([[cos, sin], [-sin, cos]]) + (x, y)
    return np.column_stack([places, poses[:, 2] + yaw])


TRUTH = round_trip()


def test_a_perfect_map_has_no_error_whatever_its_frame() -> None:
    found = carried(TRUTH, 3.0, -7.0, 2.0)
    seen = revisits(found, TRUTH)
    assert relative_error_m(found, TRUTH) == pytest.approx(0.0, abs=1e-9)
    assert errors_m(found, TRUTH).max() == pytest.approx(0.0, abs=1e-9)
    assert len(seen.scans) > 40
    assert seen.wrong_share == 0.0
    assert seen.num_closed == seen.num_loops == 1


def test_a_scale_error_of_a_tenth_is_a_tenth_of_each_distance_on_a_line() -> None:
    truth = np.column_stack([np.arange(31.0), np.zeros(31), np.zeros(31)])
    found = truth * (1.1, 1.0, 1.0)
    assert relative_error_m(found, truth) == pytest.approx(0.1 * 5.5)
    away = errors_m(found, truth)
    assert away.max() == pytest.approx(1.5)
    assert away.mean() == pytest.approx(0.1 * np.abs(np.arange(31) - 15).mean())


def test_a_shift_of_the_second_round_is_the_error_of_all_its_revisits() -> None:
    found = TRUTH.copy()
    found[41:, 1] += 0.8
    seen = revisits(found, TRUTH)
    second = seen.scans > 40
    assert seen.error_m[second] == pytest.approx(0.8)
    assert seen.error_m[~second] == pytest.approx(0.0)
    assert seen.wrong_share == pytest.approx(np.mean(second))
    # Half of the poses are 0.8 m from the others: each is 0.4 m off at best.
    assert errors_m(found, TRUTH).mean() == pytest.approx(0.4, abs=0.02)


def test_a_loop_that_is_missed_counts() -> None:
    right = revisits(TRUTH, TRUTH)
    found = TRUTH.copy()
    found[30:, 0] += 2.0
    missed = revisits(found, TRUTH)
    assert (right.num_loops, right.num_closed) == (1, 1)
    assert (missed.num_loops, missed.num_closed) == (1, 0)


def test_loops_far_apart_along_the_drive_count_each() -> None:
    out = np.column_stack([np.arange(31.0), np.zeros(31), np.zeros(31)])
    aside = np.column_stack([np.full(30, 30.0), np.arange(1.0, 31.0), np.full(30, math.pi / 2)])
    back = aside[::-1] + np.array([0.0, 0.0, math.pi])
    truth = np.vstack([out, aside, [(30.0, 31.0, math.pi / 2)], back, out[::-1]])
    # Aside and back is one loop; the way home, straight behind it, belongs to it.
    assert revisits(truth, truth).num_loops == 1
    detour = np.column_stack(
        [np.full(40, 0.0), np.concatenate([np.arange(-1.0, -21.0, -1), np.arange(-20.0, 0.0)])]
    )
    more = np.vstack([truth, np.column_stack([detour, np.zeros(40)]), out[:5]])
    assert revisits(more, more).num_loops > 1


def test_a_map_that_said_it_was_unsure_is_wrong_but_not_unsaid() -> None:
    found = TRUTH.copy()
    found[41:, 1] += 0.8
    seen = revisits(found, TRUTH)
    sure = np.ones(len(TRUTH), bool)
    assert seen.unsaid_share(sure) == seen.wrong_share
    sure[41:] = False
    assert seen.unsaid_share(sure) == 0.0
    assert seen.wrong_share > 0.0


def test_a_drive_that_never_comes_back_has_no_revisits() -> None:
    truth = np.column_stack([np.arange(50.0), np.zeros(50), np.zeros(50)])
    seen = revisits(truth, truth)
    assert len(seen.scans) == 0
    assert (seen.wrong_share, seen.num_loops, seen.num_closed) == (0.0, 0, 0)
    assert seen.unsaid_share(np.ones(50, bool)) == 0.0


def test_a_wrong_heading_shows_in_what_lies_ahead() -> None:
    truth = np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0]])
    found = truth + np.array([0.0, 0.0, 0.1])
    error = relative_errors(found, truth, np.array([0]), np.array([1]))
    assert error == pytest.approx(2.0 * 2.0 * math.sin(0.05))


def test_the_way_is_the_sum_of_the_steps() -> None:
    assert way_m(TRUTH)[-1] == pytest.approx(80.0)
