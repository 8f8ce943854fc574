"""Saved places on the map that is being made: they move with it when loops are closed."""

import math
from collections.abc import Iterable, Mapping
from typing import Protocol

from msgspec import structs

from trolley.geometry import Pose2D, angle_difference
from trolley.messages import SavedPose
from trolley_mapper.slam.estimate import Anchor

MOVED_M = 0.01
"""Distance that a place must have moved to be corrected [m]."""
MOVED_RAD = math.radians(0.5)
"""Turn that a place must have made to be corrected [rad]."""


class MapAnchoring(Protocol):
    """What ties poses to the map (the core's `Mapper`)."""

    def anchor(self, map_T_pose: Pose2D) -> Anchor:
        """Tie a pose to the map."""
        ...

    def moved(self, anchor: Anchor) -> Pose2D:
        """Return where it lies now."""
        ...


class AnchoredPlaces:
    """The places of one map, each tied to it where it was when it was first seen there.

    Args:
        anchors: of a run before, by the name of the place.
        saved_at: when these places had been saved, which a new pose changes, but not the mapper.
        older: when those had been saved that were there before the map was begun; None while that
            is not known.
    """

    def __init__(
        self,
        anchors: Mapping[str, Anchor] | None = None,
        saved_at: Mapping[str, str | None] | None = None,
        older: Mapping[str, str | None] | None = None,
    ) -> None:
        self.anchors = dict(anchors or {})
        self.saved_at = dict(saved_at or {})
        self.older = None if older is None else dict(older)
        self._stored: dict[str, SavedPose] = {}
        self._moved: dict[str, SavedPose] = {}
        """What is to be stored, is being stored, or was refused."""

    def update(self, poses: Iterable[SavedPose], map_name: str, core: MapAnchoring) -> None:
        """Learn what is stored; a place that somebody has moved is tied anew."""
        before = self._stored
        self._stored = {one.name: one for one in poses if one.map == map_name}
        for name in self.anchors.keys() - self._stored.keys():
            del self.anchors[name]
        for name, place in self._stored.items():
            known = before.get(name)
            is_news = known is not None and place != self._moved.get(name)
            was_moved = is_news and differ(known.pose, place.pose)
            is_saved_anew = place.saved_at != self.saved_at.get(name, place.saved_at)
            if name not in self.anchors or was_moved or is_saved_anew:
                self.anchors[name] = core.anchor(place.pose)
        self.saved_at = {name: place.saved_at for name, place in self._stored.items()}

    def is_newer(self, name: str, saved_at: str | None) -> bool:
        """Say whether a place was saved since the map was begun."""
        older = self.older
        return older is not None and not (name in older and older[name] == saved_at)

    def recall(self, poses: Iterable[SavedPose], map_name: str) -> None:
        """Learn what is stored only after the map was saved: of what a run before tied to it."""
        self._stored = {
            one.name: one
            for one in poses
            if one.map == map_name
            and one.name in self.anchors
            and one.saved_at == self.saved_at.get(one.name, one.saved_at)
        }

    def drop_changed(self, poses: Iterable[SavedPose]) -> None:
        """Leave alone those that somebody has deleted or changed since the map was saved."""
        before = self._stored
        self._stored = {
            one.name: one
            for one in poses
            if one.name in before and one in (before[one.name], self._moved.get(one.name))
        }

    def tie_anew(self, core: MapAnchoring) -> None:
        """Tie all places to the map as it is now."""
        for name, place in self._stored.items():
            self.anchors[name] = core.anchor(place.pose)

    def tie_loose(self, core: MapAnchoring) -> None:
        """Tie those to the map that were saved before anything of it was seen."""
        for name, anchor in self.anchors.items():
            if anchor.keyframe < 0:
                self.anchors[name] = core.anchor(anchor.keyframe_T_pose)

    def moved(self, core: MapAnchoring, map_name: str | None = None) -> list[SavedPose]:
        """Return the places that lie elsewhere now, as they are to be stored.

        Args:
            core: knows where they are.
            map_name: the map that they are to belong to, if not the previous one.
        """
        moved: dict[str, SavedPose] = {}
        for name, place in self._stored.items():
            pose = core.moved(self.anchors[name]).wrapped()
            if not differ(place.pose, pose):
                pose = place.pose
            right = structs.replace(place, pose=pose, map=map_name or place.map)
            if right != place:
                moved[name] = right
        self._moved |= moved
        return list(moved.values())

    def stored(self, place: SavedPose) -> None:
        """Learn that a place is stored as it was to be, unless it has been deleted since."""
        self._moved.pop(place.name, None)
        if place.name in self._stored:
            self._stored[place.name] = place


def differ(one: Pose2D, other: Pose2D) -> bool:
    """Say whether two poses are far enough apart for what lies there to be moved."""
    turned = abs(angle_difference(one.yaw, other.yaw))
    return one.distance_to(other) > MOVED_M or turned > MOVED_RAD
