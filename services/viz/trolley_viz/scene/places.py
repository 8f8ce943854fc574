"""What people put on the map: saved poses and zones."""

from collections.abc import Sequence

import numpy as np
import viser

from trolley import topics
from trolley.messages import SavedPose, Zone
from trolley_viz.scene.layer import WALL_HEIGHT, Z_LABEL, Z_PLACE, Z_ZONE, Layer, View
from trolley_viz.shapes import arrow_outline, closed_segments, flat, open_segments, place

PLACE_COLOUR = (92, 24, 150)
ZONE_COLOURS = {
    "mirror": (0, 170, 205),
    "glass": (110, 190, 235),
    "keepout": (215, 45, 60),
    "speed": (235, 165, 20),
}
SUSPECT_COLOUR = (255, 170, 0)


def current_places(view: View) -> list[SavedPose]:
    """The saved poses that lie on the map in use."""
    saved, grid = view.feeds.latest(topics.POSES), view.feeds.latest(topics.MAP)
    if saved is None:
        return []
    return [one for one in saved.poses if grid is None or one.map == grid.name]


class PlaceLayer(Layer):
    """Saved poses: an arrow and the name."""

    key, title = "places", "Saved poses"
    group = "Map"
    source = topics.POSES

    def __init__(self, server: viser.ViserServer, above: str) -> None:
        super().__init__(server, above)
        self._nodes: dict[str, tuple[viser.MeshHandle, viser.LabelHandle]] = {}
        self._count = 0

    def draw(self, view: View) -> None:
        """Add, move and remove the places as the list changes."""
        world_T_map = view.placement.world_T("map")
        places = current_places(view) if world_T_map is not None else []
        if world_T_map is None or not self.changed(world_T_map, *places):
            return
        for name in self._nodes.keys() - {one.name for one in places}:
            for node in self._nodes.pop(name):
                node.remove()
        for one in places:
            if one.name not in self._nodes:
                self._nodes[one.name] = self._add(one.name)
            arrow, label = self._nodes[one.name]
            pose = world_T_map @ one.pose
            place(arrow, pose, Z_PLACE)
            label.position = (pose.x, pose.y, Z_LABEL)

    def _add(self, name: str) -> tuple[viser.MeshHandle, viser.LabelHandle]:
        self._count += 1  # a number, since a name may hold any letter
        arrow = self.scene.add_mesh_simple(
            self.path(f"arrow{self._count}"),
            *flat(arrow_outline(0.3, 0.22)),
            color=PLACE_COLOUR,
            side="double",
            cast_shadow=False,
        )
        label = self.scene.add_label(
            self.path(f"name{self._count}"), name, anchor="bottom-center", depth_test=False
        )
        return arrow, label


class ZoneLayer(Layer):
    """Mirrors, glass, keep-outs and speed zones."""

    key, title = "zones", "Zones"
    group = "Map"
    source = topics.ZONES

    def __init__(self, server: viser.ViserServer, above: str) -> None:
        super().__init__(server, above)
        self._nodes: list[viser.SceneNodeHandle] = []

    def draw(self, view: View) -> None:
        """Draw all of them anew when one changed."""
        zones = view.feeds.latest(topics.ZONES)
        world_T_map = view.placement.world_T("map")
        if not self.changed(zones, world_T_map):
            return
        for node in self._nodes:
            node.remove()
        self._nodes.clear()
        if world_T_map is None:
            return
        for i, zone in enumerate(zones.zones if zones is not None else []):
            self._add(i, zone, world_T_map.transform_points(np.array(zone.points)))

    def _add(self, i: int, zone: Zone, points: np.ndarray) -> None:
        colour = ZONE_COLOURS[zone.kind]
        if zone.kind in ("mirror", "glass"):
            self._add_line(f"line{i}", points, colour)
        else:
            self._add_area(i, points, colour)
        speed = f" {zone.speed:g} m/s" if zone.speed is not None else ""
        self._add_label(f"name{i}", zone.name + speed, points)

    def _add_line(self, name: str, points: np.ndarray, colour: Sequence[int]) -> None:
        """A line on top of the walls, so that a mirror on a wall is seen."""
        segments = open_segments(points, WALL_HEIGHT + 0.01)
        self._nodes.append(
            self.scene.add_line_segments(
                self.path(name), segments, np.array(colour), thickness=0.07
            )
        )

    def _add_area(self, i: int, points: np.ndarray, colour: Sequence[int]) -> None:
        vertices, faces = flat(points)
        if len(faces):
            area = self.scene.add_mesh_simple(
                self.path(f"area{i}"),
                vertices,
                faces,
                color=np.array(colour),
                opacity=0.3,
                side="double",
                cast_shadow=False,
                receive_shadow=False,
            )
            area.position = (0.0, 0.0, Z_ZONE)
            self._nodes.append(area)
        self._nodes.append(
            self.scene.add_line_segments(
                self.path(f"edge{i}"),
                closed_segments(points, Z_ZONE + 0.005),
                np.array(colour),
                thickness=2.0,
                thickness_units="screen",
            )
        )

    def _add_label(self, name: str, text: str, points: np.ndarray) -> None:
        x, y = points.mean(axis=0).tolist()
        self._nodes.append(
            self.scene.add_label(
                self.path(name),
                text,
                position=(x, y, Z_LABEL + 0.15),
                anchor="bottom-center",
                font_screen_scale=0.8,
            )
        )
