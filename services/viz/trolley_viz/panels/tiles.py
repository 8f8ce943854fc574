"""Big buttons in two columns, made for fingers."""

from collections.abc import Callable, Mapping

import viser
from viser import IconName

from trolley_viz.graphics.icons import known_icon
from trolley_viz.panels.markup import note
from trolley_viz.threads import Post, handler

MAX_TILES = 60

# viser gives its buttons no classes: a mark in the container tells where they are tiles.
STYLE = """<style>
div:has(>div>.trolley-tiles){display:grid;grid-template-columns:1fr 1fr;padding:0 8px}
div:has(>div>.trolley-tiles)>*{grid-column:1/-1;min-width:0}
div:has(>div>.trolley-tiles)>div:has(>button){grid-column:auto;margin:0 4px!important;
 padding-bottom:8px;display:grid}
div:has(>div>.trolley-tiles)>div>button{height:auto!important;min-height:58px;border-radius:10px;
 padding:6px 10px}
div:has(>div>.trolley-tiles)>div:has(>.trolley-small)~div>button{min-height:44px}
div:has(>div>.trolley-tiles) button .mantine-Button-label{white-space:normal;line-height:1.3;
 overflow-wrap:anywhere;font-size:15px;height:auto;display:-webkit-box;-webkit-line-clamp:3;
 -webkit-box-orient:vertical;overflow:hidden;text-box-trim:none;text-wrap:balance}
div:has(>div>.trolley-tiles) button .mantine-Button-section>div{width:1.5em;height:1.5em;
 margin-right:.4em}
div:has(>div>.trolley-tiles) button svg{width:100%;height:100%}
div:has(>div>.trolley-tiles) input{min-height:36px!important;font-size:16px!important}
.trolley-heading{padding:6px 4px 4px;font-weight:600;font-size:14px;opacity:.8}
</style>"""
"""To be put anywhere into the page, once."""
MARK = '<div class="trolley-tiles"></div>'
"""To be put first into a container whose buttons are to be tiles."""
SMALL = '<div class="trolley-small"></div>'
"""The buttons after it are less high."""


def heading(text: str) -> str:
    """A line over a group of tiles; `text` is our own."""
    return f'<div class="trolley-heading">{text}</div>'


def button_icon(name: str, otherwise: IconName) -> IconName:
    """The icon of a name for a viser button."""
    known = known_icon(name) if name else None
    return otherwise if known is None else IconName(known)


class Tiles:
    """One button for each of a list of names.

    Args:
        gui: where they are added.
        icon: of those that have none of their own.
        colour: of the buttons.
        press: called with the name.
        post: hands a call to the service's thread.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        icon: IconName,
        colour: tuple[int, int, int],
        press: Callable[[str], None],
        post: Post,
    ) -> None:
        self._gui, self._icon, self._colour = gui, icon, colour
        self._press, self._post = press, post
        self._folder = gui.add_folder(None)
        self._buttons: dict[str, viser.GuiButtonHandle] = {}
        self._icons: dict[str, str] = {}
        self._more: viser.GuiHtmlHandle | None = None

    def show(
        self, icons: Mapping[str, str], lit: str | None, lit_colour: tuple[int, int, int]
    ) -> None:
        """Show these, by name; `lit` is the one that stands out.

        All are made anew where one comes or goes: who presses one that moves away in this moment
        presses nothing, and never its neighbour.
        """
        shown = dict(sorted(icons.items(), key=lambda item: item[0].casefold())[:MAX_TILES])
        if self._buttons.keys() != shown.keys():
            self._make(shown, len(icons) - len(shown))
        for name, button in self._buttons.items():
            if self._icons[name] != shown[name]:
                self._icons[name] = shown[name]
                button.icon = button_icon(shown[name], self._icon)
            colour = lit_colour if name == lit else self._colour
            button.color = colour

    def _make(self, shown: Mapping[str, str], num_left_out: int) -> None:
        for button in self._buttons.values():
            button.remove()
        if self._more is not None:
            self._more.remove()
            self._more = None
        self._buttons.clear()
        self._icons = dict(shown)
        with self._folder:
            for name, icon in shown.items():
                button = self._gui.add_button(
                    name, icon=button_icon(icon, self._icon), color=self._colour
                )
                button.on_click(handler(self._post, lambda _, __, name=name: self._press(name)))
                self._buttons[name] = button
            if num_left_out:
                self._more = self._gui.add_html(note(f"and {num_left_out} more"))
