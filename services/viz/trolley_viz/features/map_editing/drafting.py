"""The draft of a map in one browser, and the picture of what becomes of the map."""

from collections.abc import Callable

from trolley.codes import Refused
from trolley.geometry import Pose2D
from trolley.gridmap import GridMap
from trolley.gridmap.wire import grid_of
from trolley.map_editing import angle_to_straighten
from trolley.messages import MapOp, OccupancyGrid
from trolley_viz.features.map_editing.draft import Draft, Drawn, draw
from trolley_viz.features.map_editing.preview import MapPreview, model_of
from trolley_viz.pointing.sketch import Point
from trolley_viz.robots.view import View
from trolley_viz.scene.map_layers import MapModel
from trolley_viz.words.plain_words import said
from trolley_viz.words.sentences import Tell


class Drafting:
    """Steps on one stored map, each drawn aside: large maps take a second.

    Args:
        preview: where it is shown.
        view: what is known of the robot.
    """

    def __init__(self, preview: MapPreview, view: Callable[[], View], tell: Tell) -> None:
        self._preview, self._view, self._tell = preview, view, tell
        self.stored: OccupancyGrid | None = None
        """The map that is changed, None while none is."""
        self.draft = Draft()
        self.drawn: Drawn | None = None
        """What the picture shows; None while that is the stored map."""
        self._wanted: Draft | None = None
        self._is_drawing = False
        self.number = 0
        """Counts the drafts: what was drawn or asked of one that is over does not count."""

    def begin(self, stored: OccupancyGrid) -> None:
        """Begin on a stored map."""
        self.end()
        self.stored = stored

    def end(self) -> None:
        """Forget all of it."""
        self.stored = self._wanted = None
        self.draft, self.drawn = Draft(), None
        self.number += 1

    def go_on_with(self, grid: OccupancyGrid | None) -> bool:
        """Go on with a map that is the same but published again; whether it is the same."""
        stored = self.stored
        if grid is not None and stored is not None and grid is not stored:
            if _content(grid) != _content(stored):
                return False
            self.stored = grid
        return grid is self.stored

    def add(self, op: MapOp) -> None:
        """Do one more thing to the map."""
        self.put(self.draft.add(op))

    def turn_to(self, angle: float) -> None:
        """Turn the map to an angle [rad] from where it was before the last turn."""
        self.put(self.draft.turned(angle, self._middle()))

    def put(self, draft: Draft) -> None:
        """Let this be the draft, and show it; where it makes no sense it is as before."""
        self.draft = self._wanted = draft
        self._draw_wanted()

    def find_skew(self, found: Callable[[float], None]) -> None:
        """Call with the angle [rad] by which the walls miss the axes, unless it changes before."""
        base, draft, before = self._base(), self.draft, self.drawn

        def find() -> float:
            drawn = draw(base, draft, before)
            return 0.0 if isinstance(drawn, Refused) else angle_to_straighten(drawn.grid)

        def heard(angle: float) -> None:
            if self.stored is not None and self.draft is draft:
                found(angle)

        self._view().work(find, heard)

    def _base(self) -> GridMap:
        if self.stored is None:
            raise RuntimeError("no map is open")
        return grid_of(self.stored)

    def _middle(self) -> Point:
        grid = self._base() if self.drawn is None else self.drawn.grid
        x, y = grid.corners().mean(axis=0).tolist()
        return round(x, 3), round(y, 3)

    def _draw_wanted(self) -> None:
        if self._is_drawing or self._wanted is None or self.stored is None:
            return
        draft, self._wanted, self._is_drawing = self._wanted, None, True
        base, before, number = self._base(), self.drawn, self.number

        def work() -> tuple[Drawn, MapModel] | Refused:
            drawn = draw(base, draft, before)
            return drawn if isinstance(drawn, Refused) else (drawn, model_of(drawn.grid))

        def done(result: tuple[Drawn, MapModel] | Refused) -> None:
            self._is_drawing = False
            if self.number == number:
                self._take(draft, result)
            self._draw_wanted()

        self._view().work(work, done)

    def _take(self, draft: Draft, result: tuple[Drawn, MapModel] | Refused) -> None:
        """Show what came of a draft, or go back to what is shown."""
        if isinstance(result, Refused):
            self._tell("Not done", said(result.message), "warn")
            if self.draft is draft:
                self.draft = draft.cut(0 if self.drawn is None else len(self.drawn.ops))
        elif not draft.ops:
            self.drawn = None
            self._preview.clear()
        else:
            self.drawn, model = result
            origin, walls = self.drawn.grid.origin, self.drawn.walls
            self._preview.show(model, origin, walls, self._view().now_ns)


def _content(grid: OccupancyGrid) -> tuple[str, Pose2D, bytes]:
    return grid.name, grid.origin, bytes(grid.cells)
