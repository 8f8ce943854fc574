"""Every schema that a saved file ever had: read today, and kept when it is newer than today's.

`state/schema-<n>` holds one small file of each kind as the releases of that schema wrote it.
"""

import json
import re
import shutil
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import pytest
import yaml

from trolley.config.kept_settings import KeptSettings
from trolley.runtime.log import Log
from trolley.runtime.state import StateFolder
from trolley.state_file import Newer, Unreadable
from trolley.zones import ZoneFile
from trolley_base.settings_keeper import SavedSettings
from trolley_localizer.zone_rules import read_seeds
from trolley_mapper import checkpoint
from trolley_mapper.edit.map_switch import PLAN_FILE, SwitchPlan, pending_plan
from trolley_mapper.edit.map_versions import MapVersions
from trolley_tour.stored.checks import ToursFile
from trolley_tour.trips.record import TripRecord
from trolley_viz.features.past import trip_file

from .test_state_files import FOLDER, FORMS, KINDS

SETTINGS = {"base_settings.toml": SavedSettings, "settings.toml": KeptSettings}
TOML = {name.replace("/", "_"): name for name in KINDS} | {name: name for name in SETTINGS}
STRUCTS = {**KINDS, **SETTINGS}


class Saved(NamedTuple):
    """A golden file."""

    name: str
    schema: int

    @property
    def content(self) -> bytes:
        return (FOLDER / f"schema-{self.schema}" / self.name).read_bytes()

    @property
    def is_older(self) -> bool:
        return self.schema < FORMS[self.name].schema

    def __str__(self) -> str:
        return f"{self.name}-{self.schema}"


SAVED = [
    Saved(file.name, int(file.parent.name.removeprefix("schema-")))
    for file in sorted(FOLDER.glob("schema-*/*"))
]


def of(*names: str) -> list[Saved]:
    return [saved for saved in SAVED if saved.name in names]


@pytest.fixture
def folder(tmp_path: Path) -> StateFolder:
    return StateFolder(tmp_path / "robot", Log("test"))


def put(file: Path, content: bytes) -> Path:
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_bytes(content)
    return file


def beside(file: Path) -> dict[str, bytes]:
    return {one.name: one.read_bytes() for one in file.parent.iterdir() if one != file}


def originals(saved: Saved, file: Path) -> dict[str, bytes]:
    """What is to lie beside a file that was read."""
    return {f"{file.name}.schema-{saved.schema}": saved.content} if saved.is_older else {}


def test_each_schema_of_each_kind_has_a_file() -> None:
    """Whoever counts a schema up adds the file that the new one writes."""
    forms = {path.name for path in (FOLDER / "forms").iterdir()}
    assert forms == {f"{saved.name}.schema-{saved.schema}.json" for saved in SAVED}


def _entry(content: bytes) -> Any:
    return yaml.safe_load(content)["trolley"]


DECODERS: dict[str, Callable[[bytes], Any]] = {
    "map.yaml": _entry,
    "map_edit.json": json.loads,
    "mapping.bin": msgspec.msgpack.decode,
    "viewer_trip": msgspec.msgpack.decode,
}
UNREAD = {"version"}
"""Keys of the first files of unfinished maps, which nobody reads."""


@pytest.mark.parametrize("saved", SAVED, ids=str)
def test_a_file_holds_only_what_its_schema_knew(saved: Saved) -> None:
    decode = DECODERS.get(saved.name, lambda content: tomllib.loads(content.decode()))
    plain = decode(saved.content)
    form = json.loads((FOLDER / "forms" / f"{saved.name}.schema-{saved.schema}.json").read_bytes())
    assert plain.pop("schema") == saved.schema
    check(plain, form, form["$defs"])


