"""The overlays in the browsers: each is sent those of the robot that it follows."""

from collections.abc import Callable

from msgspec import Struct, structs

from trolley import topics
from trolley.messages import Choice
from trolley.runtime.service import Service
from trolley_viz.overlays.cards import Card, Moment
from trolley_viz.overlays.overlay_set import OverlaySet
from trolley_viz.server.sockets import Sockets


class Click(Struct, frozen=True, kw_only=True):
    """What a browser sends: an item of a menu was clicked, or its CSV is wanted."""

    id: str
    index: int | None = None
    csv: bool = False


class File(Struct, frozen=True):
    """A file to save."""

    name: str
    text: str


class OverlayUpdate(Struct, frozen=True, kw_only=True):
    """What a browser is sent: which overlays there are, and the cards that changed."""

    order: list[str] = []
    cards: dict[str, Card] = {}
    note: str = ""
    may_choose: bool = False
    """Whether the items of menus may be clicked."""
    csv: File | None = None
    """Only this, where it is there."""


class ShownOverlays(Struct, frozen=True):
    """The overlays that a browser shows."""

    robot: str
    overlays: OverlaySet
    when: Moment


class OverlayPages:
    """The overlays of all browsers.

    Args:
        service: publishes what is chosen.
        shown: what a browser (viser's number for it) shows, None where nothing.
    """

    def __init__(self, service: Service, shown: Callable[[int], ShownOverlays | None]) -> None:
        self._service = service
        self._shown = shown
        self._sent: dict[int, OverlayUpdate] = {}
        self.sockets = Sockets(
            service.call_soon, Click, self._said, self._left, operators_only=False
        )

    def send_changes(self) -> None:
        """Send every browser what changed."""
        made: dict[str, OverlayUpdate] = {}
        for who, client_id in self.sockets.clients().items():
            shown = self._shown(client_id)
            name = "" if shown is None else shown.robot
            if name not in made:
                made[name] = OverlayUpdate() if shown is None else _update_of(shown)
            now, before = made[name], self._sent.get(who)
            if now != before:
                self._sent[who] = now
                update = now if before is None else _changes(now, before)
                self.sockets.send(
                    who, structs.replace(update, may_choose=self.sockets.may_act(who))
                )

    def _said(self, who: int, client_id: int, click: Click) -> None:
        shown = self._shown(client_id)
        if shown is None:
            return
        if click.csv:
            text = shown.overlays.csv(click.id)
            if text is not None:
                self.sockets.send(
                    who, OverlayUpdate(csv=File(f"{shown.robot}-{click.id}.csv", text))
                )
        elif click.index is not None and self.sockets.may_act(who):
            item = shown.overlays.choose(click.id, click.index)
            if item is not None:
                stamp_ns = self._service.time_of(shown.robot).now(self._service.monotonic_ns) or 0
                choice = Choice(stamp_ns=stamp_ns, index=click.index, item=item)
                self._service.publish(topics.CHOICE, choice, click.id, robot=shown.robot)

    def _left(self, who: int) -> None:
        self._sent.pop(who, None)


def _update_of(shown: ShownOverlays) -> OverlayUpdate:
    cards = shown.overlays.cards(shown.when)
    more = shown.overlays.num_left_out
    note = f"{more} more overlays are not shown." if more else ""
    return OverlayUpdate(order=list(cards), cards=cards, note=note)


def _changes(now: OverlayUpdate, before: OverlayUpdate) -> OverlayUpdate:
    changed = {name: card for name, card in now.cards.items() if before.cards.get(name) != card}
    return OverlayUpdate(order=now.order, cards=changed, note=now.note)
