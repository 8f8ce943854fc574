"""The tour service: what people store, trips and their history; markers and overlays in memory."""

from msgspec import structs

from trolley import codes, requests, topics
from trolley.codes import Refused
from trolley.config import RobotConfig
from trolley.messages import Marker, Offer, Overlay, Path
from trolley.messages.request_params import AskOffer, SendGoal
from trolley.runtime.service import Later, answers, gets, on, on_delete
from trolley_tour.drawings import checked_marker, new_markers, new_overlays
from trolley_tour.return_home import Homing
from trolley_tour.stored.capture import Capturing
from trolley_tour.trips.trip import ACTIVE

PREVIEW_S = 1.5


class TourService(Capturing, Homing):
    """All of the tour service."""

    name = "tour"

    def __init__(self, config: RobotConfig) -> None:
        super().__init__(config)
        self._markers = new_markers()
        self._overlays = new_overlays()

    # Which robot is the nearest?
    @answers(requests.TOUR_OFFER)
    def _offer(self, params: AskOffer) -> Offer | Later[Offer]:
        occupied = self._occupied
        free = not occupied
        try:
            pose = params.pose if params.name is None else self.find_place(params.name)
        except Refused as refused:
            return Offer(free=free, reason=refused.code)
        later: Later[Offer] = self.later()

        def answer(path: Path | Refused) -> None:
            if isinstance(path, Refused):
                later.reply(Offer(free=free, reason=path.code))
            else:
                num_poses = len(path.poses) // 12  # three float32 each
                seconds = max(0, num_poses - 1) * path.dt
                later.reply(Offer(free=free, seconds=seconds, reason=occupied))

        self.request(
            requests.GOAL_PREVIEW, SendGoal(pose=pose, frame="map"), answer, timeout_s=PREVIEW_S
        )
        return later

    @property
    def _occupied(self) -> str:
        """The code of why the robot is not free, "" if it is."""
        goal, base = self.goal.latest, self.base.latest
        if self.is_under_way or (goal is not None and goal.state in ACTIVE):
            return codes.BUSY
        battery = None if base is None else base.battery
        if battery is not None and battery.charging:
            return codes.CHARGING
        return codes.LOW_BATTERY if self._gauge.is_low else ""

    # Drawings.
    @on(topics.MARKER)
    def _keep_marker(self, marker: Marker, ns: str, marker_id: str) -> None:
        self._markers.put(
            (ns, marker_id), checked_marker(marker), self.monotonic_ns, marker.lifetime
        )

    @on_delete(topics.MARKER)
    def _delete_markers(self, *chunks: str) -> None:
        self._markers.delete(chunks)

    @gets(topics.MARKER)
    def _get_markers(self, parameters: dict[str, str]) -> dict[tuple[str, ...], Marker]:
        del parameters
        return {
            chunks: structs.replace(marker, lifetime=left_s)
            for chunks, (marker, left_s) in self._markers.items(self.monotonic_ns).items()
        }

    @on(topics.OVERLAY)
    def _keep_overlay(self, overlay: Overlay, overlay_id: str) -> None:
        self._overlays.put((overlay_id,), overlay, self.monotonic_ns)

    @on_delete(topics.OVERLAY)
    def _delete_overlays(self, *chunks: str) -> None:
        self._overlays.delete(chunks)

    @gets(topics.OVERLAY)
    def _get_overlays(self, parameters: dict[str, str]) -> dict[tuple[str, ...], Overlay]:
        del parameters
        return {
            chunks: overlay
            for chunks, (overlay, _) in self._overlays.items(self.monotonic_ns).items()
        }
