"""The pose graph: algebra of edges, and its optimisation."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trolley.geometry import Pose2D
from trolley.slices import whole
from trolley_mapper.slam.pose_graph import (
    LOOP,
    ODOMETRY,
    SCAN_MATCH,
    Edge,
    averaged,
    between,
    chained,
    compose,
    contradicted,
    inverted,
    make_problem,
    optimise,
    squared_errors,
)

numbers = st.floats(-5.0, 5.0)
poses = st.builds(lambda x, y, a: np.array([x, y, a]), numbers, numbers, st.floats(-3.1, 3.1))


def edge(
    first: int, second: int, step: np.ndarray, kind: int = ODOMETRY, dev: float = 0.02
) -> Edge:
    return Edge(first, second, step, np.diag([dev**-2, dev**-2, (0.5 * dev) ** -2]), kind)


@given(a=poses, b=poses)
def test_arrays_compose_as_poses_do(a: np.ndarray, b: np.ndarray) -> None:
    expected = Pose2D.from_array(a) @ Pose2D.from_array(b)
    found = Pose2D.from_array(compose(a, b))
    assert found.distance_to(expected) < 1e-9
    assert compose(a, between(a, b))[:2] == pytest.approx(b[:2], abs=1e-9)


@given(step=poses)
def test_an_edge_turned_round_twice_is_the_same(step: np.ndarray) -> None:
    one = edge(1, 2, step)
    again = inverted(inverted(one))
    assert np.allclose(again.step, one.step)
    assert np.allclose(again.information, one.information, rtol=1e-6)


@given(a=poses, b=poses, shift=poses)
def test_an_edge_turned_round_errs_as_much(a: np.ndarray, b: np.ndarray, shift: np.ndarray) -> None:
    off = compose(between(a, b), 1e-4 * shift)
    one = edge(0, 1, off)
    rows = {0: 0, 1: 1}
    there = squared_errors(np.array([a, b]), make_problem([one], rows))
    back = squared_errors(np.array([a, b]), make_problem([inverted(one)], rows))
    assert back == pytest.approx(there, rel=0.02, abs=1e-9)


def test_chained_edges_are_less_sure_and_averaged_ones_surer() -> None:
    one, other = edge(0, 1, np.array([1.0, 0.0, 0.5])), edge(1, 2, np.array([1.0, 0.0, -0.5]))
    both = chained(one, other)
    assert both.first == 0
    assert both.second == 2
    assert np.allclose(both.step, compose(one.step, other.step))
    assert np.linalg.det(both.information) < np.linalg.det(one.information)
    assert np.linalg.det(averaged(one, one).information) > np.linalg.det(one.information)


def circle(count: int) -> np.ndarray:
    angles = np.arange(count) * 2.0 * np.pi / count
    return np.column_stack([3.0 * np.sin(angles), 3.0 - 3.0 * np.cos(angles), angles])


def drifted(truth: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, list[Edge]]:
    found, edges = [truth[0]], []
    for k in range(len(truth) - 1):
        step = between(truth[k], truth[k + 1]) + rng.normal(0.0, [0.02, 0.02, 0.01])
        edges.append(edge(k, k + 1, step))
        found.append(compose(found[-1], step))
    return np.array(found), edges


def test_a_loop_brings_the_poses_back() -> None:
    truth = circle(60)
    start, edges = drifted(truth, np.random.default_rng(3))
    edges.append(edge(0, 59, between(truth[0], truth[59]), LOOP))
    found = whole(optimise(start, make_problem(edges, {k: k for k in range(60)}), [0]))
    before = np.hypot(*(start - truth)[:, :2].T).max()
    after = np.hypot(*(found - truth)[:, :2].T).max()
    assert np.array_equal(found[0], truth[0])
    assert after < 0.5 * before


def test_a_false_loop_among_true_ones_fades() -> None:
    truth = circle(60)
    start, edges = drifted(truth, np.random.default_rng(4))
    edges += [edge(0, k, between(truth[0], truth[k]), LOOP) for k in (50, 55, 59)]
    edges += [edge(k, k + 3, between(truth[k], truth[k + 3]), SCAN_MATCH) for k in range(0, 57, 3)]
    edges.append(edge(10, 40, np.array([0.5, 0.0, 0.0]), LOOP))
    found = whole(optimise(start, make_problem(edges, {k: k for k in range(60)}), [0]))
    assert np.hypot(*(found - truth)[:, :2].T).max() < 0.3


@pytest.mark.parametrize("num_wrong", [0, 1, 2])
def test_loops_that_the_others_and_the_odometry_outvote_are_found(num_wrong: int) -> None:
    # Twice round a square of 5 m; the odometry turns a little too far.
    step = np.array([1.0, 0.0, 0.0])
    turned = np.array([1.0, 0.0, 0.5 * np.pi])
    true, found = [np.zeros(3)], [np.zeros(3)]
    edges = []
    for number in range(1, 41):
        moved = turned if number % 5 == 0 else step
        drifted = moved + np.array([0.01, 0.0, 0.004])
        true.append(compose(true[-1], moved))
        found.append(compose(found[-1], drifted))
        edges.append(edge(number - 1, number, drifted, dev=0.03))
    for number in (24, 28, 33):
        edges.append(edge(number - 20, number, between(true[number - 20], true[number]), LOOP))
    for number in range(36, 36 + num_wrong):
        off = between(true[number - 20], true[number]) + np.array([3.0, 0.0, 0.0])
        edges.append(edge(number - 20, number, off, LOOP))
    problem = make_problem(edges, {number: number for number in range(41)})
    is_out = whole(contradicted(np.array(found), problem, [0]))
    assert is_out.tolist() == [False] * (43) + [True] * num_wrong
