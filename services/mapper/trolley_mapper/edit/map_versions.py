"""The maps of this host and their earlier versions: changing a map keeps the previous one.

`<state>/maps` holds the newest version: `<name>.yaml` and the image that it names. Earlier versions
are in `versions/<name>/NNNN.yaml` with their images and `NNNN.zones.toml`, the zones of that time.
The YAML file says which version it is under its own key `trolley`, which ROS ignores.

The one write that counts is the rename of `<name>.yaml`. Each version's image has a name of its own
(`<name>@7.pgm`; "@" cannot be in a map's name), so that a reader between two writes finds an image
and a description that belong together.
"""

import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import cast

import msgspec
from msgspec import Struct

from trolley.files import keep_aside, make_folder, read_file, sync_folder, write_atomically
from trolley.geometry import Pose2D
from trolley.gridmap import GridMap, MapError, load_map
from trolley.gridmap.description import parse_yaml, read_description, render_description
from trolley.gridmap.io import render_map
from trolley.messages import Zone
from trolley.state_file import Unreadable, keep_unreadable, parse, render
from trolley.zones import ZoneFile

SCHEMA = 2
"""Version of the format of the entry `trolley` in a map's YAML file."""
MAX_KEPT = 20
"""Number of former versions of a map that are kept; then the oldest is dropped."""
_FORMER = "former"
"""What the zones of a map that is gone are kept aside as, once its name is given again."""
_KEPT = re.compile(r"([0-9]{4,9})\.yaml")
_REMEDY = "make room on the disk, or check the folder and its rights"


class Version(Struct, frozen=True, kw_only=True, omit_defaults=True):
    """What a map's YAML file says of its version."""

    schema: int | None = None
    """Version of this entry's format; older files have none."""
    number: int
    before: int | None = None
    """The version that `take_back` goes back to."""
    before_T_this: Pose2D = msgspec.field(default_factory=Pose2D.identity)
    """Maps points of this version to the one before; they differ where the map was turned."""
    made_of: str | None = None
    """The map that the first version was made of, if it was another."""
    zones_added: list[str] = []
    """Names of the zones that this version added."""
    what: str = ""
    """What was done, in words for people."""
    saved_at: str | None = None
    """When it was saved: UTC, ISO 8601."""
    start: Pose2D | None = None
    """Where the robot stood when it began to map (`map_T_base`), where that is known."""


class Change(Struct, frozen=True, kw_only=True):
    """What a new version is: the fields of `Version` that its maker knows."""

    what: str
    old_T_new: Pose2D = msgspec.field(default_factory=Pose2D.identity)
    made_of: str | None = None
    zones_added: list[str] = []
    saved_at: str | None = None
    start: Pose2D | None = None


