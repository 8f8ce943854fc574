"""All robots of the network at a glance: what each is doing and where, besides the followed one."""

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

from trolley import topics
from trolley.messages import BaseState, GoalStatus, PoseEstimate, Robot
from trolley.runtime.service import Watch
from trolley.topics import Topic
from trolley_viz.robots.ages import Ages, LastHeard, overdue_s

IS_AWAY = " – away"
"""Ends what a robot is called in a list while nothing is heard of it."""


class Robots:
    """The robots of the network, and what they are called."""

    def __init__(self, own: str) -> None:
        self.own = own
        """The robot of the viewer's own configuration."""
        self._known: dict[str, Robot] = {}

    def update(self, heard: Mapping[tuple[str, ...], Robot]) -> None:
        """Store the `robot` messages by name."""
        self._known = {parts[0]: robot for parts, robot in heard.items()}

    def get(self, name: str) -> Robot | None:
        """The `robot` message of a robot, None before the first."""
        return self._known.get(name)

    def names(self, selected: str = "") -> list[str]:
        """All names, sorted; the robot of the own configuration and the selected one always."""
        return sorted({*self._known, self.own, selected or self.own})

    def labels(self, selected: str, is_away: Callable[[str], bool]) -> dict[str, str]:
        """What to call each robot in a list, to its name."""
        labels: dict[str, str] = {}
        for name in self.names(selected):
            known = self._known.get(name)
            title = known.title if known is not None else ""
            label = f"{title} ({name})" if title and title.lower() != name else title or name
            labels[label + (IS_AWAY if is_away(name) else "")] = name
        return labels


class Member(NamedTuple):
    """What is known of one robot."""

    name: str
    robot: Robot | None
    base: BaseState | None
    pose: PoseEstimate | None
    goal: GoalStatus | None
    robot_ns: int | None
    """Its time [ns], None while its clock is silent."""
    ages: Ages = MappingProxyType({})
    """How old what is known is, by topic, where there should be something newer."""
    away_s: float | None = None
    """For how long nothing has been heard of it [s]; None while it is heard, or never was."""

    @property
    def pose_age_s(self) -> float | None:
        """How old its pose is [s], None where that is not known."""
        if self.pose is None or self.robot_ns is None:
            return self.away_s
        return (self.robot_ns - self.pose.stamp_ns) * 1e-9

    @property
    def is_away(self) -> bool:
        """Whether its clock is silent."""
        return self.robot_ns is None


TOPICS: tuple[Topic[Any], ...] = (topics.BASE, topics.POSE, topics.GOAL)


class Fleet:
    """Follows a few streams of all robots while somebody looks and there are several.

    Args:
        robots: which there are.
        open_watch: subscribes to a topic of all robots.
        close_watch: ends that.
        robot_ns: the time of a robot [ns], None while its clock is silent.
    """

    def __init__(
        self,
        robots: Robots,
        open_watch: Callable[[Topic[Any]], Watch[Any]],
        close_watch: Callable[[Watch[Any]], None],
        robot_ns: Callable[[str], int | None],
    ) -> None:
        self._robots = robots
        self._open = open_watch
        self._close = close_watch
        self._robot_ns = robot_ns
        self._watches: dict[str, Watch[Any]] = {}
        self._last_heard: dict[str, LastHeard] = {}
        self.members: list[Member] = []
        """All robots, sorted by name; none where there is only one."""

    def update(self, now_ns: int, *, is_watched: bool) -> None:
        """Take in what arrived by local `now_ns`; unsubscribe where nobody looks."""
        names = self._robots.names()
        if not is_watched or len(names) < 2:
            for watch in self._watches.values():
                self._close(watch)
            self._watches.clear()
            self.members = []
            return
        for topic in TOPICS:
            if topic.name not in self._watches:
                self._watches[topic.name] = self._open(topic)
        self.members = [self._member(name, now_ns) for name in names]

    def _member(self, name: str, now_ns: int) -> Member:
        robot_ns = self._robot_ns(name)
        base, pose, goal = (self._watches[one.name].by_parts.get((name,)) for one in TOPICS)
        ages = {
            topic.name: overdue_s(topic, message, self._arrived_ns(topic, name), now_ns)
            for topic, message in ((topics.BASE, base), (topics.GOAL, goal))
        }
        return Member(
            name,
            self._robots.get(name),
            base,
            pose,
            goal,
            robot_ns,
            {topic: age_s for topic, age_s in ages.items() if age_s is not None},
            self._last_heard.setdefault(name, LastHeard()).update(robot_ns, now_ns),
        )

    def _arrived_ns(self, topic: Topic[Any], name: str) -> int | None:
        return self._watches[topic.name].arrived((name,))
