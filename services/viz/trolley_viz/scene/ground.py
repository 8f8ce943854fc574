"""The map with its walls, and the costmap on it."""

import numpy as np
import viser
from numpy.typing import NDArray

from trolley import topics
from trolley.geometry import Pose2D
from trolley.gridmap import OCCUPIED_FROM
from trolley.messages import OccupancyGrid
from trolley_viz.camera import Bounds, bounds_of
from trolley_viz.pictures import WALL, costmap_picture, map_picture
from trolley_viz.scene.layer import WALL_HEIGHT, Z_COSTMAP, Layer, View
from trolley_viz.shapes import boxes, place, wall_rectangles


def cells_of(grid: OccupancyGrid) -> NDArray[np.int8]:
    """View a grid's cells, (height, width)."""
    return np.frombuffer(grid.cells, np.int8).reshape(grid.height, grid.width)


def flat_quaternion(yaw: float) -> tuple[float, float, float, float]:
    """Lay a picture on the floor with its row 0 at +y: half a turn about x, then the heading."""
    return 0.0, float(np.cos(0.5 * yaw)), float(np.sin(0.5 * yaw)), 0.0


class Picture:
    """A grid drawn as a picture on the floor; the node is kept and updated."""

    def __init__(self, scene: viser.SceneApi, path: str, z: float) -> None:
        self._scene, self._path, self._z = scene, path, z
        self._node: viser.ImageHandle | None = None

    def show(
        self, image: NDArray[np.uint8], size: tuple[float, float], world_T_grid: Pose2D
    ) -> None:
        """Draw an image of `size` width, height [m], its lower left corner at `world_T_grid`."""
        if self._node is None:
            self._node = self._scene.add_image(
                self._path, image, *size, format="png", cast_shadow=False, receive_shadow=False
            )
        else:
            self._node.image = image
            self._node.render_width, self._node.render_height = size
        centre = world_T_grid @ Pose2D(0.5 * size[0], 0.5 * size[1], 0.0)
        self._node.position = (centre.x, centre.y, self._z)
        self._node.wxyz = flat_quaternion(centre.yaw)
        self._node.visible = True

    def hide(self) -> None:
        """Draw nothing."""
        if self._node is not None:
            self._node.visible = False


class MapLayer(Layer):
    """The floor plan: floor light, walls raised."""

    key, title = "map", "Map"
    needs = (topics.MAP,)
    period_s = 0.5

    def __init__(self, server: viser.ViserServer) -> None:
        super().__init__(server)
        self._floor = Picture(self.scene, self.path("floor"), 0.0)
        self._walls: viser.MeshHandle | None = None

    def draw(self, view: View) -> None:
        """Draw the map when another one arrived."""
        grid = view.feeds.latest(topics.MAP)
        world_T_map = None if grid is None else view.placement.world_T(grid.frame)
        if not self.changed(grid, world_T_map):
            return
        if self._walls is not None:
            self._walls.remove()
            self._walls = None
        if grid is None or world_T_map is None or grid.width * grid.height == 0:
            self._floor.hide()
            return
        cells, world_T_grid = cells_of(grid), world_T_map @ grid.origin
        image, factor = map_picture(cells)
        with self.server.atomic():
            self._floor.show(image, picture_size(grid, factor), world_T_grid)
            rectangles = wall_rectangles(cells >= OCCUPIED_FROM)
            if rectangles is not None and len(rectangles):
                vertices, faces = boxes(rectangles, grid.resolution, WALL_HEIGHT)
                self._walls = self.scene.add_mesh_simple(
                    self.path("walls"),
                    vertices,
                    faces,
                    color=WALL,
                    flat_shading=True,
                    side="double",
                    cast_shadow=False,
                    receive_shadow=False,
                )
                place(self._walls, world_T_grid, 0.0)


class CostmapLayer(Layer):
    """Where the planner lets the robot's centre be."""

    key, title = "costmap", "Costmap"
    needs = (topics.COSTMAP,)
    period_s = 0.5
    on_by_default = False

    def __init__(self, server: viser.ViserServer) -> None:
        super().__init__(server)
        self._picture = Picture(self.scene, self.path("grid"), Z_COSTMAP)

    def draw(self, view: View) -> None:
        """Draw the newest costmap."""
        grid = view.feeds.latest(topics.COSTMAP)
        world_T_frame = None if grid is None else view.placement.world_T(grid.frame)
        if not self.changed(grid, world_T_frame):
            return
        if grid is None or world_T_frame is None or grid.width * grid.height == 0:
            self._picture.hide()
            return
        image, factor = costmap_picture(cells_of(grid))
        with self.server.atomic():
            self._picture.show(image, picture_size(grid, factor), world_T_frame @ grid.origin)


def picture_size(grid: OccupancyGrid, factor: int) -> tuple[float, float]:
    """Width and height [m] of a grid's picture, padded to whole blocks of `factor` cells."""
    block = factor * grid.resolution
    return -(-grid.width // factor) * block, -(-grid.height // factor) * block


def map_bounds(view: View) -> Bounds | None:
    """The box around what is known of the map [m] in the world, None without a map."""
    grid = view.feeds.latest(topics.MAP)
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