class MapVersions:
    """Stores maps. All of it touches the disk: call it through `Service.work`.

    Args:
        folder: `<state>/maps`; made when something is stored.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    # What there is.
    def file_of(self, name: str) -> Path:
        """Return the YAML file of a map, there or not."""
        return self._folder / f"{name}.yaml"

    def newest(self, name: str) -> Version | None:
        """Say which version a map is in, None if there is no such map here."""
        file = self.file_of(name)
        return self._version(file, max(self.kept(name), default=0) + 1) if file.exists() else None

    def kept(self, name: str) -> list[int]:
        """Return the numbers of the versions that are kept, in order."""
        found = (_KEPT.fullmatch(file.name) for file in self._kept_folder(name).glob("*.yaml"))
        return sorted(int(match[1]) for match in found if match is not None)

    def next_number(self, name: str) -> int:
        """Return the number that the next version of a map gets."""
        now = self.newest(name)
        return max([*self.kept(name), 0 if now is None else now.number]) + 1

    def load_kept(self, name: str, number: int) -> GridMap:
        """Read a former version.

        Raises:
            MapError: it is not there, or cannot be read.
        """
        return load_map(self._kept_folder(name) / f"{number:04d}.yaml", name)

    # Storing.
    def save(
        self,
        grid: GridMap,
        change: Change,
        zones_before: Sequence[Zone] = (),
        seeds: Sequence[Zone] | None = None,
    ) -> Version:
        """Store a map under its name as the newest version; the one before is kept.

        Args:
            grid: the map.
            change: what was done.
            zones_before: the zones of the version that is replaced, kept beside it.
            seeds: zones for robots that have not stored any for this map; None: as they are.

        Raises:
            MapError: it cannot be written; the map is as it was.
        """
        now = self.newest(grid.name)
        version = Version(
            number=self.next_number(grid.name),
            before=None if now is None else now.number,
            before_T_this=change.old_T_new,
            made_of=change.made_of,
            zones_added=change.zones_added,
            what=change.what,
            saved_at=change.saved_at,
            schema=SCHEMA,
            start=change.start or _moved_start(now, change.old_T_new),
        )
        self._replace(grid, now, version, zones_before, seeds)
        return version

    def take_back(
        self,
        name: str,
        zones_before: Sequence[Zone] = (),
        seeds: Sequence[Zone] | None = None,
        saved_at: str | None = None,
    ) -> Version:
        """Make the previous version the newest again, a step back at each call; the newest is kept.

        Raises:
            LookupError: there is none before, or it has been dropped.
            MapError: it cannot be read or written; the map is as it was.
        """
        now = self.newest(name)
        if now is None or now.before is None or now.before not in self.kept(name):
            raise LookupError(name)
        file = self._kept_folder(name) / f"{now.before:04d}.yaml"
        former = self._version(file, now.before)
        version = msgspec.structs.replace(
            former,
            number=self.next_number(name),
            what=f"back to version {now.before}: {former.what}",
            saved_at=saved_at,
            schema=SCHEMA,
        )
        self._replace(self.load_kept(name, now.before), now, version, zones_before, seeds)
        return version

    # Inside.
    def _kept_folder(self, name: str) -> Path:
        return self._folder / "versions" / name

    def _replace(
        self,
        grid: GridMap,
        now: Version | None,
        version: Version,
        zones_before: Sequence[Zone],
        seeds: Sequence[Zone] | None,
    ) -> None:
        """Keep what there is, write the new image, and then, by the YAML file, let it count."""
        file = self.file_of(grid.name)
        if now is not None and (now.schema or SCHEMA) > SCHEMA:
            why = "a newer Trolley has changed it, and what it noted of that would be lost"
            raise MapError(file, why, "upgrade Trolley, or save under another name")
        seed_file = file.with_name(f"{grid.name}.zones.toml")
        is_new = now is None and not file.with_name(f"{grid.name}.pgm").exists()
        stem = grid.name if is_new else f"{grid.name}@{version.number}"
        try:
            files = render_map(grid, stem)
        except ValueError as error:
            raise MapError(file, *error.args) from error
        try:
            make_folder(self._folder)
            if now is not None:
                self._keep(grid.name, now, zones_before)
            else:  # nobody reads zones before the map is there
                for older in (seed_file, *self._folder.parent.glob(f"*/zones/{grid.name}.toml")):
                    if older.exists():
                        keep_aside(older, _FORMER)
                if seeds is not None:
                    _store_seeds(seed_file, seeds)
            old_image = None if now is None else _own_image(file)
            write_atomically(file.with_name(files.image), files.image_bytes)
            write_atomically(file, (files.yaml + _extra(version)).encode())
        except OSError as error:
            self._tidy(grid.name, None if now is None else read_description(file).image)
            raise MapError(file, f"it cannot be written ({error.strerror})", _REMEDY) from error
        with suppress(OSError):  # what is left does no harm
            if now is not None and seeds is not None:
                _store_seeds(seed_file, seeds)
            if old_image is not None and old_image.name != files.image:
                old_image.unlink(missing_ok=True)
        self._tidy(grid.name, files.image)

    def _keep(self, name: str, now: Version, zones: Sequence[Zone]) -> None:
        """Copy the newest version to the kept ones; its YAML file last, which makes it one."""
        folder, file = self._kept_folder(name), self.file_of(name)
        make_folder(folder)
        description = read_description(file)
        image = file.parent / description.image
        stem = f"{now.number:04d}"
        kept = replace(description, image=f"{stem}{image.suffix.lower()}")
        write_atomically(folder / kept.image, read_file(image))
        write_atomically(folder / f"{stem}.zones.toml", _toml(zones))
        text = render_description(kept) + _extra(now)
        write_atomically(folder / f"{stem}.yaml", text.encode())

    def _tidy(self, name: str, used: str | None) -> None:
        """Remove images that no version has any more, and versions that are too old."""
        with suppress(OSError):  # what cannot be removed does no harm
            for image in self._folder.glob(f"{name}@*"):
                if image.name != used:
                    image.unlink(missing_ok=True)
            folder = self._kept_folder(name)
            for number in self.kept(name)[:-MAX_KEPT]:
                # Its YAML file first: without it the others are no version.
                (folder / f"{number:04d}.yaml").unlink(missing_ok=True)
                sync_folder(folder)
                for rest in folder.glob(f"{number:04d}.*"):
                    rest.unlink(missing_ok=True)

    def _version(self, file: Path, otherwise: int) -> Version:
        """Read which version a file is; one that does not say it is the first that we know."""
        import yaml

        try:
            document = parse_yaml(read_file(file))
            found = cast("dict[str, object]", document) if isinstance(document, dict) else {}
            said = found.get("trolley")
        except (OSError, yaml.YAMLError, ValueError, RecursionError):
            return Version(number=otherwise)
        try:
            return msgspec.convert(said, type=Version)
        except (ValueError, msgspec.ValidationError, RecursionError):
            return Version(number=otherwise, schema=_schema(said))


def write_map(
    folder: Path,
    name: str,
    grid: GridMap,
    zones: Sequence[Zone] = (),
    start: Pose2D | None = None,
    state: Path | None = None,
) -> str | None:
    """Write a finished map; one that was there under this name is kept as a former version.

    Args:
        folder: `<state>/maps`.
        name: of the map.
        grid: the map.
        zones: of a map that has none yet, taken over by whoever loads it first.
        start: map_T_base where a new map began.
        state: the robot's state folder; its zones of a version that is replaced are kept with it.

    Returns:
        Why it could not be written, in a sentence; None when it is.
    """
    versions = MapVersions(folder)
    try:
        is_new = versions.newest(name) is None
        change = Change(what="mapped" if is_new else "extended", start=start)
        before: list[Zone] = []
        if not is_new and state is not None:
            with suppress(OSError, Unreadable):  # a copy only: no reason to lose the map
                before = stored_zones(state, versions.file_of(name))
        versions.save(replace(grid, name=name), change, before, list(zones) or None)
    except MapError as error:
        return f"The map could not be written: {error}."
    return None


def stored_zones(state: Path, file: Path) -> list[Zone]:
    """Return the zones of a map: those that a robot has stored, else those beside the map's file.

    Args:
        state: the robot's state folder.
        file: of the map.

    Raises:
        OSError, Unreadable: they cannot be read.
    """
    for path in (state / "zones" / f"{file.stem}.toml", file.with_name(f"{file.stem}.zones.toml")):
        with suppress(FileNotFoundError):
            return parse(read_file(path), ZoneFile).zones
    return []


def _moved_start(before: Version | None, old_T_new: Pose2D) -> Pose2D | None:
    """Return where the start of a version before lies now."""
    if before is None or before.start is None:
        return None
    return (old_T_new.inverse() @ before.start).wrapped()


def _own_image(file: Path) -> Path | None:
    """Return the image under the map's plain name that an earlier version of ours left, if any.

    One that somebody else put there is left alone: other files may name it.
    """
    image = file.parent / read_description(file).image
    is_ours = "\ntrolley:" in read_file(file).decode()
    return image if is_ours and image.parent == file.parent and image.stem == file.stem else None


def _extra(version: Version) -> str:
    import yaml

    return yaml.safe_dump(
        {"trolley": msgspec.to_builtins(version)}, sort_keys=False, allow_unicode=True
    )


def _schema(said: object) -> int | None:
    """Return the schema of an entry whose form is not known, None where it tells none."""
    schema = cast("dict[str, object]", said).get("schema") if isinstance(said, dict) else None
    return schema if type(schema) is int else None


def _store_seeds(file: Path, zones: Sequence[Zone]) -> None:
    """Write the zones beside a map; a file there that cannot be read is set aside.

    Raises:
        OSError: It cannot be written.
    """
    try:
        parse(read_file(file), ZoneFile)
    except FileNotFoundError:
        pass
    except (Unreadable, OSError) as error:
        keep_unreadable(file, error)
    write_atomically(file, _toml(zones))


def _toml(zones: Sequence[Zone]) -> bytes:
    """Return zones as the file that the localizer reads."""
    return render(ZoneFile(zones=[*zones]))
