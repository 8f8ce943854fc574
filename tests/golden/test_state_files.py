"""What was saved is read by every later release, and no form changes unnoticed.

`state/unmarked` was written by Trolley as it was before its files told a schema. `state/forms`
holds the form of each file by schema; `TROLLEY_RENEW_GOLDEN=1 pytest tests/golden` writes those
that are missing.
"""

import json
import os
import shutil
import sqlite3
import tomllib
from contextlib import closing
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
import pytest

from trolley.config.kept_settings import KeptSettings
from trolley.geometry import Pose2D
from trolley.geometry.pose import LARGEST
from trolley.gridmap import GridMap
from trolley.runtime.log import Log
from trolley.runtime.state import StateFolder
from trolley.state_file import schema_of
from trolley.zones import ZoneFile
from trolley_base.persistence import SavedLatch, SavedTime, SavedWorld
from trolley_base.settings_keeper import SavedSettings
from trolley_localizer.changes.change_file import ChangeFile
from trolley_localizer.map_server import ChosenMap
from trolley_localizer.start_pose import LastPose
from trolley_mapper import checkpoint
from trolley_mapper.checkpoint import Checkpoint
from trolley_mapper.edit.map_switch import SwitchPlan, pending_plan, store_plan
from trolley_mapper.edit.map_versions import Change, MapVersions, Version
from trolley_tour.stored.checks import PosesFile, ToursFile
from trolley_tour.trips import history_file
from trolley_tour.trips.record import TripRecord
from trolley_viz.features.past.trip_file import TripFile
from trolley_viz.server.access import AccessTokens
from trolley_viz.session.browser_choices import ViewerSettings

FOLDER = Path(__file__).with_name("state")
KINDS: dict[str, type[msgspec.Struct]] = {
    "base_time.toml": SavedTime,
    "base_stop.toml": SavedLatch,
    "base_world.toml": SavedWorld,
    "changes/home.toml": ChangeFile,
    "map.toml": ChosenMap,
    "last_pose.toml": LastPose,
    "zones/home.toml": ZoneFile,
    "poses.toml": PosesFile,
    "tours.toml": ToursFile,
    "trip.toml": TripRecord,
    "viewer.toml": ViewerSettings,
    "viewer_access.toml": AccessTokens,
}
LISTS = ("poses.toml", "tours.toml", "zones/home.toml", "viewer.toml")


class Form(NamedTuple):
    """What stands in a kind of file."""

    kind: type[msgspec.Struct]
    schema: int


FORMS = {
    **{name.replace("/", "_"): Form(kind, schema_of(kind)) for name, kind in KINDS.items()},
    "mapping.bin": Form(Checkpoint, Checkpoint(name="a", core=b"").schema),
    "map_edit.json": Form(SwitchPlan, 3),
    "viewer_trip": Form(TripFile, TripFile.SCHEMA),
    "settings.toml": Form(KeptSettings, schema_of(KeptSettings)),
    "base_settings.toml": Form(SavedSettings, schema_of(SavedSettings)),
    "map.yaml": Form(Version, 2),
    "map.zones.toml": Form(ZoneFile, schema_of(ZoneFile)),
}


@pytest.fixture
def folder(tmp_path: Path) -> StateFolder:
    shutil.copytree(FOLDER / "unmarked", tmp_path / "robot")
    return StateFolder(tmp_path / "robot", Log("test"))


def kept_aside(folder: StateFolder) -> list[str]:
    return [path.name for mark in ("broken", "newer") for path in folder.path.rglob(f"*.{mark}-*")]


@pytest.mark.parametrize("name", KINDS)
def test_what_was_saved_before_files_told_their_schema_is_read(folder: StateFolder, name: str):
    plain = tomllib.loads((folder.path / name).read_text("utf-8"))
    found = folder.read(name, KINDS[name])
    assert found == msgspec.convert(plain, KINDS[name])
    assert kept_aside(folder) == []


@pytest.mark.parametrize("name", KINDS)
def test_what_is_saved_now_is_read_by_the_release_before(folder: StateFolder, name: str):
    """It took any content whose required fields fit, and knew of no schema."""
    found = folder.read(name, KINDS[name])
    assert found is not None
    folder.write(name, found)
    plain = tomllib.loads((folder.path / name).read_text("utf-8"))
    assert plain["schema"] == schema_of(KINDS[name])
    assert msgspec.convert(plain, KINDS[name]) == found
    assert folder.read(name, KINDS[name]) == found


@pytest.mark.parametrize("name", KINDS)
@pytest.mark.parametrize(
    ("content", "mark"),
    [
        ("", "broken"),
        ("\n\n", "broken"),
        ("# nothing but a note\n", "broken"),
        ("schema = 1\n", "broken"),
        ('[project]\nname = "something else"\n', "broken"),
        ("schema = 1\n[project]\n", "broken"),
        ('schema = "1"\n', "broken"),
        ("schema = 0\n", "broken"),
        ("schema = true\n", "broken"),
        ("schema = 99\nwhatever = true\n", "newer"),
    ],
)
def test_what_is_empty_foreign_or_newer_is_kept(
    folder: StateFolder, name: str, content: str, mark: str, caplog: pytest.LogCaptureFixture
):
    (folder.path / name).write_text(content)
    assert folder.read(name, KINDS[name]) is None
    (aside,) = (folder.path / name).parent.glob(f"{Path(name).name}.{mark}-*")
    assert aside.read_text() == content
    assert "set aside" in caplog.text


