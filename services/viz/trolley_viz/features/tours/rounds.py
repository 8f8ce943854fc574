"""How often a tour that is being edited is driven."""

from collections.abc import Callable

from trolley_viz.controls.controls import Controls
from trolley_viz.controls.shared import AddFolder
from trolley_viz.features.tours.draft import Draft


class RoundsEditor:
    """Rounds, whether it turns round at the end, and whether it goes on after a restart.

    Args:
        folder: adds its folder.
        change: called with fields of the draft that were changed.
    """

    def __init__(self, gui: Controls, folder: AddFolder, change: Callable[..., None]) -> None:
        with folder("How often"):
            self._repeat = gui.add_number("Rounds", 1, min=1, max=1000, step=1)
            self._endless = gui.add_check("Repeat forever", False)
            self._back = gui.add_check("There and back", False)
            self._resume = gui.add_check(
                "Continue after a restart",
                False,
                hint="Whether it continues by itself after the robot has been switched off and on.",
            )

        def set_repeat() -> None:
            change(repeat=0 if self._endless.value else round(self._repeat.value))

        self._repeat.on_change(lambda _: set_repeat())
        self._endless.on_change(lambda _: set_repeat())
        self._back.on_change(lambda is_on: change(there_and_back=is_on))
        self._resume.on_change(lambda is_on: change(resume=is_on))

    def open(self, draft: Draft) -> None:
        """Show a draft from elsewhere."""
        self._repeat.value = max(draft.repeat, 1)
        self._endless.value = draft.repeat == 0
        self._back.value = draft.there_and_back
        self._resume.value = draft.resume

    def update(self) -> None:
        """Ask for a number of rounds only where there is one."""
        self._repeat.visible = not self._endless.value
