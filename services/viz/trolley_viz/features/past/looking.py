"""Which time one browser looks at: now, or a moment of the past."""

import datetime
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from trolley import requests
from trolley.messages import PastTrip, StopResult
from trolley.requests import Request
from trolley.runtime.service import Service
from trolley_viz.features.past.keeper import Keeper
from trolley_viz.features.past.record import PastView, Record, Then, Trouble
from trolley_viz.features.past.recorder import KEPT_NS
from trolley_viz.words.sentences import StatusLine, Tell, duration

FAST = 8.0
"""How many seconds pass in one while it is played fast."""
NEAR_END_NS = 2_000_000_000
"""Whoever looks at a moment this near to now looks at now."""
TRACK_NS = 300_000_000_000
"""How much of the track is drawn of the last ten minutes."""
REDRAWN_NS = 100_000_000
"""The picture is drawn again for a time that differs by this much."""
DAY_S = 86_400.0

MOVING: tuple[Request[Any, Any], ...] = (
    requests.BASE_RESUME,
    requests.GOAL_SEND,
    requests.GOAL_FOLLOW,
    requests.GOAL_RESUME,
    requests.POSE_FIND,
    requests.POSE_SET,
    requests.TOUR_START,
    requests.TOUR_RESUME,
    requests.TOUR_SKIP,
    requests.MAP_NEW,
    requests.MAP_EXTEND,
    requests.MAP_EXPLORE,
)
"""Requests that move the robot, or say where it is: whoever sends one has to see it as it is."""


@dataclass(frozen=True)
class Window:
    """The time that can be looked at [ns since boot]."""

    first_ns: int
    last_ns: int


