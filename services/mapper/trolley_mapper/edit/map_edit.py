"""What `map/edit` does to the files: read, change, store; and what the robot must be told then.

All of it touches the disk or takes its time: call it through `Service.work`.
"""

import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypeVar

import msgspec
import numpy as np
from msgspec import Struct

from trolley import codes
from trolley.codes import Refused
from trolley.files import read_text
from trolley.geometry import Pose2D
from trolley.gridmap import OCCUPIED_FROM, GridMap, MapError, load_map
from trolley.map_editing import apply, merge
from trolley.messages import EditMap, MapEdited, Merge, SavedPose, TakeBack, Tour, Zone
from trolley.state_file import Unreadable
from trolley_mapper.edit.map_switch import (
    PLAN_FILE,
    SwitchPlan,
    forget_plan,
    pending_plan,
    store_plan,
)
from trolley_mapper.edit.map_transform import moved_place, moved_tours, moved_zones, renamed_zones
from trolley_mapper.edit.map_versions import Change, MapVersions, Version, stored_zones

MAX_SHOWN = 2000
"""Wall points of a merged map that a preview shows."""
Item = TypeVar("Item", SavedPose, Tour)


@dataclass(frozen=True, slots=True)
class Situation:
    """What an edit has to know of the robot.

    Attributes:
        configured: the YAML file of `[map] file`, which is never written.
        is_on: whether the robot is on the map.
        under_way: a goal or a trip that is not over, if any.
        zones: of the map, where the robot is on it.
        places: all saved ones; None where the tour service does not answer.
        tours: all of them, likewise.
        state: the robot's state folder.
        now: UTC, ISO 8601.
        untold: of an edit whose map the localizer did not load, so that nothing follows it yet.
    """

    configured: Path | None
    is_on: bool
    under_way: Literal["goal", "trip", ""]
    zones: tuple[Zone, ...]
    places: tuple[SavedPose, ...] | None
    tours: tuple[Tour, ...] | None
    state: Path
    now: str | None
    untold: SwitchPlan | None


@dataclass(frozen=True, slots=True)
class Edited:
    """What came of an edit, and what the robot must be told, if anything."""

    reply: MapEdited
    plan: SwitchPlan | None = None


def edit(store: MapVersions, params: EditMap, situation: Situation) -> Edited | Refused:
    """Carry out an edit; one that is refused has changed nothing."""
    try:
        return _Edit(store, params, situation).run()
    except Refused as refused:
        return refused
    except MapError as error:
        return Refused(codes.NOT_SAVED, f"{str(error)[:1].upper()}{str(error)[1:]}.")


