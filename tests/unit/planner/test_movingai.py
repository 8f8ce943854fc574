"""MovingAI's files, and the planner on them."""

from pathlib import Path

import numpy as np
import pytest
from bench.planner.movingai import (
    BLOCKED,
    GROUND,
    WATER,
    Query,
    find_map,
    read_map,
    read_scen,
    write_map,
    write_scen,
)
from bench.planner.movingai_maps import draw_files, drawn_maps, run

MAP = """type octile
height 3
width 5
map
.G@T.
S....
OW..@
"""


pytestmark = pytest.mark.drives


def test_a_map_is_read_with_its_kinds_of_cells(tmp_path: Path) -> None:
    path = tmp_path / "a.map"
    path.write_text(MAP)
    b, g, w = BLOCKED, GROUND, WATER
    expected = [[g, g, b, b, g], [g, g, g, g, g], [b, w, g, g, b]]
    np.testing.assert_array_equal(read_map(path), expected)
    path.write_bytes(MAP.replace("\n", "\r\n").encode())
    np.testing.assert_array_equal(read_map(path), expected)


@pytest.mark.parametrize(
    ("before", "after", "why"),
    [
        ("octile", "hex", ": the type"),
        ("height 3", "height x", ": height"),
        ("height 3\n", "", ": height"),
        ("height 3", "height 4", ": 3 rows"),
        ("S....", "S...", ", line 6: 4 cells"),
        ("S....", "S..?.", ", line 6: cells"),
        ("S....", "S..\xe4.", ", line 6: cells"),
        ("OW..@\n", "OW", ", line 7: 2 cells"),
    ],
)
def test_a_broken_map_is_refused_by_name(tmp_path: Path, before, after, why) -> None:
    path = tmp_path / "broken.map"
    path.write_text(MAP.replace(before, after), encoding="latin-1")
    with pytest.raises(ValueError, match=rf"broken\.map{why}"):
        read_map(path)


@pytest.mark.parametrize("version", ["version 1\n", "version 1.0\n", ""])
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_queries_are_read_as_they_were_written(tmp_path: Path, version, end) -> None:
    queries = [Query("a.map", (0, 0), (4, 1), 4.41421356), Query("a.map", (1, 1), (1, 1), 0.0)]
    path = tmp_path / "a.scen"
    write_scen(path, queries, (3, 5))
    lines = path.read_text().replace("version 1\n", version)
    path.write_bytes(lines.replace("\n", end).encode())
    assert read_scen(path) == queries
    assert {query.shape for query in read_scen(path)} == {(3, 5)}
    path.write_text(lines.replace("\t", " "))
    assert read_scen(path) == queries
    path.write_text(lines.replace("a.map", "maps\\dao\\a.map"))
    assert {query.map_name for query in read_scen(path)} == {"maps/dao/a.map"}


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("version 2\n", "line 1: 'version 2'"),
        ("version 1\n3 a.map 5\n", "line 2: expected nine fields"),
        ("version 1\n0\ta.map\t5\t3\t0\t0\t4\t1\n", "line 2: expected nine fields"),
        ("version 1\n0\ta.map\t5\t3\t0\t0\t4\tx\t1.0\n", "line 2: expected nine fields"),
        ("version 1\n0\ta.map\t5\t3\t0\t0\t4\t1\tnan\n", "line 2: the optimal length"),
        ("version 1\n0\ta.map\t6\t3\t0\t0\t4\t1\t4.0\n", "line 2: is for a map of 6 x 3"),
        ("version 1\n0\ta.map\t5\t3\t0\t0\t5\t1\t4.0\n", r"line 2: the goal \(5, 1\)"),
        ("version 1\n0\ta.map\t5\t3\t2\t0\t4\t1\t4.0\n", r"line 2: the start \(2, 0\)"),
        ("version 1\n0\tb.map\t5\t3\t0\t0\t4\t1\t4.0\n", r"line 2: there is no b\.map"),
    ],
)
def test_a_query_that_cannot_be_asked_is_refused_by_its_line(tmp_path: Path, text, why) -> None:
    (tmp_path / "a.map").write_text(MAP)
    (tmp_path / "a.scen").write_text(text)
    with pytest.raises(ValueError, match=rf"a\.scen, {why}"):
        run(tmp_path, 0, 0)


def test_maps_of_the_same_name_are_told_apart(tmp_path: Path) -> None:
    one, other, apart = tmp_path / "dao" / "a.map", tmp_path / "wc3" / "a.map", tmp_path / "a.scen"
    maps = [one, other]
    assert find_map(Query("a.map", (0, 0), (0, 0), 0.0), tmp_path / "dao" / "a.scen", maps) == one
    assert find_map(Query("maps/wc3/a.map", (0, 0), (0, 0), 0.0), apart, maps) == other
    with pytest.raises(ValueError, match=r"dao/a\.map or .*wc3/a\.map"):
        find_map(Query("a.map", (0, 0), (0, 0), 0.0), apart, maps)


def test_a_folder_without_queries_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"no \.scen files"):
        run(tmp_path, 0, 0)


def test_ways_on_all_kinds_of_maps_are_as_short_as_can_be(tmp_path: Path) -> None:
    draw_files(tmp_path, 64, 12, 3)
    tallies, total = run(tmp_path, 0, 0)
    assert set(tallies) == {f"{name}.map" for name in drawn_maps(16, np.random.default_rng(0))}
    assert len(total.grid_ratios) == 12 * len(tallies)
    assert (total.missed, total.wrong, total.failures) == (0, 0, [])
    # Lengths of steps are rounded: 24 / 17 for the square root of 2.
    assert max(total.grid_ratios) <= 1.002
    assert max(total.smooth_ratios) <= 1.002


def test_water_is_left_by_water_only(tmp_path: Path) -> None:
    (tmp_path / "a.map").write_text("type octile\nheight 2\nwidth 4\nmap\n.WWW\n....\n")
    queries = [Query("a.map", (1, 0), (3, 0), 2.0), Query("a.map", (0, 0), (3, 1), 3.41421356)]
    write_scen(tmp_path / "a.scen", queries, (2, 4))
    _, total = run(tmp_path, 0, 0)
    assert (total.missed, total.wrong, len(total.grid_ratios)) == (0, 0, 2)
    write_scen(tmp_path / "a.scen", [Query("a.map", (1, 0), (1, 1), 1.0)], (2, 4))
    _, total = run(tmp_path, 0, 0)
    assert total.missed == 1


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
    assert ["line 2" in total.failures[0], "line 4" in total.failures[1]] == [True, True]
