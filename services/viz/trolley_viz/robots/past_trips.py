"""The past trips of a robot: asked for when somebody looks, and again when a trip has ended."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from trolley import codes
from trolley.codes import Refused
from trolley.geometry import Pose2D
from trolley.messages import PastTrip, StopResult, TourStatus
from trolley.under_way import TRIP_UNDER_WAY
from trolley_viz.words.sentences import refusal

MAX_TRIPS = 200
AGAIN_NS = 10_000_000_000
"""How long after a refusal to ask again, while somebody is looking."""
SAME_SPOT_M = 0.4
MAX_SPOTS = 60

AT_THE_STOP = (codes.IN_OBSTACLE, codes.OUTSIDE_MAP, codes.KEEPOUT)
"""Reasons that are about the place of the stop, wherever the robot stands."""

Answered = Callable[[list[PastTrip] | Refused], None]


class PastTrips:
    """What is known of them.

    Args:
        ask: asks for the newest so many, and calls back.
    """

    def __init__(self, ask: Callable[[int, Answered], None]) -> None:
        self.trips: tuple[PastTrip, ...] | None = None
        """The newest first, None until they are known."""
        self.problem = ""
        """Why they are not known, in one sentence."""
        self._ask = ask
        self._is_asking = False
        self._asked_at: tuple[str | None, bool] | None = None
        self._again_ns = 0

    def refresh(self, trip: TourStatus | None, now_ns: int) -> None:
        """Ask again if a trip has begun or ended since the last time; called while somebody looks.

        Args:
            trip: the one under way or the last one, None while the tour service is silent.
            now_ns: local monotonic time [ns].
        """
        at = (None, False) if trip is None else (trip.trip, trip.state in TRIP_UNDER_WAY)
        is_due = at != self._asked_at or (self.problem != "" and now_ns >= self._again_ns)
        if not is_due or self._is_asking:
            return
        self._is_asking, self._asked_at, self._again_ns = True, at, now_ns + AGAIN_NS
        self._ask(MAX_TRIPS, self._answered)

    def _answered(self, reply: list[PastTrip] | Refused) -> None:
        self._is_asking = False
        if isinstance(reply, Refused):
            self.problem = refusal(reply)
        else:
            self.trips, self.problem = tuple(reply), ""


@dataclass(frozen=True)
class Spot:
    """A place on the map where the robot did not get on, or to which it could not go."""

    pose: Pose2D
    count: int
    newest: StopResult
    when: str | None
    """When the newest of them began, UTC, as far as it is known."""


def trouble_spots(trips: Sequence[PastTrip], map_name: str) -> list[Spot]:
    """Gather where on a map stops failed; of many spots those where it happened last.

    Stops that people skipped count for nothing.

    Args:
        trips: the newest first.
        map_name: the map.
    """
    spots: list[Spot] = []
    for trip in trips:
        if trip.map != map_name:
            continue
        for result in reversed(trip.results):
            pose = result.goal if result.code in AT_THE_STOP else result.pose
            if pose is None or not has_failed(result):
                continue
            for i, spot in enumerate(spots):
                if spot.pose.distance_to(pose) <= SAME_SPOT_M:
                    spots[i] = Spot(spot.pose, spot.count + 1, spot.newest, spot.when)
                    break
            else:
                if len(spots) < MAX_SPOTS:
                    spots.append(Spot(pose, 1, result, result.started_at))
    return spots


def has_failed(result: StopResult) -> bool:
    """Whether the robot could not reach the stop (and no person skipped it)."""
    return result.state != "reached" and result.code != codes.SKIPPED
