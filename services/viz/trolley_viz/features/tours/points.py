"""The points of a tour that is being edited: a row each, and the details of the chosen one."""

from collections.abc import Callable, Sequence

from trolley_viz.controls.controls import Button, Controls
from trolley_viz.controls.markup import note
from trolley_viz.features.tours.draft import Draft, Editing, stay_text
from trolley_viz.features.tours.point_editor import PointEditor

MAX_POINT_ROWS = 30
"""Number of points that are shown, those around the chosen one."""


class PointRows:
    """Rows to press, which open the details of a point, and to drag into another order.

    Args:
        add_details: adds the controls for one point, which stand below its row.
        choose: called with the index of the point whose row was pressed.
        move: called with the index of a point and by how much it was dragged.
    """

    def __init__(
        self,
        gui: Controls,
        add_details: Callable[[], PointEditor],
        choose: Callable[[int], None],
        move: Callable[[int, int], None],
    ) -> None:
        self._gui = gui
        self._choose, self._move = choose, move
        self._rows: list[Button] = []
        self._first = 0
        self._list = gui.add_folder()
        with self._list:
            self._details = add_details()
        self._around = gui.add_html("")

    def show(self, editing: Editing, places: Sequence[str]) -> None:
        """Show the points of a draft; `places` are the names to choose from."""
        points, chosen = editing.draft.points, editing.chosen
        self._first = first_shown(len(points), chosen)
        with self._list:
            while len(self._rows) < min(len(points), MAX_POINT_ROWS):
                self._rows.append(self._add_row(len(self._rows)))
        for i, button in enumerate(self._rows):
            index = self._first + i
            button.visible = index < len(points)
            if button.visible:
                button.label = point_text(editing.draft, index)
                button.colour = "teal" if index == chosen else "grey"
        if chosen is not None:
            self._details.folder.order = chosen - self._first + 0.5
            self._details.folder.label = point_text(editing.draft, chosen)
        self._details.show(editing.point, places)
        hidden = len(points) - min(len(points), MAX_POINT_ROWS)
        self._around.content = note(f"{hidden} more points are not shown.") if hidden else ""

    def _add_row(self, row: int) -> Button:
        button = self._gui.add_button("")
        button.order = row
        button.on_press(lambda: self._choose(self._first + row))
        button.on_move(lambda by: self._move(self._first + row, by))
        return button


def first_shown(num_points: int, chosen: int | None) -> int:
    """The first point that has a row: all have one, or those around the chosen one."""
    last = max(num_points - MAX_POINT_ROWS, 0)
    return last if chosen is None else min(max(chosen - MAX_POINT_ROWS // 2, 0), last)


def point_text(draft: Draft, index: int) -> str:
    """A point in a line: "2  kitchen · stays 5 s"."""
    point, number = draft.points[index], draft.stop_number(index)
    name = point.name or "a point on the map"
    if number is None:
        return f"passes {name}"
    return f"{number}  {name}" + (f" · stays {stay_text(point.dwell)}" if point.dwell else "")
