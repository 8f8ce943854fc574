"""The base of all layers."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import viser

from trolley.geometry import Pose2D
from trolley.messages import Path, Robot
from trolley.topics import Topic
from trolley_viz.feeds import Feeds
from trolley_viz.placement import Placement

# Heights above the floor [m] keep flat things from flickering into each other.
Z_COSTMAP = 0.01
Z_ZONE = 0.015
Z_FOOTPRINT = 0.03
Z_PLACE = 0.035
Z_PATH = 0.045
Z_TRAJECTORY = 0.055
Z_PARTICLES = 0.065
WALL_HEIGHT = 0.12
Z_SCAN = 0.14
Z_LABEL = 0.2


@dataclass(frozen=True)
class View:
    """What layers draw from."""

    feeds: Feeds
    placement: Placement
    robot: Robot | None
    now_ns: int
    """Local monotonic time [ns]."""
    is_away: bool
    """The robot's clock is silent."""
    work: Callable[[Callable[[], Any], Callable[[Any], None]], None]
    """Runs a slow function aside, then calls the second one with its result."""
    preview: Path | None = None
    """The way to where somebody points just now."""

    def is_fresh(self, topic: Topic[Any], within_s: float = 1.5) -> bool:
        """Whether a message of the topic arrived within the last real seconds."""
        arrived_ns = self.feeds.arrived_ns(topic)
        return arrived_ns is not None and self.now_ns - arrived_ns <= within_s * 1e9


class Layer:
    """Something that can be switched on and off; it draws itself from a view at its own pace."""

    key: ClassVar[str]
    title: ClassVar[str]
    needs: ClassVar[Sequence[Topic[Any]]] = ()
    """The streams it needs besides those that are always there."""
    period_s: ClassVar[float] = 0.2
    on_by_default: ClassVar[bool] = True
    is_listed: ClassVar[bool] = True
    """Whether people may switch it."""

    def __init__(self, server: viser.ViserServer) -> None:
        self.server = server
        self.scene = server.scene
        self.is_on = self.on_by_default
        self._root = self.scene.add_frame(f"/{self.key}", show_axes=False, visible=self.is_on)
        self._due_ns = 0
        self._drawn: tuple[Any, ...] = ()

    def switch(self, is_on: bool) -> None:
        """Show or hide it."""
        self.is_on = is_on
        self._root.visible = is_on

    def update(self, view: View) -> None:
        """Draw what changed, if it is shown and due."""
        if self.is_on and view.now_ns >= self._due_ns:
            self._due_ns = view.now_ns + int(self.period_s * 1e9)
            self.draw(view)

    def forget(self) -> None:
        """Draw everything anew the next time, as for another robot."""
        self._drawn = ()
        self._due_ns = 0

    def draw(self, view: View) -> None:
        """Bring the scene nodes up to date; `changed` keeps it from sending what is there."""
        raise NotImplementedError

    def changed(self, *inputs: Any) -> bool:
        """Whether the inputs differ from those of the last call; messages count by identity."""
        same = len(inputs) == len(self._drawn) and all(map(_same, inputs, self._drawn))
        if not same:
            self._drawn = inputs
        return not same

    def path(self, name: str) -> str:
        """The scene path of a node of this layer."""
        return f"/{self.key}/{name}"


def _same(a: Any, b: Any) -> bool:
    return a is b or (isinstance(a, Pose2D | str | int | tuple) and a == b)
