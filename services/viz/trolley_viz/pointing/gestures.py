"""Gestures that the page's own script reports, handed to the session of its browser."""

from collections.abc import Callable
from typing import Annotated, Protocol

from msgspec import Meta, Struct

from trolley_viz.pointing.drags import Drags
from trolley_viz.server.sockets import Sockets
from trolley_viz.threads import Post

Pixels = Annotated[float, Meta(ge=1.0, le=100_000.0)]
Share = Annotated[float, Meta(ge=-100.0, le=100.0)]


class Gesture(Struct, frozen=True, kw_only=True):
    """A report from a page: one of these four."""

    released: tuple[Share, Share] | None = None
    """Where a pointer was let go, as shares of the picture."""
    cancelled: bool = False
    """That the press was called off."""
    size: tuple[Pixels, Pixels] | None = None
    """Width and height of the picture."""
    folder: str = ""
    """The title of a folder of controls."""
    is_open: bool = False
    """Whether that folder is open from now on."""


class Page(Protocol):
    """The session of a browser, as far as gestures concern it."""

    @property
    def may_drive(self) -> bool:
        """Whether its person may do more than look."""
        ...

    drags: Drags
    """The drags on its map."""

    def resized(self, size: tuple[float, float]) -> None:
        """Note the width and height of the picture [px]."""
        ...

    def remember_folder(self, title: str, *, is_open: bool) -> None:
        """Keep whether a folder is open."""
        ...


class Gestures:
    """The gestures in all browsers.

    Args:
        post: hands a call to the service's thread.
        page: the session of a browser, by viser's number for it; None where there is none.
    """

    def __init__(self, post: Post, page: Callable[[int], Page | None]) -> None:
        self._page = page
        self.sockets = Sockets(post, Gesture, self._said, lambda _: None, operators_only=False)

    def _said(self, who: int, client_id: int, gesture: Gesture) -> None:
        page = self._page(client_id)
        if page is None or page.may_drive != self.sockets.may_act(who):
            return  # who only looks speaks for no operator's page
        if gesture.released is not None:
            page.drags.released(gesture.released)
        elif gesture.cancelled:
            page.drags.cancelled()
        elif gesture.size is not None:
            page.resized(gesture.size)
        elif gesture.folder:
            page.remember_folder(gesture.folder, is_open=gesture.is_open)
