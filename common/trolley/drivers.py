"""The drivers of motor boards and lidars: which there are, and what all of them declare.

A driver is an object in a module, named by an entry point of the group `trolley.boards` or
`trolley.lidars`. The entry point's name is what robot.toml calls the device; its object is a dict
of drivers by such names, since one protocol is often spoken by several models:

    [project.entry-points."trolley.lidars"]
    acme_x1 = "trolley_acme:DRIVERS"

Our own stand in `BUILT_IN` in the same form and not in our packages' metadata. Reading that of all
packages takes 15 ms, 80 ms the first time, as long as importing every driver; so it is read only
for a name that is not here, and by what lists drivers. Of the modules only the one that is asked
for is imported.

A driver that cannot be used is left out and named with the reason (`Drivers.refused`).
"""

import importlib
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar, Generic, NamedTuple, TypeVar, cast

import msgspec
from msgspec import Struct

from trolley.invalid import in_words_of_a_file

API = 1
"""Version of what drivers are given and have to give; one for another version is not used."""
BOARDS, LIDARS = "trolley.boards", "trolley.lidars"
WORDS = {BOARDS: "motor board", LIDARS: "lidar"}
BUILT_IN: Mapping[str, Mapping[str, tuple[str, ...]]] = {
    BOARDS: {
        "linorobot": ("linorobot",),
        "linorobot2": ("linorobot2",),
        "arduino_bridge": ("arduino_bridge",),
        "waveshare_ugv": ("waveshare_ugv",),
        "create2": ("create2",),
        "hoverboard": ("hoverboard",),
    },
    LIDARS: {
        "rplidar": (
            "rplidar_a1",
            "rplidar_a2",
            "rplidar_a3",
            "rplidar_c1",
            "rplidar_s1",
            "rplidar_s2",
            "rplidar_s3",
        ),
        "ydlidar": (
            "ydlidar_x4",
            "ydlidar_x4_pro",
            "ydlidar_x2",
            "ydlidar_g2",
            "ydlidar_g4",
            "ydlidar_tmini",
        ),
        "ld19": ("ld19", "stl27l", "ld14p"),
        "xv11": ("xv11", "lds02rr"),
        "lds01": ("lds01",),
        "camsense": ("camsense_x1",),
        "hokuyo": ("hokuyo_urg",),
        "delta2": ("delta2a", "delta2b"),
        "coin_d4": ("coin_d4",),
    },
}
"""By group: our modules, and the models that each drives, in the order in which they are tried."""
_FOLDER = "trolley_base.drivers"
FELT_KEPT_S = 60.0
"""What a bumper or a cliff sensor has felt usually stays for so long [s]: it sees nothing from
afar."""
NAME = re.compile(r"[a-z0-9][a-z0-9_]{0,31}")

S = TypeVar("S", bound=Struct)
T = TypeVar("T")


