"""Where worlds are found."""

from pathlib import Path

import pytest

from trolley import worlds


def test_the_apartment_ships_with_trolley() -> None:
    assert worlds.find("apartment.toml") == worlds.folder() / "apartment.toml"


def test_a_world_that_ships_may_be_called_by_its_name_alone() -> None:
    assert worlds.find("house") == worlds.folder() / "house.toml"
    with pytest.raises(FileNotFoundError, match="there is no file castle"):
        worlds.find("castle")


def test_a_file_beside_the_configuration_comes_first(tmp_path: Path) -> None:
    (tmp_path / "apartment.toml").write_text("")
    assert worlds.find("apartment.toml", beside=tmp_path) == tmp_path / "apartment.toml"
    assert worlds.find(tmp_path / "apartment.toml") == tmp_path / "apartment.toml"


def test_the_folder_can_be_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TROLLEY_WORLDS", str(tmp_path))
    with pytest.raises(FileNotFoundError, match=str(tmp_path)):
        worlds.find("apartment.toml", beside=tmp_path)
