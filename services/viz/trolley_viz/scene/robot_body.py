"""The robot: its body raised from the footprint, and its outline on the floor."""

import numpy as np
import viser
from numpy.typing import NDArray

from trolley import topics
from trolley.geometry import Pose2D
from trolley.geometry.frames import BASE
from trolley.messages import PoseState, Robot
from trolley_viz.graphics.robot_mesh import mesh_problem
from trolley_viz.graphics.shapes import arrow_outline, closed_segments, flat, place, prism
from trolley_viz.robots.view import View
from trolley_viz.scene.layer import Z_FOOTPRINT, Layer

BODY_COLOURS: dict[PoseState, tuple[int, int, int]] = {
    "localized": (20, 78, 190),
    "mapping": (20, 78, 190),
    "unsure": (214, 124, 0),
    "searching": (96, 102, 112),
    "lost": (190, 24, 24),
}
AWAY_COLOUR = (110, 112, 118)
OUTLINE = (20, 70, 160)
GLTF_UPRIGHT = (0.5, 0.5, 0.5, 0.5)
"""Turns what has +y up and looks along +z, as glTF has it, to +z up and +x ahead (REP-103)."""


class RobotLayer(Layer):
    """The robot where it is now; its colour says how sure that is."""

    key, title = "robot", "Robot"
    group = "Robot"
    source = topics.ODOM
    period_s = 0.0  # at each look

    def __init__(self, server: viser.ViserServer, above: str) -> None:
        super().__init__(server, above)
        self._frame = self.scene.add_frame(self.path("base_link"), show_axes=False, visible=False)
        self._body: viser.MeshHandle | None = None
        self._parts: list[viser.SceneNodeHandle] = []
        self._pose: Pose2D | None = None
        """Where it is drawn."""
        self._colour = AWAY_COLOUR
        """Of the body."""
        self.problem = ""
        """Why the robot's own body is not shown."""

    def draw(self, view: View) -> None:
        """Move the body; rebuild it when the robot's description changes."""
        if self.changed(view.robot, view.placement.tree.link("laser") is not None):
            self._build(view)
        pose = view.placement.world_T_base
        is_shown = pose is not None and view.robot is not None
        if self._frame.visible != is_shown:
            self._frame.visible = is_shown
        if pose is not None and pose != self._pose:
            self._pose = pose
            with self.server.atomic():
                place(self._frame, pose, 0.0)
        if self._body is not None:
            estimate = view.streams.latest(topics.POSE)
            fresh = not view.is_away and (view.is_fresh(topics.POSE) or estimate is None)
            state: PoseState = "localized" if estimate is None else estimate.state
            colour = BODY_COLOURS[state] if fresh else AWAY_COLOUR
            if colour != self._colour:
                self._colour = self._body.color = colour

    def _build(self, view: View) -> None:
        for part in self._parts:
            part.remove()
        self._parts.clear()
        self._body = None
        robot = view.robot
        if robot is None:
            return
        points = np.array(robot.footprint)
        outline = self.scene.add_line_segments(
            self.path("base_link/footprint"),
            closed_segments(points, Z_FOOTPRINT),
            OUTLINE,
            thickness=2.5,
            thickness_units="screen",
        )
        self._parts.append(outline)
        self.problem = "" if robot.mesh is None else mesh_problem(robot.mesh)
        if robot.mesh is None or self.problem:
            self._build_body(robot, view)
            return
        mesh = self.scene.add_glb(
            self.path("base_link/mesh"), robot.mesh, wxyz=GLTF_UPRIGHT, cast_shadow=False
        )
        self._parts.append(mesh)

    def _build_body(self, robot: Robot, view: View) -> None:
        """Raise the footprint, with an arrow on top and the lidar's drum where it is mounted."""
        points = np.array(robot.footprint)
        size = float(np.ptp(points, axis=0).min())
        height = body_height(points)
        self._colour = AWAY_COLOUR
        self._body, arrow = add_body(self.scene, self.path("base_link"), points, AWAY_COLOUR)
        self._parts += [self._body, arrow]
        laser = view.placement.tree.link("laser")
        if laser is not None and laser.parent == BASE:
            radius = float(np.clip(0.16 * size, 0.02, 0.06))
            drum = self.scene.add_cylinder(
                self.path("base_link/laser"), radius, 0.04, color=(34, 36, 42)
            )
            place(drum, laser.pose, height + 0.025)
            self._parts.append(drum)


def add_body(
    scene: viser.SceneApi,
    path: str,
    footprint: NDArray[np.float64],
    colour: tuple[int, int, int],
    opacity: float | None = None,
) -> tuple[viser.MeshHandle, viser.MeshHandle]:
    """Raise a footprint (n, 2) [m] below a frame, with an arrow on top; returns body and arrow."""
    size, height = float(np.ptp(footprint, axis=0).min()), body_height(footprint)
    body = scene.add_mesh_simple(
        f"{path}/body",
        *prism(0.97 * footprint, 0.03, height),
        color=colour,
        opacity=opacity,
        flat_shading=True,
    )
    length = 0.62 * float(np.ptp(footprint[:, 0]))
    arrow = scene.add_mesh_simple(
        f"{path}/heading",
        *flat(arrow_outline(length, 0.6 * size)),
        color=(255, 255, 255),
        side="double",
        cast_shadow=False,
    )
    middle = 0.5 * float(footprint[:, 0].max() + footprint[:, 0].min())
    place(arrow, Pose2D(middle - 0.5 * length, 0.0, 0.0), height + 0.006)
    return body, arrow


def body_height(footprint: NDArray[np.float64]) -> float:
    """How high a body is drawn [m] over a footprint (n, 2)."""
    size = float(np.ptp(footprint, axis=0).min())
    return float(np.clip(0.45 * size, 0.08, 0.4))
