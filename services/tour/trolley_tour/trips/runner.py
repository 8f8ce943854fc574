"""Drives trips: carries out what a trip asks for, and passes it the news."""

from functools import partial

from trolley import codes, requests, topics
from trolley.codes import Refused
from trolley.messages import BaseState, GoalStatus, Tour, TourStatus
from trolley.messages.request_params import Nothing, StartTour, WhichGoal
from trolley.runtime.service import Service, answers, every
from trolley_tour import sentences
from trolley_tour.problems import Problems
from trolley_tour.robot_state import RobotState
from trolley_tour.state_files import StateFiles
from trolley_tour.stored.checks import checked_tour
from trolley_tour.stored.places import Places
from trolley_tour.stored.tours import Tours
from trolley_tour.trips.actions import Action, Cancel, Pause, Send
from trolley_tour.trips.record import Moment, TripRecord
from trolley_tour.trips.report import TripReport
from trolley_tour.trips.trip import Trip
from trolley_tour.trips.trip_params import TripParams

TRIP_FILE = "trip.toml"
SKIPPED = "schedule"
"""The problem that a tour was due and skipped; over once one is started, or that one deleted."""


class TripRunner:
    """Runs one trip at a time: feeds it what the robot reports, and asks the planner.

    A trip that drives home because of a low battery carries the one that it interrupted in its
    record, and gives way to it, paused, at its end.
    """

    def __init__(
        self,
        service: Service,
        files: StateFiles,
        robot: RobotState,
        places: Places,
        tours: Tours,
        report: TripReport,
        problems: Problems,
        params: TripParams,
    ) -> None:
        self._service = service
        self._files = files
        self._robot = robot
        self._places = places
        self._tours = tours
        self._report = report
        self._problems = problems
        self._params = params
        self._trip: Trip | None = None
        self._epoch_ns: int | None = None

    def set_params(self, params: TripParams) -> None:
        """Wait and give up by other numbers, on this trip and the next ones."""
        self._params = params
        if self._trip is not None:
            self._trip.set_params(params)

    def start(self) -> None:
        """Take up the trip where it was."""
        record = self._files.read(TRIP_FILE, TripRecord)
        if record is not None:
            self._take_up(record).hold()
        self._carry_out()
        self._report.update()

    def epoch_began(self, epoch_ns: int) -> None:
        """Hear of a restart of `base`, or of its clock for the first time."""
        self._epoch_ns = epoch_ns
        trip = self._trip
        if trip is None:
            return
        if trip.is_held:
            self._service.get(topics.GOAL, then=lambda found: self._go_on(trip, found.get(())))
        else:
            trip.epoch_began(epoch_ns)
            self._carry_out()

    @property
    def record(self) -> TripRecord | None:
        """What is known of the present trip or the last one."""
        return None if self._trip is None else self._trip.record

    @property
    def is_held(self) -> bool:
        """Whether the trip was loaded and waits for news of the robot."""
        return self._trip is not None and self._trip.is_held

    @property
    def is_busy(self) -> bool:
        """Whether a trip is under way or paused."""
        return self._trip is not None and not self._trip.record.is_over

    # Requests.
    @answers(requests.TOUR_START)
    def _start(self, params: StartTour) -> TourStatus:
        if params.tour is not None:
            tour = checked_tour(params.tour)
        else:
            tour = self._tours.find(params.name or "")
        map_name = self._robot.map_name
        if not tour.is_for(map_name):
            which = f"The tour {tour.name!r}" if tour.name else "The tour"
            why = f"{which} is on the map {tour.map}, the robot is on {map_name}."
            raise Refused(codes.WRONG_MAP, why, map=tour.map)
        for stop in tour.stops:
            if stop.name is not None and stop.name not in self._places.items:
                message = f"The tour needs the saved pose {stop.name!r}, which does not exist."
                raise Refused(codes.UNKNOWN_NAME, message, name=stop.name)
        return self.begin(tour, params.speed)

    @answers(requests.TOUR_STOP)
    def _stop(self, params: Nothing) -> TourStatus:
        del params
        self._present.stop(self._moment)
        return self._carry_out()

    @answers(requests.TOUR_PAUSE)
    def _pause(self, params: Nothing) -> TourStatus:
        del params
        trip = self._present
        title = trip.record.title
        trip.pause(codes.PAUSED, f"Paused before {title}; resume the tour to continue.")
        return self._carry_out()

    @answers(requests.TOUR_RESUME)
    def _resume(self, params: Nothing) -> TourStatus:
        del params
        trip = self._present
        trip.record.epoch_ns = self._epoch_ns
        trip.resume(self._moment, self._robot.goal_id)
        return self._carry_out()

    @answers(requests.TOUR_SKIP)
    def _skip(self, params: Nothing) -> TourStatus:
        del params
        self._present.skip(self._moment)
        return self._carry_out()

    def begin(self, tour: Tour, speed: float | None = None) -> TourStatus:
        """Start a trip in place of the one under way, at `speed` [m/s] at most."""
        if self._trip is not None and self.is_busy:
            self._trip.stop(self._moment, codes.REPLACED, "Another trip was started.")
            self._carry_out()
        self._problems.set(SKIPPED, None)
        return self._set_off(tour, speed=speed)

    def begin_way_home(self, tour: Tour, charge: float) -> None:
        """Start a trip because the battery is so low; the one under way waits, paused."""
        interrupted = None
        if self._trip is not None and self.is_busy:
            self._trip.pause(codes.LOW_BATTERY, sentences.PAUSES[codes.LOW_BATTERY])
            interrupted = self._trip.record.copy()
            self._carry_out()
        self._set_off(tour, charge, interrupted)

    def _set_off(
        self,
        tour: Tour,
        battery: float | None = None,
        interrupted: TripRecord | None = None,
        speed: float | None = None,
    ) -> TourStatus:
        record = TripRecord(
            trip=self._service.new_id(),
            tour=tour,
            tries=[0] * len(tour.stops),
            epoch_ns=self._epoch_ns,
            battery=battery,
            interrupted=interrupted,
            speed=speed,
        )
        trip = self._take_up(record)
        self._service.log.info(
            "Trip begins", tour=tour.name, trip=record.trip, stops=len(tour.stops)
        )
        trip.begin(self._moment, self._robot.goal_id, self._robot.command_source)
        return self._carry_out()

    def _take_up(self, record: TripRecord) -> Trip:
        self._trip = Trip(record, self._places.find, self._params)
        self._report.follow(record)
        return self._trip

    @property
    def _present(self) -> Trip:
        """The trip under way; raises `Refused` where there is none."""
        if self._trip is None or not self.is_busy:
            raise Refused(codes.NOT_DRIVING)
        return self._trip

    @property
    def _moment(self) -> Moment:
        service, robot = self._service, self._robot
        return Moment(
            service.now_ns,
            service.monotonic_ns,
            service.utc_now(),
            robot.map_name,
            robot.map_T_base,
        )

    # News for the trip.
    def _go_on(self, trip: Trip, goal: GoalStatus | None) -> None:
        if trip.is_held and self._epoch_ns is not None:
            trip.go_on(self._moment, self._epoch_ns, goal)
            record = trip.record
            self._service.log.info("Trip taken up", trip=record.trip, state=record.state)
            self._carry_out_for(trip)

    def update_goal(self, status: GoalStatus) -> None:
        """Take what the planner reports of its goal."""
        if self._trip is not None:
            self._trip.update_goal(status, self._moment)
            self._carry_out()

    def update_base(self, state: BaseState) -> None:
        """Take what the base reports."""
        if self._trip is not None:
            self._trip.update_base(state)
            self._carry_out()

    @every(0.2, clock="local")
    def _tick(self) -> None:
        if self._trip is not None:
            self._trip.tick(self._moment)
            self._carry_out()

    # What the trip asks for.
    def _carry_out(self) -> TourStatus:
        if self._trip is not None:
            self._carry_out_for(self._trip)
        return self._report.status()

    def _carry_out_for(self, trip: Trip) -> None:
        """Do what the trip asks for: stopping at once, sending once its state is saved.

        So the saved trip always knows a goal that was sent, whenever the power goes.
        """
        actions, trip.actions = trip.actions, []
        for action in actions:
            self._stop_goal(trip, action)
        sends = [action for action in actions if isinstance(action, Send)]
        if trip.needs_saving:
            trip.needs_saving = False
            self._files.save(TRIP_FILE, trip.record.copy(), lambda _: self._send(trip, sends))
        else:
            self._send(trip, sends)
        if trip is self._trip:
            self._report.update()
            if trip.record.is_over and trip.record.interrupted is not None:
                self._return_to(trip.record.interrupted, trip)

    def _stop_goal(self, trip: Trip, action: Action) -> None:
        """Cancel or pause a goal; a refusal means that it is gone already."""
        match action:
            case Cancel(goal_id):
                request = requests.GOAL_CANCEL
            case Pause(goal_id):
                request = requests.GOAL_PAUSE
            case Send():
                return

        def update(result: GoalStatus | Refused) -> None:
            if isinstance(result, GoalStatus):
                trip.update_goal(result, self._moment)
                self._carry_out_for(trip)

        self._service.request(request, WhichGoal(id=goal_id), update)

    def _send(self, trip: Trip, sends: list[Send]) -> None:
        for send in sends:
            goal_id = send.goal.id or ""
            if trip is self._trip and trip.wants(goal_id):
                reply = partial(self._update_reply, trip, goal_id)
                self._service.request(requests.GOAL_SEND, send.goal, reply)

    def _update_reply(self, trip: Trip, goal_id: str, result: GoalStatus | Refused) -> None:
        trip.update_reply(goal_id, result, self._moment)
        self._carry_out_for(trip)

    def _return_to(self, interrupted: TripRecord, way_home: Trip) -> None:
        """Return to the interrupted trip, paused; who stopped the way home ends it too."""
        home = way_home.record
        home.interrupted = None
        trip = self._take_up(interrupted)
        trip.needs_saving = True
        if home.state == "stopped":
            trip.stop(self._moment, home.reason, home.message)
        elif home.state == "failed":
            interrupted.message = f"{home.message} {interrupted.message}"
        self._carry_out_for(trip)
