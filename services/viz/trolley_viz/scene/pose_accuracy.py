"""How sure the robot is of its pose, and, in a simulation, how right."""

import math
from dataclasses import dataclass

import numpy as np
import viser

from trolley import topics
from trolley.geometry import Pose2D, wrap_angle
from trolley.messages import PoseEstimate, Truth
from trolley_viz.graphics.shapes import closed_segments, ellipse, place
from trolley_viz.robots.view import View
from trolley_viz.scene.layer import Z_FOOTPRINT, Z_LABEL, Layer
from trolley_viz.scene.robot_body import body_height
from trolley_viz.scene.routes import Line

ELLIPSE_COLOUR = (190, 60, 200)
TRUTH_COLOUR = (20, 20, 24)
MIN_AXIS_M = 0.005
"""Thinner ellipses are drawn this wide, else they could not be seen."""


class CovarianceLayer(Layer):
    """The ellipse in which the robot's middle is with 95 %."""

    key, title = "covariance", "Position, 95 %"
    group = "Sensing"
    source = topics.POSE
    on_by_default = False

    def __init__(self, server: viser.ViserServer, above: str) -> None:
        super().__init__(server, above)
        self._line = Line(self.scene, self.path("ellipse"), ELLIPSE_COLOUR, 0.02)

    def draw(self, view: View) -> None:
        """Draw it where the newest estimate is."""
        estimate = None if view.is_away else view.streams.latest(topics.POSE)
        world_T_map = view.placement.world_T("map")
        if not self.changed(estimate, world_T_map):
            return
        segments = np.zeros((0, 2, 3), np.float32)
        if (
            estimate is not None
            and estimate.pose is not None
            and estimate.covariance is not None
            and world_T_map is not None
        ):
            spread = np.array(estimate.covariance, np.float64).reshape(3, 3)[:2, :2]
            world_T_middle = world_T_map @ Pose2D(estimate.pose.x, estimate.pose.y, 0.0)
            points = world_T_middle.transform_points(ellipse(spread, MIN_AXIS_M))
            robot = view.robot
            # On top of the body, which would hide it.
            height = 0.0 if robot is None else body_height(np.array(robot.footprint))
            segments = closed_segments(points, height + 0.02)
        self._line.show(segments)


class TruthLayer(Layer):
    """Where a simulated robot really is: its outline, and how far the estimate is off."""

    key, title = "truth", "True position"
    group = "Robot"
    source = topics.SIM_TRUTH
    needs = (topics.SIM_TRUTH,)
    period_s = 0.0  # at each look
    on_by_default = False

    def __init__(self, server: viser.ViserServer, above: str) -> None:
        super().__init__(server, above)
        self._frame = self.scene.add_frame(self.path("pose"), show_axes=False, visible=False)
        self._outline: viser.LineSegmentsHandle | None = None
        self._label = self.scene.add_label(
            self.path("pose/error"), "", anchor="top-center", font_screen_scale=0.8
        )
        self._label.position = (0.0, 0.0, Z_LABEL)
        self._footprint: object = None

    def draw(self, view: View) -> None:
        """Move the outline; update the error when it differs in whole centimetres."""
        truth = view.streams.latest(topics.SIM_TRUTH) if view.is_fresh(topics.SIM_TRUTH) else None
        world_T_map = view.placement.world_T("map")
        if not self.changed(truth, world_T_map):
            return
        is_shown = truth is not None and world_T_map is not None and view.robot is not None
        if self._frame.visible != is_shown:
            self._frame.visible = is_shown
        if truth is None or world_T_map is None or view.robot is None:
            return
        if self._footprint is not view.robot:
            self._footprint = view.robot
            self._show_outline(np.array(view.robot.footprint))
        place(self._frame, world_T_map @ truth.pose, 0.0)
        error = error_of(view)
        text = "truth" if error is None else f"off by {error.text}"
        if self._label.text != text:
            self._label.text = text

    def _show_outline(self, points: np.ndarray) -> None:
        if self._outline is not None:
            self._outline.remove()
        self._outline = self.scene.add_line_segments(
            self.path("pose/outline"),
            closed_segments(points, Z_FOOTPRINT + 0.015),
            TRUTH_COLOUR,
            thickness=2.0,
            thickness_units="screen",
        )


@dataclass(frozen=True)
class PoseError:
    """How far an estimate is off."""

    distance_m: float
    turn_rad: float

    @property
    def text(self) -> str:
        """In centimetres and degrees."""
        return f"{100 * self.distance_m:.0f} cm, {math.degrees(abs(self.turn_rad)):.1f}°"


def error_of(view: View) -> PoseError | None:
    """Compare the newest estimate with the truth at its time; None while that is not known."""
    estimate = view.streams.latest(topics.POSE)
    truths = view.streams.history(topics.SIM_TRUTH)
    return None if estimate is None else pose_error(estimate, truths)


def pose_error(estimate: PoseEstimate, truths: list[Truth]) -> PoseError | None:
    """Compare an estimate with the truth at its time, which lies between two of `truths`."""
    if estimate.pose is None or len(truths) < 2:
        return None
    times = [truth.stamp_ns for truth in truths]
    if not times[0] <= estimate.stamp_ns <= times[-1]:
        return None
    later = next(i for i, at in enumerate(times) if at >= estimate.stamp_ns)
    a, b = truths[max(later - 1, 0)], truths[later]
    span = b.stamp_ns - a.stamp_ns
    share = (estimate.stamp_ns - a.stamp_ns) / span if span > 0 else 0.0
    true = Pose2D(
        a.pose.x + share * (b.pose.x - a.pose.x),
        a.pose.y + share * (b.pose.y - a.pose.y),
        wrap_angle(a.pose.yaw + share * wrap_angle(b.pose.yaw - a.pose.yaw)),
    )
    turn = wrap_angle(estimate.pose.yaw - true.yaw)
    return PoseError(estimate.pose.distance_to(true), turn)
