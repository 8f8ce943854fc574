"""The overlays in the pages: each is told those of the robot that it follows."""

from msgspec import Struct, structs

from trolley import topics
from trolley.messages import Choice
from trolley.runtime.service import Service
from trolley_viz.overlays.cards import Card, CardContext
from trolley_viz.overlays.overlay_set import OverlaySet


class Click(Struct, frozen=True, kw_only=True):
    """What a page says: an item of a menu was clicked, or its CSV is wanted."""

    id: str
    index: int | None = None
    csv: bool = False


class File(Struct, frozen=True):
    """A file to save."""

    name: str
    text: str


class OverlayUpdate(Struct, frozen=True, kw_only=True):
    """What a page is told: which overlays there are, and the cards that changed."""

    order: list[str] = []
    cards: dict[str, Card] = {}
    note: str = ""
    may_choose: bool = False
    """Whether the items of menus may be clicked."""


class ShownOverlays(Struct, frozen=True):
    """The overlays that a page shows."""

    robot: str
    overlays: OverlaySet
    when: CardContext


class OverlayPages:
    """What each page shows of the overlays.

    Args:
        service: publishes what is chosen.
    """

    def __init__(self, service: Service) -> None:
        self._service = service
        self._sent: dict[int, OverlayUpdate] = {}

    def changes(
        self, who: int, shown: ShownOverlays | None, *, may_choose: bool
    ) -> OverlayUpdate | None:
        """Return what a page has not been told yet, None for nothing."""
        now = OverlayUpdate() if shown is None else _update_of(shown)
        now = structs.replace(now, may_choose=may_choose)
        before = self._sent.get(who)
        if now == before:
            return None
        self._sent[who] = now
        return now if before is None else _changes(now, before)

    def forget(self, who: int) -> None:
        """Tell a page everything again, or nothing any more."""
        self._sent.pop(who, None)

    def clicked(self, shown: ShownOverlays, click: Click, *, may_choose: bool) -> File | None:
        """Do what was clicked; returns the file that was asked for."""
        if click.csv:
            text = shown.overlays.csv(click.id)
            return None if text is None else File(f"{shown.robot}-{click.id}.csv", text)
        if click.index is not None and may_choose:
            item = shown.overlays.choose(click.id, click.index)
            if item is not None:
                stamp_ns = self._service.time_of(shown.robot).now(self._service.monotonic_ns) or 0
                choice = Choice(stamp_ns=stamp_ns, index=click.index, item=item)
                self._service.publish(topics.CHOICE, choice, click.id, robot=shown.robot)
        return None


def _update_of(shown: ShownOverlays) -> OverlayUpdate:
    cards = shown.overlays.cards(shown.when)
    more = shown.overlays.num_left_out
    note = f"{more} more overlays are not shown." if more else ""
    return OverlayUpdate(order=list(cards), cards=cards, note=note)


def _changes(now: OverlayUpdate, before: OverlayUpdate) -> OverlayUpdate:
    changed = {name: card for name, card in now.cards.items() if before.cards.get(name) != card}
    return structs.replace(now, cards=changed)
