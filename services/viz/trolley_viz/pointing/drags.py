"""Drags and clicks on the map: which of their ends were meant.

viser tells of an end whenever a drag is over: when the pointer is let go, but also when a phone
takes the touch for itself, when the window loses the focus, when a key changes what is held, and
when the page is closed; a second finger that comes up is a click to it. The page's own script
(`frontend/scene.js`) says where a pointer was let go, and nothing otherwise; an end or a click that
it does not speak for moves nothing.

A tap of which only the script tells counts, too: viser tells of none before it has drawn the floor
that takes it, and a slow browser shows the hint of a tool before that.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import viser
from numpy.typing import ArrayLike

from trolley_viz.threads import Post

WAIT_NS = 2_000_000_000
"""The two connections from a page may differ by so much."""
CANCELLED_NS = 500_000_000
"""What ends this soon after a press was called off belongs to it."""
MISSED_NS = 500_000_000
"""A tap of which viser has not told by then it has not seen."""
SAME_PLACE = 0.01
"""How far the place that the script tells may be from viser's, as a share of the picture."""

At = tuple[float, float]
"""A place in the picture, as shares of its width and height from the upper left corner."""
Ray = tuple[ArrayLike, ArrayLike]
"""A line of sight: from where, and in which direction."""
Tapped = Callable[[Ray], None]
"""Takes a tap on the floor."""


@dataclass(frozen=True)
class _End:
    """An end that waits for the script to confirm it."""

    at: At
    act: Callable[[], None]
    cancel: Callable[[], None]
    due_ns: int


@dataclass(frozen=True)
class _Release:
    """That a pointer was let go: news of it is waited for from viser."""

    at: At
    heard_ns: int
    tap: Callable[[], None] | None = None
    """What it means where viser has missed it."""
    is_done: bool = False
    """Whether that was done: viser would only repeat it."""


class Drags:
    """The drags and clicks of one browser, on the service's thread.

    Args:
        post: hands a call there.
        now_ns: the local monotonic time [ns].
        unconfirmed: called when an end was not confirmed in time.
    """

    def __init__(
        self, post: Post, now_ns: Callable[[], int], unconfirmed: Callable[[], None]
    ) -> None:
        self._post = post
        self._now_ns = now_ns
        self._unheard = unconfirmed
        self._end: _End | None = None
        self._released: _Release | None = None
        self._floors: dict[object, Tapped] = {}
        """What takes taps on the floor, by who laid it; the newest last."""
        self._is_dragged = False
        """Whether viser tells of a drag: it has not missed that the pointer came down."""
        self._cancelled_until_ns = 0
        self._came_late = False
        """Whether that was since word of the end came too late."""

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

    def lay_floor(self, owner: object, floor: viser.MeshHandle, tapped: Tapped) -> None:
        """Take the taps on a floor for somebody, until `lift_floor`."""

        # async, so that clicks come in the order of drags; see viser's note on `on_drag`.
        async def click(event: viser.SceneNodePointerEvent[Any]) -> None:
            ray = event.ray_origin, event.ray_direction
            self.on_click(event, lambda: tapped(ray))

        self.lift_floor(owner)
        self._floors[owner] = tapped
        floor.on_click(click)

    def lift_floor(self, owner: object) -> None:
        """Leave the taps on the floor to who took them before."""
        self._floors.pop(owner, None)

    def released(self, at: At, ray: Ray | None = None) -> None:
        """The script reports that a pointer was let go.

        Args:
            at: where.
            ray: the line of sight there, if it was a tap.
        """
        self.do_missed_tap()
        end = self._end
        self._cancelled_until_ns = 0
        if end is not None and _is_same(at, end.at):
            self._end = None
            end.act()
        else:
            self._released = _Release(at, self._now_ns(), self._tap_of(ray))

    def do_missed_tap(self) -> None:
        """Do what a tap means of which viser has not told: something else is to be done next."""
        released = self._released
        if released is not None and released.tap is not None:
            self._released = replace(released, tap=None, is_done=True)
            released.tap()

    def forget_missed_tap(self) -> None:
        """Let a tap of which viser has not told mean nothing."""
        self._released = None

    def cancelled(self, *, is_late: bool = False) -> None:
        """The script reports that a press was called off, or too late that it ended."""
        self._cancelled_until_ns = self._now_ns() + CANCELLED_NS
        self._is_dragged, self._came_late = False, is_late
        if self._end is not None and is_late:
            self._unheard()
        self._drop()

    def tick(self) -> None:
        """Give up on an end that was not confirmed in time, and on viser's word of a tap."""
        released = self._released
        if released is not None and self._now_ns() - released.heard_ns > MISSED_NS:
            self.do_missed_tap()
        if self._end is not None and self._now_ns() > self._end.due_ns:
            self._drop()
            self._unheard()

    def _taken(
        self, phase: str, at: At, act: Callable[[], None], cancel: Callable[[], None]
    ) -> None:
        self._is_dragged = phase != "end"
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
            if self._came_late:
                self._unheard()
        elif (
            released is not None
            and now_ns - released.heard_ns < WAIT_NS
            and _is_same(at, released.at)
        ):
            self._released = None
            (cancel if released.is_done else act)()
        else:
            self._drop()
            self._end = _End(at, act, cancel, now_ns + WAIT_NS)

    def _tap_of(self, ray: Ray | None) -> Callable[[], None] | None:
        """What a tap means to whoever laid the newest floor, as long as it lies there."""
        if ray is None or self._is_dragged or not self._floors:
            return None
        owner, tapped = next(reversed(self._floors.items()))

        def tap() -> None:
            if self._floors.get(owner) is tapped:
                tapped(ray)

        return tap

    def _drop(self) -> None:
        end, self._end = self._end, None
        if end is not None:
            end.cancel()


def _is_same(one: At, other: At) -> bool:
    return math.dist(one, other) < SAME_PLACE