def check(plain: Any, form: dict[str, Any], defs: dict[str, Any]) -> None:
    """Compare names, kinds and what must be there with a form, as far down as objects go."""
    if "$ref" in form:
        form = defs[form["$ref"].rpartition("/")[2]]
    if "properties" in form:
        assert plain.keys() - form["properties"].keys() <= UNREAD
        assert not set(form.get("required", ())) - plain.keys()
        for name, value in plain.items():
            check(value, form["properties"].get(name, {}), defs)
    elif isinstance(plain, list) and isinstance(form.get("items"), dict):
        for one in plain:
            check(one, form["items"], defs)
    elif "enum" in form:
        assert plain in form["enum"]


@pytest.mark.parametrize("saved", of(*TOML), ids=str)
def test_a_toml_file_of_any_schema_is_read_and_its_original_kept(
    folder: StateFolder, saved: Saved
) -> None:
    name = TOML[saved.name]
    file = put(folder.path / name, saved.content)
    plain = tomllib.loads(saved.content.decode())
    del plain["schema"]
    found = folder.read(name, STRUCTS[name])
    assert found is not None
    assert holds(msgspec.to_builtins(found), plain)
    assert folder.problems == {}
    assert beside(file) == originals(saved, file)


def holds(found: Any, plain: Any) -> bool:
    """Whether all that was saved is found again."""
    if isinstance(plain, dict):
        return all(holds(found[name], value) for name, value in plain.items())
    if isinstance(plain, list):
        return len(found) == len(plain) and all(map(holds, found, plain))
    return bool(found == plain)


@pytest.mark.parametrize(
    "saved", [one for one in of("tours.toml", "trip.toml") if one.is_older], ids=str
)
def test_an_older_tour_beyond_today_s_limits_is_read(folder: StateFolder, saved: Saved) -> None:
    """They knew none: rounds and seconds were any numbers."""
    content = re.sub(rb"repeat = \d+", b"repeat = 10000000", saved.content)
    content = re.sub(rb"dwell = .+", b"dwell = 1e15\ntimeout = 1e15", content)
    put(folder.path / saved.name, content)
    found = folder.read(saved.name, STRUCTS[saved.name])
    assert isinstance(found, ToursFile | TripRecord)
    for tour in found.tours if isinstance(found, ToursFile) else [found.tour]:
        assert tour.repeat == 1_000_000
        assert {(stop.dwell, stop.timeout) for stop in tour.stops} == {(1e12, 1e12)}


@pytest.mark.parametrize("saved", of(*TOML), ids=str)
def test_a_toml_file_of_a_newer_release_is_set_aside_and_reported(
    folder: StateFolder, saved: Saved
) -> None:
    name = TOML[saved.name]
    content = re.sub(rb"schema = \d+", b"schema = 99", saved.content, count=1)
    file = put(folder.path / name, content)
    assert folder.read(name, STRUCTS[name]) is None
    assert name in folder.problems
    ((aside, kept),) = beside(file).items()
    assert aside.startswith(f"{file.name}.newer-")
    assert kept == content


def test_rooms_are_among_what_is_read(folder: StateFolder) -> None:
    put(folder.path / "zones/home.toml", Saved("zones_home.toml", 2).content)
    zones = folder.read("zones/home.toml", ZoneFile)
    assert zones is not None
    assert ("room", "Küche") in {(zone.kind, zone.name) for zone in zones.zones}


@pytest.mark.parametrize("saved", of("mapping.bin"), ids=str)
def test_an_unfinished_map_of_any_schema_is_read_and_its_original_kept(
    tmp_path: Path, saved: Saved
) -> None:
    file = put(tmp_path / checkpoint.FILE, saved.content)
    found = checkpoint.read(tmp_path)
    assert isinstance(found, checkpoint.Checkpoint)
    assert (found.name, found.core, found.schema) == ("home", b"core", 7)
    assert beside(file) == originals(saved, file)


