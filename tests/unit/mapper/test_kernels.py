"""The compiled loops against slow, obvious twins and against the truth."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.cases import cases

from trolley.scan_matching import lines
from trolley.scan_matching.information import without_noise
from trolley.scan_matching.layout import Cloud
from trolley.scan_matching.surfels import EXPLAINED
from trolley.scan_matching.sweep import Sweep
from trolley.slices import is_left, whole
from trolley_mapper.kernels import correlate
from trolley_mapper.kernels.trace import Cells, trace_keyframe
from trolley_mapper.slam.keyframe import Keyframe
from trolley_mapper.slam.local_map import LocalMap


def room(count: int = 240) -> Cloud:
    """What is seen from the middle of a room of 6 x 4 m with a pillar."""
    angles = -math.pi + np.arange(count) * 2.0 * math.pi / count
    with np.errstate(divide="ignore"):
        x = np.where(np.cos(angles) > 0.0, 3.5, -2.5) / np.cos(angles)
        y = np.where(np.sin(angles) > 0.0, 2.2, -1.8) / np.sin(angles)
    ranges = np.minimum(x, y).astype(np.float32)
    rays = np.column_stack([np.cos(angles), np.sin(angles)])
    points = (ranges[:, None] * rays).astype(np.float64)
    normals = np.empty((count, 2))
    beams = np.arange(count, dtype=np.int32)
    lines.fit_normals(normals, points, beams, np.zeros(2), 2.0 * math.pi / count)
    return Cloud(points, normals)


def local_map() -> LocalMap:
    cloud = room()
    one = Keyframe.of(0, 0, Sweep(cloud, np.zeros(2), is_blind=False))
    return LocalMap([one], np.zeros((1, 3)), np.zeros(2), 8.0)


def test_normals_look_from_the_walls_to_the_laser() -> None:
    cloud = room()
    known = np.any(cloud.normals != 0.0, axis=1)
    assert known.mean() > 0.85
    assert np.all(np.sum(cloud.normals * cloud.points, axis=1)[known] < 0.0)
    right = known & (cloud.points[:, 0] > 3.49) & (np.abs(cloud.points[:, 1]) < 1.5)
    assert cloud.normals[right] == pytest.approx(np.tile([-1.0, 0.0], (right.sum(), 1)), abs=1e-4)


def test_a_normal_depends_on_few_neighbours_however_dense_the_beams_are() -> None:
    count = 3000
    x = np.linspace(-0.05, 0.05, count)
    points = np.column_stack([x, np.full(count, 0.05)])
    bent = points.copy()
    bent[count // 2 + 150 :, 1] += 0.05
    normals, of_bent = np.empty((count, 2)), np.empty((count, 2))
    beams = np.arange(count, dtype=np.int32)
    for out, seen in ((normals, points), (of_bent, bent)):
        lines.fit_normals(out, seen, beams, np.zeros(2), math.pi / count)
    middle = count // 2
    assert normals[middle] == pytest.approx([0.0, -1.0])
    assert of_bent[middle] == pytest.approx(normals[middle])


@settings(max_examples=cases(30))
@given(x=st.floats(-0.12, 0.12), y=st.floats(-0.12, 0.12), yaw=st.floats(-0.06, 0.06))
def test_alignment_finds_the_way_back(x: float, y: float, yaw: float) -> None:
    start = np.array([x, y, yaw])
    pose, information = local_map().align(start, room(), start, 1e-3 * np.eye(3), 0.3)
    assert pose == pytest.approx(np.zeros(3), abs=0.004)
    assert np.linalg.eigvalsh(information)[0] > 0.0


def test_along_a_corridor_the_prior_decides() -> None:
    cloud = room()
    walls = np.abs(cloud.normals[:, 1]) > 0.9
    corridor = Cloud(cloud.points[walls].copy(), cloud.normals[walls].copy())
    prior = np.array([0.15, 0.05, 0.0])
    pose, information = local_map().align(prior, corridor, prior, np.diag([400.0] * 3), 0.3)
    assert pose == pytest.approx([0.15, 0.0, 0.0], abs=0.01)
    assert information[0, 0] < 0.02 * information[1, 1]


def test_noise_is_no_information() -> None:
    assert without_noise(np.diag([10.0, 1e4, 9e4]))[0, 0] == 0.0
    assert without_noise(np.diag([1e4, 1e4, 9e4]))[0, 0] == pytest.approx(9700.0)


def naive_score(level: np.ndarray, cells: np.ndarray, row: int, col: int) -> float:
    """The mean score of points that are shifted by so many cells, 0 to 1."""
    total = 0
    _, height, width = level.shape
    for r, c, layer in np.add(cells, [row, col, 0]):
        if 0 <= r < height and 0 <= c < width:
            total += int(level[layer, r, c])
    return total / (255.0 * len(cells))


@given(
    seed=st.integers(0, 1000),
    cols=st.sampled_from([5, 30, 60]),
    pull=st.sampled_from([0.0, 0.05, 0.3]),
)
def test_branch_and_bound_finds_what_trying_everything_finds(
    seed: int, cols: int, pull: float
) -> None:
    rng = np.random.default_rng(seed)
    shape = (correlate.LAYERS + 1, 45, cols)
    levels = np.zeros((4, *shape), np.uint8)
    levels[0] = rng.integers(0, 256, shape) * (rng.random(shape) < 0.2)
    levels[0, correlate.ANY_SIDE] = levels[0, : correlate.LAYERS].max(axis=0)
    correlate.fill_pyramid(levels)
    low, high = (-3, -3, 0), (48, cols + 3, correlate.LAYERS + 1)
    cells = rng.integers(low, high, (3, 12, 3)).astype(np.int32)
    best = whole(correlate.find_best_shift(levels, cells.copy(), 6, -1.0, pull))
    heading = int(best[4])
    assert heading >= 0
    tried = [
        # The corner and the outermost headings lose half of `pull` each.
        naive_score(levels[0], cells[a], row, col)
        - 0.5 * pull * (row * row + col * col) / (2.0 * 6 * 6)
        - 0.5 * pull * (a - 1) ** 2
        for a in range(3)
        for row in range(-6, 7)
        for col in range(-6, 7)
    ]
    assert best[3] == pytest.approx(max(tried))
    again = naive_score(levels[0], cells[heading], int(best[1]), int(best[2]))
    assert again == pytest.approx(best[0])


@given(seed=st.integers(0, 1000), cols=st.sampled_from([1, 3, 8, 40]))
def test_a_pyramid_has_the_maxima_up_and_right(seed: int, cols: int) -> None:
    rng = np.random.default_rng(seed)
    levels = np.zeros((4, correlate.LAYERS + 1, 20, cols), np.uint8)
    levels[0] = rng.integers(0, 256, levels[0].shape)
    correlate.fill_pyramid(levels)
    for h in range(4):
        for row in range(20):
            for col in range(cols):
                block = levels[0, :, row : row + (1 << h), col : col + (1 << h)]
                assert (levels[h, :, row, col] == block.max(axis=(1, 2))).all()


@pytest.mark.parametrize("turn", [0.0, 0.5, 1.0, 2.5])
def test_the_back_of_a_wall_is_not_laid_over_its_front(turn: float) -> None:
    pose = np.array([0.0, 0.0, turn])
    seen = room()
    one = Keyframe.of(0, 0, Sweep(seen, np.zeros(2), is_blind=False))
    local = LocalMap([one], pose[None], np.zeros(2), 8.0)
    clear = np.any(seen.normals != 0.0, axis=1)
    front = Cloud(seen.points[clear], seen.normals[clear])
    back = Cloud(front.points, -front.normals)
    found = whole(local.correlate(front, pose, (0.3, 0.1), 0.5, 0.0))
    assert found is not None
    assert found[0] == pytest.approx(pose, abs=0.05)
    assert whole(local.correlate(back, pose, (0.3, 0.1), 0.5, 0.0)) is None
    classes = [local.classify(pose, Sweep(c, np.zeros(2), is_blind=False)) for c in (front, back)]
    assert np.mean(classes[0] == EXPLAINED) > 0.95
    assert not np.any(classes[1] == EXPLAINED)


def test_beams_free_what_they_pass_and_raise_where_they_end() -> None:
    log_odds = np.zeros((40, 40), np.int16)
    cells = Cells(log_odds, np.zeros((40, 40), np.int32), np.zeros((40, 40, 2), np.int8))
    points = np.array([[1.525, 0.0], [0.0, 0.525]], np.float32)
    frame = np.array([-0.225, -0.225, 20.0])
    for mark in (1, 2):
        trace_keyframe(
            cells, frame, points, np.zeros((2, 2), np.float32),
            (np.zeros(3), np.zeros(2, np.float32)), (mark, 60, 20, 100),
        )  # fmt: skip
    assert log_odds[4, 34] == 100
    assert log_odds[14, 4] == 100
    assert np.all(log_odds[4, 4:34] == -40)
    assert np.all(log_odds[4:14, 4] == -40)
    assert np.count_nonzero(log_odds) == 2 + 30 + 9


def test_a_search_far_and_wide_can_be_left_in_many_places_and_finds_what_a_short_one_does() -> None:
    local, cloud = local_map(), room()
    short = whole(local.correlate(cloud, np.zeros(3), (0.3, 0.1), 0.5, 0.0))
    slices = local.correlate(cloud, np.array([1.0, -1.0, 0.5]), (4.0, math.pi), 0.5, 0.0)
    assert sum(1 for _ in iter(lambda: is_left(slices), False)) > 5
    again = whole(local.correlate(cloud, np.array([1.0, -1.0, 0.5]), (4.0, math.pi), 0.5, 0.0))
    assert short is not None
    assert again is not None
    assert again[0] == pytest.approx(short[0], abs=0.05)
