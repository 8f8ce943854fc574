"""What the buttons do: requests to the selected robot, and what people are told of the answers."""

import math
from collections.abc import Callable
from typing import Any

import msgspec
import numpy as np

from trolley import codes, requests
from trolley.codes import Refused
from trolley.geometry import Pose2D
from trolley.geometry.frames import MAP
from trolley.messages import GoalStatus, Path, floats_from_bytes
from trolley.messages.asking import (
    Capture,
    Named,
    Nothing,
    SendGoal,
    SetPose,
    StartTour,
    WhichGoal,
)
from trolley.requests import Request
from trolley.runtime.service import Service
from trolley_viz.pointing import Pointed, Pointing, Tool
from trolley_viz.scene.layer import View
from trolley_viz.words import Tone, duration

GO_TO, SET_POSE = "go_to", "set_pose"
GOAL_HINT = "Press where to go, drag to where it shall look, release."
POSE_HINT = "Press where the robot is, drag to where it looks, release."
PREVIEW_PERIOD_NS = 300_000_000
ANY_HEADING = math.pi
UNSURE_XY, UNSURE_YAW = 0.25, math.radians(20.0)
"""How exactly people point: standard deviations of place [m] and direction [rad]."""

Tell = Callable[[str, str, Tone], None]
"""Shows people a title and a sentence."""


