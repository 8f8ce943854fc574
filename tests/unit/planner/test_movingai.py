"""MovingAI's files, and the planner on them."""

from pathlib import Path

import numpy as np
import pytest
from movingai import Query, read_map, read_scen, write_map, write_scen
from planner_mazes import draw_files, drawn_maps, run

MAP = """type octile
height 3
width 5
map
.G@T.
S....
OW..@
"""


def test_a_map_is_read_with_its_kinds_of_cells(tmp_path: Path) -> None:
    path = tmp_path / "a.map"
    path.write_text(MAP)
    expected = [[1, 1, 0, 0, 1], [1, 1, 1, 1, 1], [0, 0, 1, 1, 0]]
    np.testing.assert_array_equal(read_map(path), np.array(expected, bool))
    path.write_bytes(MAP.replace("\n", "\r\n").encode())
    np.testing.assert_array_equal(read_map(path), np.array(expected, bool))


@pytest.mark.parametrize(
    ("before", "after", "why"),
    [
        ("octile", "hex", "type"),
        ("height 3", "height x", "height"),
        ("height 3", "height 4", "rows"),
        ("S....", "S...", "rows"),
        ("S....", "S..?.", "cells"),
    ],
)
def test_a_broken_map_is_refused_by_name(tmp_path: Path, before, after, why) -> None:
    path = tmp_path / "broken.map"
    path.write_text(MAP.replace(before, after))
    with pytest.raises(ValueError, match=rf"broken\.map: .*{why}"):
        read_map(path)


def test_queries_are_read_as_they_were_written(tmp_path: Path) -> None:
    queries = [Query("a.map", (0, 0), (4, 1), 4.41421356), Query("a.map", (1, 1), (1, 1), 0.0)]
    write_scen(tmp_path / "a.scen", queries, (3, 5))
    assert read_scen(tmp_path / "a.scen") == queries
    lines = (tmp_path / "a.scen").read_text()
    (tmp_path / "a.scen").write_text(lines.replace("a.map", "maps/dao/a.map"))
    assert read_scen(tmp_path / "a.scen") == queries
    (tmp_path / "a.scen").write_text(lines + "3 a.map 5\n")
    with pytest.raises(ValueError, match=r"a\.scen, line 4"):
        read_scen(tmp_path / "a.scen")


def test_a_folder_without_its_maps_is_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"no \.scen files"):
        run(tmp_path, 0, 0)
    write_scen(tmp_path / "a.scen", [Query("a.map", (0, 0), (1, 0), 1.0)], (3, 5))
    with pytest.raises(ValueError, match=r"a\.map"):
        run(tmp_path, 0, 0)


def test_ways_on_all_kinds_of_maps_are_the_shortest(tmp_path: Path) -> None:
    draw_files(tmp_path, 64, 12, 3)
    tallies, total = run(tmp_path, 0, 0)
    assert set(tallies) == {f"{name}.map" for name in drawn_maps(16, np.random.default_rng(0))}
    assert len(total.grid_ratios) == 12 * len(tallies)
    assert (total.missed, total.wrong) == (0, 0)
    # Lengths of steps are rounded: 41 / 29 for the square root of 2.
    assert max(total.grid_ratios) <= 1.001
    assert min(total.grid_ratios) >= 1.0 - 1e-6


def test_what_cannot_be_reached_and_what_is_wrong_is_counted(tmp_path: Path) -> None:
    passable = np.ones((6, 6), bool)
    passable[:, 3] = False
    write_map(tmp_path / "a.map", passable)
    queries = [
        Query("a.map", (0, 0), (5, 5), 7.0),  # A wall between: no way, whatever the file says.
        Query("a.map", (0, 0), (2, 0), 2.0),
        Query("a.map", (0, 0), (2, 0), 3.0),  # Shorter than it says can be.
        Query("a.map", (0, 0), (5, 0), 0.0),
    ]
    write_scen(tmp_path / "a.map.scen", queries, passable.shape)
    _, total = run(tmp_path, 0, 0)
    assert (total.missed, total.wrong, len(total.grid_ratios)) == (1, 1, 2)