def test_an_unfinished_map_whose_original_cannot_be_kept_stays_as_it_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    content = Saved("mapping.bin", 1).content
    put(tmp_path / checkpoint.FILE, content)

    def refuse(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("trolley.state_file.write_atomically", refuse)
    said = checkpoint.read(tmp_path)
    assert isinstance(said, str)
    assert "No space left on device" in said
    (aside,) = tmp_path.iterdir()
    assert aside.name in said
    assert aside.read_bytes() == content


def encoded(saved: Saved, schema: int) -> bytes:
    codec = msgspec.json if saved.name == PLAN_FILE else msgspec.msgpack
    return codec.encode({**codec.decode(saved.content), "schema": schema})


@pytest.mark.parametrize("saved", of("mapping.bin", PLAN_FILE), ids=str)
def test_what_a_newer_mapper_was_about_to_do_is_set_aside_and_reported(
    tmp_path: Path, saved: Saved
) -> None:
    content = encoded(saved, 99)
    put(tmp_path / saved.name, content)
    is_plan = saved.name == PLAN_FILE
    maps = MapVersions(tmp_path / "maps")
    said = pending_plan(tmp_path, maps) if is_plan else checkpoint.read(tmp_path)
    (aside,) = tmp_path.iterdir()
    assert isinstance(said, str)
    assert aside.name in said
    assert aside.name.startswith(f"{saved.name}.newer-")
    assert aside.read_bytes() == content


@pytest.mark.parametrize("saved", of(PLAN_FILE), ids=str)
def test_a_plan_of_any_schema_is_carried_out_and_its_original_kept(
    tmp_path: Path, saved: Saved
) -> None:
    maps = MapVersions(tmp_path / "maps")
    put(maps.file_of("home"), Saved("map.yaml", 1).content.replace(b"number: 3", b"number: 2"))
    file = put(tmp_path / "state" / PLAN_FILE, saved.content)
    plan = pending_plan(file.parent, maps)
    assert isinstance(plan, SwitchPlan)
    assert [place.name for place in plan.places] == ["Küche"]
    assert [zone.kind for zone in plan.zones] == ["room"] * (saved.schema >= 2)
    assert beside(file) == originals(saved, file)


@pytest.mark.parametrize("saved", of("map.zones.toml"), ids=str)
def test_zones_beside_a_map_are_read_and_newer_ones_refused(tmp_path: Path, saved: Saved) -> None:
    file = put(tmp_path / "home.zones.toml", saved.content)
    found = read_seeds(tmp_path / "home.yaml")
    assert not isinstance(found, str)
    assert found is not None
    assert [zone.kind for zone in found] == ["mirror", "room"][: saved.schema]
    file.write_bytes(saved.content.replace(b"schema = ", b"schema = 9"))
    said = read_seeds(tmp_path / "home.yaml")
    assert isinstance(said, str)
    assert "newer Trolley" in said


@pytest.mark.parametrize("saved", of("viewer_trip"), ids=str)
def test_a_past_trip_is_read_and_a_newer_one_refused(saved: Saved) -> None:
    record, offset_ns = trip_file.decode(saved.content)
    assert (record.maps, offset_ns) == (["home"], 1_763_971_200_000_000_000)
    with pytest.raises(Newer):
        trip_file.decode(encoded(saved, 99))
    with pytest.raises(Unreadable):
        trip_file.decode(saved.content[:-3])


@pytest.mark.parametrize("saved", of("map.yaml"), ids=str)
def test_a_map_says_its_version_whatever_wrote_it(tmp_path: Path, saved: Saved) -> None:
    versions = MapVersions(tmp_path)
    file = put(versions.file_of("home"), saved.content)
    found = versions.newest("home")
    assert found is not None
    assert (found.number, found.before, found.zones_added) == (3, 2, ["Küche"])
    assert (found.start is not None) == (saved.schema == 2)
    shutil.copy(file, tmp_path / "other.yaml")
    schema = f"schema: {saved.schema}".encode()
    file.write_bytes(saved.content.replace(schema, b"schema: 99"))
    newer = versions.newest("home")
    assert newer is not None
    assert newer.schema == 99
