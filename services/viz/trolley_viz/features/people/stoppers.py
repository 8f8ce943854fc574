"""Who stopped the robots that stand because somebody pressed Stop at a page."""

from collections.abc import Set
from dataclasses import dataclass

from trolley.messages import BaseState


@dataclass
class _Stopped:
    """A stop that a robot has answered, and who had asked for it."""

    name: str
    stamp_ns: int
    """When it answered [ns of its own time]: it stood by then."""
    is_seen: bool = False
    """Whether a state told of it since."""


class Stoppers:
    """The names of those who pressed Stop first, until the robot may drive again."""

    def __init__(self) -> None:
        self._asked: dict[str, str] = {}
        self._stopped: dict[str, _Stopped] = {}

    def press(self, robot: str, name: str, base: BaseState | None) -> None:
        """Note who presses Stop, unless the robot stands already or nobody knows."""
        if base is not None and base.mode != "stopped":
            self._asked.setdefault(robot, name)

    def answered(self, robot: str, stamp_ns: int) -> None:
        """Note that the robot has stopped."""
        name = self._asked.pop(robot, None)
        if name is not None:
            self._stopped.setdefault(robot, _Stopped(name, stamp_ns))

    def release(self, robot: str) -> None:
        """Forget a press that was not answered: it was taken back."""
        self._asked.pop(robot, None)

    def of(self, robot: str, base: BaseState | None) -> str:
        """Return who stopped a robot, "" where it was nobody at a page or it may drive."""
        stopped = self._stopped.get(robot)
        if stopped is None or base is None:
            return ""
        if base.mode == "stopped":
            stopped.is_seen = True
            return stopped.name
        if stopped.is_seen or base.stamp_ns > stopped.stamp_ns:
            del self._stopped[robot]
        return ""

    def keep(self, robots: Set[str]) -> None:
        """Forget all others: while nobody looks they may be resumed and stopped again."""
        for noted in (self._asked, self._stopped):
            for robot in noted.keys() - robots:
                del noted[robot]
