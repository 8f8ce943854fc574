"""State files: readable, whole or not at all, never overwritten when broken."""

import stat
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import msgspec
import pytest

from trolley.files import write_atomically
from trolley.messages import SavedPose
from trolley.runtime.log import Log
from trolley.runtime.state import StateFolder, state_root


class Notes(msgspec.Struct):
    """Something to keep."""

    name: str
    number: float = 0.0
    place: SavedPose | None = None
    places: list[SavedPose] = []


@pytest.fixture
def folder(tmp_path: Path) -> StateFolder:
    return StateFolder(tmp_path / "robot", Log("test"))


def test_what_is_written_is_read(folder: StateFolder):
    pose = msgspec.convert({"x": 0.1, "y": -2.0, "yaw": 3.0}, SavedPose.__annotations__["pose"])
    notes = Notes(name="Küche", number=0.1, places=[SavedPose(name="a", pose=pose)])
    folder.write("notes.toml", notes)
    assert folder.read("notes.toml", Notes) == notes
    assert 'name = "Küche"' in (folder.path / "notes.toml").read_text("utf-8")
    assert [file.name for file in folder.path.iterdir()] == ["notes.toml"]
    assert stat.S_IMODE((folder.path / "notes.toml").stat().st_mode) == 0o644


def test_a_mark_that_windows_editors_put_first_is_not_read(folder: StateFolder):
    folder.write("notes.toml", Notes(name="a"))
    file = folder.path / "notes.toml"
    file.write_bytes(b"\xef\xbb\xbf" + file.read_bytes().replace(b"\n", b"\r\n"))
    assert folder.read("notes.toml", Notes) == Notes(name="a")


def test_nothing_is_read_where_nothing_is(folder: StateFolder):
    assert folder.read("notes.toml", Notes) is None


@pytest.mark.parametrize(
    "content",
    [b"name = ", b"\xff\xfe", b'name = "a"\nnumber = "b"', b"number = 1", b"a = " + b"[" * 100_000,
     b"number = " + b"9" * 5000, b""],
)  # fmt: skip
def test_a_broken_file_is_kept_aside(folder: StateFolder, content: bytes):
    folder.path.mkdir()
    for _ in range(3):  # within one second, too
        (folder.path / "notes.toml").write_bytes(content)
        assert folder.read("notes.toml", Notes) is None
    kept = list(folder.path.iterdir())
    assert len(kept) == 3
    assert all(file.name.startswith("notes.toml.broken-") for file in kept)
    assert all(file.read_bytes() == content for file in kept)


def test_a_file_that_cannot_be_opened_is_kept_aside(folder: StateFolder):
    (folder.path / "notes.toml" / "inside").mkdir(parents=True)
    assert folder.read("notes.toml", Notes) is None
    folder.write("notes.toml", Notes(name="new"))
    assert len(list(folder.path.iterdir())) == 2


def test_a_file_that_cannot_even_be_kept_aside_stays(folder: StateFolder, monkeypatch):
    folder.path.mkdir()
    (folder.path / "notes.toml").write_text("broken")

    def refuse(*_: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "rename", refuse)
    assert folder.read("notes.toml", Notes) is None
    assert (folder.path / "notes.toml").read_text() == "broken"
    assert "neither read nor set aside" in folder.problems["notes.toml"]
    with pytest.raises(PermissionError):
        folder.write("notes.toml", Notes(name="new"))
    assert (folder.path / "notes.toml").read_text() == "broken"
    monkeypatch.undo()
    folder.write("notes.toml", Notes(name="new"))
    folder.write("notes.toml", Notes(name="newer"))
    (aside,) = folder.path.glob("notes.toml.broken-*")
    assert aside.read_text() == "broken"


class OtherNotes(msgspec.Struct):
    """What notes have become."""

    SCHEMA = 2

    title: str

    @classmethod
    def bring_forward(cls, plain: dict[str, Any], schema: int) -> dict[str, Any]:
        return {"title": plain["name"]}


def test_an_original_that_found_no_room_is_kept_before_it_is_overwritten(
    folder: StateFolder, monkeypatch
):
    folder.write("notes.toml", Notes(name="old"))
    before = (folder.path / "notes.toml").read_bytes()

    def fail(*_: object) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr("os.fsync", fail)
        assert folder.read("notes.toml", OtherNotes) == OtherNotes("old")
        with pytest.raises(OSError, match="No space"):
            folder.write("notes.toml", OtherNotes("new"))
    assert (folder.path / "notes.toml").read_bytes() == before
    folder.write("notes.toml", OtherNotes("new"))
    assert (folder.path / "notes.toml.schema-1").read_bytes() == before


def test_a_failed_write_leaves_the_old_content(folder: StateFolder, monkeypatch):
    folder.write("notes.toml", Notes(name="old"))

    def fail(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", fail)
    with pytest.raises(OSError, match="No space"):
        folder.write("notes.toml", Notes(name="new"))
    monkeypatch.undo()
    assert folder.read("notes.toml", Notes) == Notes(name="old")
    assert len(list(folder.path.iterdir())) == 1


@pytest.mark.programs
def test_a_kill_in_between_leaves_one_content_whole(tmp_path: Path):
    """SIGKILL at any moment: the file holds all of one version or all of another."""
    file = tmp_path / "state"
    write_atomically(file, b"a" * 200_000)
    program = (
        "import sys, pathlib, itertools\n"
        "from trolley.files import write_atomically\n"
        "print(flush=True)\n"
        "for letter in itertools.cycle(b'abcdefgh'):\n"
        "    write_atomically(pathlib.Path(sys.argv[1]), bytes([letter]) * 200_000)\n"
    )
    for i in range(6):
        with subprocess.Popen(
            [sys.executable, "-c", program, str(file)], stdout=subprocess.PIPE
        ) as writer:
            assert writer.stdout is not None
            writer.stdout.readline()
            time.sleep(0.003 + 0.004 * i)
            writer.kill()
        content = file.read_bytes()
        assert len(content) == 200_000
        assert content == content[:1] * 200_000


@pytest.mark.parametrize(
    ("variables", "expected"),
    [
        ({"TROLLEY_STATE": "/a", "STATE_DIRECTORY": "/b"}, "/a"),
        ({"STATE_DIRECTORY": "/b:/c"}, "/b"),
        ({"XDG_STATE_HOME": "/x"}, "/x/trolley"),
        ({"HOME": "/home/me"}, "/home/me/.local/state/trolley"),
        ({"HOME": "/home/me", "XDG_STATE_HOME": "~/state"}, "/home/me/.local/state/trolley"),
    ],
)
def test_the_state_folder_is_named_by_the_environment(
    monkeypatch: pytest.MonkeyPatch, variables: dict[str, str], expected: str
):
    for name in ("TROLLEY_STATE", "STATE_DIRECTORY", "XDG_STATE_HOME"):
        monkeypatch.delenv(name, raising=False)
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    assert state_root() == Path(expected)


def test_a_command_on_an_installed_robot_finds_the_state_of_its_services(
    monkeypatch: pytest.MonkeyPatch,
):
    for name in ("TROLLEY_STATE", "STATE_DIRECTORY"):
        monkeypatch.delenv(name, raising=False)
    assert state_root(Path("/etc/trolley/robot.toml")) == Path("/var/lib/trolley")
    monkeypatch.setenv("XDG_STATE_HOME", "/x")
    assert state_root(Path("/home/me/robot.toml")) == Path("/x/trolley")
    monkeypatch.setenv("TROLLEY_STATE", "/a")
    assert state_root(Path("/etc/trolley/robot.toml")) == Path("/a")
