"""The part of the service that drives trips: it does what a trip asks and tells it the news."""

import datetime
from collections import deque
from functools import partial

from trolley import codes, requests, topics
from trolley.codes import Refused
from trolley.config import RobotConfig
from trolley.geometry import Pose2D
from trolley.messages import BaseState, GoalStatus, PastTrip, Tour, TourStatus
from trolley.messages.request_params import AskHistory, Nothing, StartTour, WhichGoal
from trolley.runtime.service import Later, Watch, answers, every
from trolley_tour import sentences
from trolley_tour.stored import checks
from trolley_tour.stored.places import Keeping
from trolley_tour.trips import history_file as history
from trolley_tour.trips.actions import Cancel, Limits, Pause, Send
from trolley_tour.trips.record import Moment, TripRecord
from trolley_tour.trips.schedule import Minutes, tours_due
from trolley_tour.trips.trip import Trip

TRIP_FILE = "trip.toml"
HISTORY_BYTES = 900_000
FILE_AGAIN_S = 5.0
MOST_UNFILED = 100
"""Past trips that wait for room on the disk; of more than these the newest are kept."""


class Travelling(Keeping):
    """Trips, their history and their schedule."""

    goal: Watch[GoalStatus]
    base: Watch[BaseState]

    def __init__(self, config: RobotConfig) -> None:
        super().__init__(config)
        self._limits = Limits(config.tour.stop_timeout_s, config.tour.retry_wait_s)
        self._trip: Trip | None = None
        self._epoch_ns: int | None = None
        self._said: TourStatus | None = None
        self._num_logged = 0
        self._is_filed = True
        self._unfiled: deque[PastTrip] = deque(maxlen=MOST_UNFILED)
        self._minutes = Minutes()

    def start(self) -> None:
        """Take up the trip where it was."""
        super().start()
        record = self.read(TRIP_FILE, TripRecord)
        if record is not None:
            self._take_up(record)
            self._num_logged = record.num_results
            self._is_filed = False  # in case the end was saved and not yet told to the history
        self.goal = self.watch(topics.GOAL, then=self._hear_goal)
        self.base = self.watch(topics.BASE, then=self._hear_base)
        if self._trip is not None:
            self._trip.hold()
        self._carry_out()
        self._say()

    def epoch_began(self) -> None:
        """Hear of a restart of `base`, or of its clock for the first time."""
        self._epoch_ns = self.epoch_ns
        trip = self._trip
        if trip is None:
            return
        if trip.is_held:
            self.get(topics.GOAL, then=lambda found: self._go_on(trip, found.get(())))
        else:
            trip.epoch_began(self.epoch_ns)
            self._carry_out()

    # Requests.
    @property
    def is_under_way(self) -> bool:
        """Whether a trip is under way or paused."""
        return self._trip is not None and not self._trip.record.is_over

    @answers(requests.TOUR_START)
    def _start(self, params: StartTour) -> TourStatus:
        if params.tour is not None:
            tour = checks.checked_tour(params.tour)
        else:
            tour = self._find_tour(params.name or "")
        for stop in tour.stops:
            if stop.name is not None and stop.name not in self.poses.items:
                message = f"The tour needs the saved pose {stop.name!r}, which there is not."
                raise Refused(codes.UNKNOWN_NAME, message, name=stop.name)
        return self._begin(tour)

    @answers(requests.TOUR_STOP)
    def _stop(self, params: Nothing) -> TourStatus:
        del params
        self._present.stop(self._moment)
        return self._carry_out()

    @answers(requests.TOUR_PAUSE)
    def _pause(self, params: Nothing) -> TourStatus:
        del params
        trip = self._present
        trip.pause(codes.PAUSED, f"Paused before {trip.record.title}; resume the tour to go on.")
        return self._carry_out()

    @answers(requests.TOUR_RESUME)
    def _resume(self, params: Nothing) -> TourStatus:
        del params
        trip = self._present
        trip.record.epoch_ns = self._epoch_ns
        trip.resume(self._moment, self._goal_before)
        return self._carry_out()

    @answers(requests.TOUR_SKIP)
    def _skip(self, params: Nothing) -> TourStatus:
        del params
        self._present.skip(self._moment)
        return self._carry_out()

    @answers(requests.TOUR_HISTORY)
    def _history(self, params: AskHistory) -> Later[list[PastTrip]]:
        since: datetime.datetime | None = None
        if params.since is not None:
            since = checks.parse_utc(params.since)
            if since is None:
                raise Refused(codes.BAD_REQUEST, f"{params.since!r} is no time in ISO 8601.")
        later: Later[list[PastTrip]] = self.later()

        def answer(done: history.Done) -> None:
            self._note_history(done)
            if done.problem is None:
                later.reply([*done.trips])
            else:
                later.refuse(
                    Refused(codes.INTERNAL, f"The history cannot be read: {done.problem}.")
                )

        folder = self.state.path
        self.work(lambda: history.read_trips(folder, since, params.limit, HISTORY_BYTES), answer)
        return later

    # Trips.
    def _find_tour(self, name: str) -> Tour:
        tour = self.tours.items.get(checks.plain_name(name))
        if tour is None:
            raise Refused(codes.UNKNOWN_NAME, f"There is no tour {name!r}.", name=name)
        return tour

    def find_place(self, name: str) -> Pose2D:
        """Where a saved pose is on the present map; raises `Refused`."""
        return checks.find_place(self.poses.items, name, self.map_name)

    def _begin(self, tour: Tour, battery: float | None = None) -> TourStatus:
        """Start a trip in place of the one under way; because of a `battery` so low, that waits."""
        interrupted = None
        if self._trip is not None and not self._trip.record.is_over:
            if battery is None:
                self._trip.stop(self._moment, codes.REPLACED, "Another trip was started.")
            else:
                self._trip.pause(codes.LOW_BATTERY, sentences.PAUSES[codes.LOW_BATTERY])
                interrupted = self._trip.record.copy()
            self._carry_out()
        record = TripRecord(
            trip=self.new_id(),
            tour=tour,
            tries=[0] * len(tour.stops),
            epoch_ns=self._epoch_ns,
            battery=battery,
            interrupted=interrupted,
        )
        trip = self._take_up(record)
        self.log.info("Trip begins", tour=tour.name, trip=record.trip, stops=len(tour.stops))
        source = None if self.base.latest is None else self.base.latest.source
        trip.begin(self._moment, self._goal_before, source)
        return self._carry_out()

    def _take_up(self, record: TripRecord) -> Trip:
        self._trip = Trip(record, self.find_place, self._limits)
        self._num_logged, self._is_filed = 0, False
        return self._trip

    @property
    def _present(self) -> Trip:
        """The trip under way; raises `Refused` where there is none."""
        if self._trip is None or self._trip.record.is_over:
            raise Refused(codes.NOT_DRIVING)
        return self._trip

    @property
    def _moment(self) -> Moment:
        pose = None if self.pose.latest is None else self.pose.latest.pose
        return Moment(self.now_ns, self.monotonic_ns, self.utc_now(), self.map_name, pose)

    @property
    def _goal_before(self) -> str | None:
        return None if self.goal.latest is None else self.goal.latest.id

    # News for the trip.
    def _go_on(self, trip: Trip, goal: GoalStatus | None) -> None:
        if trip.is_held and self._epoch_ns is not None:
            trip.go_on(self._moment, self._epoch_ns, goal)
            self.log.info("Trip taken up", trip=trip.record.trip, state=trip.record.state)
            self._carry_out_for(trip)

    def _hear_goal(self, status: GoalStatus) -> None:
        if self._trip is not None:
            self._trip.hear_goal(status, self._moment)
            self._carry_out()

    def _hear_base(self, state: BaseState) -> None:
        if self._trip is not None:
            self._trip.hear_base(state)
            self._carry_out()

    @every(0.2, clock="local")
    def _tick(self) -> None:
        if self._trip is not None:
            self._trip.tick(self._moment)
            self._carry_out()

    @every(1.0, clock="local")
    def _each_second(self) -> None:
        self._publish(self._status())
        now = self.utc_now()
        moment = None if now is None else checks.parse_utc(now)
        if moment is None:
            return
        minute = self._minutes.next(moment.astimezone())
        for tour in [] if minute is None else tours_due(self.tours.items.values(), minute):
            self._begin_scheduled(tour)

    def _begin_scheduled(self, tour: Tour) -> None:
        """Start a tour by its schedule, unless a trip is under way or was paused by somebody."""
        if self.is_under_way:
            self.count("schedule/busy")
            self.log.warning("A tour was due but another trip is not over", tour=tour.name)
        else:
            self.log.info("A tour is due", tour=tour.name)
            self._begin(tour)

    # What the trip wants.
    def _carry_out(self) -> TourStatus:
        if self._trip is not None:
            self._carry_out_for(self._trip)
        return self._status()

    def _carry_out_for(self, trip: Trip) -> None:
        """Do what the trip asks for: stopping at once, sending once its state is saved.

        So a goal that was sent is always known to the saved trip, whenever the power goes.
        """
        actions, trip.actions = trip.actions, []
        sends: list[Send] = []
        for action in actions:
            match action:
                case Cancel(goal_id):
                    self.request(
                        requests.GOAL_CANCEL,
                        WhichGoal(id=goal_id),
                        partial(self._hear_answer, trip),
                    )
                case Pause(goal_id):
                    self.request(
                        requests.GOAL_PAUSE, WhichGoal(id=goal_id), partial(self._hear_answer, trip)
                    )
                case Send():
                    sends.append(action)
        if trip.needs_saving:
            trip.needs_saving = False
            self.save(TRIP_FILE, trip.record.copy(), lambda _: self._send(trip, sends))
        else:
            self._send(trip, sends)
        if trip is self._trip:
            self._say()

    def _send(self, trip: Trip, sends: list[Send]) -> None:
        for send in sends:
            goal_id = send.goal.id or ""
            if trip is self._trip and trip.wants(goal_id):
                self.request(
                    requests.GOAL_SEND, send.goal, partial(self._hear_reply, trip, goal_id)
                )

    def _hear_reply(self, trip: Trip, goal_id: str, result: GoalStatus | Refused) -> None:
        trip.hear_reply(goal_id, result, self._moment)
        self._carry_out_for(trip)

    def _hear_answer(self, trip: Trip, result: GoalStatus | Refused) -> None:
        """Hear what became of a cancel or pause; a refusal means that the goal is gone already."""
        if isinstance(result, GoalStatus):
            trip.hear_goal(result, self._moment)
            self._carry_out_for(trip)

    # What people are told.
    def _status(self) -> TourStatus:
        if self._trip is None:
            return TourStatus(stamp_ns=self.stamp_ns, name=None, trip=None, state="idle")
        return self._trip.record.status(self.stamp_ns)

    def _publish(self, status: TourStatus) -> None:
        self._said = status
        self.publish(topics.TOUR, status)

    def _say(self) -> None:
        """Publish what changed, log new results, and tell the history of a trip that ended."""
        status, said = self._status(), self._said
        if said is None or (said.state, said.reason, said.message, said.trip) != (
            status.state,
            status.reason,
            status.message,
            status.trip,
        ):
            self._publish(status)
        trip = self._trip
        if trip is None:
            return
        record = trip.record
        num_new = record.num_results - self._num_logged
        self._num_logged = record.num_results
        for result in record.results[len(record.results) - num_new :]:
            self.log.info(result.message, tour=record.tour.name, seconds=round(result.seconds, 1))
        if record.is_over and not self._is_filed:
            self._is_filed = True
            self._file(record.past())

    def _file(self, past: PastTrip) -> None:
        self.log.info(past.message, tour=past.name, state=past.state)
        self._unfiled.append(past)
        if len(self._unfiled) == 1:
            self._file_next()

    @every(FILE_AGAIN_S, clock="local")
    def _file_next(self) -> None:
        """File the oldest that waits: at once, or again where the disk may have room by now."""
        if not self._unfiled:
            return
        folder, days = self.state.path, float(self.config.tour.history_days)
        past = self._unfiled[0]

        def filed(done: history.Done) -> None:
            self._note_history(done)
            if done.problem is not None:
                self.count("history/not_saved")
                problem = f"The history of trips could not be saved: {done.problem}."
                self.set_problem(history.FILE, problem)
                return
            self.set_problem(history.FILE, None)
            if self._unfiled and self._unfiled[0] is past:
                self._unfiled.popleft()
                self._file_next()

        self.work(lambda: history.keep_trip(folder, past, days), filed)

    def _note_history(self, done: history.Done) -> None:
        """Report what was found broken in the history."""
        if done.kept is not None:
            self.log.error("The history was broken and was kept aside", kept=done.kept)
            self.set_problem(
                f"{history.FILE} before", f"{history.FILE} was broken and has been kept aside."
            )
        if done.num_unreadable:
            self.count("history/unreadable", done.num_unreadable)