@pytest.mark.parametrize("name", LISTS)
@pytest.mark.parametrize("other", LISTS)
def test_a_list_under_the_name_of_another_is_no_empty_list(
    folder: StateFolder, name: str, other: str
):
    if name == other:
        return
    shutil.copy(folder.path / other, folder.path / name)
    assert folder.read(name, KINDS[name]) is None
    assert len(kept_aside(folder)) == 1


class Third(msgspec.Struct, frozen=True):
    """A kind of file whose form was changed twice."""

    SCHEMA = 3

    places: list[str]
    note: str

    @classmethod
    def bring_forward(cls, plain: dict[str, Any], schema: int) -> dict[str, Any]:
        if schema == 1:
            return {"places": [plain["place"]]}
        return {**plain, "note": f"from {schema}"}


@pytest.mark.parametrize(
    ("content", "schema", "places"),
    [
        ('place = "den"\n', 1, ["den"]),
        ('schema = 1\nplace = "den"\n', 1, ["den"]),
        ('schema = 2\nplaces = ["a", "b"]\n', 2, ["a", "b"]),
        ('schema = 3\nplaces = []\nnote = "from 2"\n', 3, []),
    ],
)
def test_an_older_file_is_brought_forward_and_its_original_kept(
    folder: StateFolder, content: str, schema: int, places: list[str]
):
    file = folder.path / "third.toml"
    file.write_text(content)
    wanted = Third(places, "from 2")
    assert folder.read("third.toml", Third) == wanted
    folder.write("third.toml", wanted)
    assert folder.read("third.toml", Third) == wanted
    originals = list(folder.path.glob("third.toml.schema-*"))
    if schema == 3:
        assert originals == []
    else:
        assert [one.name for one in originals] == [f"third.toml.schema-{schema}"]
        assert originals[0].read_text() == content
    assert kept_aside(folder) == []


# What is no TOML.


def test_the_history_of_before_is_read_and_marked(folder: StateFolder):
    found = history_file.read_trips(folder.path, None, 10, 1 << 20)
    assert [trip.trip for trip in found.trips] == ["abc123"]
    history_file.keep_trip(folder.path, msgspec.structs.replace(found.trips[0], trip="b"), 1e6)
    assert user_version(folder.path / "history.sqlite") == history_file.SCHEMA
    assert len(history_file.read_trips(folder.path, None, 10, 1 << 20).trips) == 2
    assert kept_aside(folder) == []


def user_version(file: Path, new: int | None = None) -> int:
    with closing(sqlite3.connect(file)) as connection, connection:
        if new is not None:
            connection.execute(f"PRAGMA user_version = {new}")
        return connection.execute("PRAGMA user_version").fetchone()[0]


def test_a_history_that_cannot_be_looked_for_is_told_of(folder: StateFolder):
    found = history_file.read_trips(folder.path / ("a" * 300), None, 10, 1 << 20)
    assert found.problem is not None
    assert "File name too long" in found.problem


def test_a_history_that_is_a_folder_is_kept(folder: StateFolder):
    (folder.path / "history.sqlite").unlink()
    (folder.path / "history.sqlite" / "inside").mkdir(parents=True)
    found = history_file.read_trips(folder.path, None, 10, 1 << 20)
    assert (found.trips, found.problem) == ((), None)
    assert found.kept is not None
    assert (folder.path / found.kept / "inside").is_dir()


@pytest.mark.parametrize("what", ["empty", "foreign", "newer"])
def test_a_history_that_is_none_of_ours_is_kept(folder: StateFolder, what: str):
    file = folder.path / "history.sqlite"
    if what == "newer":
        user_version(file, 2)
    else:
        file.unlink()
        file.touch()
    if what == "foreign":
        with closing(sqlite3.connect(file)) as connection, connection:
            connection.execute("CREATE TABLE songs (title TEXT)")
    content = file.read_bytes()
    found = history_file.read_trips(folder.path, None, 10, 1 << 20)
    assert (found.trips, found.problem) == ((), None)
    assert found.kept is not None
    assert found.kept.startswith(f"history.sqlite.{'newer' if what == 'newer' else 'broken'}-")
    assert (folder.path / found.kept).read_bytes() == content


def test_a_history_is_never_empty_under_its_name(tmp_path: Path):
    trip = history_file.read_trips(FOLDER / "unmarked", None, 10, 1 << 20).trips[0]
    history_file.keep_trip(tmp_path, trip, 1e6)
    assert [file.name for file in tmp_path.iterdir()] == ["history.sqlite"]
    assert user_version(tmp_path / "history.sqlite") == history_file.SCHEMA


