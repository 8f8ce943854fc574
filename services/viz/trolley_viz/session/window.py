"""What one page shows of the scene: its connection to viser, its own drawings, its camera."""

import math
from collections.abc import Callable

import viser

from trolley_viz.graphics.camera import NORTH, Look
from trolley_viz.pointing.picture import Picture
from trolley_viz.robots.view import View
from trolley_viz.scene.place_labels import Eye
from trolley_viz.session.browser_scene import BrowserScene
from trolley_viz.session.viewport import Viewport


class Window:
    """Shut until viser's part of the page has loaded; how its person looks outlasts that.

    Args:
        view: what is known of the robot that is followed.
        now_ns: the clock that the picture's layout is waited for by.
    """

    def __init__(self, view: Callable[[], View], now_ns: Callable[[], int]) -> None:
        self._view, self._now_ns = view, now_ns
        self.picture = Picture()
        """Where the page draws what is its own."""
        self.scene: BrowserScene | None = None
        """What this browser alone has in its scene; None while it has no picture."""
        self.look = Look()
        """How its person wants to see the map."""
        self._viewport: Viewport | None = None
        self._size: tuple[float, float] | None = None
        """Width and height of the picture [px of the page], once the page has told."""

    def open(self, client: viser.ClientHandle) -> None:
        """Show a picture that is new."""
        self.picture.client = client
        self.scene = BrowserScene(client.scene)
        self._viewport = Viewport(client, self._size, self.look)

    def shut(self) -> None:
        """Go without a picture."""
        self.picture.client = self.scene = self._viewport = None

    @property
    def eye(self) -> Eye | None:
        """From where things are seen, None without a picture."""
        return None if self._viewport is None else self._viewport.eye

    def offset(self, right: float, up: float) -> tuple[float, float]:
        """What is so far to the right and up in the picture, as x and y in the world [m]."""
        heading = NORTH if self._viewport is None else self._viewport.up
        cos, sin = math.cos(heading), math.sin(heading)
        return up * cos + right * sin, up * sin - right * cos

    def resized(self, size: tuple[float, float]) -> None:
        """Note the width and height of the picture [px of the page]."""
        self._size = size
        if self._viewport is not None:
            self._viewport.resized(size, self._now_ns())

    def look_at(self, x: float, y: float) -> None:
        """Show a place in the world [m] from near."""
        if self._viewport is not None:
            self._viewport.look_at(x, y)

    def change_look(self, look: Look) -> None:
        """Turn the camera as a button of the view bar says."""
        self.look = look
        if self._viewport is not None:
            self._viewport.change(look, self._view())

    def fit(self) -> None:
        """Show the whole map, and follow nobody."""
        self.change_look(Look(is_flat=self.look.is_flat))
        if self._viewport is not None:
            self._viewport.fit(self._view())

    def update(self, robot: str) -> None:
        """Let the camera follow the robot, and fit a map that is new."""
        if self._viewport is not None:
            self._viewport.update(self._view(), robot)
