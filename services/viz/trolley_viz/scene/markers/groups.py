"""Which markers are drawn together: those of one frame and sort, some hundred in a scene node."""

from collections import Counter
from collections.abc import Callable, Mapping
from typing import NamedTuple

from trolley.messages import Marker
from trolley_viz.scene.markers.motion import is_moving
from trolley_viz.scene.markers.solids import SOLIDS

Name = tuple[str, ...]
"""Namespace and id."""

BATCH = 256
"""Markers in one node: what is sent anew when one of them changes."""
MAX_MARKER_FRAMES = 60
MAX_NUMBER = {"text": 200, "icon": 400, "line": 1000}
MAX_POINTS, MAX_ALL_POINTS = 5000, 100_000
"""Number of points of one line, and of all lines."""
MAX_MOVING = 200
"""Further solids are drawn still."""


class Group(NamedTuple):
    """Markers that one scene node draws."""

    frame: str
    sort: str
    """The kind of its markers; `moving` and the kind where they move by themselves."""
    width_mm: int = 0
    """Width of lines."""
    number: int = 0
    """Several where one would be too large."""


class Drawn(NamedTuple):
    """A marker in the scene."""

    marker: Marker
    since_ns: int
    """Local monotonic time at which it came or was changed."""
    group: Group


class Grouping:
    """The markers that are drawn, by group, and which groups have to be drawn anew."""

    def __init__(self) -> None:
        self.members: dict[Group, dict[Name, Drawn]] = {}
        self.dirty: set[Group] = set()
        self.left_out: set[Name] = set()
        """Markers of which there are too many, or that are too long."""
        self._drawn: dict[Name, Drawn] = {}
        self._sorts: Counter[str] = Counter()
        self._frames: Counter[str] = Counter()
        self._num_points = 0

    def take_over(
        self, known: Mapping[Name, Marker], arrived_ns: Callable[[Name], int | None]
    ) -> None:
        """Draw exactly the known markers; those that are equal stay as they are."""
        gone = (self._drawn.keys() | self.left_out) - known.keys()
        for name in gone:
            self._remove(name)
        retried = set(self.left_out) if gone else set[Name]()
        for name, marker in known.items():
            drawn = self._drawn.get(name)
            if drawn is not None and (drawn.marker is marker or drawn.marker == marker):
                continue
            if name not in self.left_out or name in retried:
                self._put(name, marker, arrived_ns(name) or 0)

    def calm_down(self, now_ns: int) -> None:
        """Let those that have jumped their one jump stand still."""
        for group in [one for one in self.members if one.sort.startswith("moving")]:
            for name, drawn in list(self.members[group].items()):
                if not is_moving(drawn.marker, (now_ns - drawn.since_ns) * 1e-9):
                    self._remove(name)
                    self._join(name, drawn.marker, drawn.since_ns, drawn.marker.kind)

    def take_dirty(self) -> dict[Group, list[Drawn]]:
        """The groups that have to be drawn anew, with their markers; asked for once."""
        dirty = {group: list(self.members[group].values()) for group in self.dirty}
        for group, drawn in dirty.items():
            if not drawn:
                del self.members[group]
        self.dirty.clear()
        return dirty

    def _put(self, name: Name, marker: Marker, since_ns: int) -> None:
        self._remove(name)
        if self._is_too_much(marker):
            self.left_out.add(name)
            return
        moves = marker.motion != "none" and self._sorts["moving"] < MAX_MOVING
        sort = f"moving {marker.kind}" if moves and marker.kind in SOLIDS else marker.kind
        self._join(name, marker, since_ns, sort)

    def _is_too_much(self, marker: Marker) -> bool:
        if marker.frame not in self._frames and len(self._frames) >= MAX_MARKER_FRAMES:
            return True
        most = MAX_NUMBER.get(marker.kind)
        is_full = most is not None and self._sorts[marker.kind] >= most
        num_points = len(marker.points)
        is_long = num_points > MAX_POINTS or num_points + self._num_points > MAX_ALL_POINTS
        return is_full or is_long

    def _join(self, name: Name, marker: Marker, since_ns: int, sort: str) -> None:
        width_mm = max(1, round(1000.0 * marker.size[0])) if sort == "line" else 0
        number = 0
        while len(self.members.get(Group(marker.frame, sort, width_mm, number), ())) >= BATCH:
            number += 1
        group = Group(marker.frame, sort, width_mm, number)
        self._drawn[name] = drawn = Drawn(marker, since_ns, group)
        self.members.setdefault(group, {})[name] = drawn
        self.dirty.add(group)
        self._sorts[sort.split()[0]] += 1
        self._frames[marker.frame] += 1
        self._num_points += len(marker.points)

    def _remove(self, name: Name) -> None:
        self.left_out.discard(name)
        drawn = self._drawn.pop(name, None)
        if drawn is None:
            return
        del self.members[drawn.group][name]
        self.dirty.add(drawn.group)
        self._sorts[drawn.group.sort.split()[0]] -= 1
        self._num_points -= len(drawn.marker.points)
        self._frames[drawn.marker.frame] -= 1
        if self._frames[drawn.marker.frame] <= 0:
            del self._frames[drawn.marker.frame]