class Looking:
    """Which time one browser looks at, and the play button that moves it on.

    Args:
        service: whose clocks it uses.
        keeper: what is known of the past.
        robot: the robot that the browser follows.
        tell: shows its person a title and a sentence.
    """

    def __init__(
        self,
        service: Service,
        keeper: Keeper,
        robot: Callable[[], str],
        time_zone: Callable[[], datetime.tzinfo | None],
        tell: Tell,
    ) -> None:
        self.is_open = False
        """Whether its person has the bar open."""
        self.trip = ""
        """What the trip is called that is looked at, "" for the last ten minutes."""
        self.speed = 0.0
        """How many seconds pass in one; 0: none."""
        self._service, self._keeper = service, keeper
        self._robot, self._time_zone, self._tell = robot, time_zone, tell
        self._record: Record | None = None
        """What is looked at, as it was when its person began to; None: now."""
        self._at_ns = self._ticked_ns = 0
        self._asked = 0
        """Counts the trips that were asked for: only the last one is shown."""
        self._picture: PastView | None = None
        self._drawn: tuple[Record, int] | None = None

    # What the panels and the scene read.
    @property
    def is_past(self) -> bool:
        """Whether a moment of the past is looked at."""
        return self._record is not None

    @property
    def at_ns(self) -> int:
        """The time that is looked at."""
        return self._at_ns if self.is_past else self._service.since_boot_ns

    @property
    def window(self) -> Window:
        """The time that can be looked at."""
        if self._record is not None:
            return Window(self._record.first_ns or 0, self._record.last_ns)
        now_ns = self._service.since_boot_ns
        first_ns = self._keeper.lately(self._robot()).first_ns
        return Window(now_ns if first_ns is None else first_ns, now_ns)

    @property
    def is_short(self) -> bool:
        """Whether less than ten minutes are recorded, as after the viewer was started."""
        window = self.window
        return not self.trip and window.last_ns - window.first_ns < KEPT_NS - NEAR_END_NS

    @property
    def troubles(self) -> list[Trouble]:
        """What went wrong in that time."""
        return (self._record or self._keeper.lately(self._robot())).troubles()

    @property
    def picture(self) -> PastView | None:
        """What there is to draw; None for what is now."""
        record = self._record
        if record is None:
            return None
        key = record, self._at_ns // REDRAWN_NS
        if self._picture is None or key != self._drawn:
            self._drawn, then = key, record.at(self._at_ns)
            since_ns = 0 if self.trip else self._at_ns - TRACK_NS
            self._picture = PastView(then, record.track(self._at_ns, since_ns, then.map))
        return self._picture

    def wall_time(self, at_ns: int) -> datetime.datetime:
        """A time by this host's clock, as that is set now, in its person's time zone."""
        unix_s = (at_ns + self._keeper.store.unix_offset_ns) * 1e-9
        return datetime.datetime.fromtimestamp(unix_s, datetime.UTC).astimezone(self._time_zone())

    def sentence(self, map_name: str) -> StatusLine | None:
        """Say that this is the past, and what was said of the robot then; None for now.

        Args:
            map_name: the map that is shown.
        """
        record = self._record
        if record is None:
            return None
        then = record.at(self._at_ns)
        said = "Nothing was recorded at that time." if then.words is None else then.words.headline
        where = (
            f" It was on the map “{then.map}”, which is not shown."
            if then.map and then.map != map_name
            else ""
        )
        return StatusLine(f"{self._when(then)} {said}{where}", "idle")

    # What its person does.
    def open(self) -> None:
        """Open the bar; what is shown is still what is now."""
        self.is_open = True

    def close(self) -> None:
        """Close the bar, and return to what is now."""
        self.is_open = False
        self.return_to_now()

    def return_to_now(self) -> None:
        """Show what is now."""
        self._record, self._picture = None, None
        self.trip, self.speed = "", 0.0
        self._asked += 1

    def look(self, at_ns: int) -> None:
        """Look at a time."""
        if self._record is None and not self._begin():
            return
        window = self.window
        if not self.trip and at_ns >= window.last_ns - NEAR_END_NS:
            self.return_to_now()
        else:
            self._at_ns = min(max(at_ns, window.first_ns), window.last_ns)

    def play_or_pause(self) -> None:
        """Let time pass, or halt it; from now it begins with the earliest moment."""
        if self._record is None:
            if self._begin():
                self._at_ns = self.window.first_ns
        elif self.speed == 0.0 and self._at_ns >= self.window.last_ns:
            self._at_ns = self.window.first_ns
        if self._record is not None:
            self.speed = 1.0 if self.speed == 0.0 else 0.0

    def change_speed(self) -> None:
        """Play fast, or as it was."""
        if self.speed == 0.0:
            self.play_or_pause()
        if self.is_past:
            self.speed = FAST if self.speed != FAST else 1.0

    def show_trip(self, trip: PastTrip, result: StopResult | None = None) -> None:
        """Look at a past trip: from its beginning, or where a stop was not reached."""
        self._asked += 1
        number = self._asked

        def found(record: Record | str) -> None:
            if number != self._asked:
                return
            if isinstance(record, str) or record.first_ns is None:
                why = record if isinstance(record, str) else "Nothing was recorded of it."
                self._tell("The trip cannot be shown", why, "warn")
                return
            self.is_open, self._record = True, record
            self.trip, self.speed = trip.name or "unnamed", 0.0
            moment_ns = None if result is None else moment_of(record, trip, result)
            self._at_ns = record.first_ns if moment_ns is None else moment_ns

        self._keeper.trip(self._robot(), trip.trip, found)

    def asks(self, request: Request[Any, Any]) -> None:
        """Return to now where its person is about to move the robot."""
        if request in MOVING:
            self.return_to_now()

    # What the session asks for.
    def tick(self) -> None:
        """Let time pass, where it is played."""
        now_ns = self._service.monotonic_ns
        passed_ns, self._ticked_ns = now_ns - self._ticked_ns, now_ns
        record = self._record
        if record is None or self.speed == 0.0:
            return
        self._at_ns += int(self.speed * passed_ns)
        if self._at_ns < record.last_ns:
            return
        if self.trip:
            self._at_ns, self.speed = record.last_ns, 0.0
        else:
            self._catch_up()

    # Inside.
    def _begin(self) -> bool:
        """Take hold of the last ten minutes as they are now; False where there are none."""
        record = self._keeper.lately(self._robot())
        if record.first_ns is None:
            return False
        self._record, self.trip = record.copy(), ""
        return True

    def _catch_up(self) -> None:
        """Go on with what was recorded meanwhile, or with now."""
        newer = self._keeper.lately(self._robot())
        if self._at_ns < newer.last_ns - NEAR_END_NS:
            self._record = newer.copy()
            self._at_ns = max(self._at_ns, newer.first_ns or 0)
        else:
            self.return_to_now()

    def _when(self, then: Then) -> str:
        """Begin a sentence about a time."""
        at, now = self.wall_time(then.at_ns), self.wall_time(self._service.since_boot_ns)
        if at.date() != now.date():
            return f"On {at:%d %b} at {at:%H:%M:%S}:".replace("On 0", "On ")
        ago_s = max((self._service.since_boot_ns - then.at_ns) // 1_000_000_000, 0)
        return f"At {at:%H:%M:%S}, {duration(ago_s).replace('.0 s', ' s')} ago:"


def moment_of(record: Record, trip: PastTrip, result: StopResult) -> int | None:
    """When a stop was not reached, None where the record does not go so far [ns].

    Where the record has not noted it, the trip's own times tell how long after its beginning it
    was, whatever the robot's clock says.
    """
    for failure in record.failures:
        if (failure.stop, failure.started_at) == (result.stop, result.started_at):
            return failure.at_ns
    began, started = _time(trip.started_at), _time(result.started_at)
    if began is None or started is None or record.first_ns is None:
        return None
    after_s = (started - began).total_seconds() + result.seconds
    return min(max(record.first_ns + int(after_s * 1e9), record.first_ns), record.last_ns)


def _time(text: str | None) -> datetime.datetime | None:
    try:
        time = datetime.datetime.fromisoformat(text or "")
    except ValueError:
        return None
    return time if time.tzinfo is not None else time.replace(tzinfo=datetime.UTC)