class NoSettings(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Of a driver that has no settings of its own."""


class DriverUnusable(Exception):
    """A driver that is not there or cannot be used; the text says why, as a sentence."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BoardSensor:
    """A sensor of a motor board: it leaves echoes once robot.toml lists it.

    Attributes:
        name: of its table `[base.scans.NAME]`.
        meaning: what it is and what its echoes are good for, as sentences.
        settings: what the table says, as `ExtraSensorConfig` reads it.
        is_usual: `trolley detect --write` lists it; else it writes the table as a comment, for its
            owner to decide or to fill in.
    """

    name: str
    meaning: str
    settings: Mapping[str, Any]
    is_usual: bool = True


@dataclass(frozen=True, slots=True, kw_only=True)
class Driver:
    """What every driver declares; those of boards and lidars say more.

    Attributes:
        api: the version of `API` that it was written for, as a number.
        page: where people read about the device: a file in `docs/hardware`, or a URL.
        settings: its own, `[base.chassis.settings]` or `[base.lidar.settings]`: a struct whose
            fields have types, bounds (`msgspec.Meta`) and a docstring each, with the unit in the
            name.
        example: tables of `[base.chassis]` or `[base.lidar]` that fit the emulated device.
        emulator: what emulates it, such as "trolley_acme.emulator:EMULATORS": a dict by name.
        sensors: bumpers, cliff sensors and the like that a board always has, or may have.
    """

    group: ClassVar[str] = ""
    api: int
    page: str = ""
    settings: type[Struct] = NoSettings
    example: Mapping[str, Any] = field(default_factory=dict[str, Any])
    emulator: str = ""
    sensors: tuple[BoardSensor, ...] = ()


D = TypeVar("D", bound=Driver)


class Place(NamedTuple):
    """Where a driver is: an entry point, or the same of a module of ours.

    Attributes:
        value: module and object, such as "trolley_acme:DRIVERS".
        package: that it belongs to, with its version.
    """

    value: str
    package: str = "Trolley"


class Refused(NamedTuple):
    """A driver that is installed and left out.

    Attributes:
        group: `BOARDS` or `LIDARS`.
        name: of its entry point.
        package: that brought it along, with its version.
        why: what is wrong with it.
    """

    group: str
    name: str
    package: str
    why: str

    def __str__(self) -> str:
        return (
            f"The driver of the {WORDS[self.group]} {self.name} in {self.package} is not used: "
            f"{self.why}."
        )


class Drivers(Generic[D], Mapping[str, D]):
    """The drivers of one kind by name; as a mapping, those that can be used.

    Args:
        kind: what their objects must be.
        group: `BOARDS` or `LIDARS`.
    """

    def __init__(self, kind: type[D], group: str = "") -> None:
        self._kind = kind
        self._group = group or kind.group
        self._own = {
            model: Place(f"{_FOLDER}.{self._group.rpartition('.')[2]}.{module}:DRIVERS")
            for module, models in BUILT_IN[self._group].items()
            for model in models
        }
        self._loaded: dict[str, D] = {}
        self._unusable: dict[str, Refused] = {}

    @property
    def names(self) -> tuple[str, ...]:
        """All that are declared, usable or not; ours first. Imports none of them."""
        return (*self._own, *self.added)

    @property
    def added(self) -> tuple[str, ...]:
        """Those of other packages."""
        return tuple(self._added)

    def find(self, name: str) -> D:
        """Return a driver, imported if it was not yet.

        Raises:
            DriverUnusable: there is none of this name, or it cannot be used.
        """
        if name in self._loaded:
            return self._loaded[name]
        place = self._own.get(name) or self._added.get(name)
        if place is None:
            misnamed = [str(one) for one in self._misnamed if one.name == name]
            known = f"there is no {WORDS[self._group]} {name!r}, only {', '.join(self.names)}"
            raise DriverUnusable(" ".join([f"{known}.", *misnamed]))
        if name not in self._unusable:
            try:
                self._loaded[name] = self._load(name, place)
                return self._loaded[name]
            except DriverUnusable as error:
                self._unusable[name] = Refused(self._group, name, place.package, str(error))
        raise DriverUnusable(str(self._unusable[name]))

    def refused(self) -> list[Refused]:
        """Import all drivers, and return those that are left out."""
        len(self)
        return [*self._misnamed, *self._unusable.values()]

    def __getitem__(self, name: str) -> D:
        try:
            return self.find(name)
        except DriverUnusable as error:
            raise KeyError(name) from error

    def __iter__(self) -> Iterator[str]:
        return (name for name in self.names if name in self)

    def __len__(self) -> int:
        return sum(1 for _ in self)

    @cached_property
    def _entries(self) -> tuple[dict[str, Place], list[Refused]]:
        """Those of other packages, in the order of these; those of no use apart."""
        from importlib.metadata import entry_points  # takes 20 ms: only where it is needed

        added: dict[str, Place] = {}
        left_out: list[Refused] = []
        found = [
            (f"{entry.dist.name} {entry.dist.version}" if entry.dist else "?", entry)
            for entry in entry_points(group=self._group)
        ]
        for package, entry in sorted(found, key=lambda one: (one[0], one[1].name)):
            why = ""
            if entry.name in self._own:
                why = "Trolley itself has one of this name; it needs another"
            elif entry.name in added:
                other = added[entry.name].package
                why = f"{other} has one of this name, too; uninstall one of them"
            elif not NAME.fullmatch(entry.name):
                why = "a name is 1 to 32 characters of a-z, 0-9 and _"
            if why:
                left_out.append(Refused(self._group, entry.name, package, why))
            else:
                added[entry.name] = Place(entry.value, package)
        return added, left_out

    @property
    def _added(self) -> dict[str, Place]:
        return self._entries[0]

    @property
    def _misnamed(self) -> list[Refused]:
        return self._entries[1]

    def _load(self, name: str, place: Place) -> D:
        """Import a driver.

        Raises:
            DriverUnusable: it is none, or another version's.
        """
        driver = load_named(place.value, name)
        if not (isinstance(driver, self._kind) and driver.group == self._group):
            raise DriverUnusable(f"{place.value} has no driver of a {WORDS[self._group]} there")
        if driver.api != API:
            raise DriverUnusable(
                f"it was written for version {driver.api} of the interface of drivers, and this "
                f"Trolley has version {API}: install another version of it"
            )
        return driver


def load_named(value: str, name: str) -> Any:
    """Return what a dict holds under a name, such as that at "trolley_acme:DRIVERS".

    Raises:
        DriverUnusable: it cannot be imported, whatever that raised, or there is no such dict.
    """
    module, _, attribute = value.partition(":")
    try:
        found: object = getattr(importlib.import_module(module.strip()), attribute.strip())
    except (Exception, SystemExit) as error:
        text = f"{type(error).__name__}: {error}".rstrip(": ").replace("\n", " ")
        raise DriverUnusable(f"{value} cannot be imported ({text})") from error
    if not isinstance(found, dict) or name not in found:
        raise DriverUnusable(f"{value} is not a dict that has {name!r}")
    return cast("dict[str, Any]", found)[name]


def guarded(function: Callable[..., T], note: Callable[[str], None]) -> Callable[..., T | None]:
    """Return a driver's function that gives None where it fails, and notes how it failed.

    What asks all drivers in turn does not end at one that is wrong.
    """

    def call(*arguments: Any) -> T | None:
        try:
            return function(*arguments)
        except Exception as error:
            note(f"{type(error).__name__}: {error}")
            return None

    return call


def read_settings(plain: Mapping[str, Any], kind: type[S], table: str) -> S:
    """Read a driver's own settings.

    Args:
        plain: what robot.toml says.
        kind: what the driver declares.
        table: where they stand in it, such as `base.lidar.settings`.

    Raises:
        DriverUnusable: a key is unknown, missing or not allowed; the text names it.
    """
    try:
        return msgspec.convert(dict(plain), kind)
    except msgspec.ValidationError as error:
        raise DriverUnusable(in_words_of_a_file(str(error), kind, table)) from error
