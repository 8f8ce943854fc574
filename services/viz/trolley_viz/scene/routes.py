"""Where the robot is going: path, trajectory, and the goal with the footprint there."""

import numpy as np
import viser

from trolley import topics
from trolley.geometry import Pose2D
from trolley.messages import Path, floats_from_bytes
from trolley.under_way import GOAL_UNDER_WAY
from trolley_viz.graphics.shapes import arrow_outline, closed_segments, flat, open_segments, place
from trolley_viz.robots.placement import Placement
from trolley_viz.robots.view import View
from trolley_viz.scene.layer import Z_FOOTPRINT, Z_LABEL, Z_PATH, Z_TRAJECTORY, Layer

Colour = tuple[int, int, int]

PATH_COLOUR: Colour = (40, 110, 245)
PREVIEW_COLOUR: Colour = (120, 200, 140)
TRAJECTORY_COLOUR: Colour = (20, 170, 80)
GOAL_COLOUR: Colour = (0, 120, 45)
FAILED_COLOUR: Colour = (190, 20, 20)
BLOCKED_COLOUR: Colour = (215, 45, 45)


class Line:
    """A polyline on the floor; the node is kept and updated."""

    def __init__(self, scene: viser.SceneApi, path: str, colour: Colour, width: float) -> None:
        self._scene, self._path, self._colour, self._width = scene, path, colour, width
        self._node: viser.LineSegmentsHandle | None = None

    def show(self, segments: np.ndarray) -> None:
        """Draw segments (n, 2, 3) [m]; nothing where there are none."""
        if not len(segments):
            if self._node is not None:
                self._node.visible = False
            return
        if self._node is None:
            self._node = self._scene.add_line_segments(
                self._path, segments, self._colour, thickness=self._width
            )
        self._node.points = segments
        self._node.visible = True


class PathLayer(Layer):
    """The planned way."""

    key, title = "path", "Path"
    group = "Driving"
    source = topics.PATH
    needs = (topics.PATH,)
    width = 0.055
    colour = PATH_COLOUR
    height = Z_PATH

    def __init__(self, server: viser.ViserServer, above: str) -> None:
        super().__init__(server, above)
        self._line = Line(self.scene, self.path("line"), self.colour, self.width)

    def draw(self, view: View) -> None:
        """Draw the newest path while there is somewhere to go."""
        goal = view.streams.latest(topics.GOAL)
        is_going = goal is not None and goal.state in GOAL_UNDER_WAY and not view.is_away
        path = view.streams.latest(self.needs[0]) if is_going else None
        world_T_path = None if path is None else view.placement.world_T(path.frame)
        if self.changed(path, world_T_path):
            self._line.show(path_segments(path, world_T_path, self.height))


class TrajectoryLayer(PathLayer):
    """What the controller drives within the next seconds."""

    key, title = "trajectory", "Trajectory"
    group = "Driving"
    source = topics.TRAJECTORY
    needs = (topics.TRAJECTORY,)
    period_s = 0.1
    width = 0.028
    colour = TRAJECTORY_COLOUR
    height = Z_TRAJECTORY


class GoalLayer(Layer):
    """The goal: an arrow, the footprint there, its name, and what is in the way."""

    key, title = "goal", "Goal"
    group = "Driving"
    source = topics.GOAL

    def __init__(self, server: viser.ViserServer, above: str) -> None:
        super().__init__(server, above)
        self._frame = self.scene.add_frame(self.path("pose"), show_axes=False, visible=False)
        self._arrow = self.scene.add_mesh_simple(
            self.path("pose/arrow"),
            *flat(arrow_outline(0.5, 0.32)),
            color=GOAL_COLOUR,
            side="double",
            cast_shadow=False,
        )
        self._arrow.position = (0.0, 0.0, Z_FOOTPRINT)
        self._footprint: viser.LineSegmentsHandle | None = None
        self._blocked: viser.PointCloudHandle | None = None

    def draw(self, view: View) -> None:
        """Draw the goal while the robot is on its way there, and red where it failed."""
        goal = view.streams.latest(topics.GOAL)
        world_T_frame = None if goal is None else view.placement.world_T(goal.frame)
        if not self.changed(goal, world_T_frame, view.robot, view.is_away):
            return
        shown = (
            goal is not None
            and goal.pose is not None
            and world_T_frame is not None
            and goal.state in (*GOAL_UNDER_WAY, "failed")
            and not view.is_away
        )
        self._frame.visible = shown
        blocked = goal.blocked if shown and goal is not None else []
        self._show_blocked(blocked, world_T_frame)
        if not shown or goal is None or goal.pose is None or world_T_frame is None:
            return
        self._arrow.color = FAILED_COLOUR if goal.state == "failed" else GOAL_COLOUR
        place(self._frame, world_T_frame @ goal.pose, 0.0)
        if view.robot is not None:
            self._show_footprint(np.array(view.robot.footprint))

    def _show_footprint(self, points: np.ndarray) -> None:
        segments = closed_segments(points, Z_FOOTPRINT)
        if self._footprint is None:
            self._footprint = self.scene.add_line_segments(
                self.path("pose/footprint"),
                segments,
                GOAL_COLOUR,
                thickness=2.0,
                thickness_units="screen",
            )
        self._footprint.points = segments

    def _show_blocked(self, points: list[tuple[float, float]], world_T: Pose2D | None) -> None:  # noqa: N803
        if not points or world_T is None:
            if self._blocked is not None:
                self._blocked.visible = False
            return
        placed = world_T.transform_points(np.array(points))
        raised = np.column_stack([placed, np.full(len(placed), Z_LABEL)]).astype(np.float32)
        if self._blocked is None:
            self._blocked = self.scene.add_point_cloud(
                self.path("blocked"),
                raised,
                BLOCKED_COLOUR,
                point_size=0.1,
                point_shape="diamond",
                point_shading="flat",
                precision="float32",
            )
        self._blocked.points = raised
        self._blocked.visible = True


class PreviewLine:
    """The path to where the person at one browser is pointing."""

    def __init__(self, scene: viser.SceneApi) -> None:
        self._line = Line(scene, "/preview", PREVIEW_COLOUR, 0.035)
        self._drawn: Path | None = None

    def draw(self, path: Path | None, placement: Placement) -> None:
        """Draw it while it is shown."""
        if path is not self._drawn:
            self._drawn = path
            world_T_path = None if path is None else placement.world_T(path.frame)
            self._line.show(path_segments(path, world_T_path, Z_TRAJECTORY))


def path_segments(path: Path | None, world_T_path: Pose2D | None, z: float) -> np.ndarray:
    """A path as line segments (n, 2, 3) [m] in the world; none where it cannot be placed."""
    if path is None or world_T_path is None:
        return np.zeros((0, 2, 3), np.float32)
    poses = floats_from_bytes(path.poses, 3)
    return open_segments(world_T_path.transform_points(poses[:, :2]), z)
