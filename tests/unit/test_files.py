"""Files and folders that survive a cut of the power."""

import os
from pathlib import Path

import pytest

from trolley.files import make_folder, write_atomically


@pytest.fixture
def synced(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """What is synced, by its path."""
    paths: list[str] = []
    sync = os.fsync

    def note(handle: int) -> None:
        paths.append(os.readlink(f"/proc/self/fd/{handle}"))
        sync(handle)

    monkeypatch.setattr(os, "fsync", note)
    return paths


def test_each_new_folder_is_synced_into_the_one_above(tmp_path: Path, synced: list[str]) -> None:
    make_folder(tmp_path / "state" / "robot")
    assert synced == [str(tmp_path), str(tmp_path / "state")]
    make_folder(tmp_path / "state" / "robot")
    assert len(synced) == 2


def test_a_file_in_the_way_of_a_folder_is_told(tmp_path: Path) -> None:
    (tmp_path / "state").write_text("a file")
    with pytest.raises(OSError, match="state"):
        make_folder(tmp_path / "state" / "robot")


def test_content_is_synced_before_its_name(tmp_path: Path, synced: list[str]) -> None:
    write_atomically(tmp_path / "one.toml", b"new")
    assert len(synced) == 2
    assert Path(synced[0]).name.startswith(".one.toml.")
    assert synced[1] == str(tmp_path)
