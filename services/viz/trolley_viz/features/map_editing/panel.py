"""Controls for changing the map itself."""

import math

from trolley_viz.controls.controls import Controls
from trolley_viz.controls.markup import note
from trolley_viz.controls.shared import AddFolder
from trolley_viz.features.map_editing.editor import MapEditor
from trolley_viz.features.map_editing.pencil import BRUSH_M, WALL_M, Tool

TOOLS: dict[str, Tool] = {"Look": "look", "Erase": "erase", "Wall": "wall", "Crop": "crop"}
CHOOSE = "choose …"


class MapEditPanel:
    """The controls of the map editor."""

    def __init__(self, gui: Controls, add_folder: AddFolder, editor: MapEditor) -> None:
        self._editor = editor
        self._filled = -1
        with add_folder("Edit map"):
            self._closed = gui.add_folder()
            with self._closed:
                self._open = gui.add_button("Change this map", icon="pencil")
                self._undo = gui.add_button("Back to the previous version", icon="history")
            self._opened = gui.add_folder(visible=False)
            with self._opened:
                self._tools = gui.add_choice("Tool", tuple(TOOLS))
                self._now = gui.add_html("")
                self._brush = gui.add_slider("Brush (m)", BRUSH_M, min=0.05, max=2.0, step=0.05)
                self._unknown = gui.add_check("Erase to unknown", False)
                self._wall = gui.add_slider("Wall (m)", WALL_M, min=0.05, max=0.5, step=0.05)
                self._angle = gui.add_slider("Turn (°)", 0.0, min=-180.0, max=180.0, step=0.5)
                self._straight = gui.add_button("Straighten the walls", icon="angle")
                self._other = gui.add_list("Merge with", (CHOOSE,), words=(CHOOSE,))
                self._back = gui.add_button("Undo last step", icon="arrow-back")
                self._name = gui.add_text("Save as", "")
                self._save = gui.add_button("Save as new version", icon="check", colour="green")
                self._leave = gui.add_button("Cancel", icon="x")
        self._bind()

    def update(self) -> None:
        """Show what is under way."""
        editor = self._editor
        self._closed.visible, self._opened.visible = not editor.is_open, editor.is_open
        self._undo.disabled = editor.is_busy
        label = next(text for text, one in TOOLS.items() if one == editor.pencil.tool)
        steps = len(editor.drafting.draft.ops)
        count = "nothing changed yet" if not steps else f"{steps} step{'s' * (steps > 1)}"
        busy = " · working …" if editor.is_busy else ""
        self._now.content = note(f"{label} · {count}{busy}")
        self._brush.visible = self._unknown.visible = editor.pencil.tool == "erase"
        self._wall.visible = editor.pencil.tool == "wall"
        self._other.visible = bool(editor.maps)
        self._other.options = (CHOOSE, *editor.maps)
        self._back.visible = bool(steps)
        self._save.disabled = editor.is_busy or not steps
        self._angle.value = round(math.degrees(editor.drafting.draft.last_turn), 3)
        if self._filled != editor.filled:
            self._filled = editor.filled
            self._name.value, self._other.value = editor.as_name, CHOOSE

    def _bind(self) -> None:
        editor = self._editor
        self._open.on_press(editor.open)
        self._undo.on_press(editor.undo_stored)
        self._tools.on_press(lambda label: editor.choose(TOOLS[label]))
        self._brush.on_change(lambda metres: setattr(editor.pencil, "brush_m", metres))
        self._wall.on_change(lambda metres: setattr(editor.pencil, "wall_m", metres))
        self._unknown.on_change(lambda is_on: setattr(editor.pencil, "to_unknown", is_on))
        self._angle.on_change(editor.turn_to)
        self._straight.on_press(editor.straighten)
        self._other.on_change(editor.merge)
        self._back.on_press(editor.take_back)
        self._name.on_change(lambda name: setattr(editor, "as_name", name))
        self._save.on_press(editor.store)
        self._leave.on_press(editor.leave)
