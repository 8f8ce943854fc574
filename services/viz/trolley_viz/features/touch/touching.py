"""What was touched on the map, and what its person does there."""

from collections.abc import Callable

from msgspec.structs import replace

from trolley import codes, requests
from trolley.codes import Refused
from trolley.geometry import Pose2D
from trolley.geometry.frames import MAP
from trolley.messages import Path, SavedPose
from trolley.messages.request_params import SendGoal
from trolley.runtime.service import Service
from trolley_viz.features.driving.aiming import ANY_HEADING, Aiming, preview_text
from trolley_viz.features.driving.robot_actions import RobotActions
from trolley_viz.features.places.place_actions import PlaceActions
from trolley_viz.features.touch.touched import Touched
from trolley_viz.pointing.pointer import Pointed
from trolley_viz.robots.view import View
from trolley_viz.words.sentences import refusal

FLOOR_TITLE = "a place on the map"
OUT_OF_REACH = (codes.IN_OBSTACLE, codes.OUTSIDE_MAP, codes.KEEPOUT, codes.NO_PATH)
"""Refusals that are about the place; others may have passed while one reads them."""


class Touching:
    """What one person has touched on the map (at most one thing), and the buttons of its card.

    Args:
        actions: ask the robot that is followed.
        aiming: sets poses.
        place_actions: save places.
        robot: the name of the robot that is followed.
        view: what is known of it.
    """

    def __init__(
        self,
        service: Service,
        actions: RobotActions,
        aiming: Aiming,
        place_actions: PlaceActions,
        robot: Callable[[], str],
        view: Callable[[], View],
    ) -> None:
        self._service = service
        self._actions, self._aiming, self._place_actions = actions, aiming, place_actions
        self._robot, self._view = robot, view
        self.touched: Touched | None = None
        """What the card is about; None: there is none."""
        self.preview: Path | None = None
        """How the robot would drive there."""
        self.way = ""
        """How far that is and how long it takes, or why it cannot."""
        self.is_refused = False
        """Whether the robot cannot go there."""

    def touch(self, one: Touched | None) -> None:
        """Show a card about this, and find out whether the robot can go there."""
        self.close()
        self.touched = one
        if one is None or one.what not in ("place", "floor"):
            return

        def answered(reply: Path | Refused) -> None:
            if self.touched is not one:
                return
            if not isinstance(reply, Refused):
                self.preview, self.way = reply, preview_text(reply)
            elif reply.code != codes.TIMEOUT:
                self.way = refusal(reply)
                self.is_refused = reply.code in OUT_OF_REACH

        self._service.request(requests.GOAL_PREVIEW, self._goal(one), answered, robot=self._robot())

    def close(self) -> None:
        """Take the card away."""
        self.touched = self.preview = None
        self.way = ""
        self.is_refused = False

    def go(self) -> None:
        """Drive there."""
        one = self.touched
        if one is None:
            return
        if one.what == "place":
            self._actions.choose_place(one.name)
        else:
            goal = replace(self._goal(one), id=self._service.new_id())
            self._actions.send_goal(goal, FLOOR_TITLE)
        self.close()

    def follow(self) -> None:
        """Follow whoever stands there."""
        if self.touched is not None:
            self._actions.follow_person((self.touched.x, self.touched.y))
            self.close()

    def save(self, name: str) -> None:
        """Save it as a place, facing the way that the robot would come."""
        one = self.touched
        if one is None:
            return
        if self._view().placement.world != MAP:
            self._actions.tell("Not now", "There is no map to save a place on.", "warn")
            return
        pose = self._aiming.pose_at(Pointed(one.x, one.y))
        self._place_actions.put_new(SavedPose(name=name, pose=pose), lambda _: self.close())

    def set_pose(self) -> None:
        """Tell the robot that this is where it is, facing as it thinks."""
        one = self.touched
        if one is not None:
            self._aiming.set_pose(Pointed(one.x, one.y))
            self.close()

    def _goal(self, one: Touched) -> SendGoal:
        if one.what == "place":
            return SendGoal(name=one.name)
        frame = self._view().placement.world
        return SendGoal(pose=Pose2D(one.x, one.y, 0.0), frame=frame, yaw_tolerance=ANY_HEADING)