def test_the_unfinished_map_of_before_is_read(folder: StateFolder):
    found = checkpoint.read(folder.path)
    assert isinstance(found, Checkpoint)
    assert (found.name, found.seconds, found.core) == ("home", 12.5, b"core")


@pytest.mark.parametrize(
    ("content", "mark"),
    [
        (b"", "broken"),
        (b"\x80", "broken"),
        (msgspec.msgpack.encode({"schema": 8, "anything": 1}), "newer"),
        (msgspec.msgpack.encode({"songs": ["a"]}), "broken"),
    ],
)
def test_an_unfinished_map_that_is_none_is_kept(folder: StateFolder, content: bytes, mark: str):
    (folder.path / checkpoint.FILE).write_bytes(content)
    said = checkpoint.read(folder.path)
    assert isinstance(said, str)
    (aside,) = folder.path.glob(f"mapping.bin.{mark}-*")
    assert aside.name in said
    assert aside.read_bytes() == content


def test_an_unfinished_map_that_cannot_be_opened_is_kept(folder: StateFolder):
    """The next map would overwrite it, or be discarded with it."""
    (folder.path / checkpoint.FILE).unlink()
    (folder.path / checkpoint.FILE).mkdir()
    said = checkpoint.read(folder.path)
    (aside,) = folder.path.glob("mapping.bin.broken-*")
    reason = "The unfinished map cannot be read (Is a directory)"
    assert said == f"{reason}; it is kept as {aside.name}."


def test_the_plan_of_before_is_read(folder: StateFolder, tmp_path: Path):
    plan = pending_plan(folder.path, MapVersions(tmp_path / "maps"))
    assert plan is None, "its map was not stored, so it is void"
    assert kept_aside(folder) == []


@pytest.mark.parametrize(
    ("content", "mark"), [(b"", "broken"), (b"{}", "broken"), (b'{"schema": 7}', "newer")]
)
def test_a_plan_that_is_none_is_kept(
    folder: StateFolder, tmp_path: Path, content: bytes, mark: str
):
    (folder.path / "map_edit.json").write_bytes(content)
    said = pending_plan(folder.path, MapVersions(tmp_path / "maps"))
    assert isinstance(said, str)
    (aside,) = folder.path.glob(f"map_edit.json.{mark}-*")
    assert aside.name in said


def test_a_plan_that_is_no_file_is_kept(folder: StateFolder, tmp_path: Path):
    (folder.path / "map_edit.json").unlink()
    (folder.path / "map_edit.json").mkdir()
    said = pending_plan(folder.path, MapVersions(tmp_path / "maps"))
    assert isinstance(said, str)
    assert said.startswith("The pending switch to an edited map cannot be read (Is a directory); ")


def test_a_void_plan_that_cannot_be_deleted_ends_no_mapper(
    folder: StateFolder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "unlink", refuse)
    said = pending_plan(folder.path, MapVersions(tmp_path / "maps"))
    assert isinstance(said, str)
    assert "Permission denied" in said


def test_a_plan_tells_its_schema(tmp_path: Path):
    content = json.loads((FOLDER / "unmarked" / "map_edit.json").read_bytes())
    plan = msgspec.convert(content, SwitchPlan)
    store_plan(tmp_path, plan)
    assert json.loads((tmp_path / "map_edit.json").read_bytes())["schema"] == 3


def test_zones_beside_a_map_that_cannot_be_read_are_kept_when_it_is_edited(tmp_path: Path):
    versions = MapVersions(tmp_path)
    grid = GridMap("home", 0.05, Pose2D.identity(), np.zeros((4, 4), np.int8))
    versions.save(grid, Change(what="mapped"), seeds=[])
    seeds = tmp_path / "home.zones.toml"
    seeds.write_text("schema = 99\nzones = []\n")
    versions.save(grid, Change(what="turned"), seeds=[])
    (aside,) = tmp_path.glob("home.zones.toml.newer-*")
    assert aside.read_text() == "schema = 99\nzones = []\n"
    assert "schema = 2" in seeds.read_text()


@pytest.mark.parametrize("name", FORMS)
def test_a_form_that_changes_has_a_new_schema(name: str):
    """A release that does not know a field loses it, so every field needs a new schema."""
    kind, schema = FORMS[name]
    form = _bare(msgspec.json.schema(kind))
    file = FOLDER / "forms" / f"{name}.schema-{schema}.json"
    if os.environ.get("TROLLEY_RENEW_GOLDEN") and not file.exists():
        file.parent.mkdir(exist_ok=True)
        file.write_bytes(msgspec.json.format(msgspec.json.encode(form)))
    assert _bare(json.loads(file.read_bytes())) == form, (
        f"count up the schema of {name}: what it holds has changed"
    )


def _bare(form: Any) -> Any:
    """The form without its words, and without bounds that no number in a file comes near."""
    if isinstance(form, dict):
        return {
            key: _bare(value)
            for key, value in form.items()
            if not (key in ("description", "title") and isinstance(value, str))
            and not (isinstance(value, float) and abs(value) >= LARGEST)
        }
    return [_bare(item) for item in form] if isinstance(form, list) else form
