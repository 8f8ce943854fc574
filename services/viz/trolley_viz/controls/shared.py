"""What several panels do with their controls."""

from typing import Protocol

from trolley_viz.controls.controls import Button, Folder
from trolley_viz.controls.undo import History, Kind


class AddFolder(Protocol):
    """Adds a folder of controls."""

    def __call__(self, title: str, *, is_open: bool = False) -> Folder:
        """Add one that is open or closed as its person left it, else as is said here."""
        ...


def show_undo(button: Button, history: History, kind: Kind) -> None:
    """Offer to take the last step of a kind back, naming it."""
    last = history.last(kind)
    button.visible = last is not None
    if last is not None:
        button.label = f"Undo: {last.title}"
