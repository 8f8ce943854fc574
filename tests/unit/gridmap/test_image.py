from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from trolley.geometry import Pose2D
from trolley.gridmap.description import MapDescription, Mode
from trolley.gridmap.image import decode_table, encode_table, read_cells


def description(mode: Mode = "trinary", negate: bool = False) -> MapDescription:
    """A description with ROS's usual thresholds."""
    return MapDescription("map.png", 0.05, Pose2D(0.0, 0.0, 0.0), negate=negate, mode=mode)


def cells_of(pixels: object, folder: Path, mode: Mode = "trinary", kind: str = "uint8") -> list:
    """The cells of an image with these pixels, top row first, as a list."""
    file = folder / "map.png"
    Image.fromarray(np.array(pixels, dtype=kind)).save(file)
    return read_cells(file, description(mode))[::-1].tolist()


def test_trinary_follows_the_thresholds() -> None:
    table = decode_table(description(), 255)
    # 0.65 of 255 is 165.75: up to 89 is occupied. 0.196 of 255 is 49.98: from 206 is free.
    assert [table[v] for v in (0, 89, 90, 205, 206, 255)] == [100, 100, -1, -1, 0, 0]


def test_negate_swaps_black_and_white() -> None:
    table = decode_table(description(), 255)
    np.testing.assert_array_equal(decode_table(description(negate=True), 255), table[::-1])


def test_scale_runs_from_free_to_occupied() -> None:
    table = decode_table(description("scale"), 255)
    # (0.5 - 0.196) / (0.65 - 0.196) is 0.67 for the middle grey, p = 127.5 / 255.
    assert table[0] == 100
    assert table[255] == 0
    assert table[127] == 67
    assert (np.diff(table.astype(int)) <= 0).all()
    assert table.min() == 0


@pytest.mark.parametrize("negate", [False, True])
def test_raw_takes_the_number_as_it_is(negate: bool) -> None:
    table = decode_table(description("raw", negate), 255)
    assert table[:101].tolist() == list(range(101))
    assert (table[101:] == -1).all()


def test_usual_pixels_are_written() -> None:
    assert encode_table(description()) == {-1: 205, 0: 254, 100: 0}
    assert encode_table(description(negate=True)) == {-1: 50, 0: 1, 100: 255}
    assert encode_table(description("raw"))[-1] == 255


def test_image_is_turned_upside_down(tmp_path: Path) -> None:
    file = tmp_path / "map.png"
    Image.fromarray(np.array([[0, 254], [205, 254], [254, 254]], dtype=np.uint8)).save(file)
    assert read_cells(file, description()).tolist() == [[0, 0], [-1, 0], [100, 0]]


def test_colours_are_averaged(tmp_path: Path) -> None:
    # Means of 255, 85 (p = 2/3 > 0.65) and 170 (p = 1/3).
    pixels = [[[255, 255, 255], [255, 0, 0], [255, 255, 0]]]
    assert cells_of(pixels, tmp_path) == [[0, 100, -1]]


def test_alpha_is_one_more_colour_in_trinary_mode(tmp_path: Path) -> None:
    # Black, opaque: mean 63.75, p = 0.75. White, transparent: mean 191.25, p = 0.25.
    pixels = [[[0, 0, 0, 255], [255, 255, 255, 0], [254, 254, 254, 255]]]
    assert cells_of(pixels, tmp_path) == [[100, -1, 0]]


def test_alpha_means_unknown_in_scale_mode_only(tmp_path: Path) -> None:
    pixels = [[[0, 255], [0, 254], [255, 0]]]
    assert cells_of(pixels, tmp_path, "scale") == [[100, -1, -1]]
    assert cells_of(pixels, tmp_path, "raw") == [[0, 0, -1]]


def test_palette_is_looked_up(tmp_path: Path) -> None:
    file = tmp_path / "map.png"
    image = Image.fromarray(np.array([[0, 1, 2]], dtype=np.uint8), mode="P")
    image.putpalette([254, 254, 254, 0, 0, 0, 205, 205, 205])
    image.save(file)
    assert read_cells(file, description()).tolist() == [[0, 100, -1]]
    image.save(file, transparency=1)
    assert read_cells(file, description("scale"))[0].tolist()[:2] == [0, -1]


def test_black_and_white_image_is_read(tmp_path: Path) -> None:
    file = tmp_path / "map.png"
    Image.fromarray(np.array([[0, 255]], dtype=np.uint8)).convert("1").save(file)
    assert read_cells(file, description()).tolist() == [[100, 0]]


def test_sixteen_bits_count_in_full(tmp_path: Path) -> None:
    pixels = [[0, 65535, 205 * 257]]
    assert cells_of(pixels, tmp_path, kind="uint16") == [[100, 0, -1]]


@pytest.mark.parametrize(
    "content",
    [
        b"P2\n3 1\n255\n0 205 254\n",
        b"P2 # drawn by hand\n# 3 x 1\n3 1 # size\n255\n0 205\n# last\n254\n",
        b"P2\n3 1\n100\n0 80 100\n",
        b"P5\n3 1\n255\n\x00\xcd\xfe",
        b"P5 # CREATOR: map_saver 0.050 m/pix\n3 1\n255\n\x00\xcd\xfe",
        b"P5\n3 1\n100\n\x00\x50\x64",
        b"P5\n3 1\n65535\n\x00\x00\xcd\xcd\xfe\xfe",
        b"P3\n3 1\n255\n0 0 0 205 205 205 254 254 254\n",
    ],
)
def test_every_kind_of_pgm_is_read(tmp_path: Path, content: bytes) -> None:
    file = tmp_path / "map.pgm"
    file.write_bytes(content)
    assert read_cells(file, description()).tolist() == [[100, -1, 0]]
