"""Files and folders that survive a cut of the power."""

import os
import socket
from pathlib import Path

import pytest

from trolley.files import make_folder, open_file, read_file, read_text, write_atomically


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


def test_only_regular_files_are_read(tmp_path: Path) -> None:
    """Reading a pipe that nobody writes to, or /dev/zero, would never end."""
    pipe, bound = tmp_path / "pipe", tmp_path / "socket"
    os.mkfifo(pipe)
    with socket.socket(socket.AF_UNIX) as channel:
        channel.bind(str(bound))
        for path in (pipe, bound, Path("/dev/zero"), Path("/dev/null"), tmp_path):
            for read in (open_file, read_file, read_text):
                with pytest.raises(OSError, match=r"pipe or a device|directory|No such device"):
                    read(path)


def test_a_file_is_read_whole_up_to_a_size(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes("Küche".encode())
    link = tmp_path / "link"
    link.symlink_to(path)
    assert read_text(link) == "Küche"
    assert read_file(path, 6) == path.read_bytes()
    with pytest.raises(OSError, match="large"):
        read_file(path, 5)
    with open_file(path) as file:
        assert os.get_blocking(file.fileno()) is False
        assert file.read(2) == "K\u00fc".encode()[:2]
