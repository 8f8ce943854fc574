"""What the buttons do: requests to the selected robot, and notices about the answers."""

from collections.abc import Callable
from typing import Any

from trolley import codes, requests, topics
from trolley.codes import Refused
from trolley.messages import GoalStatus, PoseEstimate, TourStatus
from trolley.messages.request_params import FollowPerson, Nothing, SendGoal, StartTour, WhichGoal
from trolley.requests import Request
from trolley.runtime.service import Service
from trolley.under_way import GOAL_GOES, GOAL_UNDER_WAY, trip_of, what_is_under_way
from trolley_viz.controls.undo import History, Step
from trolley_viz.features.driving.goal_queue import MAX_STOPS, GoalQueue
from trolley_viz.features.driving.search import Search
from trolley_viz.robots.view import View
from trolley_viz.scene.places import current_places
from trolley_viz.words.sentences import Tell, refusal

SENDING = (requests.GOAL_SEND, requests.GOAL_FOLLOW, requests.TOUR_START)
"""The requests that set a robot off."""


class RobotActions:
    """Requests from one browser; all on the service's thread.

    Args:
        robot: the name of the robot that is asked.
        view: what is known of it.
        tell: shows a notice.
        note_sent: notes a robot and the goal or trip that it was sent.
    """

    def __init__(
        self,
        service: Service,
        robot: Callable[[], str],
        view: Callable[[], View],
        tell: Tell,
        note_sent: Callable[[str, str], None],
    ) -> None:
        self._service = service
        self._robot = robot
        self._view = view
        self.tell = tell
        self._note_sent = note_sent
        self.before_ask: Callable[[Request[Any, Any]], None] | None = None
        """Hears of each request before it is sent."""
        self.history = History()
        """What the person did and can undo."""
        self.goal_queue = GoalQueue()
        """The goals that the person has queued."""
        self.search = Search(tell)
        """What the person waits for after *Find position*."""
        self._asked: list[Request[Any, Any]] = []

    def is_asking(self, *which: Request[Any, Any]) -> bool:
        """Whether an answer to one of these requests is awaited."""
        return any(request in which for request in self._asked)

    def forget(self) -> None:
        """Forget what was done and queued, as when another robot is followed."""
        self.history.clear()
        self.goal_queue.collect(is_on=False)
        self.goal_queue.clear()
        self.search.forget()

    # Goals.
    def choose_place(self, name: str) -> None:
        """Drive to a saved pose, or queue it while goals are being collected."""
        if not self.goal_queue.is_collecting:
            self.send_goal(SendGoal(id=self._service.new_id(), name=name), name)
            return
        for place in current_places(self._view()):
            if place.name == name:
                self.line_up(is_added=self.goal_queue.add_place(name, place.pose))

    def follow_person(self, point: tuple[float, float] | None = None) -> None:
        """Follow whoever is at a point of the world [m], or else the nearest person ahead."""
        params = FollowPerson(
            id=self._service.new_id(),
            point=point,
            frame=None if point is None else self._view().placement.world,
        )
        self.ask(requests.GOAL_FOLLOW, params, "The robot does not follow anybody")

    def steer(self, action: str) -> None:
        """Do "Pause", "Continue" or "Cancel" to what is under way: the trip, or else the goal."""
        streams = self._view().streams
        goal = streams.latest(topics.GOAL)
        what = what_is_under_way(goal, streams.latest(topics.TOUR))
        if not what:
            self.tell(f"{action}: not done", "The robot is not going anywhere.", "idle")
        elif what == "trip":
            self.steer_tour("End" if action == "Cancel" else action)
        else:
            self.steer_goal(action, goal)

    def steer_goal(self, action: str, goal: GoalStatus | None) -> None:
        """Do "Pause", "Continue" or "Cancel" to this goal and no newer one."""
        request = {
            "Pause": requests.GOAL_PAUSE,
            "Continue": requests.GOAL_RESUME,
            "Cancel": requests.GOAL_CANCEL,
        }[action]
        which = WhichGoal(id=None if goal is None else goal.id)
        self.ask(request, which, f"{action}: not done")

    @property
    def was_stopped(self) -> bool:
        """Whether what is under way waits for nothing but the end of a stop."""
        streams = self._view().streams
        goal, trip = streams.latest(topics.GOAL), streams.latest(topics.TOUR)
        status = trip if what_is_under_way(goal, trip) == "trip" else goal
        return status is not None and (status.state, status.reason) == ("paused", codes.STOPPED)

    def start_goal_queue(self) -> None:
        """Drive to the queued goals, one after the other."""
        tour = self.goal_queue.tour()
        if tour is not None:
            self.ask(
                requests.TOUR_START,
                StartTour(tour=tour),
                "The robot did not set off",
                self.goal_queue.set_off,
            )

    # The pose.
    def find(self) -> None:
        """Let the robot search for itself on the whole map."""

        def begun(estimate: PoseEstimate) -> None:
            self.search.begin(estimate.stamp_ns, self._service.monotonic_ns)

        self.ask(requests.POSE_FIND, Nothing(), "The robot cannot search", begun)

    # Tours.
    def start_tour(self, name: str) -> None:
        """Start a stored tour."""
        self.ask(requests.TOUR_START, StartTour(name=name), "The tour did not start")

    def steer_tour(self, action: str) -> None:
        """Do "Pause", "Continue", "Skip" or "End" to the trip."""
        request = {
            "Pause": requests.TOUR_PAUSE,
            "Continue": requests.TOUR_RESUME,
            "Skip": requests.TOUR_SKIP,
            "End": requests.TOUR_STOP,
        }[action]
        self.ask(request, Nothing(), f"{action}: not done")

    def ask(
        self,
        request: Request[Any, Any],
        params: Any,
        failed: str,
        done: Callable[[Any], None] | None = None,
        then: Callable[[Any, str], None] | None = None,
        robot: str = "",
        refused: Callable[[], None] = lambda: None,
    ) -> None:
        """Send a request to a robot and tell people if it is refused.

        Args:
            request: what is asked.
            params: of it.
            failed: says that it was not done.
            done: takes the answer, if the same robot is selected still.
            then: takes the answer and the robot, whichever is selected: asks it for the rest.
            robot: whom; the selected one if "".
            refused: called if it is refused, and the same robot is selected still.
        """
        robot = robot or self._robot()

        def finish(reply: Any) -> None:
            self._asked.remove(request)
            if isinstance(reply, Refused):
                self._service.log.info("Refused", request=request.name, code=reply.code)
                self.tell(failed, refusal(reply), "bad")
                if robot == self._robot():
                    refused()
                return
            sent = _id_of(reply) if request in SENDING else None
            if sent:
                self._note_sent(robot, sent)
            if then is not None:
                then(reply, robot)
            # What comes next is about the robot that was asked: another may be followed by now.
            if done is not None and robot == self._robot():
                done(reply)

        if self.before_ask is not None:
            self.before_ask(request)
        self._asked.append(request)
        self._service.request(request, params, finish, robot=robot)

    # Inside.
    def line_up(self, *, is_added: bool) -> None:
        """Tell the person where the queue is full."""
        if not is_added:
            self.tell("Not added", f"There are already {MAX_STOPS} places in the row.", "warn")

    def send_goal(self, goal: SendGoal, title: str) -> None:
        """Drive somewhere; `title` names it in the undo step."""
        before = self._view().streams.latest(topics.GOAL)

        def sent(status: GoalStatus) -> None:
            def holds() -> bool:
                now = self._view().streams.latest(topics.GOAL)
                if now is None or now.stamp_ns < status.stamp_ns:
                    return True  # its first status has not come yet
                return now.id == status.id and now.state in GOAL_UNDER_WAY

            undo = Step("drive", f"Go to {title}", lambda: self._go_back(before, status), holds)
            self.history.add(undo)

        self.ask(requests.GOAL_SEND, goal, "The robot cannot go there", sent)

    def _go_back(self, before: GoalStatus | None, sent: GoalStatus) -> None:
        """Drive to where it was driving before this goal was sent, or nowhere."""
        was_driving = before is not None and before.state in GOAL_GOES
        if before is None or not was_driving or before.pose is None:
            self.steer_goal("Cancel", sent)
        elif trip_of(before.id) is not None:
            self.steer_tour("Continue")
        else:
            goal = SendGoal(id=self._service.new_id(), pose=before.pose, frame=before.frame)
            self.ask(requests.GOAL_SEND, goal, "The robot cannot go back")


def _id_of(status: GoalStatus | TourStatus) -> str | None:
    return status.id if isinstance(status, GoalStatus) else status.trip
