"""What is known of one robot now: what drawings and sentences are made from."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from trolley import topics
from trolley.messages import GoalStatus, OccupancyGrid, Robot, SetupState
from trolley.topics import Topic
from trolley_viz.robots.ages import overdue_s
from trolley_viz.robots.fleet import Member
from trolley_viz.robots.past_trips import PastTrips
from trolley_viz.robots.placement import Placement
from trolley_viz.robots.streams import Streams

SETUP_S = 2.0
"""A setup that has said nothing for so long has ended [s]; it speaks at 2 Hz."""


@dataclass(frozen=True)
class View:
    """One robot, as its newest messages tell of it."""

    robot_name: str
    streams: Streams
    placement: Placement
    robot: Robot | None
    now_ns: int
    """Local monotonic time [ns]."""
    robot_ns: int | None
    """The robot's time [ns], None while its clock is silent."""
    work: Callable[[Callable[[], Any], Callable[[Any], None]], None]
    """Runs a slow function aside, then calls the second one with its result."""
    past: PastTrips
    """The past trips, once somebody looks at them."""
    fleet: Sequence[Member] = ()
    """All robots, where there are several."""
    silent: frozenset[str] = frozenset()
    """Services that have fallen silent, or were never heard although they should have been."""
    away_s: float | None = None
    """For how long nothing has been heard of it [s]; None while it is heard, or never was."""
    lost_goal: GoalStatus | None = None
    """The goal that a restart of its planner has lost, None if none was."""

    @property
    def is_away(self) -> bool:
        """Whether the robot's clock is silent."""
        return self.robot_ns is None

    @property
    def can_go(self) -> bool:
        """Whether its planner takes goals: while the robot is stopped it takes none."""
        has_planner = self.streams.latest(topics.GOAL) is not None and "planner" not in self.silent
        return has_planner and not self.is_away and not self.is_halted

    @property
    def can_tour(self) -> bool:
        """Whether its tours can be started."""
        return self.can_go and "tour" not in self.silent

    @property
    def is_halted(self) -> bool:
        """Whether the robot stands until somebody lets it drive on."""
        base = self.streams.latest(topics.BASE)
        return base is not None and base.is_halted and not self.is_away

    @property
    def setup(self) -> SetupState | None:
        """How far its setup is, None while there is none."""
        state = self.streams.latest(topics.SETUP)
        is_there = self.is_fresh(topics.SETUP, SETUP_S)
        return state if is_there and state is not None and state.outcome != "ended" else None

    @property
    def map(self) -> OccupancyGrid | None:
        """The robot's map, None if it has none, or none any more."""
        estimate = self.streams.latest(topics.POSE)
        is_gone = estimate is not None and estimate.map is None
        return None if is_gone else self.streams.latest(topics.MAP)

    def place_frames(self) -> None:
        """Bring the frames to where the newest messages say that they are."""
        self.placement.update(
            self.streams.by_parts(topics.TF),
            self.streams.history(topics.ODOM),
            has_map=self.map is not None,
        )

    def overdue_s(self, topic: Topic[Any]) -> float | None:
        """How old the newest message is [s], None if there need not be a newer one."""
        streams = self.streams
        arrived_ns = streams.arrived_ns(topic)
        return overdue_s(topic, streams.latest(topic), arrived_ns, self.now_ns, self.silent)

    def is_fresh(self, topic: Topic[Any], within_s: float = 1.5) -> bool:
        """Whether a message of the topic arrived within the last real seconds."""
        arrived_ns = self.streams.arrived_ns(topic)
        return arrived_ns is not None and self.now_ns - arrived_ns <= within_s * 1e9
