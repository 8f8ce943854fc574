"""A moment of the past on the map, for whoever looks at it: where the robot was and what it saw."""

import numpy as np
import viser
from numpy.typing import NDArray

from trolley.geometry import Pose2D
from trolley.messages import Robot
from trolley_viz.features.past.record import PastView
from trolley_viz.features.tours.layer import TripLayer
from trolley_viz.graphics.shapes import circle, closed_segments, place
from trolley_viz.robots.view import View
from trolley_viz.scene.layer import Z_LABEL, Z_PATH, Z_SCAN
from trolley_viz.scene.map_layers import CostmapLayer, GlobalCostmapLayer
from trolley_viz.scene.other_robots import OthersLayer
from trolley_viz.scene.pose_accuracy import CovarianceLayer, TruthLayer
from trolley_viz.scene.robot_body import RobotLayer, add_body
from trolley_viz.scene.routes import GoalLayer, PathLayer, TrajectoryLayer
from trolley_viz.scene.scan_and_particles import CandidateLayer, ParticleLayer, ScanLayer

GHOST, SEEN = (206, 20, 106), (232, 62, 140)
"""Colours that nothing else on the map has: the robot is blue, places are purple, its scan is red.
"""
GHOST_OPACITY = 0.75
AIM_RADIUS_M = 0.18
DEFAULT_FOOTPRINT = ((0.2, -0.2), (0.2, 0.2), (-0.2, 0.2), (-0.2, -0.2))
"""Footprint of a robot that has not reported its own [m]."""

HIDDEN = frozenset(
    layer.key
    for layer in (
        RobotLayer,
        OthersLayer,
        CovarianceLayer,
        TruthLayer,
        ScanLayer,
        ParticleLayer,
        CandidateLayer,
        GoalLayer,
        PathLayer,
        TrajectoryLayer,
        TripLayer,
        CostmapLayer,
        GlobalCostmapLayer,
    )
)
"""The layers that show what is now: they are not shown with what was."""


class PastDrawing:
    """Draws the ghost, its echoes and its track in one browser's scene."""

    def __init__(self, scene: viser.SceneApi) -> None:
        self._scene = scene
        self._drawn: PastView | None = None
        self._ghost: viser.FrameHandle | None = None
        self._ghost_of: Robot | None = None
        self._track: viser.LineSegmentsHandle | None = None
        self._ring: viser.LineSegmentsHandle | None = None
        """Where it was to drive."""
        self._scan: viser.PointCloudHandle | None = None

    @property
    def ghost(self) -> viser.FrameHandle | None:
        """Where the robot was, None while it is not shown."""
        return self._ghost

    def draw(self, picture: PastView | None, view: View) -> None:
        """Draw a moment, unless it was on another map; None: nothing."""
        grid = view.map
        if picture is not None and (grid is None or picture.then.map != grid.name):
            picture = None
        if picture is self._drawn:
            return
        self._drawn = picture
        then = None if picture is None else picture.then
        self._place_ghost(None if then is None else then.pose, view.robot)
        self._draw_track(None if picture is None else picture.track)
        self._draw_aim(None if then is None else then.aim)
        self._draw_scan(None if then is None else then.scan)

    # Inside.
    def _place_ghost(self, pose: Pose2D | None, robot: Robot | None) -> None:
        is_other = robot is not self._ghost_of
        if self._ghost is not None and (pose is None or is_other):
            self._ghost.remove()
            self._ghost = None
        if pose is None:
            return
        if self._ghost is None:
            self._ghost, self._ghost_of = self._build_ghost(robot), robot
        place(self._ghost, pose, 0.0)

    def _build_ghost(self, robot: Robot | None) -> viser.FrameHandle:
        ghost = self._scene.add_frame("/past/ghost", show_axes=False)
        points = np.array(DEFAULT_FOOTPRINT if robot is None else robot.footprint)
        add_body(self._scene, "/past/ghost", points, GHOST, GHOST_OPACITY)
        return ghost

    def _draw_track(self, track: NDArray[np.float32] | None) -> None:
        if track is None or not len(track):
            _hide(self._track)
            return
        raised = np.full((len(track), 2, 3), Z_PATH, np.float32)
        raised[..., :2] = track
        if self._track is None:
            self._track = self._add_lines("track", raised)
        self._track.points, self._track.visible = raised, True

    def _draw_aim(self, aim: Pose2D | None) -> None:
        if aim is None:
            _hide(self._ring)
            return
        if self._ring is None:
            self._ring = self._add_lines("aim", closed_segments(circle(AIM_RADIUS_M), 0.0))
        place(self._ring, aim, Z_LABEL)
        self._ring.visible = True

    def _add_lines(self, name: str, points: NDArray[np.float32]) -> viser.LineSegmentsHandle:
        return self._scene.add_line_segments(
            f"/past/{name}", points, GHOST, thickness=4.0, thickness_units="screen"
        )

    def _draw_scan(self, scan: NDArray[np.float32] | None) -> None:
        if scan is None or not len(scan):
            _hide(self._scan)
            return
        raised = np.column_stack([scan, np.full(len(scan), Z_SCAN, np.float32)])
        if self._scan is None:
            self._scan = self._scene.add_point_cloud(
                "/past/scan",
                raised,
                SEEN,
                point_size=0.05,
                point_shape="circle",
                precision="float32",
            )
        self._scan.points, self._scan.visible = raised, True


def _hide(node: viser.SceneNodeHandle | None) -> None:
    if node is not None and node.visible:
        node.visible = False
