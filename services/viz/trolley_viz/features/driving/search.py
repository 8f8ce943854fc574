"""What came of a search for the robot on the whole map."""

from dataclasses import dataclass

from trolley import topics
from trolley.messages import PoseEstimate
from trolley.zones import room_of
from trolley_viz.robots.view import View
from trolley_viz.scene.places import current_places
from trolley_viz.words.sentences import Tell

PATIENCE_NS = 20_000_000_000
"""After this the person is told that it still searches; a large map takes a Pi some seconds."""
AT_M = 0.3
"""So near a place it is there [m]."""
ADVICE = "Drive it a little by hand, or show it where it is with “Set pose …”."


@dataclass(frozen=True)
class Asked:
    """A search that somebody asked for.

    Attributes:
        stamp_ns: of the estimate that answered it [ns of the robot's time].
        at_ns: when [ns of the viewer's clock].
    """

    stamp_ns: int
    at_ns: int


class Search:
    """Tells that a search has begun, and once what came of it."""

    def __init__(self, tell: Tell) -> None:
        self._tell = tell
        self._asked: Asked | None = None

    def begin(self, stamp_ns: int, now_ns: int) -> None:
        """Note that the robot has begun to search; `stamp_ns` is that of its answer."""
        self._asked = Asked(stamp_ns, now_ns)
        self._tell("Searching", "The robot is working out where it is.", "busy")

    def forget(self) -> None:
        """Wait for nothing, as when another robot is followed."""
        self._asked = None

    def update(self, view: View) -> None:
        """Tell what came of it, as soon as the robot is sure, or nobody waits longer."""
        asked, estimate = self._asked, view.streams.latest(topics.POSE)
        if asked is None:
            return
        if estimate is not None and estimate.stamp_ns <= asked.stamp_ns:
            estimate = None
        if estimate is not None and estimate.state == "localized":
            took_s = (estimate.stamp_ns - asked.stamp_ns) * 1e-9
            where = _where(estimate, view)
            self._tell("It knows where it is", f"It took {took_s:.1f} s.{where}", "good")
        elif estimate is not None and estimate.state == "lost":
            self._tell("Not found", ADVICE, "bad")
        elif view.now_ns - asked.at_ns > PATIENCE_NS:
            self._tell("Not sure yet", ADVICE, "warn")
        else:
            return
        self._asked = None


def _where(estimate: PoseEstimate, view: View) -> str:
    """The room that the robot is in, else the nearest place; "" where there is neither."""
    room = room_of(estimate, view.streams.latest(topics.ZONES))
    if room is not None:
        return f" It is in “{room}”."
    here, places = estimate.pose, current_places(view)
    if here is None or not places:
        return ""
    distance, name = min((one.pose.distance_to(here), one.name) for one in places)
    return f" It is at {name}." if distance < AT_M else f" It is {distance:.1f} m from {name}."
