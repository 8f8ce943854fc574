"""The overlays in the browsers: each is told of those of the robot that it follows."""

from collections.abc import Callable

from msgspec import Struct, structs

from trolley import topics
from trolley.messages import Choice
from trolley.runtime.service import Service
from trolley_viz.overlays.board import Board
from trolley_viz.overlays.cards import Card, Moment
from trolley_viz.sockets import Sockets


class Click(Struct, frozen=True, kw_only=True):
    """What a browser says: an item of a menu was clicked, or its CSV is wanted."""

    id: str
    index: int | None = None
    csv: bool = False


class File(Struct, frozen=True):
    """A file to save."""

    name: str
    text: str


class Told(Struct, frozen=True, kw_only=True):
    """What a browser is told: which overlays there are, and how those look that changed."""

    order: list[str] = []
    cards: dict[str, Card] = {}
    note: str = ""
    may_choose: bool = False
    """Whether the items of menus may be clicked."""
    csv: File | None = None
    """Only this, where it is there."""


class Shown(Struct, frozen=True):
    """The overlays that a browser shows."""

    robot: str
    board: Board
    when: Moment


class InPages:
    """The overlays of all browsers.

    Args:
        service: publishes what is chosen.
        shown: what a browser (viser's number for it) shows, None where nothing.
    """

    def __init__(self, service: Service, shown: Callable[[int], Shown | None]) -> None:
        self._service = service
        self._shown = shown
        self._told: dict[int, Told] = {}
        self.sockets = Sockets(
            service.call_soon, Click, self._said, self._left, operators_only=False
        )

    def tell(self) -> None:
        """Tell every browser what changed."""
        made: dict[str, Told] = {}
        for who, client_id in self.sockets.who().items():
            shown = self._shown(client_id)
            name = "" if shown is None else shown.robot
            if name not in made:
                made[name] = Told() if shown is None else _told(shown)
            now, before = made[name], self._told.get(who)
            if now != before:
                self._told[who] = now
                told = now if before is None else _changes(now, before)
                self.sockets.tell(who, structs.replace(told, may_choose=self.sockets.may_act(who)))

    def _said(self, who: int, client_id: int, click: Click) -> None:
        shown = self._shown(client_id)
        if shown is None:
            return
        if click.csv:
            text = shown.board.csv(click.id)
            if text is not None:
                self.sockets.tell(who, Told(csv=File(f"{shown.robot}-{click.id}.csv", text)))
        elif click.index is not None and self.sockets.may_act(who):
            item = shown.board.choose(click.id, click.index)
            if item is not None:
                stamp_ns = self._service.time_of(shown.robot).now(self._service.monotonic_ns) or 0
                choice = Choice(stamp_ns=stamp_ns, index=click.index, item=item)
                self._service.publish(topics.CHOICE, choice, click.id, robot=shown.robot)

    def _left(self, who: int) -> None:
        self._told.pop(who, None)


def _told(shown: Shown) -> Told:
    cards = shown.board.cards(shown.when)
    more = shown.board.num_left_out
    note = f"{more} more overlays are not shown." if more else ""
    return Told(order=list(cards), cards=cards, note=note)


def _changes(now: Told, before: Told) -> Told:
    changed = {name: card for name, card in now.cards.items() if before.cards.get(name) != card}
    return Told(order=now.order, cards=changed, note=now.note)
