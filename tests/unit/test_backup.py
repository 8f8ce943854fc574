"""Backups: whole, consistent, and nothing foreign put in place."""

import contextlib
import errno
import io
import os
import shutil
import sqlite3
import tarfile
from collections.abc import Callable
from contextlib import closing
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from support.cases import cases

from trolley import backup
from trolley.backup import MANIFEST, BackupError, Manifest, Unpacked, save
from trolley.cli import cli
from trolley_tour.trips import photo_files

NOW = datetime(2026, 3, 1, 12, 0, 0, tzinfo=UTC)
MADE = Manifest(format=1, made_at="2026-03-01T12:00:00+00:00", version="0.1.0")
HEAD = 'format = 1\nmade_at = "2026-03-01"\nversion = "0.1.0"\n'
ROBOT = '[robot]\nname = "anna"\nfootprint = {radius_m = 0.2}\n'
MAP = "image: home.pgm\nresolution: 0.05\norigin: [0, 0, 0]\nnegate: 0\n"
MAP += "occupied_thresh: 0.65\nfree_thresh: 0.196\n"


def fill(state: Path) -> None:
    """The state of a robot that has been used."""
    (state / "anna" / "zones").mkdir(parents=True)
    (state / "maps").mkdir()
    (state / "anna" / "poses.toml").write_text("[kitchen]\nx = 1.0\n")
    (state / "anna" / "zones" / "home.toml").write_text("zones = []\n")
    (state / "anna" / "viewer_access.toml").write_text('operator = "secret"\n')
    (state / "anna" / "viewer_access.toml").chmod(0o600)
    (state / "anna" / "settings.toml").write_text("[set]\n[instead_of]\n")
    (state / "maps" / "shed.yaml").write_text(MAP)
    (state / "anna" / ".poses.toml.x7").write_text("half written")
    with closing(sqlite3.connect(state / "anna" / "history.sqlite")) as database:
        database.execute("CREATE TABLE trips (name TEXT)")
        database.execute("INSERT INTO trips VALUES ('evening')")
        database.commit()
    for path in state.rglob("*"):
        os.utime(path, (1_600_000_000, 1_600_000_000))


