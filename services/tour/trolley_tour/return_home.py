"""The part of the service that takes a robot with a low battery to the place `home`."""

import math

from trolley import codes
from trolley.codes import Refused
from trolley.config import RobotConfig
from trolley.geometry import Pose2D
from trolley.messages import Stop, Tour, TourStatus
from trolley.runtime.service import every
from trolley_tour import sentences
from trolley_tour.charge_monitor import Doing, Gauge, WayHome
from trolley_tour.trips.runner import Travelling
from trolley_tour.trips.trip import ACTIVE, PLANNER, Trip

HOME = "home"
HOME_TOUR = Tour(stops=[Stop(name=HOME, retries=20)])
AT_HOME_M = 0.3
PROBLEM = "battery"


class Homing(Travelling):
    """Trips, and the way home."""

    def __init__(self, config: RobotConfig) -> None:
        super().__init__(config)
        self._gauge = Gauge(config.tour.low_battery)
        self._way_home = WayHome()
        self._was_low = False

    # Twice as often as trips move on, so that the end of a visit is not missed.
    @every(0.1, clock="local")
    def _watch_battery(self) -> None:
        base, now_ns = self.base.latest, self.now_ns
        if base is None or now_ns is None:
            return
        self._gauge.hear(base)
        self._say_battery()
        if self._way_home.is_time(self._gauge, self._doing(), now_ns):
            self._way_home = WayHome()
            self._go_home()

    def _doing(self) -> Doing:
        """What the robot is doing as far as the way home is concerned."""
        trip, goal, base = self._trip, self.goal.latest, self.base.latest
        by_hand = base is not None and base.source not in (None, PLANNER)
        if base is None or base.mode in ("stopped", "fault") or by_hand:
            return "held"
        if trip is not None and trip.record.is_under_way:
            if trip.is_held or trip.record.battery is not None:
                return "held"
            stands = trip.record.goal is None or trip.record.state == "waiting"
            return "between" if stands else "driving"
        if goal is None or goal.frame != "map":
            return "held"
        if goal.state in ACTIVE:
            return "driving"
        # A person let the trip around it end or wait.
        is_of_trip = trip is not None and (goal.id or "").startswith(f"tour-{trip.record.trip}-")
        if is_of_trip and trip is not None and trip.record.state in ("paused", "stopped"):
            return "held"
        return "arrived" if goal.state in ("arrived", "failed") else "held"

    def _go_home(self) -> None:
        """Set off, unless there is no home or the robot is there."""
        home = self._home
        charge = self._gauge.charge or 0.0
        if home is None:
            self.log.limited("no home", "The battery is low, and there is no place to go to")
            return
        pose = None if self.pose.latest is None else self.pose.latest.pose
        if pose is not None and math.hypot(pose.x - home.x, pose.y - home.y) <= AT_HOME_M:
            return
        self.log.warning(f"{sentences.charge(charge)}: driving home")
        self._begin(HOME_TOUR, charge)

    @property
    def _home(self) -> Pose2D | None:
        try:
            return self.find_place(HOME)
        except Refused:
            return None

    # The trip that was interrupted.
    def _carry_out_for(self, trip: Trip) -> None:
        super()._carry_out_for(trip)
        record = trip.record
        if trip is self._trip and record.is_over and record.interrupted is not None:
            self._take_back(trip)

    def _take_back(self, home: Trip) -> None:
        """Put the interrupted trip back in its place, paused; who stopped the way home ends it."""
        interrupted, home.record.interrupted = home.record.interrupted, None
        if interrupted is None:
            return
        trip = self._take_up(interrupted)
        self._num_logged = interrupted.num_results
        trip.needs_saving = True
        if home.record.state == "stopped":
            trip.stop(self._moment, home.record.reason, home.record.message)
        elif home.record.state == "failed":
            interrupted.message = f"{home.record.message} {interrupted.message}"
        self._carry_out_for(trip)

    # What people are told.
    def _say_battery(self) -> None:
        is_low, charge = self._gauge.is_low, self._gauge.charge or 0.0
        if not is_low and not self._was_low:
            return
        if is_low and not self._was_low:
            self.log.warning(f"{sentences.charge(charge)}: it is low")
        self._was_low = is_low
        lacks = "" if self._home is not None else f" There is no place “{HOME}” to go to."
        problem = f"{sentences.charge(charge)}: charge the robot.{lacks}"
        self.set_problem(PROBLEM, problem if is_low else None)

    def _status(self) -> TourStatus:
        status = super()._status()
        if status.state != "idle" or not self._gauge.is_low:
            return status
        charge = self._gauge.charge or 0.0
        return TourStatus(
            stamp_ns=status.stamp_ns,
            name=None,
            trip=None,
            state="idle",
            reason=codes.LOW_BATTERY,
            message=f"{sentences.charge(charge)}: charge the robot.",
        )

    def _begin_scheduled(self, tour: Tour) -> None:
        if self._gauge.is_low:
            self.count("schedule/low_battery")
            self.log.warning("A tour was due but the battery is low", tour=tour.name)
        else:
            super()._begin_scheduled(tour)
