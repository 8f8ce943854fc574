"""All overlays of the shown robot: which there are, what they follow, how they look, clicks."""

from collections.abc import Callable, Mapping

from trolley import topics
from trolley.geometry.relation import Frames
from trolley.messages import Overlay
from trolley_viz.overlays.cards import Card, CardContext, card_of, scale_of
from trolley_viz.overlays.readings import Reading, Readings
from trolley_viz.robots.frames import frames_of
from trolley_viz.robots.view import View

MAX_OVERLAYS = 24
NEEDS_SOURCE = ("gauge", "plot")


class OverlaySet:
    """The overlays of one robot.

    Args:
        readings: follows what they show.
    """

    def __init__(self, readings: Readings) -> None:
        self._readings = readings
        self._overlays: dict[str, Overlay] = {}
        self._chosen: dict[str, int] = {}
        self.num_left_out = 0
        """How many there are too many to show."""

    def update(self, view: View) -> None:
        """Update which overlays there are, and sample the relations of frames they show."""
        overlays = view.streams.by_parts(topics.OVERLAY)
        if not (overlays or self._overlays):
            return
        self.put(overlays)
        self.sample(lambda wanted: frames_of(view.streams, view.robot_ns, wanted), view.now_ns)

    def put(self, overlays: Mapping[tuple[str, ...], Overlay]) -> None:
        """Show exactly these, by the one chunk of their keys."""
        names = sorted(name for (name,) in overlays)
        self.num_left_out = max(0, len(names) - MAX_OVERLAYS)
        self._overlays = {name: overlays[(name,)] for name in names[:MAX_OVERLAYS]}
        for name in self._chosen.keys() - self._overlays.keys():
            del self._chosen[name]
        self._readings.follow(one.source for one in self._overlays.values() if _follows(one))

    def sample(self, frames: Callable[[set[str]], Frames], now_ns: int) -> None:
        """Take distances and bearings, where any are wanted and due."""
        wanted = self._readings.frames_wanted()
        if wanted and self._readings.is_sampling_due(now_ns):
            self._readings.sample(frames(wanted), now_ns)

    def cards(self, when: CardContext) -> dict[str, Card]:
        """How the overlays look now, by name."""
        return {
            name: card_of(overlay, self._reading(overlay), self._chosen.get(name), when)
            for name, overlay in self._overlays.items()
        }

    def choose(self, name: str, index: int) -> str | None:
        """Take a click on an item of a menu; the item, None where there is none such."""
        overlay = self._overlays.get(name)
        if overlay is None or overlay.kind != "menu" or not 0 <= index < len(overlay.items):
            return None
        self._chosen[name] = index
        return overlay.items[index]

    def csv(self, name: str) -> str | None:
        """The recorded values of an overlay as CSV, None where it has none."""
        overlay = self._overlays.get(name)
        reading = None if overlay is None else self._reading(overlay)
        if overlay is None or reading is None:
            return None
        return reading.history.csv(scale_of(overlay, reading))

    def drop_all(self) -> None:
        """Follow nothing and forget everything, as for another robot."""
        self._overlays.clear()
        self._chosen.clear()
        self._readings.drop_all()

    def _reading(self, overlay: Overlay) -> Reading | None:
        return self._readings.of(overlay.source) if _follows(overlay) else None


def _follows(overlay: Overlay) -> bool:
    return bool(overlay.source) or overlay.kind in NEEDS_SOURCE
