"""The map editor of one browser: the tool, the steps so far, and saving.

All of it on the service's thread. The robot is asked once, at the end: until then only this browser
sees what becomes of the map.
"""

import math
from collections.abc import Callable, Sequence
from typing import Literal

from trolley import codes, requests
from trolley.codes import Refused
from trolley.geometry import Pose2D
from trolley.geometry.frames import MAP
from trolley.gridmap import GridMap
from trolley.gridmap.wire import grid_of
from trolley.map_editing import angle_to_straighten
from trolley.messages import (
    Crop,
    DrawWall,
    EditMap,
    EraseStroke,
    MapEdited,
    MapOp,
    Merge,
    OccupancyGrid,
    TakeBack,
)
from trolley.messages.request_params import Nothing
from trolley.runtime.service import Service
from trolley_viz.actions.map_edits import request_map_edit
from trolley_viz.drawing.canvas import Canvas, Phase, PointerHandlers
from trolley_viz.drawing.sketch import Point
from trolley_viz.map_editing.map_draft import Draft, Drawn, draw
from trolley_viz.map_editing.map_preview import MapPreview, model_of
from trolley_viz.plain_words import said
from trolley_viz.robots.view import View
from trolley_viz.scene.map_layers import MapModel
from trolley_viz.sentences import Tell, refusal

Tool = Literal["look", "erase", "wall", "crop"]
HINTS: dict[Tool, str] = {
    "look": "",
    "erase": "Drag over what should be erased.",
    "wall": "Drag from one end of the wall to the other, or tap both ends.",
    "crop": "Drag from corner to corner of what should be kept.",
}
BRUSH_M, WALL_M = 0.25, 0.1
# A point of a stroke is taken when it is so far from the last [share of the brush's width].
_STEP_SHARE = 0.25
_MAX_STROKE = 2000


