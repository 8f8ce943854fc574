"""The map editor of one browser: the tool, the steps so far, and saving.

All of it on the service's thread. The robot is asked once, at the end: until then only this browser
sees what becomes of the map.
"""

import math
from collections.abc import Callable, Sequence

from trolley import codes, requests
from trolley.codes import Refused
from trolley.geometry import Pose2D
from trolley.geometry.frames import MAP
from trolley.messages import EditMap, MapEdited, Merge, TakeBack
from trolley.messages.request_params import Nothing
from trolley.runtime.service import Service
from trolley_viz.features.map_editing.drafting import Drafting
from trolley_viz.features.map_editing.pencil import HINTS, Pencil, Tool
from trolley_viz.features.map_editing.preview import MapPreview
from trolley_viz.features.map_editing.requests import request_map_edit
from trolley_viz.pointing.canvas import Canvas
from trolley_viz.robots.view import View
from trolley_viz.words.plain_words import said
from trolley_viz.words.sentences import Tell, refusal

# Walls that miss the axes by less are called straight [rad].
STRAIGHT_RAD = math.radians(0.05)


class MapEditor:
    """Edits one map at a time: begins, undoes steps, saves or discards.

    Args:
        canvas: what the browser takes.
        preview: what it shows.
        service: asks the robot's mapper.
        robot: whom.
        view: what is known of the robot.
        begin: called before the floor is taken: other tools are put away.
    """

    def __init__(
        self,
        canvas: Canvas,
        preview: MapPreview,
        service: Service,
        robot: Callable[[], str],
        view: Callable[[], View],
        tell: Tell,
        begin: Callable[[], None],
    ) -> None:
        self._preview = preview
        self._service, self._robot, self._view = service, robot, view
        self._tell, self._begin = tell, begin
        self.drafting = Drafting(preview, view, tell)
        """What was done so far."""
        self.pencil = Pencil(canvas, preview, self.drafting.add)
        self.is_busy = False
        """Whether the mapper is asked."""
        self.as_name = ""
        self.filled = 0
        """Counts how often the fields were filled in."""
        self.maps: Sequence[str] = ()
        """The other maps, to be merged."""

    # What there is.
    @property
    def is_open(self) -> bool:
        """Whether a map is being changed."""
        return self.drafting.stored is not None

    @property
    def hint(self) -> str:
        """What to do with the tool."""
        return HINTS[self.pencil.tool] if self.is_open else ""

    @property
    def hides_map(self) -> bool:
        """Whether this browser shows the draft in place of the stored map."""
        return self.is_open and self._preview.is_shown

    @property
    def new_T_old(self) -> Pose2D:
        """Where the rest of the scene lies on the draft."""
        drawn = self.drafting.drawn
        return drawn.new_T_old if self.hides_map and drawn else Pose2D.identity()

    # Its picture.
    def hide(self) -> None:
        """Leave the picture; what was made of the map is kept."""
        self.pencil.put_down()
        self._preview.clear()

    def show(self) -> None:
        """Show what was made of the map, in a picture that is new."""
        if self.is_open:
            self.choose(self.pencil.tool)
            self.drafting.put(self.drafting.draft)

    # Life.
    def open(self) -> None:
        """Begin on the map that the robot is on."""
        view = self._view()
        if view.map is None or view.placement.world != MAP:
            self._tell("No map", "There is no map to change.", "warn")
            return
        self.leave()
        self._begin()
        self.drafting.begin(view.map)
        self.as_name = view.map.name
        self.filled += 1
        self._ask_for_maps()
        self.choose("look")

    def leave(self) -> None:
        """End it and store nothing."""
        self.drafting.end()
        self.pencil.take("look")
        self.hide()

    def put_aside(self) -> Callable[[], None] | None:
        """Leave; returns what takes the steps so far up again, None where there are none."""
        stored, draft = self.drafting.stored, self.drafting.draft
        as_name = self.as_name
        is_kept = bool(draft.ops) and not self.is_busy
        self.leave()

        def take_up() -> None:
            self.open()
            if stored is not None:
                self.drafting.begin(stored)
                self.as_name = as_name
                self.drafting.put(draft)

        return take_up if is_kept else None

    def choose(self, tool: Tool) -> None:
        """Take up a tool; with "look" drags turn the camera."""
        if self.is_open:
            if tool != "look":
                self._begin()
            self.pencil.take(tool)

    def update(self) -> None:
        """Leave when the robot is on another map by now."""
        view = self._view()
        self._preview.update(view.now_ns)
        if self.is_open and not self.is_busy and not self.drafting.go_on_with(view.map):
            self.leave()
            self._tell("Map changed", "The robot's map has changed. Please start again.", "warn")

    # Doing.
    def turn_to(self, degrees: float) -> None:
        """Turn the map to an angle from where it was before the last turn."""
        draft = self.drafting.draft
        if self.is_open and abs(degrees - math.degrees(draft.last_turn)) > 1e-6:
            self.drafting.turn_to(math.radians(degrees))

    def straighten(self) -> None:
        """Turn the map so that its walls run along the axes."""

        def found(angle: float) -> None:
            if abs(angle) < STRAIGHT_RAD:
                self._tell("Straight", "The walls are already straight.", "idle")
            else:
                self.drafting.turn_to(self.drafting.draft.last_turn + angle)

        if self.is_open:
            self.drafting.find_skew(found)

    def merge(self, name: str) -> None:
        """Find where another map lies, and lay it beside this one."""
        stored, draft = self.drafting.stored, self.drafting.draft
        if stored is None or self.is_busy or name not in self.maps:
            return
        ops = [*draft.ops, Merge(name=name)]

        def placed(reply: MapEdited) -> None:
            if self.is_open and self.drafting.draft is draft and reply.placed is not None:
                merged = Merge(name=name, pose=reply.placed)
                self.drafting.put(draft.add_merged(merged, reply.walls))
                self._tell("It fits", said(reply.message), "good")

        as_name = self._other_name()
        self._ask(EditMap(name=stored.name, ops=ops, as_name=as_name, preview=True), placed)

    def take_back(self) -> None:
        """Take the last step back."""
        if self.is_open and self.drafting.draft.ops:
            self.drafting.put(self.drafting.draft.take_back())

    def store(self) -> None:
        """Store what was made of it as a new version."""
        stored, ops = self.drafting.stored, self.drafting.draft.ops
        if stored is None or self.is_busy:
            return
        if not ops:
            self._tell("Nothing to save", "Nothing has been changed yet.", "idle")
            return

        number = self.drafting.number

        def done(reply: MapEdited) -> None:
            if self.drafting.number == number:
                self.leave()
            self._tell("Saved", said(reply.message), "good")

        self._ask(EditMap(name=stored.name, ops=list(ops), as_name=self._other_name()), done)

    def undo_stored(self) -> None:
        """Go back to the previous version of the map that the robot is on."""
        grid = self._view().map
        if grid is not None and not self.is_busy:
            self.leave()
            params = EditMap(name=grid.name, ops=[TakeBack()])
            self._ask(params, lambda reply: self._tell("Undone", said(reply.message), "good"))

    # Inside.
    def _other_name(self) -> str | None:
        stored, name = self.drafting.stored, self.as_name.strip()
        return None if stored is None or name in ("", stored.name) else name

    def _ask_for_maps(self) -> None:
        def heard(reply: list[str] | Refused) -> None:
            stored = self.drafting.stored
            here = "" if stored is None else stored.name
            self.maps = [] if isinstance(reply, Refused) else [n for n in reply if n != here]

        self._service.request(requests.MAP_LIST, Nothing(), heard, robot=self._robot())

    def _ask(self, params: EditMap, done: Callable[[MapEdited], None]) -> None:
        self.is_busy = True
        number = self.drafting.number

        def finish(reply: MapEdited | Refused) -> None:
            self.is_busy = False
            if not isinstance(reply, Refused):
                done(reply)
                return
            self._service.log.info("Refused", request="map/edit", code=reply.code)
            if reply.code == codes.EXISTS and self.is_open and self.drafting.number == number:
                self.as_name = self._free_name()
                self.filled += 1
            self._tell("Not saved", refusal(reply), "bad")

        request_map_edit(self._service, params, finish, self._robot())

    def _free_name(self) -> str:
        stem = self.as_name.strip() or "map"
        taken, number = {*self.maps, stem}, 2
        while f"{stem}-{number}" in taken:
            number += 1
        return f"{stem}-{number}"
