"""Takes a robot with a low battery to the place `home`."""

from trolley import codes
from trolley.codes import Refused
from trolley.geometry import Pose2D
from trolley.messages import Stop, Tour
from trolley.messages.touring import HOME
from trolley.runtime.service import Service, every
from trolley.under_way import GOAL_GOES, trip_of
from trolley_tour import sentences
from trolley_tour.charge_monitor import Activity, BatteryParams, ChargeMonitor, ReturnDecision
from trolley_tour.problems import Problems
from trolley_tour.robot_state import RobotState
from trolley_tour.stored.places import Places
from trolley_tour.trips.runner import TripRunner

HOME_TOUR = Tour(stops=[Stop(name=HOME, retries=20)])
AT_HOME_M = 0.3
"""A robot this near is at home already."""
PROBLEM = "battery"


class ReturnHome:
    """Watches the battery, says that it is low, and starts the trip home."""

    def __init__(
        self,
        service: Service,
        robot: RobotState,
        places: Places,
        trips: TripRunner,
        charge: ChargeMonitor,
        problems: Problems,
        params: BatteryParams,
    ) -> None:
        self._service = service
        self._robot = robot
        self._places = places
        self._trips = trips
        self._charge = charge
        self._problems = problems
        self._decision = ReturnDecision(params)
        self._was_low = False

    # Twice as often as trips move on, so that the end of a visit is not missed.
    @every(0.1, clock="local")
    def _watch_battery(self) -> None:
        base, now_ns = self._robot.base.latest, self._service.now_ns
        if base is None or now_ns is None:
            return
        self._charge.update(base)
        self._report()
        if self._decision.is_time(self._charge, self._activity(), now_ns):
            self._decision.set_off()
            self._go_home()

    def _activity(self) -> Activity:
        record, goal, base = self._trips.record, self._robot.goal.latest, self._robot.base.latest
        if base is None or base.mode in ("stopped", "fault") or self._robot.is_driven_by_hand:
            return "held"
        if record is not None and record.is_under_way:
            if self._trips.is_held or record.battery is not None:
                return "held"
            stands = record.goal is None or record.state == "waiting"
            return "between_goals" if stands else "driving"
        if goal is None or goal.frame != "map":
            return "held"
        if goal.state in GOAL_GOES:
            return "driving"
        # A person ended or paused the trip that this goal belongs to.
        is_of_trip = record is not None and trip_of(goal.id) == record.trip
        if is_of_trip and record is not None and record.state in ("paused", "stopped"):
            return "held"
        return "arrived" if goal.state in ("arrived", "failed") else "held"

    def _go_home(self) -> None:
        """Set off, unless there is no home or the robot is there."""
        home, pose = self._home, self._robot.map_T_base
        if isinstance(home, str):
            self._service.log.limited("no home", "The battery is low", why=home)
            return
        if pose is not None and pose.distance_to(home) <= AT_HOME_M:
            return
        charge = self._charge.fraction
        self._service.log.warning(f"{sentences.battery_at(charge)}: driving home")
        self._trips.begin_way_home(HOME_TOUR, charge)

    @property
    def _home(self) -> Pose2D | str:
        """Where home is, or why that is not known."""
        try:
            return self._places.find(HOME)
        except Refused as refused:
            if refused.code == codes.UNKNOWN_NAME:
                return f"There is no place “{HOME}” to go to."
            return refused.message

    def _report(self) -> None:
        """Say in log and health that the battery is low, until it is not."""
        is_low, was_low = self._charge.is_low, self._was_low
        if not is_low and not was_low:
            return
        self._was_low = is_low
        battery = sentences.battery_at(self._charge.fraction)
        if is_low and not was_low:
            self._service.log.warning(f"{battery}: it is low")
        home = self._home
        lacks = f" {home}" if isinstance(home, str) else ""
        self._problems.set(PROBLEM, f"{battery}: charge the robot.{lacks}" if is_low else None)
