"""The tour editor: the points in order, how often, when, and what keeps it from being saved."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from trolley import topics
from trolley.geometry import Pose2D
from trolley.geometry.frames import MAP
from trolley.messages import Tour
from trolley_viz.controls.controls import Controls
from trolley_viz.controls.markup import note, row, title
from trolley_viz.controls.shared import AddFolder
from trolley_viz.features.driving.aiming import Aiming, ignore
from trolley_viz.features.touch.touched import Touched
from trolley_viz.features.tours.draft import Draft, Editing, Point, bearing
from trolley_viz.features.tours.layer import place_finder
from trolley_viz.features.tours.point_editor import REMOVE, UP, PointEditor
from trolley_viz.features.tours.points import PointRows
from trolley_viz.features.tours.rounds import RoundsEditor
from trolley_viz.features.tours.times import TimesEditor
from trolley_viz.pointing.pointer import Pointed, Tool
from trolley_viz.robots.view import View
from trolley_viz.words.sentences import StatusLine, Tell

TOUR_POINT = "tour_point"
POINT_HINT = "Press where it should stop, drag the way it should face, and release."
TAP_HINT = "Tap places on the map in the order in which it should visit them."
CHOOSE = "choose …"
HERE, POINT_OUT = "Where it is", "Point on the map"
KEEP_MINE, TAKE_THEIRS = "Keep mine", "Take theirs"
SURE = ("localized", "unsure")
"""Pose states in which "where it stands" means something."""


class TourEditor:
    """Edits one tour at a time.

    Args:
        aiming: points at the map.
        view: what is known of the robot.
        save: called with the tour and what it was when it was opened.
    """

    def __init__(
        self,
        gui: Controls,
        add_folder: AddFolder,
        aiming: Aiming,
        view: Callable[[], View],
        tell: Tell,
        save: Callable[[Tour, Tour | None], None],
    ) -> None:
        self._aiming, self._view, self._tell = aiming, view, tell
        self._save_tour = save
        self._tours: Sequence[Tour] = ()
        self._is_leaving = False
        """Whether the next press of Cancel throws the changes away."""
        self._begun = Draft()
        """What there was when it was opened."""
        self.editing: Editing | None = None
        self._folder = gui.add_folder(visible=False)
        with self._folder:
            self._title = gui.add_html("")
            self._name = gui.add_text("Name", "")
            gui.add_html(note(TAP_HINT))
            self._points = PointRows(
                gui,
                lambda: PointEditor(gui, self._change_point, self._arrange, self._point_out_again),
                self._choose,
                self._move,
            )
            self._add_place = gui.add_list("Add place", (CHOOSE,), words=(CHOOSE,))
            add_other = gui.add_choice("or add", (HERE, POINT_OUT))
            self._rounds = RoundsEditor(gui, add_folder, self._edit)
            self._times = TimesEditor(gui, add_folder, lambda times: self._edit(times=times))
            with gui.add_actions():
                self._problems = gui.add_html("")
                self._whose = gui.add_choice("", (KEEP_MINE, TAKE_THEIRS), visible=False)
                self._save = gui.add_button("Save", icon="device-floppy", colour="green")
                self._cancel = gui.add_button("Cancel", icon="x")
        self._name.on_change(lambda name: self._edit(name=name))
        self._add_place.on_change(self._add_named)
        add_other.on_press(self._add_where)
        self._whose.on_press(self._settle)
        self._save.on_press(self._press_save)
        self._cancel.on_press(self._press_cancel)

    # Opening and closing.
    def open(self, editing: Editing) -> None:
        """Edit this."""
        self.editing, self._begun = editing, editing.draft
        self._is_leaving = False
        self._times.open()
        self._title.content = title("New tour" if editing.opened is None else "Edit the tour")
        self._fill(editing.draft)

    def close(self) -> None:
        """Forget what was edited."""
        self.editing = None
        self._put_away()

    def _fill(self, draft: Draft) -> None:
        self._name.value = draft.name
        self._rounds.open(draft)

    # Showing.
    def update(self, view: View, tours: Sequence[Tour], *, is_shown: bool) -> None:
        """Show the draft, and what keeps it from being saved."""
        editing, self._tours = self.editing, tours
        self._folder.visible = is_shown and editing is not None
        if editing is None or not is_shown:
            return
        editing.hear(tours)
        saved, grid = view.streams.latest(topics.POSES), view.map
        maps = {one.name: one.map for one in ([] if saved is None else saved.poses)}
        names = sorted(name for name, on in maps.items() if grid is None or on == grid.name)
        self._points.show(editing, names)
        self._add_place.options = [CHOOSE, *names]
        self._add_place.value = CHOOSE
        self._rounds.update()
        self._times.show(editing.draft)
        elsewhere = [
            f"“{name}” is on another map."
            for name in dict.fromkeys(point.name for point in editing.draft.points)
            if name in maps and name not in names
        ]
        self._show_problems(editing, elsewhere)
        self._cancel.label = "Discard changes? Press again" if self._is_leaving else "Cancel"

    def _show_problems(self, editing: Editing, hints: Sequence[str]) -> None:
        lines = [StatusLine(text, "bad") for text in self._problems_of(editing)]
        if editing.was_changed:
            gone = editing.theirs is None
            text = "has deleted this tour" if gone else "has changed this tour"
            lines.insert(0, StatusLine(f"Somebody else {text}.", "warn"))
        lines += [StatusLine(text, "warn") for text in hints]
        self._problems.content = "".join(map(row, lines))
        self._whose.visible = editing.was_changed
        self._save.disabled = bool(self._problems_of(editing)) or editing.was_changed

    def _problems_of(self, editing: Editing) -> list[str]:
        saved = self._view().streams.latest(topics.POSES)
        places = {one.name: one.pose for one in ([] if saved is None else saved.poses)}
        problems = editing.draft.problems(editing.taken(self._tours), places.get)
        return [*problems, self._times.problem] if self._times.problem else problems

    # Editing.
    def _edit(self, **changes: Any) -> None:
        if self.editing is not None:
            self.editing.draft = replace(self.editing.draft, **changes)
            self._is_leaving = False

    def _choose(self, index: int) -> None:
        """Open the details of a point, or close them."""
        editing = self.editing
        if editing is not None and index < len(editing.draft.points):
            editing.chosen = None if editing.chosen == index else index

    def _move(self, index: int, by: int) -> None:
        """Put a point earlier or later."""
        editing = self.editing
        if editing is not None and index < len(editing.draft.points):
            self._is_leaving = False
            editing.move(index, by)

    def _arrange(self, action: str) -> None:
        editing = self.editing
        if editing is None:
            return
        self._is_leaving = False
        if action == REMOVE:
            editing.remove()
        elif editing.chosen is not None:
            editing.move(editing.chosen, -1 if action == UP else 1)

    def _change_point(self, before: Point, point: Point) -> None:
        """Change the chosen point, unless another was chosen while the change was on its way."""
        if self.editing is not None and self.editing.point is before:
            self._is_leaving = False
            self.editing.change(point)

    def _add(self, point: Point) -> None:
        if self.editing is not None:
            self._is_leaving = False
            self.editing.add(point)

    def add_touched(self, one: Touched) -> None:
        """Add a place or a point of the floor that was touched on the map."""
        if one.what == "place":
            self._add(Point(name=one.name))
        elif self.editing is not None:
            self._add(Point(pose=self._facing_on(self.editing, one.x, one.y, None)))

    def _facing_on(self, editing: Editing, x: float, y: float, yaw: float | None) -> Pose2D:
        """A pose at a place, which without a heading faces on from the last point."""
        points = editing.draft.points
        last = points[-1].where(place_finder(self._view())) if points else None
        return bearing(x, y, yaw, last)

    def _add_named(self, name: str) -> None:
        if name != CHOOSE:
            self._add(Point(name=name))

    def _add_where(self, action: str) -> None:
        if action == POINT_OUT:
            self._point_out(lambda editing, point: self._add(point))
            return
        view = self._view()
        estimate = view.streams.latest(topics.POSE)
        is_sure = estimate is not None and estimate.state in SURE and view.is_fresh(topics.POSE)
        if estimate is None or estimate.pose is None or not is_sure:
            self._tell("Not added", "The robot does not know where it is.", "warn")
        else:
            self._add(Point(pose=estimate.pose))

    def _point_out_again(self) -> None:
        """Let the person show another place for the chosen point."""

        def move(editing: Editing, point: Point) -> None:
            if editing.point is not None:
                moved = replace(editing.point, name=None, pose=point.pose)
                self._change_point(editing.point, moved)

        self._point_out(move)

    def _point_out(self, take: Callable[[Editing, Point], None]) -> None:
        aiming, before = self._aiming, self.editing
        if self._view().placement.world != MAP:
            self._tell("Not now", "There is no map to point at.", "warn")
            return

        def done(pointed: Pointed) -> None:
            aiming.put_away()
            editing = self.editing
            if editing is None or editing is not before:
                return
            pose = self._facing_on(editing, pointed.x, pointed.y, pointed.yaw)
            take(editing, Point(pose=pose))

        if aiming.armed == TOUR_POINT:
            aiming.put_away()
        else:
            aiming.arm(Tool(TOUR_POINT, ignore, done), POINT_HINT)

    def _put_away(self) -> None:
        if self._aiming.armed == TOUR_POINT:
            self._aiming.put_away()

    # The end.
    def _settle(self, action: str) -> None:
        """Keep what is edited here, or take what somebody else saved."""
        editing = self.editing
        if editing is None or not editing.was_changed:
            return
        if action == KEEP_MINE:
            editing.keep_mine()
        elif editing.theirs is None:
            self.close()
        else:
            editing.take_theirs()
            self._fill(editing.draft)

    def _press_save(self) -> None:
        editing = self.editing
        if editing is None or editing.was_changed or self._problems_of(editing):
            return
        saved = self._view().streams.latest(topics.POSES)
        places = {one.name: one.pose for one in ([] if saved is None else saved.poses)}
        self._save_tour(editing.draft.tour(places.get), editing.opened)

    def _press_cancel(self) -> None:
        """Leave; changes are thrown away at the second press."""
        editing = self.editing
        if editing is None:
            return
        unchanged = self._begun if editing.opened is None else Draft.of(editing.opened)
        if editing.draft == unchanged or self._is_leaving:
            self.close()
        else:
            self._is_leaving = True
