"""What may be stored: the rules for names, saved poses and tours, and the files they lie in."""

import datetime
from collections.abc import Mapping
from typing import Any, ClassVar, TypeVar

from msgspec import Struct, structs

from trolley import codes
from trolley.codes import Refused
from trolley.geometry import Pose2D
from trolley.geometry.pose import LARGEST
from trolley.messages import SavedPose, Stop, Tour
from trolley.messages.mapping import MAP_NAME, MAX_COORDINATE_M
from trolley.messages.types import fit_into_a_message
from trolley.names import canonical, free_name, name_problem
from trolley.suggestions import did_you_mean

T = TypeVar("T", SavedPose, Tour)

MAX_VIA = 1000
"""Via points of one stop."""
MAX_TEXT = 1000
"""Characters of an icon or a note."""
MAX_ROUNDS = 1_000_000
"""Of a tour; more can only be meant as forever."""
LIMITS = {"repeat": MAX_ROUNDS, "dwell": LARGEST, "timeout": LARGEST}
"""Of a tour and its stops."""


class PosesFile(Struct, frozen=True, kw_only=True):
    """`poses.toml`."""

    poses: list[SavedPose] = []


class ToursFile(Struct, frozen=True, kw_only=True):
    """`tours.toml`."""

    tours: list[Tour] = []

    SCHEMA: ClassVar[int] = 2

    @classmethod
    def bring_forward(cls, plain: dict[str, Any], schema: int) -> dict[str, Any]:
        """Return the content of a file of schema 1: tours had no map, and no limits."""
        del schema
        return limited(plain)


def limited(plain: Any) -> Any:
    """The content of a file, with what is beyond today's limits in its tours at those."""
    if isinstance(plain, list):
        return [limited(one) for one in plain]
    if not isinstance(plain, dict):
        return plain
    return {
        name: min(value, LIMITS[name])
        if name in LIMITS and isinstance(value, int | float)
        else limited(value)
        for name, value in plain.items()
    }


def plain_name(name: str) -> str:
    """The name as it is stored: NFC.

    Raises:
        Refused: It is not a valid name; the message says why.
    """
    problem = name_problem(name)
    if problem is not None:
        raise Refused(codes.BAD_REQUEST, f"{problem[:1].upper()}{problem[1:]}.", name=name)
    return canonical(name)


def key_name(key: str | None, body: str) -> str:
    """The name of a value whose key, if it has one, says `key` and whose body says `body`.

    Raises:
        Refused: The two differ, or the name is not valid.
    """
    if key is None:
        return plain_name(body)
    name = plain_name(key)
    if body and canonical(body) != name:
        raise Refused(
            codes.BAD_REQUEST,
            f"The key says {name!r} and the body {body!r}; leave the name out of the body.",
        )
    return name


def only_chunk(chunks: tuple[str, ...]) -> str:
    """The one name in the key of a deletion.

    Raises:
        Refused: The key has several chunks.
    """
    if len(chunks) != 1:
        raise Refused(codes.BAD_REQUEST, "A deletion must name one value.")
    return chunks[0]


def checked_pose(pose: SavedPose, key: str | None, map_name: str | None) -> SavedPose:
    """The saved pose as it is stored; without a map of its own it belongs to the current one.

    Raises:
        Refused: Something in it is not allowed, or no map is known.
    """
    name = key_name(key, pose.name)
    on_map = pose.map or map_name
    if on_map is None:
        raise Refused(codes.NOT_READY, "No map is loaded yet; say which map the pose is on.")
    _check_map_name(on_map)
    _check_coordinates(pose.pose)
    if max(len(pose.icon), len(pose.note)) > MAX_TEXT:
        raise Refused(codes.TOO_LARGE, f"Icon and note may have {MAX_TEXT} characters at most.")
    if pose.saved_at is not None and parse_utc(pose.saved_at) is None:
        raise Refused(codes.BAD_REQUEST, f"{pose.saved_at!r} is not an ISO 8601 time.")
    return structs.replace(pose, name=name, map=on_map, pose=pose.pose.wrapped())


def _check_map_name(name: str) -> None:
    if not MAP_NAME.fullmatch(name):
        raise Refused(codes.BAD_REQUEST, f"{name!r} is not a valid map name.")


