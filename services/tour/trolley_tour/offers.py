"""The request `tour/offer`: how soon this robot could be somewhere."""

from trolley import codes, requests
from trolley.codes import Refused
from trolley.messages import Offer, Path
from trolley.messages.request_params import AskOffer, SendGoal
from trolley.runtime.service import Later, Service, answers
from trolley_tour.charge_monitor import ChargeMonitor
from trolley_tour.robot_state import RobotState
from trolley_tour.stored.places import Places
from trolley_tour.trips.runner import TripRunner

PREVIEW_S = 1.5
"""The planner's time for a path: the offer is due within 2 s."""
BYTES_OF_POSE = 12
"""Three float32 each."""


class Offers:
    """Answers `tour/offer`: how soon this robot could be at a place, or why it cannot."""

    def __init__(
        self,
        service: Service,
        robot: RobotState,
        places: Places,
        trips: TripRunner,
        charge: ChargeMonitor,
    ) -> None:
        self._service = service
        self._robot = robot
        self._places = places
        self._trips = trips
        self._charge = charge

    @answers(requests.TOUR_OFFER)
    def _offer(self, params: AskOffer) -> Offer | Later[Offer]:
        occupied = self._occupied()
        is_free = not occupied
        try:
            pose = params.pose if params.name is None else self._places.find(params.name)
        except Refused as refused:
            return Offer(free=is_free, reason=refused.code)
        later: Later[Offer] = self._service.later()

        def answer(path: Path | Refused) -> None:
            if isinstance(path, Refused):
                later.reply(Offer(free=is_free, reason=path.code))
            else:
                num_poses = len(path.poses) // BYTES_OF_POSE
                seconds = max(0, num_poses - 1) * path.dt
                later.reply(Offer(free=is_free, seconds=seconds, reason=occupied))

        goal = SendGoal(pose=pose, frame="map")
        self._service.request(requests.GOAL_PREVIEW, goal, answer, timeout_s=PREVIEW_S)
        return later

    def _occupied(self) -> str:
        """The code of why the robot is not free, "" if it is."""
        occupation = codes.BUSY if self._trips.is_busy else self._robot.occupation
        if occupation:
            return occupation
        base = self._robot.base.latest
        battery = None if base is None else base.battery
        if battery is not None and battery.charging:
            return codes.CHARGING
        return codes.LOW_BATTERY if self._charge.is_low else ""
