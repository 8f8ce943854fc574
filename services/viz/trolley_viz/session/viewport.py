"""The camera of one browser: it shows the whole map until somebody moves it."""

import math

import numpy as np
import viser
from numpy.typing import NDArray

from trolley.geometry import Pose2D, wrap_angle
from trolley_viz.graphics import camera
from trolley_viz.graphics.shapes import is_near
from trolley_viz.robots.view import View
from trolley_viz.scene.map_layers import map_bounds
from trolley_viz.scene.place_labels import Eye

SETTLE_NS = 2_000_000_000
SAME_ASPECT = 0.03
MOVED_M, TURNED_RAD = 0.02, math.radians(1.0)
"""The camera moves after the robot once it has moved so far."""


class Viewport:
    """The camera of one browser."""

    def __init__(
        self, client: viser.ClientHandle, size: tuple[float, float] | None, look: camera.Look
    ) -> None:
        self._client = client
        self._size = size
        """Width and height of the picture [px of the page], once the page has told."""
        self._fitted = ""
        """The map that the camera was last moved for, and the shape of the picture then."""
        self._aspect = 1.0
        self._begins: list[NDArray[np.float64]] = []
        """Where pages begin (3,) [m], unless it was moved there anyway."""
        self._settled_ns: int | None = None
        """When to see whether the page is laid out as it was thought to be [ns]."""
        self._look = look
        self._followed: Pose2D | None = None
        """Where the robot was when the camera was last moved after it."""

    @property
    def eye(self) -> Eye:
        """From where things are seen."""
        at = self._client.camera
        size = self._size or (at.image_width, at.image_height)
        return Eye(at.position, at.wxyz, at.fov, size)

    @property
    def up(self) -> float:
        """Which heading is up in the picture [rad]."""
        at = self._client.camera
        x, y, _ = (np.asarray(at.look_at) - np.asarray(at.position)).tolist()
        return math.atan2(y, x)

    def resized(self, size: tuple[float, float], now_ns: int) -> None:
        """Take note of the size of the picture: the map may not fit any more."""
        self._size = size
        self._settled_ns = now_ns + SETTLE_NS

    def fit(self, view: View) -> None:
        """Show the whole map."""
        bounds = map_bounds(view)
        if bounds is not None:
            self._fit(bounds)

    def change(self, look: camera.Look, view: View) -> None:
        """Look from elsewhere."""
        was, self._look = self._look, look
        self._followed = None
        if look.follows:
            self._follow(view)
        elif was.is_flat != look.is_flat:
            self.fit(view)

    def look_at(self, x: float, y: float) -> None:
        """Show a place in the world [m] from near."""
        self._stand_near(x, y, camera.NORTH)

    def update(self, view: View, robot: str) -> None:
        """Move the camera to a map that is new to it, and again where the page undoes that."""
        if self._look.follows:
            self._follow(view)
            return
        if view.map is None:
            return
        fitted = f"{robot}/{view.map.name}"
        is_to_fit = self._fitted != fitted or self._is_reset()
        if not is_to_fit and self._settled_ns is None:
            return  # as nearly always: the bounds of a large map take a while
        bounds = map_bounds(view)
        if bounds is None or not (is_to_fit or self._is_laid_out_anew(view.now_ns, bounds)):
            return
        self._settled_ns = view.now_ns + SETTLE_NS
        self._fit(bounds)
        self._fitted = fitted

    def _follow(self, view: View) -> None:
        """Move the camera as the robot moved; where it is seen from is the person's affair."""
        here, last = view.placement.world_T_base, self._followed
        if here is None:
            return
        turn = 0.0 if last is None else wrap_angle(here.yaw - last.yaw)
        if last is None:
            self._stand_near(here.x, here.y, here.yaw if self._look.turns else camera.NORTH)
        elif here.distance_to(last) > MOVED_M or (self._look.turns and abs(turn) > TURNED_RAD):
            at = self._client.camera
            offset = np.asarray(at.position) - np.asarray(at.look_at)
            if self._look.turns:
                offset = camera.turned(offset, turn)
            middle = np.array([here.x, here.y, 0.0])
            camera.move(self._client, middle + offset, middle)
        else:
            return
        self._followed = here

    def _stand_near(self, x: float, y: float, up: float) -> None:
        middle = np.array([x, y, 0.0])
        offset = camera.NEAR_M * camera.away(self._look.elevation, up)
        camera.move(self._client, middle + offset, middle)

    def _is_reset(self) -> bool:
        """Whether the page took the camera back: a slow one begins after it was told where to look.

        How slow it may be nobody knows, so this is asked with each picture.
        """
        return any(self._is_at(start) for start in self._begins)

    def _is_at(self, position: NDArray[np.float64]) -> bool:
        return is_near(self._client.camera.position, position)

    def _is_laid_out_anew(self, now_ns: int, bounds: camera.Bounds) -> bool:
        """Whether the page turned out to be of another shape, and nobody moved the camera."""
        if self._settled_ns is None or now_ns < self._settled_ns:
            return False
        self._settled_ns = None
        is_other = abs(self._seen_aspect() - self._aspect) > SAME_ASPECT
        return is_other and camera.stands(self._client, bounds, self._aspect)

    def _fit(self, bounds: camera.Bounds) -> None:
        self._aspect = self._seen_aspect()
        camera.fit(self._client, bounds, self._aspect, self._look.elevation)
        self._begins = [start for start in camera.starts(bounds) if not self._is_at(start)]

    def _seen_aspect(self) -> float:
        at = self._client.camera
        width, height = self._size or (at.image_width, at.image_height)
        return max(width, 1) / max(height, 1)
