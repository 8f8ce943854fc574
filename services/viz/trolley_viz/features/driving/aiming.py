"""Pointing at the map: where to go, and where the robot is."""

import math
from collections.abc import Callable

import msgspec
import numpy as np

from trolley import codes, requests, topics
from trolley.codes import Refused
from trolley.geometry import Pose2D
from trolley.geometry.frames import MAP
from trolley.messages import Path, PoseEstimate, floats_from_bytes
from trolley.messages.request_params import JoinPart, SendGoal, SetPose
from trolley.runtime.service import Service
from trolley_viz.controls.undo import Step
from trolley_viz.features.driving.correction import Correction
from trolley_viz.features.driving.robot_actions import RobotActions
from trolley_viz.pointing.pointer import Pointed, Pointer, Tool
from trolley_viz.robots.view import View
from trolley_viz.words.sentences import estimate_text, refusal

GO_TO, SET_POSE, QUEUE_GOALS = "go_to", "set_pose", "queue_goals"
POINT_GOAL, POINT_POSE, LEAVE = "Go to …", "Set pose …", "Press again to cancel"
"""What stands on the buttons of these tools, and on one whose tool is armed."""
GOAL_HINT = "Press where it should go, drag the way it should face, and release."
QUEUE_HINT = "Press the places in order, then press Start."
POSE_HINT = "Press where the robot is, drag the way it faces, and release."
PREVIEW_PERIOD_NS = 300_000_000
ANY_HEADING = math.pi
UNSURE_XY, UNSURE_YAW = 0.25, math.radians(20.0)
"""How exactly people point: standard deviations of place [m] and direction [rad]."""