def checked_tour(
    tour: Tour,
    key: str | None = None,
    map_name: str | None = None,
    stored: Tour | None = None,
) -> Tour:
    """The tour as it is stored or driven; one that is only driven needs no name.

    Poses of its own without a map belong to that of the tour `stored` under this name if all were
    in it, else to the current one.

    Raises:
        Refused: Something in it is not allowed.
    """
    if tour.repeat > MAX_ROUNDS:
        raise Refused(
            codes.BAD_REQUEST, f"`repeat` may be {MAX_ROUNDS} at most; 0 repeats the tour forever."
        )
    if stored is not None and _poses(tour) <= _poses(stored):
        map_name = stored.map
    on_map = (tour.map or map_name or "") if tour.has_poses else ""
    if on_map:
        _check_map_name(on_map)
    stops = [_checked_stop(stop, index) for index, stop in enumerate(tour.stops)]
    name = key_name(key, tour.name) if key is not None or tour.name else ""
    return structs.replace(tour, name=name, stops=stops, map=on_map)


def _poses(tour: Tour) -> set[Pose2D]:
    all_poses = (pose for stop in tour.stops for pose in (stop.pose, *stop.via))
    return {pose for pose in all_poses if pose is not None}


def _checked_stop(stop: Stop, index: int) -> Stop:
    if len(stop.via) > MAX_VIA:
        raise Refused(codes.TOO_LARGE, f"Stop {index + 1} has more than {MAX_VIA} via points.")
    _check_coordinates(*stop.via, *(() if stop.pose is None else (stop.pose,)))
    return stop if stop.name is None else structs.replace(stop, name=plain_name(stop.name))


def _check_coordinates(*poses: Pose2D) -> None:
    if any(max(abs(pose.x), abs(pose.y)) > MAX_COORDINATE_M for pose in poses):
        raise Refused(codes.BAD_REQUEST, f"Coordinates may be {MAX_COORDINATE_M:.0f} m at most.")


def parse_utc(text: str) -> datetime.datetime | None:
    """Parse an ISO 8601 time (UTC where it names no zone); None if it is not one."""
    try:
        moment = datetime.datetime.fromisoformat(text)
    except ValueError:
        return None
    if moment.tzinfo is None:
        moment = moment.replace(tzinfo=datetime.UTC)
    return moment


def with_item(items: Mapping[str, T], item: T) -> dict[str, T]:
    """The values with one added or replaced.

    Raises:
        Refused: All together would no longer fit into one message.
    """
    changed = {**items, item.name: item}
    if not fit_into_a_message(list(changed.values())):
        raise Refused(codes.TOO_LARGE, f"There is no room for {item.name!r}; delete others first.")
    return changed


def without_item(items: Mapping[str, T], name: str, kind: str) -> tuple[dict[str, T], T]:
    """The values without the one called `name`, and that one.

    Raises:
        Refused: There is none.
    """
    rest = dict(items)
    found = rest.pop(canonical(name), None)
    if found is None:
        hint = did_you_mean(name, items)
        raise Refused(codes.UNKNOWN_NAME, f"There is no {kind} {name!r}. {hint}")
    return rest, found


def by_name(items: list[T]) -> tuple[dict[str, T], list[str]]:
    """The values read from a file, by their names in NFC; and which names several of them had.

    Of these the first keeps the name, the later ones get a number: `kitchen-2`.
    """
    names = [canonical(item.name) for item in items]
    found: dict[str, T] = {}
    doubled: list[str] = []
    for name, item in zip(names, items, strict=True):
        own = name
        if name in found:
            doubled.append(name)
            own = free_name(name, {*names, *found})
        found[own] = structs.replace(item, name=own)
    return found, doubled


def find_place(poses: Mapping[str, SavedPose], name: str, map_name: str | None) -> Pose2D:
    """Where a saved pose is on the present map (any map while none is known).

    Raises:
        Refused: There is none of that name, or it is on another map.
    """
    saved = poses.get(canonical(name))
    if saved is None:
        hint = did_you_mean(name, poses)
        raise Refused(codes.UNKNOWN_NAME, f"There is no saved place {name!r}. {hint}", name=name)
    if map_name is not None and saved.map != map_name:
        raise Refused(
            codes.WRONG_MAP,
            f"The saved pose {name!r} is on the map {saved.map}, the robot is on {map_name}.",
            map=saved.map,
        )
    return saved.pose