class Actions:
    """Requests on behalf of whoever pressed the button; all on the service's thread."""

    def __init__(
        self, service: Service, robot: Callable[[], str], view: Callable[[], View], tell: Tell
    ) -> None:
        self._service = service
        self._robot = robot
        self._view = view
        self._tell = tell
        self.hint = ""
        """What the armed tool waits for, or what its preview came to."""
        self.preview: Path | None = None
        """The way to where the pointer is."""
        self._preview_due_ns = 0
        self._asked: Pointed | None = None

    # Pointing.
    def point_goal(self, pointing: Pointing) -> None:
        """Let the person point out where to go; pressed again, leave it."""
        self.arm(pointing, Tool(GO_TO, self._preview, self._go_to), GOAL_HINT)

    def point_pose(self, pointing: Pointing) -> None:
        """Let the person point out where the robot is; pressed again, leave it."""
        self.arm(pointing, Tool(SET_POSE, _ignore, self._set_pose), POSE_HINT)

    def put_away(self) -> None:
        """Forget hint and preview of the tool."""
        self.hint, self.preview, self._asked = "", None, None

    # Goals.
    def go_to_place(self, name: str) -> None:
        """Drive to a saved pose."""
        self._send_goal(SendGoal(id=self._service.new_id(), name=name))

    def steer_goal(self, action: str, goal: GoalStatus | None) -> None:
        """Do "Pause", "Go on" or "Cancel" to this goal and no newer one."""
        request = {
            "Pause": requests.GOAL_PAUSE,
            "Go on": requests.GOAL_RESUME,
            "Cancel": requests.GOAL_CANCEL,
        }[action]
        which = WhichGoal(id=None if goal is None else goal.id)
        self.ask(request, which, f"{action}: not done")

    # The pose.
    def find(self) -> None:
        """Let the robot search for itself on the whole map."""
        self.ask(requests.POSE_FIND, Nothing(), "The robot does not search")

    # Places.
    def save_place(self, name: str, *, replace: bool, saved: Callable[[], None]) -> None:
        """Save where the robot is under a name."""
        if not name.strip():
            self._tell("Not saved", "Give the place a name first.", "warn")
            return

        def done(_: Any) -> None:
            self._tell("Saved", f"This place is called {name.strip()} now.", "good")
            saved()

        params = Capture(name=name.strip(), replace=replace)
        self.ask(requests.POSE_CAPTURE, params, "Not saved", done)

    def delete_place(self, name: str) -> None:
        """Forget a saved pose."""
        self.ask(requests.POSES_DELETE, Named(name=name), "Not deleted")

    # Tours.
    def start_tour(self, name: str) -> None:
        """Start a stored tour."""
        self.ask(requests.TOUR_START, StartTour(name=name), "The tour did not start")

    def steer_tour(self, action: str) -> None:
        """Do "Pause", "Resume", "Skip" or "End" to the trip."""
        request = {
            "Pause": requests.TOUR_PAUSE,
            "Resume": requests.TOUR_RESUME,
            "Skip": requests.TOUR_SKIP,
            "End": requests.TOUR_STOP,
        }[action]
        self.ask(request, Nothing(), f"{action}: not done")

    def resume(self) -> None:
        """Let the robot drive again; it does not set off by itself."""
        self.ask(requests.BASE_RESUME, Nothing(), "Not resumed")

    # For all of them.
    def arm(self, pointing: Pointing, tool: Tool, hint: str) -> None:
        """Let the person point at something; where the tool waits already, leave it."""
        was = pointing.tool
        pointing.disarm()
        self.put_away()
        if was is None or was.name != tool.name:
            pointing.arm(tool)
            self.hint = hint

    def ask(
        self,
        request: Request[Any, Any],
        params: Any,
        failed: str,
        done: Callable[[Any], None] | None = None,
    ) -> None:
        """Send a request to the selected robot and tell people if it is refused."""

        def finish(reply: Any) -> None:
            if isinstance(reply, Refused):
                self._service.log.info("Refused", request=request.name, code=reply.code)
                self._tell(failed, reply.message, "bad")
            elif done is not None:
                done(reply)

        self._service.request(request, params, finish, robot=self._robot())

    # Inside.
    def _goal(self, pointed: Pointed, goal_id: str | None) -> SendGoal:
        here = self._view().placement.world_T_base
        free = 0.0 if here is None else math.atan2(pointed.y - here.y, pointed.x - here.x)
        yaw = free if pointed.yaw is None else pointed.yaw
        goal = SendGoal(
            id=goal_id,
            pose=Pose2D(pointed.x, pointed.y, yaw),
            frame=self._view().placement.world,
        )
        if pointed.yaw is None:
            return msgspec.structs.replace(goal, yaw_tolerance=ANY_HEADING)
        return goal

    def _go_to(self, pointed: Pointed) -> None:
        self.put_away()
        self._send_goal(self._goal(pointed, self._service.new_id()))

    def _send_goal(self, goal: SendGoal) -> None:
        self.ask(requests.GOAL_SEND, goal, "The robot does not go there")

    def _set_pose(self, pointed: Pointed) -> None:
        self.put_away()
        world = self._view().placement.world
        if world != MAP:
            self._tell("Pose not set", "There is no map to set a pose on.", "warn")
            return
        here = self._view().placement.world_T_base
        kept = 0.0 if here is None else here.yaw
        std_yaw = UNSURE_YAW if pointed.yaw is not None or here is not None else math.pi
        params = SetPose(
            pose=Pose2D(pointed.x, pointed.y, kept if pointed.yaw is None else pointed.yaw),
            covariance=[UNSURE_XY**2, 0, 0, 0, UNSURE_XY**2, 0, 0, 0, std_yaw**2],
        )
        self.ask(requests.POSE_SET, params, "Pose not set")

    def _preview(self, pointed: Pointed) -> None:
        """Ask for the way to where the pointer is, one question at a time."""
        now_ns = self._service.monotonic_ns
        if self._asked is not None or now_ns < self._preview_due_ns:
            return
        self._asked, self._preview_due_ns = pointed, now_ns + PREVIEW_PERIOD_NS

        def show(reply: Path | Refused) -> None:
            if self._asked is not pointed:
                return
            self._asked = None
            if isinstance(reply, Refused):
                self.preview = None
                self.hint = GOAL_HINT if reply.code == codes.TIMEOUT else reply.message
            else:
                self.preview = reply
                self.hint = preview_text(reply)

        self._service.request(
            requests.GOAL_PREVIEW, self._goal(pointed, None), show, robot=self._robot()
        )


def _ignore(_: Pointed) -> None:
    """Nothing is drawn ahead but the arrow."""


def preview_text(path: Path) -> str:
    """Say how far a way is and how long it takes."""
    poses = floats_from_bytes(path.poses, 3)
    length = float(np.hypot(*np.diff(poses[:, :2], axis=0).T).sum())
    eta = f", about {duration((len(poses) - 1) * path.dt)}" if path.dt > 0.0 else ""
    return f"{length:.1f} m{eta}"
