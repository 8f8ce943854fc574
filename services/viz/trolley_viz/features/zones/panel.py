"""Zones: draw, change and delete them, and answer whether a suspected mirror is one."""

from collections.abc import Callable

from trolley.messages import SuspectLine
from trolley.messages.mapping import ZoneKind
from trolley_viz.controls.controls import Button, Controls
from trolley_viz.controls.markup import note
from trolley_viz.controls.shared import AddFolder, show_undo
from trolley_viz.controls.undo import History
from trolley_viz.features.zones.editor import SLOW_MPS, Mode, ZoneEditor
from trolley_viz.features.zones.suspected_mirrors import SuspectLines

LINES: dict[str, ZoneKind] = {"Mirror": "mirror", "Glass": "glass"}
AREAS: dict[str, ZoneKind] = {"No-go": "keepout", "Slow": "speed", "Room": "room"}
KINDS: dict[str, ZoneKind] = LINES | AREAS
CHOOSE = "choose …"
YES, NO = "Yes, add it", "No"
SUSPECT_TEXT = "There seems to be a mirror where the map says “mirror?”."


class MirrorQuestion:
    """Asks whether a mirror that the localizer suspects is one, one at a time.

    Args:
        suspects: shows them on the map.
        dismiss: suspects one no more.
        editor: stores the others as zones.
    """

    def __init__(
        self,
        gui: Controls,
        suspects: SuspectLines,
        dismiss: Callable[[SuspectLine], None],
        editor: ZoneEditor,
    ) -> None:
        self._suspects, self._dismiss, self._editor = suspects, dismiss, editor
        self._offer: SuspectLine | None = None
        self._text = gui.add_html(note(SUSPECT_TEXT), visible=False)
        self._answer = gui.add_choice("Mirror?", (YES, NO), visible=False)
        self._answer.on_press(self._answered)

    def update(self) -> None:
        """Ask where something is suspected and no zone is being drawn."""
        suspects = self._suspects.offered
        is_free = self._editor.mode == "idle"
        self._offer = suspects[0] if suspects and is_free else None
        self._text.visible = self._answer.visible = self._offer is not None

    def _answered(self, answer: str) -> None:
        if self._offer is None:
            return
        if answer == NO:
            self._dismiss(self._offer)
        else:
            self._editor.accept(self._offer)


class ZonePanel:
    """The zones of the map, and the controls of their editor.

    Args:
        editor: of zones.
        suspects: mirrors to ask about.
        dismiss: suspects one no more.
        history: what can be undone.
    """

    def __init__(
        self,
        gui: Controls,
        add_folder: AddFolder,
        editor: ZoneEditor,
        suspects: SuspectLines,
        dismiss: Callable[[SuspectLine], None],
        history: History,
    ) -> None:
        self._gui = gui
        self._editor, self._history = editor, history
        self._filled = -1
        self._mode: Mode = "idle"
        self._commands: list[Button] = []
        self.folder = add_folder("Zones", is_open=True)
        with self.folder:
            self._question = MirrorQuestion(gui, suspects, dismiss, editor)
            self._lines = gui.add_choice("Draw a line", tuple(LINES))
            self._areas = gui.add_choice("Draw an area", tuple(AREAS))
            self._choice = gui.add_list("Change", (CHOOSE,), words=(CHOOSE,))
            self._pick = gui.add_button("Choose on the map", icon="hand-finger")
            self._name = gui.add_text("Name", "", visible=False)
            self._speed = gui.add_number(
                "At most (m/s)", SLOW_MPS, min=0.01, max=5.0, step=0.01, visible=False
            )
            self._done = gui.add_button("Done", icon="check", colour="green", visible=False)
            self._back = gui.add_button("Undo last corner", icon="arrow-back", visible=False)
            self._delete = gui.add_button("Delete", icon="trash", visible=False)
            self._leave = gui.add_button("Cancel", icon="x", visible=False)
            self._undo = gui.add_button("Undo", icon="arrow-back-up", visible=False)
        self._bind()

    def update(self) -> None:
        """Show what there is to choose, and what is under way."""
        editor = self._editor
        self._question.update()
        self._show_choice()
        show_undo(self._undo, self._history, "zone")
        if self._mode != editor.mode:
            self._mode = editor.mode
            self._set_hotkeys()
        is_drawn, is_changed = editor.mode == "draw", editor.mode == "edit"
        is_open = is_drawn or is_changed
        self._lines.visible = self._areas.visible = self._pick.visible = not is_open
        self._name.visible = self._done.visible = is_open
        self._speed.visible = is_open and editor.kind == "speed"
        self._done.label = "Save" if is_changed else "Done"
        self._back.visible, self._delete.visible = is_drawn, is_changed
        self._leave.visible = editor.mode != "idle"
        self._leave.label = "Close" if is_changed else "Cancel"
        if self._filled != editor.filled:
            self._filled = editor.filled
            self._name.value, self._speed.value = editor.form.name, editor.form.speed

    def _show_choice(self) -> None:
        editor = self._editor
        selected = CHOOSE if editor.selected is None else editor.selected.name
        self._choice.options = [CHOOSE, *sorted(zone.name for zone in editor.zones)]
        self._choice.visible = editor.mode != "draw"
        if selected in self._choice.options:
            self._choice.value = selected

    def _bind(self) -> None:
        editor = self._editor
        for choice in (self._lines, self._areas):
            choice.on_press(lambda label: editor.start(KINDS[label]))
        self._choice.on_change(editor.select)
        self._pick.on_press(editor.pick)
        self._name.on_change(lambda name: setattr(editor.form, "name", name))
        self._speed.on_change(lambda mps: setattr(editor.form, "speed", mps))
        self._done.on_press(editor.done)
        self._back.on_press(editor.take_back)
        self._delete.on_press(editor.delete)
        self._leave.on_press(editor.leave)
        self._undo.on_press(lambda: self._history.undo("zone"))

    def _set_hotkeys(self) -> None:
        """Listen to keys that mean something only while a zone is drawn."""
        for command in self._commands:
            command.remove()
        self._commands.clear()
        if self._mode == "draw":
            self._commands = [
                self._gui.add_command("Finish the zone", "enter", self._editor.done),
                self._gui.add_command("Undo the last corner", "backspace", self._editor.take_back),
            ]