class _Edit:
    """One request."""

    def __init__(self, store: MapVersions, params: EditMap, situation: Situation) -> None:
        self._store, self._params, self._situation = store, params, situation
        self._name = params.name
        self._target = params.as_name or params.name
        self._old_T_new = Pose2D.identity()
        self._said: list[str] = []
        self._reply = MapEdited(state="preview", name=self._target, message="")

    def run(self) -> Edited:
        """Do it."""
        ops = self._params.ops
        file = self._file(self._name)
        if any(isinstance(op, TakeBack) for op in ops):
            return self._take_back()
        self._check_target()
        grid, zones = load_map(file, self._name), self._zones(self._name, file)
        added: list[str] = []
        for op in ops:
            if isinstance(op, Merge):
                grid, come = self._merge(grid, op)
                free = renamed_zones(come, {zone.name for zone in zones})
                zones += free
                added += [zone.name for zone in free]
                continue
            grid, step = apply(grid, op)
            self._old_T_new = self._old_T_new @ step
            zones = moved_zones(zones, step)
            self._say(type(op).__name__)
        self._say_size(grid)
        if self._params.preview:
            return Edited(self._reply)
        self._check_may_move(is_more=bool(added))
        return self._save(grid, zones, added)

    def _save(self, grid: GridMap, zones: list[Zone], added: list[str]) -> Edited:
        is_new = self._target != self._name
        situation = self._situation
        change = Change(
            what=", ".join(self._said),
            old_T_new=self._old_T_new,
            made_of=self._name if is_new else None,
            zones_added=added,
            saved_at=situation.now,
        )
        named = GridMap(self._target, grid.resolution, grid.origin, grid.cells)
        is_moved = is_new or self._old_T_new != Pose2D.identity() or bool(added)
        plan = self._store_plan(
            self._store.next_number(self._target), zones if is_moved else [], []
        )
        before = list(situation.zones) if not is_new else []
        with self._void_unless_stored(plan):
            version = self._store.save(named, change, before, zones if is_moved else None)
        return Edited(self._done(version, ""), plan)

    def _take_back(self) -> Edited:
        if len(self._params.ops) > 1 or self._params.as_name is not None:
            raise Refused(codes.BAD_REQUEST, "Undo cannot be combined with other changes.")
        now = self._store.newest(self._name)
        if now is None or (now.before is None and now.made_of is None):
            raise Refused(codes.BAD_REQUEST, f"There is nothing to undo on the map {self._name}.")
        untold = self._untold(now.number)
        if untold is None:
            self._old_T_new = now.before_T_this.inverse()
        if self._params.preview:
            return Edited(self._reply)
        if now.before is None and now.made_of is not None:
            return self._back_to(now.made_of)
        if untold is not None:
            # The robot is on the version before, and all lies as it does there.
            zones = list(self._situation.zones)
            version = self._previous(untold.zones or zones, zones)
            return Edited(self._done(version, "Undone"), self._store_plan(version.number, [], []))
        self._check_may_move(is_more=bool(now.zones_added))
        gone = [zone.name for zone in self._situation.zones if zone.name in now.zones_added]
        kept = [zone for zone in self._situation.zones if zone.name not in gone]
        zones = moved_zones(kept, self._old_T_new)
        is_moved = self._old_T_new != Pose2D.identity() or bool(gone)
        plan = self._store_plan(
            self._store.next_number(self._name), zones if is_moved else [], gone
        )
        with self._void_unless_stored(plan):
            version = self._previous(list(self._situation.zones), zones if is_moved else None)
        return Edited(self._done(version, "Undone"), plan)

    def _untold(self, number: int) -> SwitchPlan | None:
        """Return the plan that led to a version of the map where nothing followed it."""
        plan = self._situation.untold
        if plan is None or plan.is_to_other:
            return None
        return plan if (plan.map, plan.version) == (self._name, number) else None

    def _previous(self, zones_before: list[Zone], zones: list[Zone] | None) -> Version:
        """Make the previous version the newest again.

        Raises:
            Refused: it is no longer kept.
        """
        now = self._situation.now
        try:
            return self._store.take_back(self._name, zones_before, zones, now)
        except LookupError as error:
            raise Refused(
                codes.BAD_REQUEST, f"The previous version of {self._name} is no longer kept."
            ) from error

    def _back_to(self, former: str) -> Edited:
        """Go back from a first version to the map that it was made of; both stay as they are."""
        self._file(former)
        self._target = former
        self._check_may_move(is_more=True)
        plan = self._store_plan(None, [], [])
        message = f"Undone: the robot is back on the map {former}; {self._name} is kept."
        return Edited(MapEdited(state="saved", name=former, message=message), plan)

    # Checks.

    def _file(self, name: str) -> Path:
        configured = self._situation.configured
        file = self._store.file_of(name)
        if configured is not None and configured.stem == name:
            file = configured
        if not file.exists():
            raise Refused(codes.UNKNOWN_NAME, f"There is no map {name!r}.", name=name)
        return file

    def _check_target(self) -> None:
        configured = self._situation.configured
        if configured is not None and self._target == configured.stem:
            raise Refused(
                codes.EXISTS,
                f"The map {self._target} is your original file, which is never overwritten: "
                f"store the changed map under another name (`--as NAME`).",
                name=self._target,
            )
        if self._target != self._name and self._store.file_of(self._target).exists():
            raise Refused(
                codes.EXISTS, f"The map {self._target!r} already exists; choose another name."
            )

    def _check_may_move(self, *, is_more: bool) -> None:
        """Refuse what would leave zones, places or a robot where they do not belong any more."""
        situation, is_turned = self._situation, self._old_T_new != Pose2D.identity()
        in_place = self._target == self._name
        if is_turned and situation.is_on and situation.under_way:
            raise Refused(codes.BUSY, _BUSY[situation.under_way])
        if not in_place or not (is_turned or is_more):
            return
        if not situation.is_on:
            raise Refused(
                codes.WRONG_MAP,
                f"Load the map {self._name} first, so that its zones and places change with it.",
            )
        others = _others_on(situation.state, self._name) if is_turned else []
        if others:
            raise Refused(
                codes.EXISTS,
                f"{', '.join(others)} would be lost: last seen on the map {self._name}. Store "
                "the changed map under another name.",
            )

    # Parts.

    def _merge(self, grid: GridMap, op: Merge) -> tuple[GridMap, list[Zone]]:
        file = self._file(op.name)
        other = load_map(file, op.name)
        if op.pose is None:
            # SciPy is loaded when it is needed: the service is small while it does nothing.
            from trolley_mapper.edit.map_alignment import align_maps

            found = align_maps(grid, other)
            pose = found.this_T_other
            self._said.append(
                f"merged {op.name} ({found.agreeing_m:.1f} m of its walls match, {found.share:.0%})"
            )
        else:
            pose = op.pose
            self._said.append(f"merged {op.name}")
        walls = other.cell_to_world(np.argwhere(other.cells >= OCCUPIED_FROM))
        shown = walls[:: max(1, -(-len(walls) // MAX_SHOWN))]
        points = [(float(x), float(y)) for x, y in pose.transform_points(shown)]
        self._reply = msgspec.structs.replace(self._reply, placed=pose, walls=points)
        zones = moved_zones(self._zones(op.name, file), pose.inverse())
        return merge(grid, other, pose), zones

    def _zones(self, name: str, file: Path) -> list[Zone]:
        """Return the zones of a map: those that the robot has, else those beside its file."""
        if self._situation.is_on and name == self._name:
            return list(self._situation.zones)
        try:
            return stored_zones(self._situation.state, file)
        except (OSError, Unreadable) as error:
            why = f"The zones of {name} cannot be read: {error}."
            raise Refused(codes.NOT_SAVED, why) from error

    def _store_plan(
        self, version: int | None, zones: list[Zone], gone: list[str]
    ) -> SwitchPlan | None:
        """Write down what the robot must be told before the map is stored.

        That of an edit before it which led to another map, and was not loaded, is void from now on.

        Raises:
            Refused: `busy` while it has not been told of the edit before; `not_saved`.
        """
        state = self._situation.state
        former, untold = pending_plan(state, self._store), self._situation.untold
        is_void = untold is not None and untold.is_to_other and former == untold
        if isinstance(former, SwitchPlan) and not is_void:
            raise Refused(
                codes.BUSY,
                f"Zones and places do not know yet of the edit before, of {former.map}: load "
                f"{former.map} and restart the mapper; or, to leave them as they are, delete "
                f"{state / PLAN_FILE}.",
            )
        if not self._situation.is_on:
            if is_void:
                forget_plan(state)
            return None
        plan = SwitchPlan(
            map=self._target,
            of=self._name,
            version=version,
            old_T_new=self._old_T_new,
            zones=zones,
            zones_gone=gone,
            places=self._places(),
            tours=self._tours(),
        )
        try:
            store_plan(state, plan)
        except OSError as error:
            raise Refused(
                codes.NOT_SAVED, f"The edit could not be written to disk: {error.strerror}."
            ) from error
        return plan

    @contextmanager
    def _void_unless_stored(self, plan: SwitchPlan | None) -> Iterator[None]:
        """Forget a plan whose map was not stored: it would wait for the next map of that number."""
        try:
            yield
        except (MapError, Refused):
            if plan is not None:
                forget_plan(self._situation.state)
            raise

    def _places(self) -> list[SavedPose]:
        """Return the places of the map as they are to be."""
        step, target = self._old_T_new, self._target
        if target == self._name and step == Pose2D.identity():
            return []
        known = _known(self._situation.places)
        mine = (place for place in known if place.map == self._name)
        return [moved_place(place, target, step) for place in mine]

    def _tours(self) -> list[Tour]:
        """Return the tours with poses of their own on the map, as they are to be.

        Those that tell no map are of this one where it turns, for want of better knowledge.
        """
        step, target = self._old_T_new, self._target
        is_turned = step != Pose2D.identity()
        if target == self._name and not is_turned:
            return []
        maps = (self._name, "") if is_turned else (self._name,)
        known = _known(self._situation.tours)
        return moved_tours(known, maps, target, step)

    def _say(self, what: str) -> None:
        words = _WORDS.get(what, what)
        if words not in self._said:
            self._said.append(words)

    def _say_size(self, grid: GridMap) -> None:
        width, height = grid.size_m
        text = ", ".join(self._said)
        self._reply = msgspec.structs.replace(
            self._reply, message=f"{text[:1].upper()}{text[1:]}.", width=width, height=height
        )

    def _done(self, version: Version, word: str) -> MapEdited:
        message = f"{word or self._reply.message.rstrip('.')}: {self._target} is stored as version "
        return msgspec.structs.replace(
            self._reply,
            state="saved",
            version=version.number,
            message=f"{message}{version.number}.",
        )


def _known(items: tuple[Item, ...] | None) -> tuple[Item, ...]:
    """Return places or tours; those that are not known would stay behind, in the wrong place.

    Raises:
        Refused: `not_ready`.
    """
    if items is None:
        why = "The saved places could not be moved along: the tour service does not answer."
        raise Refused(codes.NOT_READY, why)
    return items


_BUSY = {
    "goal": "The robot is driving; its goal would move with the map.",
    "trip": "A tour is under way or paused, and its stops would move with the map; end it first.",
}
_WORDS = {
    "EraseArea": "erased",
    "EraseStroke": "erased",
    "DrawWall": "drew a wall",
    "Turn": "turned",
    "Crop": "cropped",
}


class _LastPose(Struct, frozen=True, kw_only=True):
    map: str


def _others_on(state: Path, name: str) -> list[str]:
    """Return the other robots of this host that were last on a map."""
    found: list[str] = []
    for file in sorted(state.parent.glob("*/last_pose.toml")):
        try:
            last = msgspec.convert(tomllib.loads(read_text(file)), _LastPose)
        except (OSError, ValueError, msgspec.ValidationError):
            continue
        if file.parent != state and last.map == name:
            found.append(file.parent.name)
    return found
