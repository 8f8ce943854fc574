"""Pointing at the floor: press, drag and release give a place and a direction, as in rviz.

While a tool is armed an unseen plane lies under the scene of the browser that armed it, and takes
the drags that else would turn the camera. viser gives the end of a drag on a plane that faces
the camera; the line of sight through it is followed down to the floor.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import viser

from trolley.geometry import Pose2D, wrap_angle
from trolley_viz.graphics.shapes import meet_floor
from trolley_viz.pointing.drags import Drags, Ray
from trolley_viz.pointing.picture import Picture

FLOOR_HALF_SIZE_M = 500.0
MIN_DRAG_SCREEN = 0.012
"""A drag shorter than this share of the screen is a click, without a direction."""
ARROW_COLOUR = (0, 140, 40)
Z_ARROW = 0.17
MARK_M = 0.09
"""Radius of the mark of the arrow keys."""


@dataclass(frozen=True)
class Pointed:
    """A place on the floor [m] and, where the pointer was dragged, a heading [rad]."""

    x: float
    y: float
    yaw: float | None = None


@dataclass(frozen=True)
class Tool:
    """What pointing is for."""

    name: str
    moved: Callable[[Pointed | None], None]
    """Called while the pointer is dragged; with None where it points at nothing any more."""
    done: Callable[[Pointed], None]
    """Called at the release."""


class Pointer:
    """The tool of one browser, armed for one gesture.

    Args:
        picture: of the page.
        drags: tells which drags and clicks were meant.
    """

    def __init__(self, picture: Picture, drags: Drags) -> None:
        self._picture = picture
        self._drags = drags
        self._plane: viser.MeshHandle | None = None
        self._arrow: viser.ArrowsHandle | None = None
        self.tool: Tool | None = None
        self.cursor: Pointed | None = None
        """What arrow keys point at."""
        self._mark: viser.IcosphereHandle | None = None

    def arm(self, tool: Tool) -> None:
        """Wait for a gesture; any tool that was armed is put away."""
        self.disarm()
        self.tool = tool
        self.show()

    def show(self) -> None:
        """Take the pointer for the armed tool, as in a picture that is new."""
        tool, scene = self.tool, self._picture.scene
        if tool is None or scene is None:
            return
        self._plane = add_floor(scene, "/pointing")
        self._take_strokes(self._plane, tool)

    def _take_strokes(self, plane: viser.MeshHandle, tool: Tool) -> None:

        # async, so that the phases of a drag arrive in order; see viser's note on `on_drag`.
        async def drag(event: viser.SceneNodeDragEvent[Any]) -> None:
            pointed, phase = pointed_by_drag(event, event.client.camera.position), event.phase
            self._drags.take(
                event,
                lambda: self._dragged(tool, pointed, phase),
                lambda: self._dragged(tool, None, phase),
            )

        def tapped(ray: Ray) -> None:
            met = meet_floor(*ray)
            if met is not None:
                self._dragged(tool, Pointed(*met), "end")

        self._drags.lay_floor(self, plane, tapped)
        plane.on_drag("left")(drag)

    def disarm(self) -> None:
        """Put the tool away."""
        self.hide()
        self.tool = self.cursor = None

    def hide(self) -> None:
        """Leave the picture; the tool stays armed."""
        self._drags.lift_floor(self)
        if self._plane is not None:
            self._plane.remove()
            self._plane = None
        if self._arrow is not None:
            self._arrow.remove()
            self._arrow = None
        if self._mark is not None:
            self._mark.remove()
            self._mark = None

    def show_arrow(self, pointed: Pointed | None) -> None:
        """Draw the arrow as it is dragged."""
        scene = self._picture.scene
        if scene is None or pointed is None or pointed.yaw is None:
            if self._arrow is not None:
                self._arrow.visible = False
            return
        length = 0.7
        tip = (
            pointed.x + length * math.cos(pointed.yaw),
            pointed.y + length * math.sin(pointed.yaw),
        )
        points = np.array([[(pointed.x, pointed.y, Z_ARROW), (*tip, Z_ARROW)]])
        if self._arrow is None:
            self._arrow = scene.add_arrows(
                "/pointed",
                points,
                ARROW_COLOUR,
                shaft_radius=0.03,
                head_radius=0.09,
                head_length=0.2,
            )
        self._arrow.points = points
        self._arrow.visible = True

    def step(self, start: Pose2D, ahead: Pose2D) -> None:
        """Move what arrow keys point at.

        Args:
            start: where they begin, in the world.
            ahead: how far it moves [m], along the world's axes, and turns [rad].
        """
        tool, at = self.tool, self.cursor or Pointed(start.x, start.y)
        if tool is None:
            return
        yaw = at.yaw
        if ahead.yaw:
            yaw = wrap_angle((start.yaw if yaw is None else yaw) + ahead.yaw)
        self.cursor = Pointed(at.x + ahead.x, at.y + ahead.y, yaw)
        self._show_mark(self.cursor)
        self._dragged(tool, self.cursor, "update")

    def take(self) -> None:
        """Point at where the arrow keys have led."""
        if self.tool is not None and self.cursor is not None:
            self._dragged(self.tool, self.cursor, "end")

    def _show_mark(self, at: Pointed) -> None:
        scene = self._picture.scene
        if self._mark is None and scene is not None:
            self._mark = scene.add_icosphere("/cursor", MARK_M, ARROW_COLOUR)
        if self._mark is not None:
            self._mark.position = (at.x, at.y, Z_ARROW)

    def _dragged(self, tool: Tool, pointed: Pointed | None, phase: str) -> None:
        if tool is not self.tool:
            return
        if pointed is None or phase != "end":
            self.show_arrow(pointed)
            tool.moved(pointed)
            return  # where it ends nowhere, the tool waits for another try
        self.disarm()
        tool.done(pointed)


def add_floor(scene: viser.SceneApi, path: str) -> viser.MeshHandle:
    """Lay an unseen floor under the scene, to take clicks and drags."""
    half = FLOOR_HALF_SIZE_M
    return scene.add_mesh_simple(
        path,
        np.array([[-half, -half, 0], [half, -half, 0], [half, half, 0], [-half, half, 0]]),
        np.array([[0, 1, 2], [0, 2, 3]]),
        opacity=0.0,
        side="double",
        cast_shadow=False,
        receive_shadow=False,
    )


def pointed_by_drag(
    event: viser.SceneNodeDragEvent[Any], camera: np.ndarray[Any, Any]
) -> Pointed | None:
    """Say what a drag points at; None while its end does not lie over the floor."""
    x, y, _ = event.start_position
    du = event.end_screen_pos[0] - event.start_screen_pos[0]
    dv = event.end_screen_pos[1] - event.start_screen_pos[1]
    if math.hypot(du, dv) < MIN_DRAG_SCREEN:
        return Pointed(x, y)
    met = meet_floor(camera, np.array(event.end_position) - camera)
    if met is None:
        return None
    return Pointed(x, y, math.atan2(met[1] - y, met[0] - x))
