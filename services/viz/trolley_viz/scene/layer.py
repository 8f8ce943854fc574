"""The base of all layers."""

from collections.abc import Sequence
from typing import Any, ClassVar, Literal

import viser

from trolley.geometry import Pose2D
from trolley.topics import Topic
from trolley_viz.robots.view import View

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


Group = Literal["Robot", "Sensing", "Driving", "Map"]


class Layer:
    """Something that browsers can show or hide; it draws itself from a view at its own pace."""

    key: ClassVar[str]
    title: ClassVar[str]
    group: ClassVar[Group]
    source: ClassVar[Topic[Any] | None] = None
    """The stream of the robot that it mainly shows: it is as old as that."""
    needs: ClassVar[Sequence[Topic[Any]]] = ()
    """The streams it needs besides those that are always there."""
    period_s: ClassVar[float] = 0.2
    on_by_default: ClassVar[bool] = True

    def __init__(self, server: viser.ViserServer, above: str) -> None:
        self.server = server
        self.scene = server.scene
        self.root = f"{above}/{self.key}"
        """The scene path of all that it draws; each browser shows or hides it for itself."""
        self.scene.add_frame(self.root, show_axes=False)
        self._due_ns = 0
        self._drawn: tuple[Any, ...] = ()

    def update(self, view: View) -> None:
        """Draw what changed, if it is due."""
        if view.now_ns >= self._due_ns:
            self._due_ns = view.now_ns + int(self.period_s * 1e9)
            self.draw(view)

    def draw(self, view: View) -> None:
        """Bring the scene nodes up to date; `changed` keeps it from sending what is there."""
        raise NotImplementedError

    def changed(self, *inputs: Any) -> bool:
        """Whether the inputs differ from those of the last call; messages count by identity."""
        if is_same(inputs, self._drawn):
            return False
        self._drawn = inputs
        return True

    def path(self, name: str) -> str:
        """The scene path of a node of this layer."""
        return f"{self.root}/{name}"


def is_same(inputs: tuple[Any, ...], drawn: tuple[Any, ...]) -> bool:
    """Whether what is to be drawn is drawn already; messages count by identity."""
    return len(inputs) == len(drawn) and all(map(_same, inputs, drawn))


def _same(a: Any, b: Any) -> bool:
    return a is b or (isinstance(a, Pose2D | str | int | tuple) and a == b)  # pyrefly: ignore[implicit-any-type-argument]
