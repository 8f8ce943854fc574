"""examples/depth.py: obstacles and cliffs of synthetic depth images, cast ray by ray."""

import math
import subprocess
import sys
from typing import Any

import numpy as np
import pytest
from support.examples import EXAMPLES, load_example

from trolley.messages.types import floats_from_bytes

SHAPE = (100, 160)
FOCAL, CENTRE = (110.0, 112.0), (81.0, 47.0)
HEIGHT, TILT = 0.3, math.radians(25.0)

Box = tuple[tuple[float, float], tuple[float, float], tuple[float, float]]
"""From and to along x (ahead), y (left) and z (up) [m]."""
FLOOR: Box = ((-9.0, 9.0), (-9.0, 9.0), (-1.0, 0.0))


@pytest.fixture(scope="module")
def depth() -> Any:
    return load_example("depth")


def rotation(tilt: float, roll: float) -> np.ndarray:
    """From the camera (right, down, along its axis) to the room (ahead, left, up)."""
    level = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    cos, sin = math.cos(tilt), math.sin(tilt)
    down = np.array([[cos, 0.0, sin], [0.0, 1.0, 0.0], [-sin, 0.0, cos]])
    cos, sin = math.cos(roll), math.sin(roll)
    about = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    return down @ level @ about


def image(boxes: list[Box], tilt: float = TILT, roll: float = 0.0) -> np.ndarray:
    """The depth of the nearest box in each pixel, 0 for none."""
    rows, columns = np.mgrid[: SHAPE[0], : SHAPE[1]]
    pixel = np.stack(
        [
            (columns - CENTRE[0]) / FOCAL[0],
            (rows - CENTRE[1]) / FOCAL[1],
            np.ones(SHAPE),
        ],
        axis=-1,
    )
    rays = pixel @ rotation(tilt, roll).T
    eye = np.array([0.0, 0.0, HEIGHT])
    nearest = np.full(SHAPE, math.inf)
    for box in boxes:
        low, high = np.array(box).T
        with np.errstate(divide="ignore"):
            one, other = (low - eye) / rays, (high - eye) / rays
        enters = np.minimum(one, other).max(axis=-1)
        leaves = np.maximum(one, other).min(axis=-1)
        hit = (enters <= leaves) & (enters > 0.0)
        nearest = np.where(hit, np.minimum(nearest, enters), nearest)
    return np.where(np.isfinite(nearest), nearest, 0.0)


def scanner(depth: Any, tilt: float = TILT, roll: float = 0.0, **judged: float) -> Any:
    camera = depth.Camera(FOCAL, CENTRE, HEIGHT, tilt, roll)
    return depth.DepthScanner(camera, SHAPE, depth.Judgement(**judged))


def points(scan: Any) -> np.ndarray:
    """Echoes (n, 2) in the frame of the scan."""
    ranges = floats_from_bytes(scan.ranges).astype(np.float64)
    angles = scan.angle_min + scan.angle_increment * np.arange(len(ranges))
    found = np.isfinite(ranges) & (ranges > 0.0)
    return (ranges[found] * np.stack([np.cos(angles[found]), np.sin(angles[found])])).T


def seen(depth: Any, picture: np.ndarray, tilt: float = TILT, roll: float = 0.0) -> np.ndarray:
    return points(scanner(depth, tilt, roll).scan(picture, 5, "front"))


def noisy(picture: np.ndarray, share: float, rng: np.random.Generator) -> np.ndarray:
    """Stereo noise, which grows with the square of the depth, and holes."""
    wrong = picture + 0.004 * picture**2 * rng.standard_normal(SHAPE)
    return np.where(rng.random(SHAPE) < share, 0.0, wrong)


@pytest.mark.parametrize("tilt_deg", [10.0, 25.0, 40.0])
@pytest.mark.parametrize("roll_deg", [-8.0, 0.0, 8.0])
def test_level_floor_is_free_however_the_camera_is_tilted(
    depth: Any, tilt_deg: float, roll_deg: float
) -> None:
    tilt, roll = math.radians(tilt_deg), math.radians(roll_deg)
    ranges = scanner(depth, tilt, roll).ranges(image([FLOOR], tilt, roll))
    assert np.mean(np.isinf(ranges)) > 0.9
    assert not ((ranges > 0.0) & np.isfinite(ranges)).any()


