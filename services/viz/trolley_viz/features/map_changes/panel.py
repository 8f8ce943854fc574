"""The card that offers to update the map where things have appeared or gone."""

from collections.abc import Callable

from trolley.messages import MapChange
from trolley_viz.controls.controls import Controls
from trolley_viz.controls.markup import note, sentence
from trolley_viz.controls.shared import show_undo
from trolley_viz.controls.undo import History
from trolley_viz.features.map_changes.changes import ChangeMarks, ChangeRequests
from trolley_viz.words.plain_words import said
from trolley_viz.words.sentences import StatusLine, aged

NO_CHOICE = ""
ACCEPT, LATER, NEVER = "Accept", "Not now", "Never"
MAX_LISTED = 5


class ChangePanel:
    """Lists the changes that the robot found, and takes the answer.

    Args:
        marks: shows them on the map.
        change_requests: accepts or dismisses them.
        put_off: offers them no more for now.
        history: what can be undone.
    """

    def __init__(
        self,
        gui: Controls,
        marks: ChangeMarks,
        change_requests: ChangeRequests,
        put_off: Callable[[list[MapChange]], None],
        history: History,
    ) -> None:
        self._marks, self._requests = marks, change_requests
        self._put_off, self._history = put_off, history
        self._offered: list[MapChange] = []
        self._text = gui.add_html("", visible=False)
        self._which = gui.add_list("Which", (NO_CHOICE,), words=(), visible=False)
        self._answer = gui.add_choice("Change the map?", (ACCEPT, LATER, NEVER), visible=False)
        self._undo = gui.add_button("Undo", icon="arrow-back-up", visible=False)
        self._answer.on_press(self._answered)
        self._undo.on_press(lambda: history.undo("map"))

    def update(self, age_s: float | None) -> None:
        """Show what there is to decide; how old [s] that is, None where it holds now."""
        offered = self._offered = self._marks.offered
        self._text.visible = self._answer.visible = bool(offered)
        self._text.content = card(offered, age_s) if offered else ""
        choices = choices_of(offered)
        self._which.options = [*choices]
        names = {one.id for one in offered}
        self._which.set_words([one for one in choices if one not in names])
        self._which.visible = len(offered) > 1
        self._answer.disabled = self._requests.is_busy
        show_undo(self._undo, self._history, "map")

    def _answered(self, answer: str) -> None:
        chosen = choices_of(self._offered)[self._which.value]
        if answer == ACCEPT:
            self._requests.accept(chosen)
        elif answer == LATER:
            self._put_off(chosen)
        else:
            self._requests.dismiss(chosen)


def choices_of(offered: list[MapChange]) -> dict[str, list[MapChange]]:
    """What can be decided on: all of it, or one by one."""
    if len(offered) < 2:
        return {NO_CHOICE: offered}
    return {f"all {len(offered)}": offered} | {one.id: [one] for one in offered}


def card(offered: list[MapChange], age_s: float | None = None) -> str:
    """What has changed and how old [s] that is, as HTML."""
    count = len(offered)
    headline = "1 thing has changed" if count == 1 else f"{count} things have changed"
    lines = [note(f"{one.id}: {said(one.message)}") for one in offered[:MAX_LISTED]]
    if count > MAX_LISTED:
        lines.append(note(f"and {count - MAX_LISTED} more, see the map"))
    words = aged(StatusLine(f"{headline} since the map was made.", "warn"), age_s)
    return sentence(words) + "".join(lines)
