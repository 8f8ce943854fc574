"""Who has the viewer open now."""

from collections.abc import Callable
from dataclasses import dataclass

from trolley_viz.features.people.names import Names
from trolley_viz.features.people.senders import Senders
from trolley_viz.features.people.stoppers import Stoppers
from trolley_viz.server.devices import A_BROWSER, by
from trolley_viz.server.visitors import Role, Visitor


@dataclass(frozen=True)
class Present:
    """An open page."""

    number: int
    name: str
    role: Role
    robot: str
    """The name of the robot that it follows."""
    since_ns: int
    """When it was opened (local monotonic)."""


@dataclass(frozen=True)
class _Open:
    visitor: Visitor
    robot: Callable[[], str]
    since_ns: int


class People:
    """The people at the open pages.

    Args:
        names: what their browsers are called.
    """

    def __init__(self, names: Names) -> None:
        self.names = names
        self.senders = Senders()
        self.stoppers = Stoppers()
        self._open: dict[int, _Open] = {}

    def come(self, number: int, visitor: Visitor, robot: Callable[[], str], since_ns: int) -> None:
        """Note that a page is open."""
        self._open[number] = _Open(visitor, robot, since_ns)

    def go(self, number: int) -> None:
        """Note that a page is not open any more."""
        self._open.pop(number, None)

    def name_of(self, number: int) -> str:
        """Return what to call the browser of a page."""
        page = self._open.get(number)
        return A_BROWSER if page is None else self.names.of(page.visitor)

    def driven_by(self, number: int) -> str:
        """Say by whom a robot is driven at a page, "" where that would tell nobody apart."""
        name = self.name_of(number)
        return "" if name == A_BROWSER else by(name)

    @property
    def present(self) -> list[Present]:
        """The pages that are open, those that came first in front."""
        return [
            Present(number, self.names.of(one.visitor), one.visitor.role, one.robot(), one.since_ns)
            for number, one in sorted(self._open.items())
        ]
