"""The map with its walls, and the costmap on it."""

import itertools
from dataclasses import dataclass

import numpy as np
import viser
from numpy.typing import NDArray

from trolley import topics
from trolley.geometry import Pose2D
from trolley.gridmap import OCCUPIED_FROM
from trolley.messages import OccupancyGrid
from trolley_viz.graphics.camera import Bounds, bounds_of
from trolley_viz.graphics.glb import floor_glb
from trolley_viz.graphics.pictures import costmap_picture, map_picture
from trolley_viz.graphics.shapes import Mesh, boxes, place, wall_rectangles
from trolley_viz.robots.view import View
from trolley_viz.scene.layer import WALL_HEIGHT, Z_COSTMAP, Layer


def cells_of(grid: OccupancyGrid) -> NDArray[np.int8]:
    """View a grid's cells, (height, width)."""
    return np.frombuffer(grid.cells, np.int8).reshape(grid.height, grid.width)


def flat_quaternion(yaw: float) -> tuple[float, float, float, float]:
    """Lay a picture on the floor with its row 0 at +y: half a turn about x, then the heading."""
    return 0.0, float(np.cos(0.5 * yaw)), float(np.sin(0.5 * yaw)), 0.0


WALL_SIDE = (44, 50, 62)
"""Darker than on the picture, as the scene is lit."""
OLD_NS = 2_000_000_000
"""How long a map stays below the one that takes its place: by then that is loaded everywhere."""
NUM_NAMES = 3
"""One for the map that is shown, one for that before, and one that was taken away a while ago."""


@dataclass(frozen=True)
class MapModel:
    """A map made ready for drawing, in frame `grid`."""

    floor: bytes
    """The floor as glb."""
    walls: Mesh | None
    """The walls, None where there are none or too many."""

    @classmethod
    def of(cls, grid: OccupancyGrid) -> "MapModel":
        """Make it; touches nothing but the message."""
        cells = cells_of(grid)
        image, factor = map_picture(cells)
        rectangles = wall_rectangles(cells >= OCCUPIED_FROM)
        walls = None
        if rectangles is not None and len(rectangles):
            walls = boxes(rectangles, grid.resolution, WALL_HEIGHT)
        return cls(floor_glb(image, *picture_size(grid, factor)), walls)


class DrawnMap:
    """A map's floor and walls in a scene, while another map takes its place, too.

    Each map has nodes of other names than those that are there: where a glb replaces one of the
    same name, viser shows nothing until it is loaded, and then shows it at the origin, not where it
    was placed. The names come round again, since viser keeps for ever that one was taken away.

    Args:
        scene: of all browsers, or of one.
        path: above its nodes.
    """

    def __init__(self, scene: viser.SceneApi, path: str) -> None:
        self._scene = scene
        self._paths = itertools.cycle([f"{path}/{i}" for i in range(NUM_NAMES)])
        self._old: list[viser.SceneNodeHandle] = []
        self._old_until_ns = 0
        self.nodes: list[viser.SceneNodeHandle] = []
        """Of the newest map."""

    def show(self, model: MapModel, world_T_grid: Pose2D, now_ns: int) -> None:
        """Draw a map over the one before, which stays until this one is surely loaded."""
        self._drop_old()
        self._old_until_ns = now_ns + OLD_NS
        path = next(self._paths)
        floor: viser.SceneNodeHandle = self._scene.add_glb(
            f"{path}/floor", model.floor, cast_shadow=False, receive_shadow=False
        )
        self._old, self.nodes = self.nodes, [floor]
        if model.walls is not None:
            walls = self._scene.add_mesh_simple(
                f"{path}/walls",
                *model.walls,
                color=WALL_SIDE,
                flat_shading=True,
                side="double",
                cast_shadow=False,
                receive_shadow=False,
            )
            self.nodes.append(walls)
        for node in self.nodes:
            place(node, world_T_grid, 0.0)

    def update(self, now_ns: int) -> None:
        """Take away the map before once it is time."""
        if self._old and now_ns >= self._old_until_ns:
            self._drop_old()

    def clear(self) -> None:
        """Take everything away."""
        self._drop_old()
        self._old, self.nodes = self.nodes, []
        self._drop_old()

    def _drop_old(self) -> None:
        for node in self._old:
            node.remove()
        self._old = []


