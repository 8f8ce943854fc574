"""The times of day at which a tour that is being edited starts by itself."""

from collections.abc import Callable

from trolley.messages import ScheduleEntry
from trolley.messages.touring import Day
from trolley_viz.controls.controls import Button, Check, Controls
from trolley_viz.controls.markup import note, row
from trolley_viz.controls.shared import AddFolder
from trolley_viz.features.tours.draft import DAYS, Draft, days_text, time_entry
from trolley_viz.words.sentences import StatusLine

MAX_TIMES = 20
CHOSEN_DAYS = "on these days"
PRESETS: dict[str, tuple[Day, ...]] = {
    "every day": DAYS,
    "Mon–Fri": DAYS[:5],
    "Sat, Sun": DAYS[5:],
}


class TimesEditor:
    """A list of times, and one more to add.

    Args:
        folder: adds its folder.
        change: called with the new times.
    """

    def __init__(
        self,
        gui: Controls,
        folder: AddFolder,
        change: Callable[[tuple[ScheduleEntry, ...]], None],
    ) -> None:
        self._gui = gui
        self._change = change
        self._times: tuple[ScheduleEntry, ...] = ()
        self._rows: list[Button] = []
        with folder("Starts by itself"):
            self._list = gui.add_folder()
            self._none = gui.add_html("")
            self._at = gui.add_text(
                "At", "", hint="A time of day by the robot's clock, such as 08:30."
            )
            self._when = gui.add_list("Days", (*PRESETS, CHOSEN_DAYS))
            self._days: dict[Day, Check] = {
                day: gui.add_check(day.title(), False, visible=False) for day in DAYS
            }
            add = gui.add_button("Add this time", icon="clock-plus")
            self._note = gui.add_html("")
        add.on_press(self._add)

    def open(self) -> None:
        """Begin with empty fields."""
        self._at.value, self._note.content = "", ""

    def show(self, draft: Draft) -> None:
        """Show the times of a draft."""
        self._times = draft.times
        with self._list:
            while len(self._rows) < len(self._times):
                self._rows.append(self._add_row(len(self._rows)))
        for i, button in enumerate(self._rows):
            button.visible = i < len(self._times)
            if button.visible:
                entry = self._times[i]
                button.label = f"Remove {entry.at} {days_text(entry.days)}"
        self._none.content = "" if self._times else note("No times set.")
        is_chosen = self._when.value == CHOSEN_DAYS
        for box in self._days.values():
            box.visible = is_chosen

    @property
    def problem(self) -> str:
        """What is typed in and not added, in words."""
        text = self._at.value.strip()
        return (
            f"The time “{text[:20]}” has not been added yet. Add it or clear the field."
            if text
            else ""
        )

    def _add_row(self, index: int) -> Button:
        button = self._gui.add_button("", icon="clock-x")
        button.on_press(lambda: self._remove(index))
        return button

    def _remove(self, index: int) -> None:
        self._change(self._times[:index] + self._times[index + 1 :])

    def _add(self) -> None:
        text = self._at.value
        chosen: tuple[Day, ...] = tuple(day for day, box in self._days.items() if box.value)
        days = PRESETS.get(self._when.value, chosen)
        entry = time_entry(text, days)
        problem = ""
        if entry is None:
            problem = f"“{text.strip()[:20]}” is not a time of day. Write it like 08:30."
        elif not days:
            problem = "Choose at least one day."
        elif entry in self._times:
            problem = "This time is already in the list."
        elif len(self._times) >= MAX_TIMES:
            problem = f"A tour has at most {MAX_TIMES} times."
        else:
            self._at.value = ""
            self._change((*self._times, entry))
        self._note.content = row(StatusLine(problem, "warn")) if problem else ""
