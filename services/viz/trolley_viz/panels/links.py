"""Letting somebody in: a link as a QR code and to copy, for those who may drive."""

from trolley_viz.controls.controls import Controls
from trolley_viz.panels.controls import AddFolder
from trolley_viz.panels.markup import code_image, note
from trolley_viz.server.links import OUT_OF_REACH, Links
from trolley_viz.server.qr import qr_image

TO_DRIVE, TO_LOOK = "To drive", "To look and stop"
SECRET = "The link is a password: whoever has it, or a picture of the code, gets in with it."
SHOWN_NS = 120_000_000_000
"""Nobody needs longer to hold a phone before it; a code that is forgotten lets strangers in."""


class LinksPanel:
    """Shows one link at a time, and only when asked."""

    def __init__(self, gui: Controls, folder: AddFolder, links: Links) -> None:
        self._links = links
        self._until_ns: int | None = None
        with folder("Let somebody in"):
            gui.add_html(note(OUT_OF_REACH), visible=not links.is_reachable)
            choice = gui.add_choice("", (TO_DRIVE, TO_LOOK), visible=links.is_reachable)
            self._shown = gui.add_folder(visible=False)
            with self._shown:
                self._code = gui.add_html("")
                self._link = gui.add_text("Link to copy", "")
                gui.add_html(note(SECRET))
                hide = gui.add_button("Hide", icon="eye-off")
        choice.on_press(self._show)
        hide.on_press(self._hide)

    def update(self, now_ns: int) -> None:
        """Hide what was shown for long enough."""
        if not self._shown.visible:
            return
        if self._until_ns is None:
            self._until_ns = now_ns + SHOWN_NS
        elif now_ns > self._until_ns:
            self._hide()

    def _show(self, what: str) -> None:
        link = self._links.operator if what == TO_DRIVE else self._links.viewer
        self._code.content = code_image(qr_image(link), f"QR code of the link: {what.lower()}")
        self._link.value = link
        self._shown.visible = True
        self._until_ns = None

    def _hide(self) -> None:
        self._code.content = self._link.value = ""
        self._shown.visible = False