class Aiming:
    """The tools of one browser that end with a place on the map, one at a time.

    Args:
        actions: ask the robot that is followed.
        robot: the name of the robot that is followed.
        view: what is known of it.
        place_at: the name of the saved place at a point of the world [m], None for none.
    """

    def __init__(
        self,
        service: Service,
        pointing: Pointer,
        actions: RobotActions,
        robot: Callable[[], str],
        view: Callable[[], View],
        place_at: Callable[[float, float], str | None],
    ) -> None:
        self._service = service
        self._pointing = pointing
        self._actions = actions
        self._robot = robot
        self._view = view
        self._place_at = place_at
        self.hint = ""
        """What the armed tool waits for, or the length of its preview."""
        self.preview: Path | None = None
        """The path to where the pointer is."""
        self._correction = Correction(actions.tell)
        self._preview_due_ns = 0
        self._asked: Pointed | None = None
        self._wanted: Pointed | None = None

    @property
    def armed(self) -> str:
        """The name of the tool that waits for a gesture; "" for none."""
        tool = self._pointing.tool
        return "" if tool is None else tool.name

    def arm(self, tool: Tool, hint: str) -> None:
        """Let the person point at the map; any other tool is put away."""
        self.put_away()
        self._pointing.arm(tool)
        self.hint = hint

    def toggle(self, name: str) -> None:
        """Arm the tool "go to" or "set pose"; put it away if it is armed already."""
        if self.armed == name:
            self.put_away()
        elif name == GO_TO:
            self.point_goal()
        else:
            self.point_pose()

    def point_goal(self) -> None:
        """Let the person point out where to go."""
        self.arm(Tool(GO_TO, self._preview_moved, self._go_to), GOAL_HINT)

    def point_queue(self) -> None:
        """Let the person point out the places of the queue, one after the other."""
        self.arm(Tool(QUEUE_GOALS, ignore, self._line_up), QUEUE_HINT)

    def point_pose(self) -> None:
        """Let the person point out where the robot is."""
        self.arm(Tool(SET_POSE, ignore, self.set_pose), POSE_HINT)

    def tick(self) -> None:
        """Go on with what takes a while: the preview of a path, the correction of a pose."""
        self._request_preview()
        self._correction.update(self._view())

    def put_away(self) -> None:
        """Put the tool away, with its hint and its preview."""
        self._pointing.disarm()
        self.hint, self.preview = "", None
        self._asked = self._wanted = None

    def pose_at(self, pointed: Pointed, kept: float | None = None) -> Pose2D:
        """The pose that was pointed out.

        Args:
            pointed: what was pointed at.
            kept: the heading [rad] where none was dragged; without it, the direction of approach.
        """
        if pointed.yaw is not None:
            return Pose2D(pointed.x, pointed.y, pointed.yaw)
        if kept is None:
            here = self._view().placement.world_T_base
            kept = 0.0 if here is None else math.atan2(pointed.y - here.y, pointed.x - here.x)
        return Pose2D(pointed.x, pointed.y, kept)

    # Inside.
    def _request_preview(self) -> None:
        """Ask for the path to where the pointer is: one request at a time, and not too often."""
        now_ns, pointed = self._service.monotonic_ns, self._wanted
        if pointed is None or self._asked is not None or now_ns < self._preview_due_ns:
            return
        self._wanted, self._asked = None, pointed
        self._preview_due_ns = now_ns + PREVIEW_PERIOD_NS
        self._service.request(
            requests.GOAL_PREVIEW,
            self._goal(pointed, None),
            lambda reply: self._show_preview(pointed, reply),
            robot=self._robot(),
        )

    def _goal(self, pointed: Pointed, goal_id: str | None) -> SendGoal:
        goal = SendGoal(id=goal_id, pose=self.pose_at(pointed), frame=self._view().placement.world)
        if pointed.yaw is None:
            return msgspec.structs.replace(goal, yaw_tolerance=ANY_HEADING)
        return goal

    def _go_to(self, pointed: Pointed) -> None:
        self.put_away()
        goal = self._goal(pointed, self._service.new_id())
        self._actions.send_goal(goal, "a place on the map")

    def _line_up(self, pointed: Pointed) -> None:
        """Queue the saved place that was pressed, else the pose that was pointed out."""
        placement, queue = self._view().placement, self._actions.goal_queue
        if placement.world != MAP:
            self.put_away()
            self._actions.tell("Not added", "A row of places needs a map.", "warn")
            return
        # A heading that was dragged is another one than the place's.
        name = self._place_at(pointed.x, pointed.y) if pointed.yaw is None else None
        if name is not None:
            self._actions.choose_place(name)
        else:
            at = (pointed.x, pointed.y, pointed.yaw)
            self._actions.line_up(is_added=queue.add_point(*at, placement.world_T_base))
        self.point_queue()  # the next one

    def set_pose(self, pointed: Pointed) -> None:
        """Tell the robot that this is where it is; it faces as it thinks where nothing is said."""
        self.put_away()
        view = self._view()
        if view.placement.world != MAP:
            self._actions.tell("Pose not set", "There is no map to set a pose on.", "warn")
            return
        here = view.placement.world_T_base
        kept = 0.0 if here is None else here.yaw
        pose = Pose2D(pointed.x, pointed.y, kept if pointed.yaw is None else pointed.yaw)
        mapping = view.streams.latest(topics.MAPPING)
        if mapping is not None and mapping.state != "idle":
            self._actions.ask(requests.MAP_JOIN, JoinPart(pose=pose), "Pose not set")
            return
        std_yaw = UNSURE_YAW if pointed.yaw is not None or here is not None else math.pi
        params = SetPose(
            pose=pose,
            covariance=[UNSURE_XY**2, 0, 0, 0, UNSURE_XY**2, 0, 0, 0, std_yaw**2],
        )
        back = self._undo_step(here)

        def done(estimate: PoseEstimate) -> None:
            self._correction.begin(params.pose, estimate.stamp_ns, self._view())
            if back is not None:
                self._actions.history.add(back)

        self._actions.ask(requests.POSE_SET, params, "Pose not set", done)

    def _undo_step(self, here: Pose2D | None) -> Step | None:
        """How to go back to the present pose, moved on by the odometry until then.

        None where there is no pose to go back to.
        """
        streams, robot = self._view().streams, self._robot()
        before, odometry = streams.latest(topics.POSE), streams.latest(topics.ODOM)
        if here is None or before is None or before.pose is None or odometry is None:
            return None
        map_T_odom = here @ odometry.pose.inverse()
        epoch = self._service.time_of(robot).epoch

        def undo() -> None:
            now = self._view().streams.latest(topics.ODOM)
            if now is not None:
                params = SetPose(pose=map_T_odom @ now.pose, covariance=before.covariance)
                self._actions.ask(requests.POSE_SET, params, "Pose not set")

        # After a restart of the base its odometry starts over.
        return Step("drive", "Set pose", undo, lambda: self._service.time_of(robot).epoch == epoch)

    def _preview_moved(self, pointed: Pointed | None) -> None:
        """Note where the pointer is, and ask for the path there."""
        self._wanted = pointed
        if pointed is None:
            self._asked, self.preview, self.hint = None, None, GOAL_HINT
        self._request_preview()

    def _show_preview(self, asked: Pointed, reply: Path | Refused) -> None:
        if self._asked is not asked:
            return  # the tool has been put away meanwhile
        self._asked = None
        if isinstance(reply, Refused):
            self.preview = None
            is_busy = reply.code == codes.TIMEOUT
            self.hint = GOAL_HINT if is_busy else refusal(reply)
            if is_busy or reply.code == codes.NOT_READY:
                self._wanted = self._wanted or asked  # it may answer by and by
        else:
            self.preview = reply
            self.hint = preview_text(reply)


def ignore(_: Pointed | None) -> None:
    """Preview nothing but the arrow."""


def preview_text(path: Path) -> str:
    """Say how long a path is and how long driving it takes."""
    poses = floats_from_bytes(path.poses, 3)
    length = float(np.hypot(*np.diff(poses[:, :2], axis=0).T).sum())
    eta = f", {estimate_text((len(poses) - 1) * path.dt)}" if path.dt > 0.0 else ""
    return f"{length:.1f} m{eta}"
