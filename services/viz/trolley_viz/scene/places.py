"""What people put on the map: saved poses and zones."""

from collections.abc import Sequence

import numpy as np
import viser

from trolley import topics
from trolley.messages import SavedPose, Zone
from trolley.zones import LINE_KINDS
from trolley_viz.graphics.pictures import badge
from trolley_viz.graphics.shapes import (
    arrow_outline,
    closed_segments,
    flat,
    open_segments,
    quaternion,
)
from trolley_viz.robots.view import View
from trolley_viz.scene.layer import WALL_HEIGHT, Z_LABEL, Z_PLACE, Z_ZONE, Layer
from trolley_viz.scene.place_labels import PlaceName

PLACE_COLOUR = (92, 24, 150)
ZONE_COLOURS = {
    "mirror": (0, 170, 205),
    "glass": (110, 190, 235),
    "keepout": (215, 45, 60),
    "speed": (235, 165, 20),
    "room": (130, 140, 165),
}
PLACE_ICON = "map-pin"
ICON_SIZE = 0.42
"""Side of a place's icon on the floor [m]."""
SUSPECT_COLOUR = (255, 170, 0)
APPEARED_COLOUR, GONE_COLOUR = (240, 110, 0), (128, 132, 140)


def current_places(view: View) -> list[SavedPose]:
    """The saved poses that lie on the map in use."""
    saved, grid = view.streams.latest(topics.POSES), view.map
    if saved is None:
        return []
    return [one for one in saved.poses if grid is None or one.map == grid.name]


def place_names(view: View) -> list[PlaceName]:
    """The names of the places, above their icons."""
    world_T_map = view.placement.world_T("map")
    if world_T_map is None:
        return []
    spots = [(one.name, world_T_map @ one.pose) for one in current_places(view)]
    return [PlaceName(name, pose.x, pose.y + 0.5 * ICON_SIZE) for name, pose in spots]


class PlaceLayer(Layer):
    """Saved poses: the icon of the place and an arrow for its heading.

    The names are `place_names`; which of them can be read differs from browser to browser.
    """

    key, title = "places", "Saved poses"
    group = "Map"
    source = topics.POSES

    def __init__(self, server: viser.ViserServer, above: str) -> None:
        super().__init__(server, above)
        self._nodes: dict[str, tuple[str, viser.FrameHandle, viser.MeshHandle]] = {}
        """By name: the icon, the place, and the arrow there."""
        self._count = 0

    def draw(self, view: View) -> None:
        """Add, move and remove the places as the list changes."""
        world_T_map = view.placement.world_T("map")
        places = current_places(view) if world_T_map is not None else []
        if world_T_map is None or not self.changed(world_T_map, *places):
            return
        icons = {one.name: one.icon for one in places}
        for name in [name for name, node in self._nodes.items() if node[0] != icons.get(name)]:
            self._nodes.pop(name)[1].remove()  # and all below it
        for one in places:
            if one.name not in self._nodes:
                self._nodes[one.name] = (one.icon, *self._add(one))
            _, spot, arrow = self._nodes[one.name]
            pose = world_T_map @ one.pose
            spot.position = (pose.x, pose.y, 0.0)
            arrow.wxyz = quaternion(pose.yaw)

    def _add(self, one: SavedPose) -> tuple[viser.FrameHandle, viser.MeshHandle]:
        self._count += 1  # a number, since a name may hold any letter
        spot = self.path(f"spot{self._count}")
        frame = self.scene.add_frame(spot, show_axes=False)
        outline = arrow_outline(0.2, 0.26) + np.array([0.5 * ICON_SIZE + 0.01, 0.0])
        arrow = self.scene.add_mesh_simple(
            f"{spot}/arrow", *flat(outline), color=PLACE_COLOUR, side="double", cast_shadow=False
        )
        arrow.position = (0.0, 0.0, Z_PLACE)
        self.scene.add_image(
            f"{spot}/icon",
            badge(one.icon or PLACE_ICON, PLACE_COLOUR),
            ICON_SIZE,
            ICON_SIZE,
            format="png",
            wxyz=(0.0, 1.0, 0.0, 0.0),  # face up, its upper edge at +y
            position=(0.0, 0.0, Z_PLACE + 0.002),
            cast_shadow=False,
            receive_shadow=False,
        )
        return frame, arrow


class ZoneLayer(Layer):
    """Mirrors, glass, no-go and slow areas, and rooms."""

    key, title = "zones", "Zones"
    group = "Map"
    source = topics.ZONES

    def __init__(self, server: viser.ViserServer, above: str) -> None:
        super().__init__(server, above)
        self._nodes: list[viser.SceneNodeHandle] = []

    def draw(self, view: View) -> None:
        """Draw all of them again when one has changed."""
        zones = None if view.map is None else view.streams.latest(topics.ZONES)
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
        if zone.kind in LINE_KINDS:
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
