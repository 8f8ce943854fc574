"""Letting somebody in: a link as a QR code and to copy, for those who may drive."""

from collections.abc import Callable

from trolley_viz.controls.controls import Controls
from trolley_viz.controls.markup import code_image, note
from trolley_viz.controls.shared import AddFolder
from trolley_viz.server.links import OUT_OF_REACH, Links
from trolley_viz.server.qr import qr_image

TO_DRIVE, TO_LOOK = "To drive", "To look and stop"
SECRET = "The link is a password: whoever has it, or a picture of the code, gets in with it."
SHOWN_NS = 120_000_000_000
"""Nobody needs longer to hold a phone before it; a code that is forgotten lets strangers in."""


class LinkCard:
    """A card over the map with one link, where its code is seen whole on any screen."""

    def __init__(self, gui: Controls, links: Links) -> None:
        self._links = links
        self._until_ns: int | None = None
        self._card = gui.add_card()
        self._card.on_close(self.hide)
        with self._card:
            self._code = gui.add_html("")
            self._link = gui.add_text("Link to copy", "")
            gui.add_html(note(SECRET))

    def show(self, what: str) -> None:
        """Show the link for driving or the one for looking."""
        link = self._links.operator if what == TO_DRIVE else self._links.viewer
        self._code.content = code_image(qr_image(link), f"QR code of the link: {what.lower()}")
        self._link.value = link
        self._card.call(what, is_name=False)
        self._card.visible = True
        self._until_ns = None

    def update(self, now_ns: int) -> None:
        """Hide what was shown for long enough."""
        if not self._card.visible:
            return
        if self._until_ns is None:
            self._until_ns = now_ns + SHOWN_NS
        elif now_ns > self._until_ns:
            self.hide()

    def hide(self) -> None:
        """Show none, nor keep one on the page."""
        self._code.content = self._link.value = ""
        self._card.visible = False


def add_links(gui: Controls, folder: AddFolder, links: Links, show: Callable[[str], None]) -> None:
    """Add the folder in which somebody who may drive asks for a link, which `show` shows."""
    with folder("Let somebody in"):
        gui.add_html(note(OUT_OF_REACH), visible=not links.is_reachable)
        choice = gui.add_choice("", (TO_DRIVE, TO_LOOK), visible=links.is_reachable)
    choice.on_press(show)