class MapLayer(Layer):
    """The floor plan: floor light, walls raised."""

    key, title = "map", "Map"
    group = "Map"
    source = topics.MAP
    needs = (topics.MAP,)

    def __init__(self, server: viser.ViserServer, above: str) -> None:
        super().__init__(server, above)
        self._map = DrawnMap(self.scene, self.root)
        self._where: tuple[str, Pose2D] | None = None

    def draw(self, view: View) -> None:
        """Draw the map when another one arrived."""
        self._map.update(view.now_ns)
        grid = view.map
        world_T_map = None if grid is None else view.placement.world_T(grid.frame)
        if not self.changed(grid, world_T_map):
            return
        if grid is None or world_T_map is None or grid.width * grid.height == 0:
            self._where = None
            self._map.clear()
            return
        # What grows while it is made stays until it is drawn anew; another map does not.
        where = (grid.name, world_T_map)
        if where != self._where:
            self._where = where
            self._map.clear()
        # A large map takes about a second, and Stop must not wait for it.
        inputs, world_T_grid = self._drawn, world_T_map @ grid.origin

        def show(model: MapModel) -> None:
            if self._drawn is inputs:  # no other map came meanwhile
                with self.server.atomic():
                    self._map.show(model, world_T_grid, view.now_ns)

        view.work(lambda: MapModel.of(grid), show)


class CostmapLayer(Layer):
    """Where the planner lets the robot's centre be."""

    key, title = "costmap", "Costmap near the robot"
    group = "Driving"
    source = topics.COSTMAP
    needs = (topics.COSTMAP,)
    period_s = 0.5
    height = Z_COSTMAP
    on_by_default = False

    def __init__(self, server: viser.ViserServer, above: str) -> None:
        super().__init__(server, above)
        self._node: viser.ImageHandle | None = None

    def draw(self, view: View) -> None:
        """Draw the newest costmap."""
        grid = view.streams.latest(self.needs[0]) if not view.is_away else None
        world_T_frame = None if grid is None else view.placement.world_T(grid.frame)
        if not self.changed(grid, world_T_frame):
            return
        if grid is None or world_T_frame is None or grid.width * grid.height == 0:
            if self._node is not None:
                self._node.visible = False
            return
        image, factor = costmap_picture(cells_of(grid))
        width, height = picture_size(grid, factor)
        centre = world_T_frame @ grid.origin @ Pose2D(0.5 * width, 0.5 * height, 0.0)
        with self.server.atomic():
            if self._node is None:
                self._node = self.scene.add_image(
                    self.path("grid"),
                    image,
                    width,
                    height,
                    format="png",
                    cast_shadow=False,
                    receive_shadow=False,
                )
            else:
                self._node.image = image
                self._node.render_width, self._node.render_height = width, height
            self._node.position = (centre.x, centre.y, self.height)
            self._node.wxyz = flat_quaternion(centre.yaw)
            self._node.visible = True


class GlobalCostmapLayer(CostmapLayer):
    """Where the planner lets the robot's centre be, on the whole map."""

    key, title = "costmap_global", "Costmap of the whole map"
    source = topics.COSTMAP_GLOBAL
    needs = (topics.COSTMAP_GLOBAL,)
    period_s = 1.0
    height = Z_COSTMAP - 0.003


def picture_size(grid: OccupancyGrid, factor: int) -> tuple[float, float]:
    """Width and height [m] of a grid's picture, padded to whole blocks of `factor` cells."""
    block = factor * grid.resolution
    return -(-grid.width // factor) * block, -(-grid.height // factor) * block


def map_bounds(view: View) -> Bounds | None:
    """The box around what is known of the map [m] in the world, None without a map."""
    grid = view.map
    world_T_map = None if grid is None else view.placement.world_T(grid.frame)
    if grid is None or world_T_map is None or grid.width * grid.height == 0:
        return None
    known = cells_of(grid) >= 0
    rows, cols = np.flatnonzero(known.any(axis=1)), np.flatnonzero(known.any(axis=0))
    if not len(rows):
        return None
    x0, x1, y0, y1 = cols[0], cols[-1] + 1, rows[0], rows[-1] + 1
    corners = grid.resolution * np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]], np.float64)
    return bounds_of((world_T_map @ grid.origin).transform_points(corners))