def files(folder: Path) -> dict[str, bytes]:
    """What lies in a folder."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def archive(path: Path, entries: dict[str, bytes | tarfile.TarInfo]) -> Path:
    """An archive as somebody else might make it."""
    with tarfile.open(path, "w:gz") as tar:
        for name, content in entries.items():
            entry = content if isinstance(content, tarfile.TarInfo) else tarfile.TarInfo(name)
            data = b"" if isinstance(content, tarfile.TarInfo) else content
            entry.size = len(data)
            tar.addfile(entry, io.BytesIO(data))
    return path


def test_all_comes_back_as_it_was(tmp_path: Path) -> None:
    state, config = tmp_path / "state", tmp_path / "etc" / "robot.toml"
    fill(state)
    (config.parent / "maps").mkdir(parents=True)
    config.write_text(ROBOT + '[map]\nfile = "maps/home.yaml"\n')
    (config.parent / "maps" / "home.yaml").write_text(MAP)
    (config.parent / "maps" / "home.pgm").write_bytes(b"P5 1 1 255\n\0")
    (config.parent / "maps" / "home.zones.toml").write_text("zones = []\n")
    saved = save(tmp_path / "b.tar.gz", state, config, MADE)
    assert (saved.num_files, saved.left_out) == (10, [])
    assert (tmp_path / "b.tar.gz").stat().st_mode & 0o777 == 0o600

    other, settings_file = tmp_path / "new" / "state", tmp_path / "new" / "etc" / "robot.toml"
    unpacked = Unpacked(tmp_path / "b.tar.gz", other)
    assert unpacked.put_state(other, NOW) is None
    assert unpacked.put_config(settings_file, NOW) == []
    unpacked.close()
    before, after = files(state), files(other)
    del before["anna/.poses.toml.x7"]
    # A database is copied page by page; what counts is what it holds.
    assert after.pop("anna/history.sqlite")
    del before["anna/history.sqlite"]
    assert after == before
    assert files(settings_file.parent) == files(config.parent)
    assert (other / "anna" / "viewer_access.toml").stat().st_mode & 0o777 == 0o600
    with closing(sqlite3.connect(other / "anna" / "history.sqlite")) as database:
        assert database.execute("SELECT name FROM trips").fetchall() == [("evening",)]
    assert sorted(path.name for path in (tmp_path / "new").iterdir()) == ["etc", "state"]


def test_a_database_that_is_being_written_is_saved_as_before_or_after(tmp_path: Path) -> None:
    fill(tmp_path / "state")
    history = tmp_path / "state" / "anna" / "history.sqlite"
    with closing(sqlite3.connect(history)) as writer:
        writer.execute("BEGIN IMMEDIATE")
        writer.execute("INSERT INTO trips VALUES ('not yet')")
        saved = save(tmp_path / "b.tar.gz", tmp_path / "state", None, MADE)
        writer.commit()
    assert saved.left_out == []
    unpacked = Unpacked(tmp_path / "b.tar.gz", tmp_path / "other")
    unpacked.put_state(tmp_path / "other", NOW)
    with closing(sqlite3.connect(tmp_path / "other" / "anna" / "history.sqlite")) as database:
        assert database.execute("SELECT name FROM trips").fetchall() == [("evening",)]


def _photos(state: Path) -> list[Path]:
    """Three photos of a trip; the first is the newest."""
    folder = state / "anna" / "photos"
    folder.mkdir(parents=True)
    found = [folder / f"trip-{number}.jpg" for number in range(3)]
    for age, path in enumerate(found):
        path.write_bytes(b"\xff\xd8\xff" + path.name.encode())
        os.utime(path, (1_700_000_000.25 - age, 1_700_000_000.25 - age))
    return found


def test_photos_of_stops_come_back_with_their_age(tmp_path: Path) -> None:
    state, other = tmp_path / "state", tmp_path / "other"
    fill(state)
    photos = _photos(state)
    save(tmp_path / "b.tar.gz", state, None, MADE)
    unpacked = Unpacked(tmp_path / "b.tar.gz", other)
    unpacked.put_state(other, NOW)
    for path in photos:
        restored = other / path.relative_to(state)
        assert restored.read_bytes() == path.read_bytes()
        assert restored.stat().st_mtime == path.stat().st_mtime
    # So the oldest still make room for new ones.
    photo_files.keep(other / "anna", "new-0", b"\xff\xd8\xff", 2 * len(photos[0].read_bytes()))
    assert photo_files.names(other / "anna") == {"new-0", "trip-0"}


def test_what_a_backup_cannot_hold_is_the_oldest_photos_and_it_can_be_restored(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    state = tmp_path / "state"
    fill(state)
    _photos(state)
    whole = save(tmp_path / "whole.tar.gz", state, None, MADE)
    monkeypatch.setattr(backup, "MAX_FILES", whole.num_files - 2)
    saved = save(tmp_path / "b.tar.gz", state, None, MADE)
    assert saved.num_files == whole.num_files - 2
    (sentence,) = saved.left_out
    assert sentence.startswith("2 photos were left out, the oldest: a backup holds")
    Unpacked(tmp_path / "b.tar.gz", tmp_path / "other").put_state(tmp_path / "other", NOW)
    assert photo_files.names(tmp_path / "other" / "anna") == {"trip-0"}
    monkeypatch.setattr(backup, "MAX_FILES", 2)
    with pytest.raises(BackupError, match="does not fit: a backup holds 2 files"):
        save(tmp_path / "c.tar.gz", state, None, MADE)
    assert not (tmp_path / "c.tar.gz").exists()


@pytest.mark.parametrize("when", ["inf", "nan", "1e300", "-5", "9e18"])
def test_a_time_that_cannot_be_harms_nothing(tmp_path: Path, when: str) -> None:
    entry = tarfile.TarInfo("state/anna/photos/a.jpg")
    entry.pax_headers = {"mtime": when}
    path = archive(tmp_path / "b.tar.gz", {MANIFEST: HEAD.encode(), entry.name: entry})
    unpacked = Unpacked(path, tmp_path / "state")
    unpacked.put_state(tmp_path / "state", NOW)
    assert (tmp_path / "state" / "anna" / "photos" / "a.jpg").is_file()


def test_what_was_there_is_kept(tmp_path: Path) -> None:
    state, config = tmp_path / "state", tmp_path / "robot.toml"
    fill(state)
    config.write_text(ROBOT)
    save(tmp_path / "b.tar.gz", state, config, MADE)
    (state / "anna" / "poses.toml").write_text("[cellar]\nx = 2.0\n")
    config.write_text(ROBOT.replace("anna", "berta"))
    config.chmod(0o640)
    old_config = tmp_path / "robot.toml.before-20260301-120000"
    for name, changed in [("20260301-120000", [old_config]), ("20260301-120000-2", [])]:
        unpacked = Unpacked(tmp_path / "b.tar.gz", state)
        assert unpacked.put_state(state, NOW) == tmp_path / f"state.before-{name}"
        assert unpacked.put_config(config, NOW) == changed
        unpacked.close()
    assert "cellar" in (tmp_path / "state.before-20260301-120000/anna/poses.toml").read_text()
    assert "kitchen" in (state / "anna" / "poses.toml").read_text()
    assert "berta" in old_config.read_text()
    assert config.stat().st_mode & 0o777 == 0o640


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give files away")
def test_a_restored_robot_toml_stays_with_the_group_that_may_read_it(tmp_path: Path) -> None:
    state, config = tmp_path / "state", tmp_path / "robot.toml"
    fill(state)
    config.write_text(ROBOT)
    save(tmp_path / "b.tar.gz", state, config, MADE)
    config.write_text(ROBOT.replace("anna", "berta"))
    config.chmod(0o640)
    os.chown(config, 0, 12345)
    Unpacked(tmp_path / "b.tar.gz", state).put_config(config, NOW)
    about = config.stat()
    assert (about.st_gid, about.st_mode & 0o777) == (12345, 0o640)


class PowerCut(BaseException):
    """Nothing runs any more."""


def cut_at(step: int, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Cut the power before the nth change of a name; returns what is done until then."""
    done: list[str] = []

    def cutting(name: str, act: Callable[..., Any]) -> Callable[..., Any]:
        def cut_or_act(*paths: Path) -> Any:
            if len(done) == step:
                raise PowerCut
            done.append(name)
            return act(*paths)

        return cut_or_act

    monkeypatch.setattr(Path, "rename", cutting("rename", Path.rename))
    monkeypatch.setattr(backup, "exchange", cutting("exchange", backup.exchange))
    return done


