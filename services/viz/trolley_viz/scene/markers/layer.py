"""What programs draw into the scene: markers, in whatever frame of the robot they stand.

A marker hangs under a node of its frame, so that one that rides on the robot costs nothing while
the robot drives. Icons turn to whoever looks, so each browser draws them for itself.
"""

import itertools
from collections.abc import Mapping
from typing import cast

import viser

from trolley import topics
from trolley.geometry import MissingLink, Pose2D
from trolley.geometry.relation import Frames, Relation, relation
from trolley.messages import Marker
from trolley.runtime.service import Watch
from trolley_viz.graphics.icons import known_icon
from trolley_viz.graphics.shapes import quaternion
from trolley_viz.robots.frames import frames_of, why_nowhere
from trolley_viz.robots.view import View
from trolley_viz.scene.layer import Layer
from trolley_viz.scene.markers.groups import Drawn, Group, Grouping
from trolley_viz.scene.markers.icons import Icon
from trolley_viz.scene.markers.motion import placed
from trolley_viz.scene.markers.nodes import Labels, Lines, MarkerNodes
from trolley_viz.scene.markers.solids import Batch, Placed, Solid, within_reach

NUM_FINE = 2
"""Number of batches of each kind that are drawn round; further ones are coarser."""
MAX_NOTES = 8

Found = Mapping[str, Relation | str]
"""Where frames are in the world, or why they are nowhere."""


class MarkerLayer(Layer):
    """Spheres, cubes, cylinders, arrows, lines, texts and icons of any program."""

    key, title = "markers", "Markers from programs"
    group = "Map"
    needs = (topics.MARKER,)
    period_s = 0.1

    def __init__(self, server: viser.ViserServer, above: str) -> None:
        super().__init__(server, above)
        self.icons: list[Icon] = []
        """Those that have a place now."""
        self.notes: list[str] = []
        """What is not drawn, and why, for people."""
        self._grouping = Grouping()
        self._nodes: dict[Group, MarkerNodes] = {}
        self._frames: dict[str, viser.FrameHandle] = {}

    def draw(self, view: View) -> None:
        """Take over what changed, and move what moves."""
        watch = view.streams.watch(topics.MARKER)
        if watch is None or not (watch.by_parts or self._frames):
            return
        _drop_ended(watch, view.now_ns)
        self._grouping.take_over(watch.by_parts, watch.arrived)
        self._grouping.calm_down(view.now_ns)
        used = {group.frame for group, members in self._grouping.members.items() if members}
        found = _find(frames_of(view.streams, view.robot_ns, used), view.placement.world, used)
        with self.server.atomic():
            self._place_frames(found)
            self._draw_groups(view.now_ns)
        self.icons = self._place_icons(found, view.now_ns)
        self.notes = self._say(found, is_full=watch.is_full)

    def _place_frames(self, found: Found) -> None:
        """Move the node of each frame; markers of a frame that has no place are hidden."""
        for frame in self._frames.keys() - found.keys():
            self._frames.pop(frame).remove()
            for group in [one for one in self._nodes if one.frame == frame]:
                del self._nodes[group]
        for frame, where in found.items():
            if frame not in self._frames:
                used = {node.name for node in self._frames.values()}
                # The first that is free: viser keeps for ever that a name was taken away.
                paths = (self.path(f"frame{i}") for i in itertools.count())
                path = next(path for path in paths if path not in used)
                self._frames[frame] = self.scene.add_frame(path, show_axes=False)
            node = self._frames[frame]
            node.visible = not isinstance(where, str)
            if not isinstance(where, str):
                node.position = within_reach(where.translation)
                node.wxyz = quaternion(where.yaw)

    def _draw_groups(self, now_ns: int) -> None:
        grouping = self._grouping
        moving = {
            group: list(members.values())
            for group, members in grouping.members.items()
            if group.sort.startswith("moving")
        }
        for group, drawn in (moving | grouping.take_dirty()).items():
            if group.sort == "icon" or group.frame not in self._frames:
                continue
            if drawn and group not in self._nodes:
                self._nodes[group] = self._new_nodes(group)
            if group in self._nodes:
                self._nodes[group].show([_placed(one, now_ns) for one in drawn])
            if not drawn:
                self._nodes.pop(group, None)

    def _new_nodes(self, group: Group) -> MarkerNodes:
        sort = group.sort.replace(" ", "_")
        path = f"{self._frames[group.frame].name}/{sort}{group.width_mm}n{group.number}"
        if group.sort == "line":
            return Lines(self.scene, path, group.width_mm * 1e-3)
        if group.sort == "text":
            return Labels(self.scene, path)
        kind = cast("Solid", group.sort.split()[-1])
        return Batch(self.scene, path, kind, fine=group.number < NUM_FINE)

    def _place_icons(self, found: Found, now_ns: int) -> list[Icon]:
        icons: list[Icon] = []
        for group, members in self._grouping.members.items():
            where = found.get(group.frame)
            if group.sort != "icon" or where is None or isinstance(where, str):
                continue
            icons += [_icon(_placed(one, now_ns), where) for one in members.values()]
        return icons

    def _say(self, found: Found, *, is_full: bool) -> list[str]:
        """What is not drawn, and why."""
        grouping, notes = self._grouping, list[str]()
        if is_full:
            notes.append("There are too many markers; the last ones are not drawn.")
        if grouping.left_out:
            count = _count(len(grouping.left_out))
            notes.append(
                f"{count} not drawn: there are too many of their kind, or they are too long."
            )
        for frame, where in found.items():
            if isinstance(where, str):
                members = [m for group, m in grouping.members.items() if group.frame == frame]
                notes.append(f"{_count(sum(map(len, members)))} not drawn. {where}")
        unknown = {one.name for one in self.icons if known_icon(one.name) is None}
        notes += [f"There is no icon “{name[:40]}”." for name in sorted(unknown)]
        more = len(notes) - MAX_NOTES
        return [*notes[:MAX_NOTES], f"… and {more} more."] if more > 0 else notes


def _drop_ended(watch: Watch[Marker], now_ns: int) -> None:
    """Forget the markers whose lifetime is over, counted from their arrival."""

    def has_ended(name: tuple[str, ...], marker: Marker) -> bool:
        arrived_ns = watch.arrived(name)
        if marker.lifetime <= 0.0 or arrived_ns is None:
            return False
        return now_ns - arrived_ns >= marker.lifetime * 1e9

    if any(has_ended(name, marker) for name, marker in watch.by_parts.items()):
        watch.forget(has_ended)


def _find(frames: Frames, world: str, used: set[str]) -> Found:
    found: dict[str, Relation | str] = {}
    for frame in sorted(used):
        try:
            found[frame] = relation(frames, world, frame)
        except MissingLink as missing:
            found[frame] = why_nowhere(frames, missing)
    return found


def _placed(drawn: Drawn, now_ns: int) -> Placed:
    return placed(drawn.marker, (now_ns - drawn.since_ns) * 1e-9)


def _icon(one: Placed, where: Relation) -> Icon:
    marker, (x, y, z) = one.marker, where.translation
    turned = Pose2D(x, y, where.yaw) @ marker.pose
    return Icon(
        name=marker.icon,
        color=marker.color,
        size=marker.size[0],
        position=(turned.x, turned.y, z + marker.z + one.lift),
        yaw=turned.yaw,
        turn=one.turn,
    )


def _count(number: int) -> str:
    return "One marker is" if number == 1 else f"{number} markers are"
