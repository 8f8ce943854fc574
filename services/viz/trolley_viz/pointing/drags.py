"""Drags and clicks on the map: which of their ends were meant.

viser tells of an end whenever a drag is over: when the pointer is let go, but also when a phone
takes the touch for itself, when the window loses the focus, when a key changes what is held, and
when the page is closed; a second finger that comes up is a click to it. The page's own script
(`frontend/scene.js`) says where a pointer was let go, and nothing otherwise; an end or a click that
it does not speak for moves nothing.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import viser

from trolley_viz.threads import Post

WAIT_NS = 2_000_000_000
"""The two connections from a page may differ by so much."""
CANCELLED_NS = 500_000_000
"""What ends this soon after a press was called off belongs to it."""
SAME_PLACE = 0.01
"""How far the place that the script tells may be from viser's, as a share of the picture."""

At = tuple[float, float]
"""A place in the picture, as shares of its width and height from the upper left corner."""


@dataclass(frozen=True)
class _End:
    """An end that waits for the script to confirm it."""

    at: At
    act: Callable[[], None]
    cancel: Callable[[], None]
    due_ns: int


class Drags:
    """The drags and clicks of one browser, on the service's thread.

    Args:
        post: hands a call there.
        now_ns: the local monotonic time [ns].
        unconfirmed: called when an end was not confirmed.
    """

    def __init__(
        self, post: Post, now_ns: Callable[[], int], unconfirmed: Callable[[], None]
    ) -> None:
        self._post = post
        self._now_ns = now_ns
        self._unheard = unconfirmed
        self._end: _End | None = None
        self._released: tuple[At, int] | None = None
        """Where a pointer was let go, and until when that is news [ns]."""
        self._cancelled_until_ns = 0

    def take(
        self,
        event: viser.SceneNodeDragEvent[Any],
        act: Callable[[], None],
        cancel: Callable[[], None],
    ) -> None:
        """Act on a phase of a drag; called on the web server's thread.

        Args:
            event: what viser tells.
            act: follows the drag, and does at its end what it was for.
            cancel: called instead at an end that nobody meant.
        """
        phase, at = event.phase, event.end_screen_pos
        self._post(lambda: self._taken(phase, at, act, cancel))

    def on_click(self, event: viser.SceneNodePointerEvent[Any], act: Callable[[], None]) -> None:
        """Act on a click; called on the web server's thread."""
        at = event.screen_pos
        self._post(lambda: self._ended(at, act, lambda: None))

    def released(self, at: At) -> None:
        """The script reports that a pointer was let go."""
        end = self._end
        self._cancelled_until_ns = 0
        if end is not None and _is_same(at, end.at):
            self._end = None
            end.act()
        else:
            self._released = at, self._now_ns() + WAIT_NS

    def cancelled(self) -> None:
        """The script reports that a press was called off."""
        self._cancelled_until_ns = self._now_ns() + CANCELLED_NS
        self._drop()

    def tick(self) -> None:
        """Give up on an end that was not confirmed in time."""
        if self._end is not None and self._now_ns() > self._end.due_ns:
            self._drop()
            self._unheard()

    def _taken(
        self, phase: str, at: At, act: Callable[[], None], cancel: Callable[[], None]
    ) -> None:
        if phase == "start":
            self._cancelled_until_ns = 0
            self._drop()
        if phase == "end":
            self._ended(at, act, cancel)
        else:
            act()

    def _ended(self, at: At, act: Callable[[], None], cancel: Callable[[], None]) -> None:
        now_ns, released = self._now_ns(), self._released
        if now_ns < self._cancelled_until_ns:
            cancel()
        elif released is not None and now_ns < released[1] and _is_same(at, released[0]):
            self._released = None
            act()
        else:
            self._drop()
            self._end = _End(at, act, cancel, now_ns + WAIT_NS)

    def _drop(self) -> None:
        end, self._end = self._end, None
        if end is not None:
            end.cancel()


def _is_same(one: At, other: At) -> bool:
    return math.dist(one, other) < SAME_PLACE