@pytest.mark.parametrize("roll_deg", [0.0, 8.0])
@pytest.mark.parametrize("holes", [0.0, 0.3])
def test_a_low_box_is_where_it_stands(depth: Any, roll_deg: float, holes: float) -> None:
    box: Box = ((1.0, 1.2), (-0.1, 0.3), (0.0, 0.12))
    roll = math.radians(roll_deg)
    rng = np.random.default_rng(3)
    found = seen(depth, noisy(image([FLOOR, box], TILT, roll), holes, rng), TILT, roll)
    assert len(found) > 15
    assert np.abs(found[:, 0] - 1.0).max() < 0.04
    assert found[:, 1].min() == pytest.approx(-0.1, abs=0.03)
    assert found[:, 1].max() == pytest.approx(0.3, abs=0.03)


def test_a_table_over_the_lidar_s_plane_is_an_obstacle_and_a_lamp_is_not(depth: Any) -> None:
    tilt = math.radians(5.0)
    table: Box = ((0.9, 1.5), (-1.0, 1.0), (0.4, 0.45))
    lamp: Box = ((0.9, 1.5), (-1.0, 1.0), (0.7, 0.8))
    assert seen(depth, image([FLOOR, table], tilt), tilt)[:, 0].min() == pytest.approx(
        0.9, abs=0.03
    )
    assert len(seen(depth, image([FLOOR, lamp], tilt), tilt)) == 0


@pytest.mark.parametrize("drop_m", [0.15, 0.6])
@pytest.mark.parametrize("holes", [0.0, 0.3])
def test_stairs_down_are_an_obstacle_at_their_edge(depth: Any, drop_m: float, holes: float) -> None:
    upper: Box = ((-9.0, 0.9), (-9.0, 9.0), (-2.0, 0.0))
    lower: Box = ((-9.0, 9.0), (-9.0, 9.0), (-2.0, -drop_m))
    found = seen(depth, noisy(image([upper, lower]), holes, np.random.default_rng(5)))
    assert len(found) > 50
    assert found[:, 0].min() > 0.85
    assert np.median(found[:, 0]) == pytest.approx(0.93, abs=0.05)


def test_noise_of_the_floor_is_neither_thing_nor_cliff(depth: Any) -> None:
    rng = np.random.default_rng(7)
    for _ in range(10):
        assert len(seen(depth, noisy(image([FLOOR]), 0.2, rng))) == 0


def test_single_pixels_are_noise(depth: Any) -> None:
    picture = image([FLOOR])
    picture[20:90:25, 10::40] *= 0.5
    assert len(seen(depth, picture)) == 0


@pytest.mark.parametrize("nothing", [0.0, math.nan, math.inf])
def test_what_is_not_measured_is_not_free(depth: Any, nothing: float) -> None:
    made = scanner(depth)
    assert (made.ranges(np.full(SHAPE, nothing)) == 0.0).all()
    half = image([FLOOR])
    half[:, : SHAPE[1] // 2] = nothing
    ranges = made.ranges(half)
    # Its left half is to the left, where angles are large.
    assert (ranges[len(ranges) // 2 + 3 :] == 0.0).all()
    assert np.isinf(ranges[5 : len(ranges) // 2 - 3]).all()


def test_the_nearest_floor_is_where_things_begin_to_be_overlooked(depth: Any) -> None:
    lowest = TILT + math.atan((SHAPE[0] - 1 - CENTRE[1]) / FOCAL[1])
    assert scanner(depth).range_min == pytest.approx(HEIGHT / math.tan(lowest), rel=0.1)


def test_whole_numbers_are_millimetres(depth: Any) -> None:
    assert depth.metres(np.full((2, 3), 1500, np.uint16))[1, 2] == 1.5
    assert depth.metres(np.full((2, 3), 1.5, np.float32))[1, 2] == 1.5
    with pytest.raises(ValueError, match="rows and columns"):
        depth.metres(np.zeros(4))


def test_without_depthai_the_other_example_says_what_it_needs() -> None:
    command = [sys.executable, str(EXAMPLES / "oak.py"), "front", "--height", "0.3"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
    assert "pip install" in done.stderr
    assert done.returncode == 1
