"""Grids as pictures, and pictures as files."""

import io
import json
import struct

import imageio.v3 as iio
import numpy as np

from trolley.geometry import Pose2D
from trolley.messages import OccupancyGrid
from trolley_viz.graphics.glb import floor_glb, png
from trolley_viz.graphics.pictures import FLOOR, UNKNOWN, WALL, costmap_picture, map_picture, shrink
from trolley_viz.scene.map_layers import MapModel


def test_a_map_is_drawn_with_north_up() -> None:
    cells = np.array([[0, 100], [-1, 0]], np.int8)  # row 0 is the southern one
    picture, factor = map_picture(cells)
    assert factor == 1
    assert picture.tolist() == [[list(UNKNOWN), list(FLOOR)], [list(FLOOR), list(WALL)]]


def test_free_cells_of_a_costmap_are_clear_and_forbidden_ones_are_not() -> None:
    picture, _ = costmap_picture(np.array([[0, -1, 50, 99, 100]], np.int8))
    alpha = picture[0, :, 3].tolist()
    assert alpha[:2] == [0, 0]
    assert 0 < alpha[2] < alpha[3] < alpha[4]


def test_values_that_mean_nothing_are_drawn_as_unknown() -> None:
    picture, _ = map_picture(np.array([[-128, 127]], np.int8))
    assert picture.tolist() == [[list(UNKNOWN), list(UNKNOWN)]]


def test_shrinking_keeps_every_wall() -> None:
    cells = np.zeros((100, 301), np.int8)
    cells[7, 300] = 100
    small, factor = shrink(cells, max_side=100)
    assert (small.shape, factor) == ((25, 76), 4)
    assert np.argwhere(small == 100).tolist() == [[1, 75]]


def test_a_huge_map_is_small_enough_for_a_phone() -> None:
    values = np.array([-1, 0, 100], np.int8)
    cells = np.random.default_rng(1).choice(values, (4000, 4000))  # nothing packs worse
    grid = OccupancyGrid(
        stamp_ns=0,
        name="huge",
        frame="map",
        resolution=0.05,
        width=4000,
        height=4000,
        origin=Pose2D(0.0, 0.0, 0.0),
        cells=memoryview(cells.tobytes()),
    )
    model = MapModel.of(grid)
    assert len(model.floor) < 1_000_000
    assert model.walls is None


def test_png_is_read_back_the_same() -> None:
    picture = np.random.default_rng(0).integers(0, 256, (7, 5, 3), np.uint8)
    np.testing.assert_array_equal(iio.imread(io.BytesIO(png(picture)), extension=".png"), picture)


def test_glb_is_whole() -> None:
    data = floor_glb(np.zeros((2, 3, 3), np.uint8), 3.0, 2.0)
    magic, version, length = struct.unpack_from("<3I", data)
    assert (magic, version, length) == (0x46546C67, 2, len(data))
    size, kind = struct.unpack_from("<2I", data, 12)
    assert (size % 4, kind) == (0, 0x4E4F534A)
    document = json.loads(data[20 : 20 + size])
    binary_size, binary_kind = struct.unpack_from("<2I", data, 20 + size)
    assert binary_kind == 0x004E4942
    assert binary_size == document["buffers"][0]["byteLength"] == len(data) - 28 - size
    for view in document["bufferViews"]:
        assert view["byteOffset"] % 4 == 0
        assert view["byteOffset"] + view["byteLength"] <= binary_size
