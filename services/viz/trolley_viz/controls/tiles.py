"""Big buttons in two columns, made for fingers."""

from collections.abc import Callable, Mapping

from trolley_viz.controls.controls import Button, Controls
from trolley_viz.controls.markup import note
from trolley_viz.controls.messages import Colour
from trolley_viz.graphics.icons import known_icon

MAX_TILES = 60


class Tiles:
    """One button for each of a list of names.

    Args:
        gui: where they are added.
        icon: of those that have none of their own.
        colour: of the buttons; green is the one that stands out.
        press: called with the name.
    """

    def __init__(
        self, gui: Controls, icon: str, colour: Colour, press: Callable[[str], None]
    ) -> None:
        self._gui, self._icon, self._press = gui, icon, press
        self._colour: Colour = colour
        self._tiles = gui.add_tiles()
        self._more = gui.add_html("")
        self._buttons: dict[str, Button] = {}

    def show(self, icons: Mapping[str, str], lit: str | None, *, can: bool = True) -> None:
        """Show these, by name; `lit` is the one that stands out, `can` whether they do anything.

        All are made anew where one comes or goes: who presses one that moves away in this moment
        presses nothing, and never its neighbour.
        """
        shown = dict(sorted(icons.items(), key=lambda item: item[0].casefold())[:MAX_TILES])
        if self._buttons.keys() != shown.keys():
            for button in self._buttons.values():
                button.remove()
            with self._tiles:
                self._buttons = {name: self._add(name) for name in shown}
        for name, button in self._buttons.items():
            button.icon = known_icon(shown[name]) or self._icon
            button.colour = "green" if name == lit else self._colour
            button.disabled = not can
        num_left_out = len(icons) - len(shown)
        self._more.content = note(f"and {num_left_out} more") if num_left_out else ""

    def _add(self, name: str) -> Button:
        button = self._gui.add_button(name, is_name=True)
        button.on_press(lambda: self._press(name))
        return button
