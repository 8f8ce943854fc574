"""The zone editor of one browser: what is being drawn or changed, and saving it.

All of it on the service's thread. What is drawn is drawn in `map`, which is the frame that the
scene shows as soon as there is a map.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

from trolley import topics
from trolley.geometry.frames import MAP
from trolley.messages import SuspectLine, Zone, Zones
from trolley.messages.mapping import ZoneKind
from trolley.names import canonical
from trolley.zones import LINE_KINDS
from trolley_viz.controls.undo import Change
from trolley_viz.features.zones.requests import ZoneRequests
from trolley_viz.pointing.canvas import Canvas, Phase, PointerHandlers, outline_of
from trolley_viz.pointing.sketch import (
    Point,
    Sketch,
    free_name,
    snap_to_wall,
    zone_at,
)
from trolley_viz.robots.view import View
from trolley_viz.words.sentences import Tell

Mode = Literal["idle", "draw", "pick", "edit"]

SLOW_MPS = 0.15
"""The speed that a new slow area begins with [m/s]."""
LINE_HINT = "Drag from one end to the other. Or tap its corners, and the last one again."
AREA_HINT = "Tap the corners one by one. Tap the first one again when done."
PICK_HINT = "Tap a zone on the map."
EDIT_HINT = "Drag a yellow corner, or the blue handle to move all of it."


@dataclass
class Form:
    """The fields of the zone being edited."""

    name: str = ""
    speed: float = SLOW_MPS
    """Only for slow areas [m/s]."""


class ZoneEditor:
    """Draws or changes one zone at a time.

    Args:
        canvas: what the browser shows and takes.
        zone_requests: what the robot is asked.
        view: what is known of the robot.
        begin: called before the floor is taken: other tools are put away.
    """

    def __init__(
        self,
        canvas: Canvas,
        zone_requests: ZoneRequests,
        view: Callable[[], View],
        tell: Tell,
        begin: Callable[[], None],
    ) -> None:
        self._canvas = canvas
        self.zone_requests = zone_requests
        self._view = view
        self._tell = tell
        self._begin = begin
        self.mode: Mode = "idle"
        self.sketch: Sketch | None = None
        self.selected: Zone | None = None
        """The zone that is being changed, as it was last seen."""
        self.form = Form()
        self.filled = 0
        """Counts how often the form was filled in."""
        self.hint = ""
        self._is_one_drag = False
        """Whether all that is drawn is the drag under way, or the last one."""
        self._seen: Zones | None = None
        self._map = ""

    # What there is.
    @property
    def zones(self) -> Sequence[Zone]:
        """The zones of the map."""
        return stored_zones(self._view())

    @property
    def kind(self) -> ZoneKind | None:
        """The kind of the zone under way."""
        return None if self.sketch is None else self.sketch.kind

    # Its picture.
    def hide(self) -> None:
        """Leave the picture; what is under way is kept."""
        self._canvas.clear()

    def show(self) -> None:
        """Show what is under way, in a picture that is new."""
        match self.mode:
            case "draw":
                self._canvas.listen(PointerHandlers(self._tapped, self._dragged))
                self._canvas.show(self.sketch)
            case "pick":
                self._canvas.listen(PointerHandlers(self._picked))
            case "edit":
                self._canvas.show(self.sketch)
                self._canvas.show_handles(self.sketch, self._handled)
            case "idle":
                pass

    # Drawing.
    def start(self, kind: ZoneKind) -> None:
        """Begin a new zone; what was under way is left."""
        view = self._view()
        if view.map is None or view.placement.world != MAP:
            self._tell("No map", "There is no map to draw on.", "warn")
            return
        self._begin()
        self.leave()
        self.mode, self.sketch = "draw", Sketch(kind)
        self.hint = LINE_HINT if kind in LINE_KINDS else AREA_HINT
        self._fill(Form(free_name(kind, {zone.name for zone in self.zones})))
        self.show()

    def take_back(self) -> None:
        """Remove the corner that was drawn last."""
        if self.mode == "draw" and self.sketch is not None:
            self.sketch = self.sketch.take_back()
            self._canvas.show(self.sketch)

    def done(self) -> None:
        """Save what was drawn, or what was changed."""
        if self.sketch is None or self.mode not in ("draw", "edit"):
            return
        problem = self.sketch.problem()
        if problem:
            self._tell("Not yet", problem, "warn")
            return
        before = self.selected if self.mode == "edit" else None
        name = " ".join(canonical(self.form.name).split())
        zone = as_zone(self.sketch, name, self.form.speed)
        if zone == before:
            self.leave()
        else:
            self.zone_requests.ask(Change(before, zone), self._saved)

    def leave(self) -> None:
        """End what is under way and save nothing."""
        self.mode, self.sketch, self.selected, self.hint = "idle", None, None, ""
        self._canvas.clear()

    def put_aside(self) -> Callable[[], None] | None:
        """Leave; returns what takes a new zone up again, None where nothing of one is drawn."""
        sketch, form, map_name = self.sketch, self.form, self._map
        is_drawn = self.mode == "draw" and sketch is not None and bool(sketch.points)
        self.leave()

        def take_up() -> None:
            if sketch is not None:
                self.start(sketch.kind)
                self.sketch, self._map = sketch, map_name
                self._fill(form)
                self.show()

        return take_up if is_drawn else None

    # Changing.
    def pick(self) -> None:
        """Let the person tap a zone on the map."""
        self._begin()
        self.leave()
        self.mode, self.hint = "pick", PICK_HINT
        self.show()

    def select(self, name: str) -> None:
        """Change the zone of this name; one that does not exist ends what is under way."""
        zone = next((one for one in self.zones if one.name == name), None)
        self._begin()
        self.leave()
        if zone is not None:
            self.mode, self.hint = "edit", EDIT_HINT
            self._show_stored(zone)

    def delete(self) -> None:
        """Delete the selected zone."""
        if self.selected is not None:
            self.zone_requests.ask(Change(self.selected, None), lambda _: self.leave())

    def accept(self, suspect: SuspectLine) -> None:
        """Store a suspected mirror as a zone."""
        name = free_name("mirror", {zone.name for zone in self.zones})
        zone = as_zone(Sketch("mirror", outline_of(suspect.points)), name, None)
        self.zone_requests.ask(
            Change(None, zone),
            lambda _: self._tell("Saved", f"The robot now knows “{name}”.", "good"),
        )

    def update(self) -> None:
        """Follow the zones that others change, and the camera."""
        if self.mode == "edit" and self.sketch is not None:
            self._canvas.resize_handles(self.sketch)
        zones = self._view().streams.latest(topics.ZONES)
        if zones is None or zones is self._seen or self.zone_requests.is_busy:
            return
        self._seen = zones
        if zones.map != self._map:
            self._map = zones.map
            if self.sketch is not None and self.sketch.points:
                self._tell(
                    "Map changed", "The robot's map has changed. Please start again.", "warn"
                )
            self.leave()
        if self.mode != "edit" or self.selected is None:
            return
        now = next((one for one in self.zones if one.name == self.selected.name), None)
        if now is None:
            self.leave()
        elif now != self.selected:
            self._show_stored(now)

    # Inside.
    def _fill(self, form: Form) -> None:
        self.form = form
        self.filled += 1

    def _show_stored(self, zone: Zone) -> None:
        self.selected = zone
        self.sketch = Sketch(zone.kind, outline_of(zone.points))
        self._fill(Form(zone.name, SLOW_MPS if zone.speed is None else zone.speed))
        self._canvas.show(self.sketch)
        self._canvas.show_handles(self.sketch, self._handled)

    def _saved(self, zone: Zone) -> None:
        if self.mode == "edit":
            self._show_stored(zone)
        else:
            self.leave()
        known = f"The robot now knows “{zone.name}”."
        respected = f"The robot will respect “{zone.name}” from now on."
        self._tell("Saved", known if zone.kind == "room" else respected, "good")

    def _snapped(self, point: Point) -> Point:
        """Snap a corner of a mirror or glass line to the wall that it hangs on."""
        view = self._view()
        grid = view.map
        if grid is None or self.kind not in LINE_KINDS:
            return point
        return snap_to_wall(grid, point)

    def _tapped(self, point: Point, reach_m: float) -> None:
        if self.mode != "draw" or self.sketch is None:
            return
        at = self._snapped(point)
        # Compared twice: the last corner may have been snapped to a wall, away from the tap.
        if self.sketch.closes_at(at, reach_m) or self.sketch.closes_at(point, reach_m):
            self.done()
            return
        self.sketch = self.sketch.add(at)
        self._canvas.show(self.sketch)

    def _dragged(self, phase: Phase, start: Point, now: Point | None) -> None:
        if self.mode != "draw" or self.sketch is None:
            return
        if phase == "start":
            self._is_one_drag = not self.sketch.points
        if not self.sketch.points:
            self.sketch = self.sketch.add(self._snapped(start))
        rubber = None if now is None else self._snapped(now)
        if phase == "end" and rubber is not None:
            self.sketch, rubber = self.sketch.add(rubber), None
        self._canvas.show(self.sketch, rubber)
        if phase == "end" and self._is_one_drag and self.kind in LINE_KINDS:
            self.done()

    def _picked(self, point: Point, reach_m: float) -> None:
        zone = zone_at(self.zones, point, max(reach_m, 0.1))
        if zone is not None:
            self.select(zone.name)

    def _handled(self, phase: Phase, index: int, by: Point) -> None:
        """Move a corner or the whole; save it at the release."""
        zone = self.selected
        if self.mode != "edit" or zone is None or self.zone_requests.is_busy:
            return
        stored = Sketch(zone.kind, outline_of(zone.points))
        if index < len(stored.points):
            x, y = stored.points[index]
            sketch = stored.moved_corner(index, self._snapped((x + by[0], y + by[1])))
        else:
            sketch = stored.moved(*by)
        problem = sketch.problem() if phase == "end" else ""
        if problem:
            self._tell("Not moved", problem, "warn")
            sketch = stored
        self.sketch = sketch
        self._canvas.show(sketch)
        self._canvas.show_handles(sketch, self._handled)
        if phase == "end" and sketch != stored:
            moved = as_zone(sketch, zone.name, zone.speed)
            self.zone_requests.ask(Change(zone, moved), self._moved, lambda: self._moved(zone))

    def _moved(self, zone: Zone) -> None:
        if self.mode == "edit":
            self._show_stored(zone)


def stored_zones(view: View) -> Sequence[Zone]:
    """The zones of the map in use."""
    zones, grid = view.streams.latest(topics.ZONES), view.map
    if zones is None or grid is None or zones.map != grid.name:
        return ()
    return zones.zones


def as_zone(sketch: Sketch, name: str, speed: float | None) -> Zone:
    """Make a zone of what was drawn; only slow areas have a speed."""
    return Zone(
        name=name,
        kind=sketch.kind,
        points=list(sketch.points),
        speed=speed if sketch.kind == "speed" else None,
    )
