"""Colours of controls, and setting of controls without sending what is there already."""

from collections.abc import Callable
from typing import Any

import viser

from trolley_viz.editing.undo import History

Colour = tuple[int, int, int]

GREEN, TEAL, GREY, STOP_RED = (26, 138, 66), (14, 122, 128), (100, 108, 120), (218, 24, 24)
PURPLE, AMBER = (92, 62, 158), (166, 96, 0)
"""Button colours on which white text can be read, on light and dark."""

READABLE = """<style>
:root[data-mantine-color-scheme=light]{--mantine-color-dimmed:#5c646d}
:root[data-mantine-color-scheme=dark]{--mantine-color-dimmed:#b3b7bd}
:root[data-mantine-color-scheme=dark] [role=tab][aria-selected=true]{color:#6db3f8}
</style>"""
"""Labels and the open tab with the contrast that small letters need; viser's are paler."""

AddFolder = Callable[[str], viser.GuiFolderHandle]
"""Adds a folder that is open or closed as its person left it."""


def show(control: Any, **values: Any) -> None:
    """Set what differs: viser sends every assignment to the page, also of what is there."""
    for name, value in values.items():
        if getattr(control, name) != value:
            setattr(control, name, value)


def set_options(dropdown: viser.GuiDropdownHandle[str], options: list[str], empty: str) -> None:
    """Offer other choices and keep the chosen one; `empty` stands where there is none."""
    wanted = tuple(options) or (empty,)
    if dropdown.options != wanted:
        dropdown.options = wanted
    dropdown.disabled = not options


def show_undo(button: viser.GuiButtonHandle, history: History) -> None:
    """Offer to take the last step back, naming it."""
    last = history.last
    button.visible = last is not None
    if last is not None:
        button.label = f"Undo: {last.title}"
