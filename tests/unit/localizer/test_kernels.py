"""The compiled loops against slow, obvious twins."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trolley.geometry.kernels import solve_spd
from trolley.scanning import Points
from trolley_localizer.kernels import matching as kernels
from trolley_localizer.kernels.beams import MOST_OF_MEAN, mark_echoes, take_evenly
from trolley_localizer.kernels.elementary import angle_of, exp_below_zero, sin_cos
from trolley_localizer.kernels.layout import Cloud, Lines
from trolley_localizer.kernels.matching import refine_pose, sample_field, score_particles
from trolley_localizer.kernels.particles import (
    count_bins,
    draw_systematic,
    mean_near,
    move_particles,
    normalise,
    scatter_particles,
    variance_of_place,
    weigh,
)
from trolley_localizer.kernels.random import normal
from trolley_localizer.kernels.resting import count_same
from trolley_localizer.kernels.search import Pyramid, bound_block, reduce_level


def make_cloud(rng: np.random.Generator, count: int, cols: float, rows: float) -> Cloud:
    return Cloud(
        rng.uniform(-5, cols + 5, count),
        rng.uniform(-5, rows + 5, count),
        rng.uniform(-4, 4, count),
    )


@pytest.mark.parametrize("beams", [0, 1, 31, 32, 33, 60, 127])
def test_scores_equal_one_look_up_per_beam(beams: int) -> None:
    rng = np.random.default_rng(1)
    table = rng.integers(0, 65536, (42, 62)).astype(np.uint16)
    cloud = make_cloud(rng, 50, 60, 40)
    points = Points(rng.uniform(-30, 30, beams), rng.uniform(-30, 30, beams))
    score = np.empty(50, np.int32)
    score_particles(score, cloud, points, table)
    for i in range(50):
        cos, sin = math.cos(cloud.yaw[i]), math.sin(cloud.yaw[i])
        total = 0
        for x, y in zip(points.x, points.y, strict=True):
            col = math.floor(cloud.x[i] + cos * x - sin * y)
            row = math.floor(cloud.y[i] + sin * x + cos * y)
            total += int(table[min(max(row + 1, 0), 41), min(max(col + 1, 0), 61)])
        assert score[i] == total


@given(angle=st.floats(-1000.0, 1000.0))
def test_sine_and_cosine_are_those_of_the_library(angle: float) -> None:
    assert sin_cos(angle) == pytest.approx((math.sin(angle), math.cos(angle)), abs=1e-11)


@given(exponent=st.floats(-1e9, 0.0))
def test_exponentials_are_those_of_the_library(exponent: float) -> None:
    assert exp_below_zero(exponent) == pytest.approx(math.exp(exponent), rel=1e-9, abs=1e-17)


@pytest.mark.parametrize("x", [-3.0, -1e-9, 0.0, 1e-9, 1.0, 40.0])
@pytest.mark.parametrize("y", [-40.0, -3.0, -1e-9, 0.0, 1.0, 3.0])
def test_the_angle_of_a_direction(x: float, y: float) -> None:
    assert angle_of(x, y) == pytest.approx(math.atan2(y, x), abs=2e-8)


@given(
    scores=st.lists(st.integers(0, 60 * 65535), min_size=1, max_size=40),
    gain=st.floats(0.0, 2e-5),
)
def test_weights_follow_the_likelihood(scores: list[int], gain: float) -> None:
    prior = np.linspace(1.0, 2.0, len(scores), dtype=np.float32)
    weights = prior.copy()
    weigh(weights, np.array(scores, np.int32), gain)
    assert normalise(weights)
    posterior = prior * np.exp(gain * (np.array(scores) - max(scores)))
    assert weights == pytest.approx(posterior / posterior.sum(), abs=1e-6)


@pytest.mark.parametrize("count", [1, 7, 64])
def test_particles_move_as_turn_drive_turn(count: int) -> None:
    cloud = make_cloud(np.random.default_rng(2), count, 60, 40)
    before = Cloud(*(part.copy() for part in cloud))
    step, deviation = np.array([0.4, 3.0, -0.7]), np.array([0.1, 0.5, 0.2, 0.3])
    move_particles(cloud, step, deviation, 3, 4.0, np.uint64(2**64 - 9))
    for i in range(count):
        counter = (2**64 - 9 + 4 * i) % 2**64
        noise = [normal(np.uint64((counter + k) % 2**64)) for k in range(4)]
        scale = 4.0 if i % 3 == 0 else 1.0
        turn, drive, after = step + scale * deviation[:3] * noise[:3]
        slip = scale * deviation[3] * noise[3]
        heading = before.yaw[i] + turn
        assert cloud.x[i] == pytest.approx(
            before.x[i] + drive * math.cos(heading) - slip * math.sin(heading)
        )
        assert cloud.y[i] == pytest.approx(
            before.y[i] + drive * math.sin(heading) + slip * math.cos(heading)
        )
        assert cloud.yaw[i] == pytest.approx(heading + after)


def test_only_every_so_many_particles_are_drawn_anew() -> None:
    cloud = Cloud(np.zeros(11), np.zeros(11), np.zeros(11))
    scatter_particles(cloud, 1, 4, np.full(3, 50.0), np.eye(3), np.uint64(5))
    assert np.flatnonzero(cloud.x).tolist() == [1, 5, 9]
    assert np.unique(cloud.yaw).size == 4


def test_random_numbers_are_normal_enough() -> None:
    numbers = np.array([normal(np.uint64(i)) for i in range(20_000)])
    assert abs(numbers.mean()) < 0.02
    assert abs(numbers.std() - 1.0) < 0.02
    assert abs(np.corrcoef(numbers[:-1], numbers[1:])[0, 1]) < 0.02


@given(
    weights=st.lists(st.floats(0.0, 1.0), min_size=1, max_size=60).filter(lambda w: sum(w) > 0.01),
    count=st.integers(1, 200),
    offset=st.floats(0.0, 0.999),
)
def test_systematic_draws_differ_from_expectation_by_less_than_one(
    weights: list[float], count: int, offset: float
) -> None:
    shares = np.array(weights, np.float32)
    shares /= shares.sum()
    index = np.empty(count, np.int32)
    draw_systematic(index, shares, offset)
    drawn = np.bincount(index, minlength=shares.size)
    assert np.abs(drawn - count * shares).max() < 1.0 + 1e-3 * count


def test_weights_that_evidence_excludes_are_left_to_the_caller() -> None:
    weights = np.array([1.0, 0.0], np.float32)
    weigh(weights, np.array([0, 1_000_000], np.int32), 1.0)
    assert not normalise(weights)


def test_bins_are_counted_once() -> None:
    cloud = Cloud(
        np.array([1.0, 2.0, 15.0, -3.0]),
        np.array([1.0, 2.0, 1.0, 1.0]),
        np.array([0.1, 0.1 + 2 * math.pi, 0.1, 0.1]),
    )
    scratch = np.empty(16, np.uint64)
    everybody = np.arange(4, dtype=np.int32)
    assert count_bins(scratch, cloud, everybody, 10.0, 36) == 3
    assert count_bins(scratch, cloud, np.array([2, 2, 2], np.int32), 10.0, 36) == 1


def test_the_mean_unwraps_headings_about_the_centre() -> None:
    cloud = Cloud(
        np.array([1.0, 3.0, 900.0]),
        np.array([0.0, 0.0, 0.0]),
        np.array([math.pi - 0.1, -math.pi + 0.1, 0.0]),
    )
    weights = np.array([0.25, 0.25, 0.5], np.float32)
    mean, reach = np.empty(3), np.array([10.0, 1.0])
    mean_near(mean, cloud, weights, np.array([2.5, 1.0, math.pi + 0.05]), reach)
    assert mean == pytest.approx([2.0, 0.0, math.pi])
    mean_near(mean, cloud, weights, np.array([50.0, 1.0, 0.2]), reach)
    assert mean.tolist() == [50.0, 1.0, 0.2]


def test_the_variance_of_place_is_that_of_the_weighted_particles() -> None:
    rng = np.random.default_rng(4)
    cloud = Cloud(rng.normal(5e3, 2.0, 40), rng.normal(-4e3, 1.0, 40), np.zeros(40))
    weights = rng.random(40).astype(np.float32)
    places = np.stack([cloud.x, cloud.y])
    expected = np.cov(places, aweights=weights, ddof=0).trace()
    assert variance_of_place(cloud, weights) == pytest.approx(expected, rel=1e-6)


def test_a_field_is_interpolated_between_cell_centres() -> None:
    field = np.zeros((4, 4), np.float32)
    field[1:3, 1] = 1.0
    field[1:3, 2] = 3.0
    assert sample_field(field, 0.5, 0.5) == pytest.approx(1.0)
    assert sample_field(field, 1.0, 0.5) == pytest.approx(2.0)
    assert math.isfinite(sample_field(field, -1e6, 1e6))


def test_solving_refuses_what_is_not_positive_definite() -> None:
    x = np.zeros(3)
    assert not solve_spd(np.zeros((3, 3)), np.ones(3), x)
    a = np.array([[4.0, 1.0, 0.5], [1.0, 3.0, 0.2], [0.5, 0.2, 2.0]])
    assert solve_spd(a, np.array([1.0, 2.0, 3.0]), x)
    assert a @ x == pytest.approx([1.0, 2.0, 3.0])


def test_refinement_slides_along_a_bare_wall_only_as_the_prior_says() -> None:
    rows, cols = 60, 80
    row = np.arange(rows + 2, dtype=np.float32) - 1
    field = np.repeat(np.abs(row - 10.0)[:, None], cols + 2, axis=1).astype(np.float32)
    # A wall along row 10, seen from 20 cells above it; the estimate is 2 cells too low.
    points = Points(np.linspace(-20, 20, 41), np.full(41, -20.0))
    pose = np.array([40.0, 28.5, 0.03])
    prior = pose.copy()
    information = np.zeros((3, 3))
    for sigma in (5.0, 2.0):
        refine_pose(
            pose,
            information,
            field,
            points,
            prior,
            np.diag([1.0, 1e-6, 1e-3]),
            np.array([sigma, 1.0]),
            20,
        )
    assert pose[1] == pytest.approx(30.5, abs=0.05)
    assert pose[2] == pytest.approx(0.0, abs=2e-3)
    assert pose[0] == pytest.approx(40.0, abs=0.2)
    assert information[0, 0] < 1e-3 * information[1, 1]


def test_only_what_ends_behind_a_line_is_marked() -> None:
    end = Points(np.array([10, 4.9, 10, -10]), np.array([0.0, 0.0, 9.0, 0.0]))
    start = Points(np.zeros(4), np.zeros(4))
    line = Lines(*(np.array([v]) for v in (5.0, -2.0, 5.0, 2.0)))
    classes = np.full(4, kernels.NOT_ON_MAP, np.uint8)
    mark = kernels.BEHIND_MIRROR
    marked = kernels.mark_crossing(classes, np.zeros(3), end, start, line, 1.0, mark)
    assert marked == 1
    assert classes.tolist() == [2, 1, 1, 1]


def test_a_ray_that_goes_on_behind_a_wall_contradicts_the_map() -> None:
    cols = np.arange(62, dtype=np.float32) - 1
    field = np.repeat(np.minimum(np.abs(cols - 30), 10)[None, :], 42, axis=0).astype(np.float32)
    assert math.isfinite(kernels.first_wall(field, 10.5, 20.5, 1.0, 0.0, 36.0))
    assert kernels.first_wall(field, 10.5, 20.5, 1.0, 0.0, 17.0) == math.inf
    assert kernels.first_wall(field, 10.5, 20.5, -1.0, 0.0, 36.0) == math.inf


def test_a_block_bounds_every_pose_in_it() -> None:
    rng = np.random.default_rng(3)
    rows, cols = [37, 19, 10], [53, 27, 14]
    sizes = [r * c for r, c in zip(rows, cols, strict=True)]
    pyramid = Pyramid(
        np.zeros(sum(sizes), np.uint8),
        np.ones(sum(sizes), np.uint8),
        np.array([0, sizes[0], sizes[0] + sizes[1]]),
        np.array(rows),
        np.array(cols),
    )
    cells = (rng.random(sizes[0]) ** 4 * 255).astype(np.uint8)
    pyramid.score[: sizes[0]] = cells
    blocks = cells.copy()
    for level in (1, 2):
        reduce_level(pyramid, blocks, level)
    beams = [rng.integers(-30, 30, 12).astype(np.int32) for _ in range(2)]
    for row in range(rows[2]):
        for col in range(cols[2]):
            bound = bound_block(pyramid, 2, row, col, *beams)
            inside = [
                bound_block(pyramid, 0, r, c, *beams)
                for r in range(4 * row, min(4 * row + 4, rows[0]))
                for c in range(4 * col, min(4 * col + 4, cols[0]))
            ]
            assert bound >= max(inside)


def some_ranges(rng: np.random.Generator, count: int) -> np.ndarray:
    """Ranges with whatever a lidar may send in place of an echo."""
    ranges = rng.uniform(0.1, 6.0, count).astype(np.float32)
    odd = np.array([np.nan, np.inf, -np.inf, 0.0, -1.0], np.float32)
    return np.where(rng.random(count) < 0.3, rng.choice(odd, count), ranges)


@given(st.integers(0, 2**32 - 1), st.integers(30, 70), st.floats(-20.0, 20.0))
def test_the_same_echoes_are_counted_where_two_turns_look_in_the_same_direction(
    seed: int, count: int, begin: float
) -> None:
    rng = np.random.default_rng(seed)
    first, step = some_ranges(rng, 50), 50 / count
    at = np.floor(begin + step * np.arange(count) + 0.5)
    is_met = (at >= 0) & (at < 50)
    before = np.where(is_met, first[np.clip(at, 0, 49).astype(int)], np.float32(0.0))
    later = np.where(rng.random(count) < 0.7, before + np.float32(0.05), some_ranges(rng, count))
    had, has = (np.isfinite(one) & (one > 0.0) for one in (before, later))
    with np.errstate(invalid="ignore"):
        near = np.abs(later - before) <= 0.03 + 0.02 * before
    most = max(np.count_nonzero(np.isfinite(first) & (first > 0.0)), np.count_nonzero(has))
    both = np.count_nonzero(had & has)
    same = np.count_nonzero(near & had & has)
    assert count_same(first, later, begin, step, 0.03, 0.02) == (most, both, same)


@given(st.integers(0, 2**32 - 1))
def test_the_echoes_of_a_scan_are_marked(seed: int) -> None:
    rng = np.random.default_rng(seed)
    ranges = some_ranges(rng, 50)
    echoes = np.flatnonzero(ranges > 0.3)
    classes = np.empty(50, np.uint8)
    telling = mark_echoes(classes, ranges, echoes, 2.5)
    assert telling == np.count_nonzero(ranges[echoes] > 2.5)
    assert (np.flatnonzero(classes == kernels.NOT_ON_MAP) == echoes).all()
    assert np.count_nonzero(classes == kernels.UNUSED) == 50 - echoes.size


@given(st.integers(0, 2**32 - 1), st.floats(0.0, 1.0))
def test_some_points_are_taken_evenly_over_the_surface_seen(seed: int, phase: float) -> None:
    rng = np.random.default_rng(seed)
    end, start = (Points(rng.normal(0.0, s, 200), rng.normal(0.0, s, 200)) for s in (60.0, 2.0))
    used = np.flatnonzero(rng.random(200) < 0.8)
    count = int(rng.integers(1, used.size + 1))
    away = (end.x - start.x)[used], (end.y - start.y)[used]
    length = np.sqrt(away[0] * away[0] + away[1] * away[1])
    surface = np.cumsum(np.minimum(length, MOST_OF_MEAN * np.cumsum(length)[-1] / used.size))
    wanted = (np.arange(count) + phase) * (surface[-1] / count)
    index = used[np.minimum(np.searchsorted(surface, wanted, "right"), used.size - 1)]
    taken = Points(np.empty(count), np.empty(count))
    take_evenly(taken, end, start, used, phase)
    assert (taken.x == end.x[index]).all()
    assert (taken.y == end.y[index]).all()
