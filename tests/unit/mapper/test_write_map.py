"""A map is written whole, and the one of before is kept, whenever the power fails."""

from pathlib import Path

import numpy as np

from trolley.geometry import Pose2D
from trolley.gridmap import GridMap, load_map
from trolley.messages import Zone
from trolley_mapper.edit.map_versions import write_map


def grid(width: int) -> GridMap:
    """A map that is told from others by its width; its origin goes with it."""
    cells = np.zeros((4, width), np.int8)
    cells[1, 1] = 100
    return GridMap("map", 0.05, Pose2D(-float(width), 0.0, 0.0), cells)


def check(folder: Path, *widths: int) -> None:
    """The map is one of these, with the origin that belongs to it."""
    found = load_map(folder / "home.yaml")
    assert found.cols in widths
    assert found.origin.x == -float(found.cols)


def test_a_new_map_is_two_files(tmp_path: Path) -> None:
    assert write_map(tmp_path / "maps", "home", grid(5)) is None
    assert {one.name for one in (tmp_path / "maps").iterdir()} == {"home.yaml", "home.pgm"}
    check(tmp_path / "maps", 5)


def test_what_was_there_before_is_kept(tmp_path: Path) -> None:
    for width in range(5, 8):
        assert write_map(tmp_path, "home", grid(width)) is None
    check(tmp_path, 7)
    kept = (tmp_path / "versions" / "home").glob("*.yaml")
    assert sorted(load_map(one).cols for one in kept) == [5, 6]


def test_zones_go_along(tmp_path: Path) -> None:
    zone = Zone(name="stairs", kind="speed", points=[(0.0, 0.0), (1.0, 0.0), (1.0, 1.0)], speed=0.2)
    assert write_map(tmp_path, "home", grid(5), [zone]) is None
    text = (tmp_path / "home.zones.toml").read_text()
    assert 'name = "stairs"' in text
    assert "speed = 0.2" in text


def test_zones_that_cannot_be_read_are_no_reason_to_lose_a_map(tmp_path: Path) -> None:
    maps = tmp_path / "maps"
    assert write_map(maps, "home", grid(5)) is None
    (maps / "home.zones.toml").write_text("[[zone]\nname = 1")
    assert write_map(maps, "home", grid(6), state=tmp_path / "trolley") is None
    check(maps, 6)


def test_a_new_map_has_no_zones_of_an_older_one_that_was_deleted(tmp_path: Path) -> None:
    maps, stored = tmp_path / "maps", tmp_path / "trolley/zones"
    stored.mkdir(parents=True)
    zone = Zone(name="stairs", kind="speed", points=[(0.0, 0.0), (1.0, 0.0), (1.0, 1.0)], speed=0.2)
    assert write_map(maps, "home", grid(5), [zone]) is None
    seeds = (maps / "home.zones.toml").read_text()
    (stored / "home.toml").write_text(seeds)
    assert write_map(maps, "home", grid(6)) is None
    assert (stored / "home.toml").exists()  # which is the same map, extended
    (maps / "home.yaml").unlink()
    assert write_map(maps, "home", grid(7)) is None
    assert not (stored / "home.toml").exists()
    assert not (maps / "home.zones.toml").exists()
    (kept,) = stored.iterdir()
    assert kept.name.startswith("home.toml.former-")
    assert kept.read_text() == seeds


def test_a_folder_that_cannot_be_written_is_said(tmp_path: Path) -> None:
    (tmp_path / "maps").write_text("in the way")
    problem = write_map(tmp_path / "maps", "home", grid(5))
    assert problem is not None
    assert problem.startswith("The map could not be written")
