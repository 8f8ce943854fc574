"""Maps come back from their files as they were, and damaged files never do harm."""

import math
import tempfile
from pathlib import Path

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from support.cases import cases

from trolley.geometry import Pose2D
from trolley.gridmap import GridMap, MapError, load_map, save_map

shapes = st.tuples(st.integers(1, 12), st.integers(1, 12))
plain_cells = hnp.arrays(np.int8, shapes, elements=st.sampled_from([-1, 0, 100]))
graded_cells = hnp.arrays(np.int8, shapes, elements=st.integers(-1, 100))
finite = st.floats(-1e6, 1e6)
origins = st.builds(Pose2D, finite, finite, st.floats(-math.pi, math.pi, exclude_min=True))
resolutions = st.floats(0.001, 1.0)

# What each mode can hold, and in which images.
WRITTEN = st.one_of(
    st.tuples(plain_cells, st.just("trinary"), st.sampled_from(["pgm", "png"])),
    st.tuples(graded_cells, st.just("raw"), st.sampled_from(["pgm", "png"])),
    st.tuples(graded_cells, st.just("scale"), st.just("png")),
    st.tuples(graded_cells, st.none(), st.none()),
)


def map_or_reason(file: Path) -> GridMap | str:
    """The map, or what its owner is told to do about it."""
    try:
        return load_map(file)
    except MapError as error:
        return error.remedy


@given(WRITTEN, origins, resolutions, st.booleans())
def test_maps_come_back_bit_for_bit(
    written: tuple[np.ndarray, str, str], origin: Pose2D, resolution: float, negate: bool
) -> None:
    cells, mode, image_format = written
    grid = GridMap("any", resolution, origin, cells)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "any.yaml"
        save_map(grid, file, mode, image_format, negate)  # type: ignore[arg-type]
        copy = load_map(file)
    np.testing.assert_array_equal(copy.cells, cells)
    assert (copy.name, copy.resolution, copy.origin) == ("any", resolution, origin)


@settings(max_examples=cases(300))
@given(
    graded_cells,
    st.sampled_from(["pgm", "png"]),
    st.lists(st.tuples(st.integers(0, 10**6), st.integers(0, 255)), min_size=1, max_size=5),
    st.one_of(st.none(), st.integers(0, 10**6)),
)
def test_damaged_images_give_a_map_or_a_reason(
    cells: np.ndarray, image_format: str, changes: list[tuple[int, int]], length: int | None
) -> None:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "any.yaml"
        grid = GridMap("any", 0.05, Pose2D.identity(), cells)
        image = save_map(grid, file, "raw", image_format)  # type: ignore[arg-type]
        content = bytearray(image.read_bytes())
        for place, value in changes:
            content[place % len(content)] = value
        if length is not None:
            del content[length % len(content) :]
        image.write_bytes(content)
        damaged = map_or_reason(file)
        assert damaged
        assert isinstance(damaged, str) or damaged.cells.min() >= -1


@settings(max_examples=cases(300))
@given(st.one_of(st.binary(max_size=200), st.text(max_size=200).map(str.encode)), st.booleans())
def test_damaged_descriptions_give_a_reason(content: bytes, appended: bool) -> None:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "any.yaml"
        save_map(GridMap("any", 0.05, Pose2D.identity(), np.zeros((2, 2), dtype=np.int8)), file)
        file.write_bytes(file.read_bytes() + content if appended else content)
        assert map_or_reason(file)
