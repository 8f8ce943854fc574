"""What several panels do with their controls."""

from collections.abc import Callable

from trolley_viz.controls.controls import Button, Folder
from trolley_viz.editing.undo import History, Kind

AddFolder = Callable[[str], Folder]
"""Adds a folder that is open or closed as its person left it."""


def show_undo(button: Button, history: History, kind: Kind) -> None:
    """Offer to take the last step of a kind back, naming it."""
    last = history.last(kind)
    button.visible = last is not None
    if last is not None:
        button.label = f"Undo: {last.title}"
