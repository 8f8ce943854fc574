"""The canvas of one browser while somebody draws: the floor, the outline, the handles.

viser tells of presses, drags and releases, not of a pointer that merely hovers: the line to the
next corner is seen while it is dragged.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import viser
from numpy.typing import NDArray

from trolley_viz.graphics.shapes import closed_segments, meet_floor, open_segments
from trolley_viz.pointing.drags import Drags, Ray
from trolley_viz.pointing.picture import Picture
from trolley_viz.pointing.pointer import add_floor
from trolley_viz.pointing.sketch import Point, Sketch
from trolley_viz.scene.layer import WALL_HEIGHT

REACH_SHARE = 0.015
"""How near is "at the same place", as a share of the distance from the camera."""
HANDLE_SHARE = 0.011
"""Size of a handle: a share of the distance from the camera; the one that moves all is larger."""
MAX_HANDLES = 100
Z_SKETCH = WALL_HEIGHT + 0.05

Colour = tuple[int, int, int]
FINE: Colour = (0, 140, 40)
BAD: Colour = (214, 30, 30)
CORNER_COLOUR, MIDDLE_COLOUR = (250, 200, 0), (30, 100, 255)

Phase = Literal["start", "update", "end"]
Dragged = Callable[[Phase, Point, Point | None], None]
Moved = Callable[[Phase, int, Point], None]

OCTAHEDRON = np.array(
    [[1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], np.float32
)
OCTAHEDRON_FACES = np.array(
    [[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4], [1, 0, 5], [2, 1, 5], [3, 2, 5], [0, 3, 5]],
    np.uint32,
)


@dataclass(frozen=True)
class PointerHandlers:
    """What to call for the pointer; points are x, y [m], reaches [m]."""

    tapped: Callable[[Point, float], None]
    """Pressed and released at a point; within the reach is the same place."""
    dragged: Dragged | None = None
    """From where to where, which is None while the pointer is not over the floor. Without it
    drags turn the camera."""


class Canvas:
    """Shows an outline in the scene of one browser and takes the pointer; on the service's thread.

    Args:
        picture: of the page.
        drags: tells which drags and clicks were meant.
    """

    def __init__(self, picture: Picture, drags: Drags) -> None:
        self._picture = picture
        self._drags = drags
        self._floor: viser.MeshHandle | None = None
        self._line: viser.LineSegmentsHandle | None = None
        self._dots: viser.BatchedMeshHandle | None = None
        self._handles: viser.BatchedMeshHandle | None = None
        self._size = 1.0

    def listen(self, strokes: PointerHandlers) -> None:
        """Take clicks and drags on the floor until `release`."""
        self.release()
        scene = self._picture.scene
        if scene is None:
            return
        floor = self._floor = add_floor(scene, "/drawing/floor")

        def tapped(ray: Ray) -> None:
            met = meet_floor(*ray)
            if met is not None:
                strokes.tapped(met, REACH_SHARE * math.dist(np.asarray(ray[0]), (*met, 0.0)))

        self._drags.lay_floor(self, floor, tapped)
        if strokes.dragged is not None:
            self._take_drags(floor, strokes.dragged)

    def _take_drags(self, floor: viser.MeshHandle, dragged: Dragged) -> None:
        # async, so that the phases of a drag arrive in order; see viser's note on `on_drag`.
        async def drag(event: viser.SceneNodeDragEvent[Any]) -> None:
            x, y, _ = event.start_position
            now, phase = floor_under(event), event.phase
            if math.isfinite(x) and math.isfinite(y):  # a page may send anything
                self._drags.take(
                    event,
                    lambda: dragged(phase, (x, y), now),
                    lambda: dragged(phase, (x, y), None),
                )

        floor.on_drag("left")(drag)

    def release(self) -> None:
        """Give clicks and drags back to the camera."""
        self._drags.lift_floor(self)
        if self._floor is not None:
            self._floor.remove()
            self._floor = None

    def show(self, sketch: Sketch | None, rubber: Point | None = None) -> None:
        """Draw the outline, on to where the pointer is; red where it crosses itself."""
        client = self._picture.client
        if sketch is None or client is None:
            self._line = _removed(self._line)
            self._dots = _removed(self._dots)
            return
        whole = sketch if rubber is None else sketch.add(rubber)
        colour = BAD if whole.crosses() else FINE
        self._show_line(client, whole, colour)
        self._show_dots(client, np.array(whole.points).reshape(-1, 2), colour)

    def show_handles(self, sketch: Sketch | None, moved: Moved | None = None) -> None:
        """Offer handles for the corners, and one more in the middle that moves the whole.

        Args:
            sketch: what they belong to; None: none.
            moved: called with the handle's number (the whole: that of corners) and how far it
                was dragged since the start, x, y [m].
        """
        client = self._picture.client
        if sketch is None or moved is None or client is None:
            self._handles = _removed(self._handles)
            return
        places = handle_places(sketch)
        if self._handles is not None and len(self._handles.batched_positions) == len(places):
            self._handles.batched_positions = places
            return
        self._handles = _removed(self._handles)
        middle = len(sketch.points)
        first = middle - len(places) + 1
        colours = np.full((len(places), 3), CORNER_COLOUR, np.uint8)
        colours[-1] = MIDDLE_COLOUR
        self._size = HANDLE_SHARE * _eye_distance(client, sketch.middle)
        handles = self._handles = client.scene.add_batched_meshes_simple(
            "/drawing/handles",
            OCTAHEDRON,
            OCTAHEDRON_FACES,
            _upright(len(places)),
            places,
            batched_scales=handle_scales(len(places), self._size),
            batched_colors=colours,
            lod="off",
            flat_shading=True,
            cast_shadow=False,
            receive_shadow=False,
        )
        self._take_moves(handles, first, len(places), moved)

    def _take_moves(
        self, handles: viser.BatchedMeshHandle, first: int, count: int, moved: Moved
    ) -> None:
        begun: dict[int, Point] = {}

        async def drag(event: viser.SceneNodeDragEvent[Any]) -> None:
            index, now, phase = event.instance_index, floor_under(event), event.phase
            if index is None or not 0 <= index < count:  # a page may send anything
                return
            if phase == "start" and now is not None:
                begun[index] = now
            start = begun.get(index)
            if start is None:
                return
            by = (0.0, 0.0) if now is None else (now[0] - start[0], now[1] - start[1])
            self._drags.take(
                event,
                lambda: moved(phase, first + index, by),
                lambda: moved(phase, first + index, (0.0, 0.0)),
            )

        handles.on_drag("left")(drag)

    def resize_handles(self, sketch: Sketch) -> None:
        """Keep the handles as large as they are on the screen when somebody zooms."""
        client = self._picture.client
        if self._handles is None or client is None:
            return
        size = HANDLE_SHARE * _eye_distance(client, sketch.middle)
        if not 0.75 <= size / self._size <= 1.33:
            self._size = size
            count = len(self._handles.batched_positions)
            self._handles.batched_scales = handle_scales(count, size)

    def clear(self) -> None:
        """Take everything away."""
        self.release()
        self.show(None)
        self.show_handles(None)

    def _show_line(self, client: viser.ClientHandle, whole: Sketch, colour: Colour) -> None:
        points = np.array(whole.points, np.float64).reshape(-1, 2)
        is_open = whole.is_line or len(points) < 3
        segments = open_segments(points, Z_SKETCH) if is_open else closed_segments(points, Z_SKETCH)
        if not len(segments):
            self._line = _removed(self._line)
        elif self._line is None:
            self._line = client.scene.add_line_segments(
                "/drawing/line", segments, colour, thickness=4.0, thickness_units="screen"
            )
        else:
            with client.atomic():
                self._line.points = segments
                self._line.colors = np.array(colour, np.uint8)

    def _show_dots(
        self, client: viser.ClientHandle, points: NDArray[np.float64], colour: Colour
    ) -> None:
        """Dots at the corners, since a first one has no line yet."""
        self._dots = _removed(self._dots)
        if not len(points):
            return
        x, y = points[-1].tolist()
        size = 0.7 * HANDLE_SHARE * _eye_distance(client, (x, y))
        self._dots = client.scene.add_batched_meshes_simple(
            "/drawing/dots",
            OCTAHEDRON,
            OCTAHEDRON_FACES,
            _upright(len(points)),
            np.column_stack([points, np.full(len(points), Z_SKETCH)]).astype(np.float32),
            batched_scales=np.full(len(points), size, np.float32),
            batched_colors=colour,
            lod="off",
            flat_shading=True,
            cast_shadow=False,
            receive_shadow=False,
        )


def handle_places(sketch: Sketch) -> NDArray[np.float32]:
    """Where the handles are (n, 3): at the corners unless there are too many, and in the middle."""
    corners = list(sketch.points) if len(sketch.points) <= MAX_HANDLES else []
    points = np.array([*corners, sketch.middle])
    return np.column_stack([points, np.full(len(points), Z_SKETCH)]).astype(np.float32)


def handle_scales(count: int, size: float) -> NDArray[np.float32]:
    """The sizes of the handles (n,) [m]: the one that moves all is larger."""
    scales = np.full(count, size, np.float32)
    scales[-1] *= 1.5
    return scales


def _eye_distance(client: viser.ClientHandle, point: Point) -> float:
    distance = math.dist(client.camera.position, (*point, 0.0))
    return min(max(distance, 0.5), 100.0)


def floor_under(event: viser.SceneNodeDragEvent[Any]) -> Point | None:
    """Where on the floor a drag is now [m], None while it is not over the floor."""
    camera = event.client.camera.position
    return meet_floor(camera, np.array(event.end_position) - camera)


def outline_of(points: Sequence[Point]) -> tuple[Point, ...]:
    """The corners of a stored zone as plain numbers."""
    return tuple((float(x), float(y)) for x, y in points)


def _upright(count: int) -> NDArray[np.float32]:
    return np.tile(np.array([1, 0, 0, 0], np.float32), (count, 1))


def _removed(node: viser.SceneNodeHandle | None) -> None:
    if node is not None:
        node.remove()
