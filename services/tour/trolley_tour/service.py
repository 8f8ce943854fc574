"""The tour service: what people store, trips and their history; markers and overlays in memory."""

from trolley.config import RobotConfig, TourConfig
from trolley.runtime.live_config import LiveConfig
from trolley.runtime.service import Service
from trolley.runtime.state import saved_for_others_only
from trolley_tour.charge_monitor import BatteryParams, ChargeMonitor
from trolley_tour.drawings import Drawings
from trolley_tour.offers import Offers
from trolley_tour.problems import Problems
from trolley_tour.return_home import ReturnHome
from trolley_tour.robot_state import RobotState
from trolley_tour.state_files import StateFiles
from trolley_tour.stored.capture import PoseCapture
from trolley_tour.stored.places import Places
from trolley_tour.stored.tours import Tours
from trolley_tour.trips.history import TripHistory
from trolley_tour.trips.photos import StopPhotos
from trolley_tour.trips.report import TripReport
from trolley_tour.trips.runner import TripRunner
from trolley_tour.trips.schedule import Scheduler
from trolley_tour.trips.trip_params import TripParams


def params_of(config: TourConfig) -> TripParams:
    """Return the numbers of a trip, as they are configured."""
    return TripParams(config.stop_timeout_s, config.retry_wait_s)


class TourService(Service):
    """All of the tour service, as parts."""

    name = "tour"

    def __init__(self, config: RobotConfig) -> None:
        tour = config.tour
        problems = Problems(self)
        files = StateFiles(self, problems)
        battery = BatteryParams(low=tour.low_battery)
        charge = self._charge = ChargeMonitor(battery)
        robot = self._robot = RobotState(self)
        places = self.places = Places(self, files, robot)
        tours = self.tours = Tours(self, files, robot)
        capture = self._capture = PoseCapture(self, places, robot)
        history = TripHistory(self, problems, float(tour.history_days))
        photos = StopPhotos(self, tour.photos_mb * 1_000_000)
        report = TripReport(self, history, photos, charge)
        trips = self._trips = TripRunner(
            self, files, robot, places, tours, report, problems, params_of(tour)
        )
        self.parts = (
            Offers(self, robot, places, trips, charge),
            Drawings(self),
            capture,
            ReturnHome(self, robot, places, trips, charge, problems, battery),
            trips,
            report,
            Scheduler(self, tours, robot, trips, charge, problems),
            history,
            photos,
            places,
            tours,
            LiveConfig(self, config, self._use),
        )

    def _use(self, config: RobotConfig) -> None:
        """Heed settings that were changed, from now on."""
        self._trips.set_params(params_of(config.tour))
        self._charge.set_low(config.tour.low_battery)

    def start(self) -> None:
        """Watch the robot, publish what is stored, and take up the trip where it was."""
        self._robot.start(
            self._capture.update_pose, self._trips.update_goal, self._trips.update_base
        )
        self.places.start()
        self.tours.start()
        if others := saved_for_others_only(self.state.path.parent, self.robot):
            self.log.warning(
                "Nobody has saved a place or tour for this robot, but for others here; if it was "
                "renamed, docs/install.md says how to take them along",
                others=", ".join(others),
            )
        self._trips.start()

    def epoch_began(self) -> None:
        """Hear of a restart of `base`, or of its clock for the first time."""
        self._trips.epoch_began(self.epoch_ns)
