"""What the bridge hears from the robot's services."""

from collections.abc import Callable
from typing import NamedTuple

from trolley import topics
from trolley.messages import (
    BaseState,
    Battery,
    GoalStatus,
    Health,
    OccupancyGrid,
    Path,
    PoseEstimate,
    Robot,
    SavedPose,
    SavedPoses,
    Tours,
    TourStatus,
    Zones,
)
from trolley.runtime.service import Service, Watch, every
from trolley_mqtt.robot_view import RobotView

SILENT_NS = 30_000_000_000
"""A planner that says nothing of its health for so long is missed; one that is restarted is not."""


class Names(NamedTuple):
    """The names of the places and tours that a command may ask for."""

    places: list[str]
    tours: list[str]


class RobotInputs:
    """Keeps the newest message of each stream that the bridge needs."""

    base: Watch[BaseState]
    pose: Watch[PoseEstimate]
    goal: Watch[GoalStatus]
    trip: Watch[TourStatus]
    poses: Watch[SavedPoses]
    zones: Watch[Zones]
    tours: Watch[Tours]
    map: Watch[OccupancyGrid]
    about: Watch[Robot]
    path: Watch[Path]
    planner: Watch[Health]

    def __init__(self, service: Service) -> None:
        self._service = service
        self._here_since_ns = 0
        """Since when the robot is heard of (local monotonic [ns]); before, nobody is missed."""

    def start(self, on_drive: Callable[[], None]) -> None:
        """Watch everything; `on_drive` is called for each state of goal and trip, however short."""

        def take(_: GoalStatus | TourStatus) -> None:
            on_drive()

        self.base = self._service.watch(topics.BASE)
        self.pose = self._service.watch(topics.POSE)
        self.goal = self._service.watch(topics.GOAL, then=take)
        self.trip = self._service.watch(topics.TOUR, then=take)
        self.goal.wakes = self.trip.wakes = False  # it is told within a second
        self.poses = self._service.watch(topics.POSES)
        self.zones = self._service.watch(topics.ZONES)
        self.tours = self._service.watch(topics.TOURS)
        self.map = self._service.watch(topics.MAP)
        self.about = self._service.watch(topics.ROBOT)
        self.path = self._service.watch(topics.PATH)
        self.planner = self._service.watch(topics.HEALTH, "planner")
        self._here_since_ns = self._service.monotonic_ns

    @every(1.0, clock="local")
    def _listen(self) -> None:
        if self._service.now_ns is None:
            self._here_since_ns = self._service.monotonic_ns

    @property
    def view(self) -> RobotView:
        """The robot now."""
        now_ns, estimate = self._service.now_ns, self.pose.latest
        age_s = None
        if estimate is not None and now_ns is not None:
            age_s = (now_ns - estimate.stamp_ns) * 1e-9
        is_replayed = self.about.latest is not None and self.about.latest.replayed
        # A robot without either is driven by hand alone.
        drives_itself = estimate is not None or self.planner.latest is not None
        heard_ns = max(self.planner.arrived_ns or 0, self._here_since_ns)
        return RobotView(
            is_away=now_ns is None,
            base=self.base.latest,
            estimate=estimate,
            age_s=age_s,
            goal=self.goal.latest,
            trip=self.trip.latest,
            places=self._places,
            zones=self.zones.latest,
            has_planner=is_replayed
            or not drives_itself
            or self._service.monotonic_ns - heard_ns <= SILENT_NS,
        )

    @property
    def names(self) -> Names:
        """The places on the robot's map, and the tours that can be driven on it."""
        tours = [] if self.tours.latest is None else self.tours.latest.tours
        on_map = None if self.pose.latest is None else self.pose.latest.map
        return Names(
            [place.name for place in self._places],
            [tour.name for tour in tours if tour.is_for(on_map)],
        )

    @property
    def knows_names(self) -> bool:
        """Whether the lists of places and tours have been heard."""
        return self.poses.latest is not None and self.tours.latest is not None

    @property
    def battery(self) -> Battery | None:
        """The newest, None while nothing was heard of one."""
        return None if self.base.latest is None else self.base.latest.battery

    @property
    def _places(self) -> list[SavedPose]:
        """The saved places on the robot's map; all of them while that is unknown."""
        poses, estimate = self.poses.latest, self.pose.latest
        found = [] if poses is None else poses.poses
        return [place for place in found if estimate is None or place.map == estimate.map]
