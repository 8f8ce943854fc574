"""Controls for changing the map itself."""

import math
from typing import cast

import viser

from trolley_viz.map_editing.map_editor import BRUSH_M, WALL_M, Tool
from trolley_viz.panels.controls import GREEN, GREY, show
from trolley_viz.panels.markup import note
from trolley_viz.session.session import Session
from trolley_viz.threads import handler

TOOLS: dict[str, Tool] = {"Look": "look", "Erase": "erase", "Wall": "wall", "Crop": "crop"}
CHOOSE = "choose …"


class MapEditPanel:
    """The controls of the map editor."""

    def __init__(self, gui: viser.GuiApi, session: Session) -> None:
        self._editor = session.map_editor
        self._filled = -1
        icon = viser.Icon
        with session.folder("Edit map"):
            self._open = gui.add_button("Change this map", icon=icon.PENCIL, color=GREY)
            self._undo = gui.add_button(
                "Back to the previous version", icon=icon.HISTORY, color=GREY
            )
            self._tools = gui.add_button_group("Tool", tuple(TOOLS), visible=False)
            self._now = gui.add_html("", visible=False)
            self._brush = gui.add_slider("Brush (m)", 0.05, 2.0, 0.05, BRUSH_M, visible=False)
            self._unknown = gui.add_checkbox("Erase to unknown", False, visible=False)
            self._wall = gui.add_slider("Wall (m)", 0.05, 0.5, 0.05, WALL_M, visible=False)
            self._angle = gui.add_slider("Turn (°)", -180.0, 180.0, 0.5, 0.0, visible=False)
            self._straight = gui.add_button(
                "Straighten the walls", icon=icon.ANGLE, color=GREY, visible=False
            )
            self._other = gui.add_dropdown("Merge with", (CHOOSE,), visible=False)
            self._back = gui.add_button(
                "Undo last step", icon=icon.ARROW_BACK, color=GREY, visible=False
            )
            self._name = gui.add_text("Save as", "", visible=False)
            self._save = gui.add_button(
                "Save as new version", icon=icon.CHECK, color=GREEN, visible=False
            )
            self._leave = gui.add_button("Cancel", icon=icon.X, color=GREY, visible=False)
        self._bind(session)

    def update(self) -> None:
        """Show what is under way."""
        editor = self._editor
        is_open, tool = editor.is_open, editor.tool
        show(self._open, visible=not is_open)
        show(self._undo, visible=not is_open, disabled=editor.is_busy)
        for control in (self._tools, self._now, self._straight, self._name, self._leave):
            show(control, visible=is_open)
        label = next(text for text, one in TOOLS.items() if one == tool)
        steps = len(editor.draft.ops)
        count = "nothing changed yet" if not steps else f"{steps} step{'s' * (steps > 1)}"
        busy = " · working …" if editor.is_busy else ""
        show(self._now, content=note(f"{label} · {count}{busy}"))
        show(self._brush, visible=is_open and tool == "erase")
        show(self._unknown, visible=is_open and tool == "erase")
        show(self._wall, visible=is_open and tool == "wall")
        show(self._angle, visible=is_open)
        show(self._other, visible=is_open and bool(editor.maps))
        show(self._other, options=(CHOOSE, *editor.maps))
        show(self._back, visible=is_open and bool(steps))
        show(self._save, visible=is_open, disabled=editor.is_busy or not steps)
        angle = round(math.degrees(editor.draft.last_turn), 3)
        show(self._angle, value=angle)
        if self._filled != editor.filled:
            self._filled = editor.filled
            show(self._name, value=editor.as_name)
            show(self._other, value=CHOOSE)

    def _bind(self, session: Session) -> None:
        editor, post = self._editor, session.post
        self._open.on_click(handler(post, lambda _, __: editor.open()))
        self._undo.on_click(handler(post, lambda _, __: editor.undo_stored()))
        self._tools.on_click(handler(post, lambda _, label: self._choose(label)))
        self._brush.on_update(handler(post, lambda _, m: setattr(editor, "brush_m", float(m))))
        self._wall.on_update(handler(post, lambda _, m: setattr(editor, "wall_m", float(m))))
        self._unknown.on_update(
            handler(post, lambda _, is_on: setattr(editor, "to_unknown", bool(is_on)))
        )
        self._angle.on_update(handler(post, lambda _, degrees: editor.turn_to(float(degrees))))
        self._straight.on_click(handler(post, lambda _, __: editor.straighten()))
        self._other.on_update(handler(post, lambda _, name: editor.merge(str(name))))
        self._back.on_click(handler(post, lambda _, __: editor.take_back()))
        self._name.on_update(handler(post, lambda _, name: setattr(editor, "as_name", name)))
        self._save.on_click(handler(post, lambda _, __: editor.store()))
        self._leave.on_click(handler(post, lambda _, __: editor.leave()))

    def _choose(self, label: object) -> None:
        if label in TOOLS:  # a page may send anything
            self._editor.choose(TOOLS[cast("str", label)])