def test_wherever_the_power_is_cut_the_old_or_the_new_state_is_in_place(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    state = tmp_path / "state"
    fill(state)
    save(tmp_path / "b.tar.gz", state, None, MADE)
    (state / "anna" / "poses.toml").write_text("[cellar]\nx = 2.0\n")
    old, found = files(state), list[str]()
    for step in range(10):
        unpacked = Unpacked(tmp_path / "b.tar.gz", state)
        with monkeypatch.context() as patch:
            done = cut_at(step, patch)
            with contextlib.suppress(PowerCut):
                unpacked.put_state(state, NOW)
        assert state.is_dir(), done
        is_new = "kitchen" in (state / "anna" / "poses.toml").read_text()
        found.append("new" if is_new else "old")
        if is_new or len(done) < step:
            break
        assert files(state) == old
    assert found == ["old", "old", "new"]
    (aside,) = [path for path in tmp_path.glob("state.before-*") if files(path) == old]
    assert files(state).keys() < files(aside).keys()


def test_where_two_names_cannot_be_swapped_they_change_one_after_the_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    state = tmp_path / "state"
    fill(state)
    save(tmp_path / "b.tar.gz", state, None, MADE)
    old = files(state)

    def refuse(*_: Path) -> None:
        raise OSError(errno.EINVAL, "no such step")

    monkeypatch.setattr(backup, "exchange", refuse)
    aside = Unpacked(tmp_path / "b.tar.gz", state).put_state(state, NOW)
    assert aside is not None
    assert files(aside) == old
    assert "anna/poses.toml" in files(state)


def test_what_cannot_be_taken_along_is_told(tmp_path: Path) -> None:
    state, config = tmp_path / "state", tmp_path / "etc" / "robot.toml"
    fill(state)
    config.parent.mkdir()
    (tmp_path / "elsewhere.yaml").write_text(MAP)
    config.write_text(ROBOT + f'mesh = "gone.glb"\n[map]\nfile = "{tmp_path}/elsewhere.yaml"\n')
    (state / "anna" / "passwd").symlink_to("/etc/passwd")
    (state / "anna" / "history.sqlite").write_bytes(b"no database at all, but kept anyway" * 40)
    saved = save(tmp_path / "b.tar.gz", state, config, MADE)
    said = "\n".join(saved.left_out)
    assert len(saved.left_out) == 4
    for part in (
        "passwd is not a regular file",
        "elsewhere.yaml was left out",
        "gone.glb",
        "as it is",
    ):
        assert part in said
    with tarfile.open(tmp_path / "b.tar.gz") as tar:
        history = tar.extractfile("state/anna/history.sqlite")
        assert history is not None
        assert history.read().startswith(b"no database at all")
        assert "state/anna/passwd" not in tar.getnames()


def test_what_lies_in_the_state_by_chance_does_not_keep_a_backup_from_being_restored(
    tmp_path: Path,
) -> None:
    state = tmp_path / "state"
    fill(state)
    before = files(state)
    (state / "notes.txt").write_text("an owner's own")
    (state / "Old Robot").mkdir()
    (state / "Old Robot" / "poses.toml").write_text("")
    Path(os.fsdecode(bytes(state / "anna") + b"/caf\xe9.toml")).write_text("")  # not UTF-8
    saved = save(tmp_path / "b.tar.gz", state, None, MADE)
    assert len(saved.left_out) == 3
    assert all(
        "does not belong to a robot's state and was left out" in one for one in saved.left_out
    )
    unpacked = Unpacked(tmp_path / "b.tar.gz", tmp_path / "back")
    unpacked.put_state(tmp_path / "back", NOW)
    unpacked.close()
    del before["anna/.poses.toml.x7"]
    assert files(tmp_path / "back").keys() == before.keys()


def test_a_robot_toml_that_cannot_be_restored_is_told_with_what_was(tmp_path: Path) -> None:
    etc, state = tmp_path / "etc", tmp_path / "state"
    fill(state)
    (etc / "maps").mkdir(parents=True)
    (etc / "maps" / "home.yaml").write_text(MAP)
    config = etc / "robot.toml"
    nobody = '[zenoh]\nconnect = ["tcp/127.0.0.1:1"]\n'
    config.write_text(f'{ROBOT}{nobody}[map]\nfile = "maps/home.yaml"\n')
    save(tmp_path / "b.tar.gz", state, config, MADE)
    shutil.rmtree(etc / "maps")
    (etc / "maps").write_text("in the way")
    words = ["restore", str(tmp_path / "b.tar.gz"), "--config", str(config), "--state", str(state)]
    result = CliRunner().invoke(cli, words)
    assert result.exit_code == 1
    assert f"{etc} cannot be written" in result.output
    assert "The state has been restored" in result.output
    (aside,) = tmp_path.glob("state.before-*")
    assert str(aside) in result.output.replace("\n", "")


def test_the_state_comes_back_whatever_the_robot_toml_of_the_backup_says(tmp_path: Path) -> None:
    etc, state = tmp_path / "etc", tmp_path / "state"
    fill(state)
    etc.mkdir()
    (etc / "robot.toml").write_text(ROBOT + "not_known_here = 1\n")
    save(tmp_path / "b.tar.gz", state, etc / "robot.toml", MADE)
    words = ["restore", str(tmp_path / "b.tar.gz"), "--state", str(tmp_path / "back")]
    words += ["--config", str(tmp_path / "robot.toml")]
    refused = CliRunner().invoke(cli, words)
    assert refused.exit_code == 1
    assert "cannot be used here: [robot] unknown key `not_known_here`" in refused.output
    assert "; --state-only restores the rest" in refused.output
    result = CliRunner().invoke(cli, [*words, "--state-only"])
    assert result.exit_code == 0
    assert (tmp_path / "back" / "anna" / "poses.toml").is_file()


@pytest.mark.parametrize(("name", "is_told"), [("plum", True), ("anna", False)])
def test_the_state_of_another_robot_is_restored_with_a_word(
    tmp_path: Path, name: str, is_told: bool
) -> None:
    fill(tmp_path / "state")
    save(tmp_path / "b.tar.gz", tmp_path / "state", None, MADE)
    config = tmp_path / "robot.toml"
    config.write_text(ROBOT.replace("anna", name) + '[zenoh]\nconnect = ["tcp/127.0.0.1:1"]\n')
    words = ["restore", str(tmp_path / "b.tar.gz"), "--state", str(tmp_path / "back")]
    result = CliRunner().invoke(cli, [*words, "--config", str(config)])
    assert result.exit_code == 0
    assert ("This is the state of anna" in result.output) == is_told
    assert (f"names the robot {name}" in result.output) == is_told


def test_of_several_folders_none_is_named_to_be_renamed(tmp_path: Path) -> None:
    fill(tmp_path / "state")
    for name in ("aaron", "Not a robot"):
        (tmp_path / "state" / name).mkdir()
        (tmp_path / "state" / name / "poses.toml").write_text("")
    save(tmp_path / "b.tar.gz", tmp_path / "state", None, MADE)
    config = tmp_path / "robot.toml"
    config.write_text(ROBOT.replace("anna", "plum") + '[zenoh]\nconnect = ["tcp/127.0.0.1:1"]\n')
    words = ["restore", str(tmp_path / "b.tar.gz"), "--state", str(tmp_path / "back")]
    result = CliRunner().invoke(cli, [*words, "--config", str(config)])
    assert "This is the state of aaron, anna, but" in result.output
    assert "rename one of them to plum" in result.output


def test_a_state_folder_may_be_named_from_the_present_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fill(tmp_path / "state")
    monkeypatch.chdir(tmp_path)
    assert save(Path("b.tar.gz"), Path("state"), None, MADE).left_out == []
    with tarfile.open("b.tar.gz") as tar:
        assert "state/anna/history.sqlite" in tar.getnames()


def test_a_backup_that_cannot_be_written_leaves_nothing(tmp_path: Path) -> None:
    fill(tmp_path / "state")
    with pytest.raises(BackupError, match="cannot be written"):
        save(tmp_path / "gone" / "b.tar.gz", tmp_path / "state", None, MADE)
    (tmp_path / "state" / "anna" / "poses.toml").unlink()
    (tmp_path / "state" / "anna" / "poses.toml").mkdir()
    assert save(tmp_path / "b.tar.gz", tmp_path / "state", None, MADE).num_files == 5


def link(kind: bytes) -> tarfile.TarInfo:
    """An entry that points elsewhere."""
    entry = tarfile.TarInfo("state/anna/poses.toml")
    entry.type, entry.linkname = kind, "/etc/shadow"
    return entry


@pytest.mark.parametrize(
    ("entries", "said"),
    [
        ({"state/anna/poses.toml": b""}, "not made by"),
        ({MANIFEST: b"format = 9", "state/x": b""}, "not made by"),
        ({MANIFEST: HEAD.replace("1\n", "2\n", 1).encode()}, "newer"),
        ({MANIFEST: (HEAD.replace("1\n", "2\n", 1) + 'host = "anna"').encode()}, "newer"),
        ({MANIFEST: HEAD.encode(), "state/../../etc/passwd": b""}, "no backup contains"),
        ({MANIFEST: HEAD.encode(), "/etc/passwd": b""}, "no backup contains"),
        ({MANIFEST: HEAD.encode(), "state/Not A Robot/poses.toml": b""}, "no backup contains"),
        ({MANIFEST: HEAD.encode(), "photos/cat.jpg": b""}, "no backup contains"),
        ({MANIFEST: HEAD.encode(), "state//anna": b""}, "no backup contains"),
        ({MANIFEST: HEAD.encode(), "l": link(tarfile.SYMTYPE)}, "no backup contains"),
        ({MANIFEST: HEAD.encode(), "l": link(tarfile.LNKTYPE)}, "no backup contains"),
        ({MANIFEST: HEAD.encode(), "l": link(tarfile.CHRTYPE)}, "no backup contains"),
        ({MANIFEST: HEAD.encode(), "state/a": b"", "state/a/b": b""}, "cannot be unpacked"),
        ({MANIFEST: HEAD.encode(), "config/robot.toml": b"[robot]\nname = 7"}, "robot.toml"),
        ({}, "is empty"),
    ],
)
def test_what_is_no_backup_changes_nothing(
    tmp_path: Path, entries: dict[str, bytes | tarfile.TarInfo], said: str
) -> None:
    fill(tmp_path / "state")
    before = files(tmp_path / "state")
    path = archive(tmp_path / "x.tar.gz", entries)
    with pytest.raises(BackupError, match=said):
        Unpacked(path, tmp_path / "state")
    assert files(tmp_path / "state") == before
    assert sorted(one.name for one in tmp_path.iterdir()) == ["state", "x.tar.gz"]


def test_the_same_file_twice_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "x.tar.gz"
    with tarfile.open(path, "w:gz") as tar:
        for name, content in [(MANIFEST, HEAD), ("state/anna/a", "1"), ("state/anna/a", "2")]:
            entry = tarfile.TarInfo(name)
            entry.size = len(content)
            tar.addfile(entry, io.BytesIO(content.encode()))
    with pytest.raises(BackupError, match="exists"):
        Unpacked(path, tmp_path / "state")


@settings(max_examples=cases(60), deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(data=st.data())
def test_a_damaged_backup_is_refused_or_whole(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    folder = tmp_path_factory.mktemp("damaged")
    fill(folder / "state")
    save(folder / "b.tar.gz", folder / "state", None, MADE)
    content = bytearray((folder / "b.tar.gz").read_bytes())
    if data.draw(st.booleans(), "cut"):
        del content[data.draw(st.integers(0, len(content) - 1)) :]
    else:
        content[data.draw(st.integers(0, len(content) - 1))] ^= data.draw(st.integers(1, 255))
    (folder / "b.tar.gz").write_bytes(content)
    try:
        unpacked = Unpacked(folder / "b.tar.gz", folder / "other")
    except BackupError:
        assert sorted(one.name for one in folder.iterdir()) == ["b.tar.gz", "state"]
        return
    unpacked.put_state(folder / "other", NOW)
    unpacked.close()
    poses = (folder / "other" / "anna" / "poses.toml").read_text()
    assert poses == (folder / "state" / "anna" / "poses.toml").read_text()
