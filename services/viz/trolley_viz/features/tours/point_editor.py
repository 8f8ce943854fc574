"""The details of one point of a tour that is being edited."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from trolley_viz.controls.controls import Controls, Field
from trolley_viz.features.tours.draft import MAX_COUNT, MAX_SECONDS, OnFailure, Point

ON_MAP = "a point on the map"
UP, DOWN, REMOVE = "Earlier", "Later", "Remove"
GIVE_UP = "end the tour"
LEAVE_OUT = "skip it"
FOR_EVER = "try until it works"
FAILURES: dict[str, OnFailure] = {GIVE_UP: "abort", LEAVE_OUT: "skip", FOR_EVER: "retry"}


class PointEditor:
    """Where it is, whether the robot stops there, how long, and what if it cannot.

    Args:
        change: called with the point before and after.
        arrange: called with `UP`, `DOWN` or `REMOVE`.
        point_out: lets the person show the place on the map.
    """

    def __init__(
        self,
        gui: Controls,
        change: Callable[[Point, Point], None],
        arrange: Callable[[str], None],
        point_out: Callable[[], None],
    ) -> None:
        self._change = change
        self._point: Point | None = None
        self.folder = gui.add_folder("Stop", is_open=True, visible=False)
        with self.folder:
            order = gui.add_choice("Order", (UP, DOWN, REMOVE))
            self._place = gui.add_list("Place", (ON_MAP,), words=(ON_MAP,))
            show = gui.add_button("Point it out on the map", icon="map-pin", colour="teal")
            self._passes = gui.add_check("Pass without stopping", False)
            self._dwell = gui.add_number("Stay (s)", 0.0, min=0.0, max=MAX_SECONDS, step=1.0)
            self._failure = gui.add_list("If it fails", tuple(FAILURES))
            self._tries = gui.add_number(
                "Tries", 1, min=1, max=MAX_COUNT, step=1, hint="How often to try before giving up."
            )
            self._timeout = gui.add_number(
                "Longest drive (s)",
                0.0,
                min=0.0,
                max=MAX_SECONDS,
                step=1.0,
                hint="How long driving there may take; 0 for the usual limit.",
            )
        order.on_press(arrange)
        show.on_press(point_out)
        self._bind()

    def show(self, point: Point | None, places: Sequence[str]) -> None:
        """Show a point, or nothing; `places` are the names to choose from."""
        self.folder.visible = point is not None
        if point is None:
            self._point = None
            return
        own = ON_MAP if point.name is None else point.name
        self._place.options = places if own in places else [own, *places]
        if point is not self._point:
            self._point = point
            self._place.value = own
            self._passes.value = point.passes
            self._dwell.value = point.dwell
            self._failure.value = failure_of(point)
            self._tries.value = point.retries + 1
            self._timeout.value = point.timeout or 0.0
        for field in (self._dwell, self._failure, self._timeout):
            field.visible = not point.passes
        self._tries.visible = not point.passes and failure_of(point) != FOR_EVER

    def _bind(self) -> None:
        def on(field: Field[Any], changed: Callable[[Point, Any], Point]) -> None:
            field.on_change(lambda value: self._changed(changed, value))

        on(self._place, place_changed)
        on(self._passes, lambda point, passes: replace(point, passes=passes))
        on(self._dwell, lambda point, seconds: replace(point, dwell=seconds))
        on(self._timeout, lambda point, seconds: replace(point, timeout=seconds or None))
        on(self._tries, lambda point, tries: replace(point, retries=round(tries) - 1))
        on(self._failure, failure_changed)

    def _changed(self, changed: Callable[[Point, Any], Point], value: Any) -> None:
        if self._point is None:
            return
        point = changed(self._point, value)
        if point != self._point:
            before, self._point = self._point, point  # the controls show it already
            self._change(before, point)


def place_changed(point: Point, name: str) -> Point:
    """The point at another place; at `ON_MAP` it stays."""
    return point if name == ON_MAP else replace(point, name=name, pose=None)


def failure_of(point: Point) -> str:
    """What happens if the stop fails, in words: a `retry` that ends gives up as `abort` does."""
    if point.on_failure == "skip":
        return LEAVE_OUT
    return FOR_EVER if point.on_failure == "retry" and point.retries == 0 else GIVE_UP


def failure_changed(point: Point, text: str) -> Point:
    """The point with another answer to failure."""
    if text == failure_of(point):
        return point
    answer = FAILURES[text]
    return replace(point, on_failure=answer, retries=0 if answer == "retry" else point.retries)
