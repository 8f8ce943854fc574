import math
import stat
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from trolley.geometry import Pose2D
from trolley.gridmap import MAX_CELLS, GridMap, MapError, load_map, save_map

GOOD = """image: map.pgm
resolution: 0.05
origin: [-1.5, 2.0, 0.0]
negate: 0
occupied_thresh: 0.65
free_thresh: 0.196
"""
CELLS = np.array([[0, 100, -1], [100, 0, 0]], dtype=np.int8)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with a good image and its good description."""
    (tmp_path / "map.yaml").write_text(GOOD)
    (tmp_path / "map.pgm").write_bytes(b"P5\n3 2\n255\n\x00\xfe\xfe\xfe\x00\xcd")
    return tmp_path


def test_map_is_read_with_its_place(folder: Path) -> None:
    grid = load_map(folder / "map.yaml")
    assert (grid.name, grid.resolution, grid.origin) == ("map", 0.05, Pose2D(-1.5, 2.0, 0.0))
    np.testing.assert_array_equal(grid.cells, CELLS)
    assert grid.cells.flags.c_contiguous
    assert grid.cells.flags.writeable
    assert load_map(str(folder / "map.yaml"), name="flat").name == "flat"


@pytest.mark.parametrize(
    ("line", "instead"),
    [
        ("image: map.pgm", "image: 'map.pgm'"),
        ("image: map.pgm", 'image:   "./map.pgm"   # beside this file'),
        ("resolution: 0.05", "resolution: 5e-2"),
        ("resolution: 0.05", "resolution: '0.05'"),
        ("negate: 0", "negate: false"),
        ("negate: 0", "negate: '0'"),
        ("origin: [-1.5, 2.0, 0.0]", "origin:\n- -1.5\n- 2\n- 0"),
        ("negate: 0", "negate: 0\nmode: trinary\nauthor: somebody\ncost_translation_table: [1]"),
    ],
)
def test_same_thing_written_otherwise(folder: Path, line: str, instead: str) -> None:
    (folder / "map.yaml").write_text(GOOD.replace(line, instead))
    grid = load_map(folder / "map.yaml")
    assert (grid.resolution, grid.origin) == (0.05, Pose2D(-1.5, 2.0, 0.0))
    np.testing.assert_array_equal(grid.cells, CELLS)


def test_image_may_be_named_by_its_full_path(folder: Path, tmp_path: Path) -> None:
    (folder / "elsewhere").mkdir()
    file = folder / "elsewhere" / "other.yaml"
    file.write_text(GOOD.replace("map.pgm", str(tmp_path / "map.pgm")))
    assert load_map(file).name == "other"


def test_turned_origin_is_wrapped(folder: Path) -> None:
    (folder / "map.yaml").write_text(GOOD.replace("2.0, 0.0]", "2.0, 4.0]"))
    assert load_map(folder / "map.yaml").origin.yaw == pytest.approx(4.0 - 2 * math.pi)


@pytest.mark.parametrize("word", ["1", "true", "True", "'1'"])
def test_negated_map_is_read(folder: Path, word: str) -> None:
    (folder / "map.yaml").write_text(GOOD.replace("negate: 0", f"negate: {word}"))
    # Pixels 0, 254, 205 with white occupied: free, occupied, occupied (p = 0.80).
    assert load_map(folder / "map.yaml").cells.tolist() == [[100, 0, 100], [0, 100, 100]]


@pytest.mark.parametrize(
    ("line", "instead", "sentence"),
    [
        (GOOD, "", "no 'key: value' lines"),
        (GOOD, "just words", "no 'key: value' lines"),
        (GOOD, "image: [", "not valid YAML at line"),
        (GOOD, "image: \tmap\n\t: x", "not valid YAML"),
        (GOOD, "a: " + "[" * 5000, "not valid YAML"),
        (GOOD, "x: 2001-99-99", r"not valid YAML \(a value"),
        (GOOD, "x: !!timestamp soon", "a value is not what it is marked as"),
        ("resolution: 0.05", "resolution: !!int ''", "a value is not what it is marked as"),
        ("resolution: 0.05", "resolution: !!float ''", "a value is not what it is marked as"),
        ("resolution: 0.05", f"resolution: {'9:' * 300}0.5", "a value is not what it is marked as"),
        ("resolution: 0.05", f"resolution: 0x{'f' * 9000}", "a number of thousands of digits"),
        ("negate: 0", "negate: !!bool maybe", "a value is not what it is marked as"),
        ("negate: 0", f"negate: 0x{'f' * 9000}", "'negate' must be 0 or 1"),
        ("image: map.pgm", 'image: "\\ud800.pgm"', "not a file name"),
        (GOOD, "# " * 40000, "too large"),
        ("image: map.pgm\n", "", "the key 'image' is missing; add a line like 'image: map.pgm'"),
        ("resolution: 0.05\n", "", "the key 'resolution' is missing"),
        ("origin: [-1.5, 2.0, 0.0]\n", "", "the key 'origin' is missing"),
        ("negate: 0\n", "", "the key 'negate' is missing"),
        ("free_thresh: 0.196", "", "the key 'free_thresh' is missing"),
        ("occupied_thresh: 0.65", "", "the key 'occupied_thresh' is missing"),
        ("image: map.pgm", "image: 7", "not a file name"),
        ("image: map.pgm", "image: ''", "not a file name"),
        ("image: map.pgm", "image: missing.pgm", "missing.pgm: there is no such image; check"),
        ("image: map.pgm", "image: .", "it cannot be read .Is a directory.; check 'image:'"),
        ("image: map.pgm", f"image: {'m' * 300}", "it cannot be read .File name too long."),
        ("image: map.pgm", "image: map.yaml", "not an image"),
        ("resolution: 0.05", "resolution: zero", "'resolution' is not a number"),
        ("resolution: 0.05", "resolution: true", "'resolution' is not a number"),
        ("resolution: 0.05", "resolution: .nan", "'resolution' is not a number"),
        ("resolution: 0.05", "resolution: 0", "resolution of 0 m"),
        ("resolution: 0.05", "resolution: -0.05", "resolution of -0.05 m"),
        ("resolution: 0.05", "resolution: 5", "resolution of 5 m"),
        ("[-1.5, 2.0, 0.0]", "[-1.5, 2.0, 90]", "yaw of 'origin' 90 is more .* in radians"),
        ("[-1.5, 2.0, 0.0]", "[-1.5, 2.0]", "three numbers"),
        ("[-1.5, 2.0, 0.0]", "[-1.5, 2.0, north]", "three numbers"),
        ("[-1.5, 2.0, 0.0]", "[-1.5, .inf, 0.0]", "three numbers"),
        ("[-1.5, 2.0, 0.0]", "{x: 1}", "three numbers"),
        ("[-1.5, 2.0, 0.0]", "[-1.5, -1e308, 0.0]", "the origin lies too far away"),
        ("[-1.5, 2.0, 0.0]", "[458000.0, 5430000.0, 0.0]", "at most 1000000 m"),
        ("negate: 0", "negate: 2", "'negate' must be 0 or 1"),
        ("occupied_thresh: 0.65", "occupied_thresh: 0.1", "out of order"),
        ("occupied_thresh: 0.65", "occupied_thresh: 65", "out of order"),
        ("free_thresh: 0.196", "free_thresh: -0.1", "out of order"),
        ("negate: 0", "negate: 0\nmode: colour", "mode 'colour' is unknown"),
        ("negate: 0", "negate: 0\nmode: [raw]", "is unknown"),
    ],
)
def test_description_that_cannot_be_read_says_why(
    folder: Path, line: str, instead: str, sentence: str
) -> None:
    file = folder / "map.yaml"
    file.write_text(GOOD.replace(line, instead))
    with pytest.raises(MapError, match=sentence) as caught:
        load_map(file)
    assert str(caught.value).startswith(f"map {caught.value.file}: ")
    assert caught.value.remedy


@pytest.mark.parametrize("key", ["resolution", "origin", "negate", "mode"])
def test_a_value_that_repeats_itself_without_end_is_not_written_out(folder: Path, key: str) -> None:
    tenfold = [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]" for i in range(1, 9)]
    lines = ["a0: &a0 x", *tenfold, *GOOD.splitlines(), f"{key}: *a8"]
    (folder / "map.yaml").write_text("\n".join(lines))
    with pytest.raises(MapError) as caught:
        load_map(folder / "map.yaml")
    assert len(str(caught.value)) < 500


def test_a_description_that_doubles_with_each_line_is_refused_at_once(folder: Path) -> None:
    doubled = [f"a{i}: &a{i} {{<<: [*a{i - 1}, *a{i - 1}]}}" for i in range(1, 28)]
    (folder / "map.yaml").write_text("\n".join([GOOD, "a0: &a0 {x: 1}", *doubled]))
    with pytest.raises(MapError, match=r"line 14 .*; write out what they stand for"):
        load_map(folder / "map.yaml")


def test_a_description_may_refer_to_itself_a_few_times(folder: Path) -> None:
    (folder / "map.yaml").write_text("zero: &zero 0\n" + GOOD.replace("negate: 0", "negate: *zero"))
    assert load_map(folder / "map.yaml").name == "map"


def test_description_in_another_encoding_says_so(folder: Path) -> None:
    (folder / "map.yaml").write_bytes(b"image: k\xfcche.pgm\n")
    with pytest.raises(MapError, match="not valid YAML"):
        load_map(folder / "map.yaml")


@pytest.mark.parametrize("name", ["nowhere.yaml", "."])
def test_description_that_is_not_there_says_so(folder: Path, name: str) -> None:
    with pytest.raises(MapError, match="cannot be read"):
        load_map(folder / name)


def test_image_given_for_the_description_says_so(folder: Path) -> None:
    with pytest.raises(MapError, match=r"give the \.yaml file"):
        load_map(folder / "map.pgm")


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        (b"", "not an image"),
        (b"P5\n3 2\n255\n\x00\xfe", "damaged or cut short"),
        (b"P2\n3 2\n255\n0 1 2\n", "damaged or cut short"),
        (b"P2\n3 2\n255\n0 1 2 3 4 none\n", "damaged or cut short"),
        (b"P5\n0 2\n255\n", "empty|not an image|damaged"),
        (b"P5\n8000 8000\n255\n", "8000 x 8000 pixels are too many"),
        (b"P5\n90000 90000\n255\n", "too large"),
        (b"\x89PNG\r\n\x1a\n", "not an image|damaged"),
        (b"GIF89a\x01\x00\x01\x00\x00\x00\x00;", "not an image"),
    ],
)
def test_image_that_cannot_be_read_says_why(folder: Path, content: bytes, sentence: str) -> None:
    (folder / "map.pgm").write_bytes(content)
    with pytest.raises(MapError, match=sentence):
        load_map(folder / "map.yaml")


def test_png_cut_short_says_so(folder: Path) -> None:
    Image.fromarray(np.arange(10000, dtype=np.uint8).reshape(100, 100)).save(folder / "cut.png")
    whole = (folder / "cut.png").read_bytes()
    (folder / "map.pgm").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(MapError, match="damaged or cut short"):
        load_map(folder / "map.yaml")


def test_largest_map_fits_a_message() -> None:
    assert MAX_CELLS < 32 * 1024 * 1024


def grid_of(values: object) -> GridMap:
    return GridMap("saved", 0.025, Pose2D(-3.25, 0.1, -2.5), np.array(values, dtype=np.int8))


def test_plain_map_is_written_as_ros_does(tmp_path: Path) -> None:
    image = save_map(grid_of([[0, 100, -1]]), tmp_path / "flat.yaml")
    assert image == tmp_path / "flat.pgm"
    assert image.read_bytes() == b"P5\n3 1\n255\n\xfe\x00\xcd"
    assert (tmp_path / "flat.yaml").read_text().splitlines() == [
        "image: flat.pgm",
        "mode: trinary",
        "resolution: 0.025",
        "origin: [-3.25, 0.1, -2.5]",
        "negate: 0",
        "occupied_thresh: 0.65",
        "free_thresh: 0.196",
    ]


def test_graded_map_is_written_so_that_nothing_is_lost(tmp_path: Path) -> None:
    grid = grid_of([list(range(-1, 101))])
    assert save_map(grid, tmp_path / "graded.yaml").suffix == ".png"
    np.testing.assert_array_equal(load_map(tmp_path / "graded.yaml").cells, grid.cells)


@pytest.mark.parametrize(
    ("values", "arguments", "sentence"),
    [
        ([[0, 50]], {"mode": "trinary"}, "value of 50 cannot be written in mode trinary"),
        ([[0, -2]], {}, "value of -2 cannot be written"),
        ([[0, 101]], {"mode": "raw"}, "value of 101 cannot be written"),
        ([[-1]], {"mode": "scale", "image_format": "pgm"}, "cannot say unknown"),
        ([[1, 2]], {"thresholds": (0.4, 0.6)}, "cannot be written"),
    ],
)
def test_map_that_would_not_come_back_is_not_written(
    tmp_path: Path, values: object, arguments: dict, sentence: str
) -> None:
    with pytest.raises(MapError, match=sentence):
        save_map(grid_of(values), tmp_path / "lost.yaml", **arguments)
    assert list(tmp_path.iterdir()) == []


def test_folder_that_is_not_there_says_so(tmp_path: Path) -> None:
    with pytest.raises(MapError, match="cannot be written"):
        save_map(grid_of([[0]]), tmp_path / "nowhere" / "flat.yaml")


def test_saving_again_replaces_and_leaves_nothing_behind(tmp_path: Path) -> None:
    save_map(grid_of([[0, 0]]), tmp_path / "flat.yaml")
    save_map(grid_of([[100], [0]]), tmp_path / "flat.yaml")
    assert load_map(tmp_path / "flat.yaml").cells.tolist() == [[100], [0]]
    assert sorted(file.name for file in tmp_path.iterdir()) == ["flat.pgm", "flat.yaml"]
    assert stat.S_IMODE((tmp_path / "flat.yaml").stat().st_mode) == 0o644


def test_name_of_any_script_comes_back(tmp_path: Path) -> None:
    save_map(grid_of([[0]]), tmp_path / "Küche: 2. 'OG'.yaml")
    assert load_map(tmp_path / "Küche: 2. 'OG'.yaml").name == "Küche: 2. 'OG'"


@pytest.mark.parametrize("name", ["freiburg-079", "mac_1st_floor_final"])
def test_published_maps_are_read_and_come_back(recordings: Path, tmp_path: Path, name: str) -> None:
    grid = load_map(recordings / f"{name}.yaml")
    assert 0.0 < grid.occupied_mask().mean() < 0.1
    save_map(grid, tmp_path / "copy.yaml")
    copy = load_map(tmp_path / "copy.yaml")
    np.testing.assert_array_equal(copy.cells, grid.cells)
    assert (copy.resolution, copy.origin) == (grid.resolution, grid.origin)