class MapEditor:
    """One draft at a time.

    Args:
        canvas: what the browser takes.
        picture: what it shows.
        service: asks the robot's mapper.
        robot: whom.
        view: what is known of the robot.
        begin: called before the floor is taken: other tools are put away.
    """

    def __init__(
        self,
        canvas: Canvas,
        picture: MapPreview,
        service: Service,
        robot: Callable[[], str],
        view: Callable[[], View],
        tell: Tell,
        begin: Callable[[], None],
    ) -> None:
        self._canvas, self._preview = canvas, picture
        self._service, self._robot, self._view = service, robot, view
        self._tell, self._begin = tell, begin
        self.is_open = False
        self.is_busy = False
        """Whether the mapper is asked."""
        self.tool: Tool = "look"
        self.brush_m = BRUSH_M
        self.wall_m = WALL_M
        self.to_unknown = False
        self.as_name = ""
        self.filled = 0
        """Counts how often the fields were filled in."""
        self.draft = Draft()
        self.maps: Sequence[str] = ()
        """The other maps, to be merged."""
        self._message: OccupancyGrid | None = None
        self._drawn: Drawn | None = None
        self._wanted: Draft | None = None
        self._is_drawing = False
        self._stroke: list[Point] = []
        self._anchor: Point | None = None

    # What there is.
    @property
    def hint(self) -> str:
        """What to do with the tool."""
        return HINTS[self.tool] if self.is_open else ""

    @property
    def hides_map(self) -> bool:
        """Whether this browser shows the draft in place of the stored map."""
        return self.is_open and self._preview.is_shown

    @property
    def new_T_old(self) -> Pose2D:
        """Where the rest of the scene lies on the draft."""
        return self._drawn.new_T_old if self.hides_map and self._drawn else Pose2D.identity()

    # Its picture.
    def hide(self) -> None:
        """Leave the picture; what was made of the map is kept."""
        self._drop_stroke()
        self._canvas.clear()
        self._preview.clear()

    def show(self) -> None:
        """Show what was made of the map, in a picture that is new."""
        if self.is_open:
            self.choose(self.tool)
            self._put(self.draft)

    # Life.
    def open(self) -> None:
        """Begin on the map that the robot is on."""
        view = self._view()
        if view.map is None or view.placement.world != MAP:
            self._tell("No map", "There is no map to change.", "warn")
            return
        self.leave()
        self._begin()
        self.is_open, self._message = True, view.map
        self._drawn = None
        self.as_name = view.map.name
        self.filled += 1
        self._ask_for_maps()
        self.choose("look")

    def leave(self) -> None:
        """End it and store nothing."""
        self.is_open, self._message, self._wanted = False, None, None
        self.draft, self._drawn, self.tool = Draft(), None, "look"
        self.hide()

    def choose(self, tool: Tool) -> None:
        """Take up a tool; with "look" drags turn the camera."""
        if not self.is_open:
            return
        self.tool = tool
        self._drop_stroke()
        if tool == "look":
            self._canvas.clear()
        else:
            self._begin()
            self._canvas.listen(PointerHandlers(self._tapped, self._dragged))

    def update(self) -> None:
        """Leave when the robot is on another map by now."""
        view = self._view()
        self._preview.update(view.now_ns)
        grid = view.map
        if self.is_open and not self.is_busy and grid is not self._message:
            is_same = (
                grid is not None
                and self._message is not None
                and (grid.name, grid.origin, bytes(grid.cells))
                == (self._message.name, self._message.origin, bytes(self._message.cells))
            )
            if is_same:
                self._message = grid
                return
            self.leave()
            self._tell("Map changed", "The robot's map has changed. Please start again.", "warn")

    # Doing.
    def turn_to(self, degrees: float) -> None:
        """Turn the map to an angle from where it was before the last turn."""
        if self.is_open and abs(degrees - math.degrees(self.draft.last_turn)) > 1e-6:
            self._put(self.draft.turned(math.radians(degrees), self._middle()))

    def straighten(self) -> None:
        """Turn the map so that its walls run along the axes."""
        base, draft, before = self._base(), self.draft, self._drawn

        def find() -> float:
            drawn = draw(base, draft, before)
            return 0.0 if isinstance(drawn, Refused) else angle_to_straighten(drawn.grid)

        def found(angle: float) -> None:
            if not self.is_open or self.draft is not draft:
                return
            if abs(angle) < math.radians(0.05):
                self._tell("Straight", "The walls are already straight.", "idle")
                return
            self._put(draft.turned(draft.last_turn + angle, self._middle()))

        if self.is_open:
            self._view().work(find, found)

    def merge(self, name: str) -> None:
        """Find where another map lies, and lay it beside this one."""
        if not self.is_open or self.is_busy or self._message is None or name not in self.maps:
            return
        draft = self.draft
        params = EditMap(
            name=self._message.name,
            ops=[*draft.ops, Merge(name=name)],
            as_name=self._other_name(),
            preview=True,
        )

        def placed(reply: MapEdited) -> None:
            if self.is_open and self.draft is draft and reply.placed is not None:
                self._put(draft.add_merged(Merge(name=name, pose=reply.placed), reply.walls))
                self._tell("It fits", said(reply.message), "good")

        self._ask(params, placed)

    def take_back(self) -> None:
        """Take the last step back."""
        if self.is_open and self.draft.ops:
            self._put(self.draft.take_back())

    def store(self) -> None:
        """Store what was made of it as a new version."""
        if not self.is_open or self._message is None or self.is_busy:
            return
        if not self.draft.ops:
            self._tell("Nothing to save", "Nothing has been changed yet.", "idle")
            return
        params = EditMap(
            name=self._message.name, ops=list(self.draft.ops), as_name=self._other_name()
        )

        def stored(reply: MapEdited) -> None:
            self.leave()
            self._tell("Saved", said(reply.message), "good")

        self._ask(params, stored)

    def undo_stored(self) -> None:
        """Go back to the previous version of the map that the robot is on."""
        grid = self._view().map
        if grid is not None and not self.is_busy:
            self.leave()
            params = EditMap(name=grid.name, ops=[TakeBack()])
            self._ask(params, lambda reply: self._tell("Undone", said(reply.message), "good"))

    # What the pointer does.
    def _tapped(self, point: Point, _reach_m: float) -> None:
        if self.tool == "erase":
            self._finish([point])
        elif self._anchor is None:
            self._anchor = point
            self._preview.show_stroke([point, (point[0] + 0.05, point[1])], 0.05, self.tool)
        else:
            self._finish([self._anchor, point])

    def _dragged(self, phase: Phase, start: Point, now: Point | None) -> None:
        if phase == "end" and now is None:  # called off
            self._drop_stroke()
            return
        if not self._stroke:
            self._stroke = [self._anchor or start]
        if now is not None and len(self._stroke) < _MAX_STROKE:
            if self.tool != "erase":
                self._stroke = [self._stroke[0], now]
            elif math.dist(self._stroke[-1], now) > _STEP_SHARE * self.brush_m or phase == "end":
                self._stroke.append(now)
        if phase == "end":
            self._finish(self._stroke)
        elif self.tool == "crop" and len(self._stroke) == 2:
            (x0, y0), (x1, y1) = self._stroke
            outline = [(x0, y0), (x1, y0), (x1, y1), (x0, y1), (x0, y0)]
            self._preview.show_stroke(outline, 0.05, "crop")
        else:
            width = self.brush_m if self.tool == "erase" else self.wall_m
            self._preview.show_stroke(self._stroke, width, self.tool)

    def _finish(self, points: list[Point]) -> None:
        """Do what was drawn."""
        op: MapOp | None = None
        if self.tool == "erase":
            to: Literal["free", "unknown"] = "unknown" if self.to_unknown else "free"
            op = EraseStroke(points=points, width=self.brush_m, to=to)
        elif len(points) == 2 and math.dist(*points) > 0.0:
            if self.tool == "wall":
                op = DrawWall(points=points, width=self.wall_m)
            elif self.tool == "crop":
                op = Crop(corners=(points[0], points[1]))
        self._drop_stroke()
        if op is not None:
            self._put(self.draft.add(op))

    def _drop_stroke(self) -> None:
        self._stroke, self._anchor = [], None
        self._preview.show_stroke([], 0.0, "")

    # Inside.
    def _base(self) -> GridMap:
        if self._message is None:
            raise RuntimeError("no map is open")
        return grid_of(self._message)

    def _middle(self) -> Point:
        grid = self._base() if self._drawn is None else self._drawn.grid
        x, y = grid.corners().mean(axis=0).tolist()
        return round(x, 3), round(y, 3)

    def _other_name(self) -> str | None:
        name = self.as_name.strip()
        return None if self._message is None or name in ("", self._message.name) else name

    def _put(self, draft: Draft) -> None:
        """Let this be the draft, and show it; where it makes no sense it is as before."""
        self.draft = self._wanted = draft
        self._draw_wanted()

    def _draw_wanted(self) -> None:
        if self._is_drawing or self._wanted is None or not self.is_open:
            return
        draft, self._wanted, self._is_drawing = self._wanted, None, True
        base, before, message = self._base(), self._drawn, self._message

        def work() -> tuple[Drawn, MapModel] | Refused:
            drawn = draw(base, draft, before)
            return drawn if isinstance(drawn, Refused) else (drawn, model_of(drawn.grid))

        def done(result: tuple[Drawn, MapModel] | Refused) -> None:
            self._is_drawing = False
            if not self.is_open or self._message is not message:
                return
            if isinstance(result, Refused):
                self._tell("Not done", said(result.message), "warn")
                if self.draft is draft:
                    self.draft = Draft() if before is None else _cut(draft, len(before.ops))
            elif not draft.ops:
                self._drawn = None
                self._preview.clear()
            else:
                self._drawn, model = result
                shown_ns = self._view().now_ns
                self._preview.show(model, self._drawn.grid.origin, self._drawn.walls, shown_ns)
            self._draw_wanted()

        self._view().work(work, done)

    def _ask_for_maps(self) -> None:
        def heard(reply: list[str] | Refused) -> None:
            here = "" if self._message is None else self._message.name
            self.maps = [] if isinstance(reply, Refused) else [n for n in reply if n != here]

        self._service.request(requests.MAP_LIST, Nothing(), heard, robot=self._robot())

    def _ask(self, params: EditMap, done: Callable[[MapEdited], None]) -> None:
        self.is_busy = True

        def finish(reply: MapEdited | Refused) -> None:
            self.is_busy = False
            if not isinstance(reply, Refused):
                done(reply)
                return
            self._service.log.info("Refused", request="map/edit", code=reply.code)
            if reply.code == codes.EXISTS and self.is_open:
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


def _cut(draft: Draft, count: int) -> Draft:
    while len(draft.ops) > count:
        draft = draft.take_back()
    return draft
