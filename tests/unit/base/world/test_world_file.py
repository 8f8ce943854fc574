"""Reading a world and its map from disk."""

from pathlib import Path

import pytest

from trolley_base.world import WorldError
from trolley_base.world.world_file import load_world


def test_a_world_comes_with_its_map(worlds: Path) -> None:
    world = load_world(worlds / "room.toml")
    assert (world.name, world.grid.name) == ("room", "room")
    assert world.map_file == worlds / "room.yaml"


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(WorldError, match=r"none\.toml: cannot be read"):
        load_world(tmp_path / "none.toml")


def test_a_missing_map_is_named_with_the_world(tmp_path: Path) -> None:
    file = tmp_path / "flat.toml"
    file.write_text('map = "flat.yaml"\nstart = {x = 0, y = 0, yaw = 0}\n')
    with pytest.raises(WorldError, match=r"flat\.toml: map: .*flat\.yaml"):
        load_world(file)
