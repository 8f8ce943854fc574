"""Whatever happens in whatever order, a trip keeps its promises."""

import msgspec
from hypothesis import example, given, settings
from hypothesis import strategies as st
from support.cases import cases

from trolley import codes
from trolley.codes import Refused
from trolley.geometry import Pose2D
from trolley.messages import BaseState, GoalState, GoalStatus, Stop, Tour
from trolley.state_file import parse, render
from trolley_tour.trips.actions import Send
from trolley_tour.trips.record import Moment, TripRecord
from trolley_tour.trips.trip import Trip
from trolley_tour.trips.trip_params import TripParams

STATES = ["idle", "planning", "driving", "recovering", "paused", "arrived", "failed", "canceled"]
REFUSALS = [codes.NOT_READY, codes.STOPPED, codes.NO_PATH, codes.NOT_LOCALIZED, codes.TIMEOUT]

stops = st.builds(
    Stop,
    name=st.sampled_from(["a", "b", "gone"]),
    dwell=st.sampled_from([0.0, 3.0]),
    timeout=st.sampled_from([None, 5.0]),
    retries=st.integers(0, 2),
    on_failure=st.sampled_from(["retry", "skip", "abort"]),
)
tours = st.builds(
    Tour,
    name=st.just(""),
    stops=st.lists(stops, min_size=1, max_size=4),
    repeat=st.integers(0, 3),
    there_and_back=st.booleans(),
    resume=st.booleans(),
)
goal_ids = st.sampled_from(["present", "older", "mine", "none"])
events = st.one_of(
    st.tuples(st.just("tick"), st.sampled_from([0.2, 1.0, 8.0])),
    st.tuples(
        st.just("goal"), goal_ids, st.sampled_from(STATES), st.sampled_from(["", "replaced"])
    ),
    st.tuples(st.just("refuse"), st.sampled_from(REFUSALS)),
    st.tuples(
        st.just("base"), st.sampled_from(["ok", "stopped"]), st.sampled_from([None, "teleop"])
    ),
    st.tuples(st.just("epoch"), st.integers(1, 3)),
    st.sampled_from([("pause",), ("resume",), ("skip",), ("stop",), ("restart",)]),
)


def find(name: str) -> Pose2D:
    if name == "gone":
        raise Refused(codes.UNKNOWN_NAME)
    return Pose2D(0.0, 0.0, 0.0)


class Play:
    """A trip, the time, and what people asked for."""

    def __init__(self, tour: Tour) -> None:
        record = TripRecord(trip="abc", tour=tour, tries=[0] * len(tour.stops), epoch_ns=1)
        self.trip = Trip(record, find, TripParams(stop_timeout_s=20.0, retry_wait_s=2.0))
        self.ns = 0
        self.ids: list[str] = []
        self.may_send = True
        self.trip.begin(self.at, "mine")
        self.check()

    @property
    def at(self) -> Moment:
        return Moment(self.ns, self.ns)

    def do(self, event: tuple) -> None:
        trip, record = self.trip, self.trip.record
        match event:
            case ("tick", seconds):
                self.ns += int(seconds * 1e9)
                trip.tick(self.at)
            case ("goal", which, state, reason):
                known = {
                    "present": record.goal,
                    "older": "tour-abc-0-0",
                    "mine": "mine",
                    "none": None,
                }
                trip.update_goal(self.status(known[which], state, reason), self.at)
            case ("refuse", code):
                trip.update_reply(record.goal or "", Refused(code, service="planner"), self.at)
            case ("base", mode, source):
                trip.update_base(BaseState(stamp_ns=self.ns, mode=mode, source=source))
            case ("epoch", epoch_ns):
                trip.epoch_began(epoch_ns)
            case (str(word),) if not record.is_over:
                self.ask(word)
        self.check()

    def ask(self, word: str) -> None:
        asked = {
            "pause": lambda: self.trip.pause(codes.PAUSED, "Paused."),
            "resume": lambda: self.trip.resume(self.at, None),
            "skip": lambda: self.trip.skip(self.at),
            "stop": lambda: self.trip.stop(self.at),
            "restart": self.restart,
        }
        asked[word]()

    def status(self, goal_id: str | None, state: GoalState, reason: str) -> GoalStatus:
        return GoalStatus(stamp_ns=self.ns, id=goal_id, state=state, reason=reason)

    def restart(self) -> None:
        """The record survives as TOML; the rest is lost."""
        saved = parse(render(self.trip.record.copy()), TripRecord)
        assert saved == self.trip.record
        self.trip = Trip(saved, find, TripParams(stop_timeout_s=20.0, retry_wait_s=2.0))
        self.trip.hold()
        self.trip.go_on(self.at, saved.epoch_ns or 1, None)

    def check(self) -> None:
        trip, record = self.trip, self.trip.record
        actions, trip.actions = trip.actions, []
        for action in actions:
            if isinstance(action, Send) and trip.wants(action.goal.id):
                assert record.is_under_way, "a paused or ended trip sends nothing"
                assert (
                    action.goal.id
                    == f"tour-abc-{record.stop_index}-{record.tries[record.stop_index]}"
                )
                if action.goal.id is not None and action.goal.id not in self.ids:
                    self.ids.append(action.goal.id)
        assert record.message, "it always says why"
        assert record.num_results >= len(record.results)
        msgspec.json.decode(
            msgspec.json.encode(record.status(self.ns)), type=type(record.status(0))
        )


RESTARTED_BEFORE_A_RETRY = [("refuse", codes.NO_PATH), ("restart",), ("tick", 0.2)]


@given(tours, st.lists(events, max_size=60))
@example(Tour(stops=[Stop(name="a", on_failure="retry")]), RESTARTED_BEFORE_A_RETRY)
def test_trip_never_sets_off_by_itself_and_loses_nothing(tour: Tour, script: list):
    play = Play(tour)
    for event in script:
        before = play.trip.record.copy()
        num_ids = len(play.ids)
        play.do(event)
        record = play.trip.record
        if before.state == "paused" and event[0] not in ("resume", "stop", "skip"):
            # Only a person goes on, by the tour or by the goal itself.
            assert record.state == "paused" or event[0] == "goal"
            assert len(play.ids) == num_ids
        if before.is_over:
            assert record.state == before.state
            assert len(play.ids) == num_ids
        if event == ("base", "stopped", None):
            assert not record.is_under_way
        assert record.reached >= before.reached
        assert record.lap >= before.lap


@given(tours)
@settings(max_examples=cases(40))
def test_trip_with_a_planner_that_always_arrives_ends(tour: Tour):
    play = Play(tour)
    for _ in range(300):
        if play.trip.record.is_over:
            break
        play.do(("tick", 8.0))
        if play.trip.record.state == "driving" and play.trip.record.goal:
            play.do(("goal", "present", "arrived", ""))
    endless = tour.repeat == 0 or any(
        stop.name == "gone" and stop.on_failure == "retry" and stop.retries == 0
        for stop in tour.stops
    )
    assert play.trip.record.is_over or endless
