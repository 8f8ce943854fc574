"""Zones: draw, change and delete them, and answer whether a suspected mirror is one."""

from collections.abc import Callable
from typing import Any

import viser

from trolley.messages import SuspectLine
from trolley.messages.mapping import ZoneKind
from trolley_viz.drawing.zone_editor import Mode
from trolley_viz.panels.controls import GREEN, GREY, show
from trolley_viz.panels.markup import note
from trolley_viz.session.session import Session
from trolley_viz.threads import handler

LINE_KINDS: dict[str, ZoneKind] = {"Mirror": "mirror", "Glass": "glass"}
AREA_KINDS: dict[str, ZoneKind] = {"No-go": "keepout", "Slow": "speed"}
KINDS: dict[str, ZoneKind] = LINE_KINDS | AREA_KINDS
CHOOSE: str = "choose …"
SUSPECT_TEXT = "There seems to be a mirror where the map says “mirror?”."


class ZonePanel:
    """The zones of the map, and the controls of their editor."""

    def __init__(self, gui: viser.GuiApi, session: Session) -> None:
        self._gui = gui
        self._editor = session.zone_editor
        self._post = session.post
        self._dismiss = session.dismiss
        self._offer: SuspectLine | None = None
        self._filled = -1
        self._mode: Mode = "idle"
        self._commands: list[viser.CommandHandle] = []
        with session.folder("Zones", is_open=True):
            self._suspect = gui.add_html(note(SUSPECT_TEXT), visible=False)
            self._answer = gui.add_button_group("Mirror?", ("Yes, add it", "No"), visible=False)
            self._lines = gui.add_button_group("Draw a line", tuple(LINE_KINDS))
            self._areas = gui.add_button_group("Draw an area", tuple(AREA_KINDS))
            self._choice = gui.add_dropdown("Change", (CHOOSE,))
            self._pick = gui.add_button(
                "Choose on the map", icon=viser.Icon.HAND_FINGER, color=GREY
            )
            self._name = gui.add_text("Name", "", visible=False)
            self._speed = gui.add_number(
                "At most (m/s)", 0.15, min=0.01, max=5.0, step=0.01, visible=False
            )
            self._done = gui.add_button("Done", icon=viser.Icon.CHECK, color=GREEN, visible=False)
            self._back = gui.add_button(
                "Undo last corner", icon=viser.Icon.ARROW_BACK, color=GREY, visible=False
            )
            self._delete = gui.add_button(
                "Delete", icon=viser.Icon.TRASH, color=GREY, visible=False
            )
            self._leave = gui.add_button("Cancel", icon=viser.Icon.X, color=GREY, visible=False)
        self._bind()

    def update(self, suspects: list[SuspectLine]) -> None:
        """Show what there is to choose, and what is under way."""
        editor = self._editor
        self._offer = suspects[0] if suspects and editor.mode == "idle" else None
        show(self._suspect, visible=self._offer is not None)
        show(self._answer, visible=self._offer is not None)
        self._show_choice()
        if self._mode != editor.mode:
            self._mode = editor.mode
            self._set_hotkeys(is_drawing=editor.mode == "draw")
        is_open = editor.mode in ("draw", "edit")
        show(self._lines, visible=not is_open)
        show(self._areas, visible=not is_open)
        show(self._pick, visible=not is_open)
        show(self._name, visible=is_open)
        show(self._speed, visible=is_open and editor.kind == "speed")
        show(self._done, visible=is_open, label="Save" if editor.mode == "edit" else "Done")
        show(self._back, visible=editor.mode == "draw")
        show(self._delete, visible=editor.mode == "edit")
        show(
            self._leave,
            visible=editor.mode != "idle",
            label="Close" if editor.mode == "edit" else "Cancel",
        )
        if self._filled != editor.filled:
            self._filled = editor.filled
            show(self._name, value=editor.form.name)
            show(self._speed, value=editor.form.speed)

    def _show_choice(self) -> None:
        editor = self._editor
        names = tuple(sorted(zone.name for zone in editor.zones))
        chosen = CHOOSE if editor.selected is None else editor.selected.name
        show(self._choice, options=(CHOOSE, *names), visible=editor.mode != "draw")
        if chosen in self._choice.options:
            show(self._choice, value=chosen)

    def _bind(self) -> None:
        editor, post = self._editor, self._post
        self._answer.on_click(handler(post, lambda _, answer: self._answered(answer)))
        self._lines.on_click(handler(post, lambda _, label: self._start(label)))
        self._areas.on_click(handler(post, lambda _, label: self._start(label)))
        self._choice.on_update(handler(post, lambda _, name: editor.select(name)))
        self._pick.on_click(handler(post, lambda _, __: editor.pick()))
        self._name.on_update(handler(post, lambda _, name: setattr(editor.form, "name", name)))
        self._speed.on_update(handler(post, lambda _, mps: setattr(editor.form, "speed", mps)))
        self._done.on_click(handler(post, lambda _, __: editor.done()))
        self._back.on_click(handler(post, lambda _, __: editor.take_back()))
        self._delete.on_click(handler(post, lambda _, __: editor.delete()))
        self._leave.on_click(handler(post, lambda _, __: editor.leave()))

    def _start(self, label: str) -> None:
        kind = KINDS.get(label)
        if kind is not None:  # a page may send anything
            self._editor.start(kind)

    def _answered(self, answer: str) -> None:
        if self._offer is None:
            return
        if answer == "No":
            self._dismiss(self._offer)
        else:
            self._editor.accept(self._offer)

    def _set_hotkeys(self, *, is_drawing: bool) -> None:
        """Keys that mean something only while a zone is drawn."""
        for command in self._commands:
            command.remove()
        self._commands.clear()
        if not is_drawing:
            return
        editor = self._editor
        self._add_hotkey("Finish the zone", "enter", editor.done)
        self._add_hotkey("Undo the last corner", "backspace", editor.take_back)

    def _add_hotkey(self, label: str, key: Any, act: Callable[[], None]) -> None:
        async def trigger(_: Any) -> None:
            self._post(act)

        command = self._gui.add_command(label, hotkey=key)
        command.on_trigger(trigger)
        self._commands.append(command)
