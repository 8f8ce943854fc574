"""The pieces of the page that are ours: each has files for markup, style and script."""

import functools
import html
from importlib import resources

PIXEL = "data:image/gif;base64,R0lGODlhAQABAAAAACwAAAAAAQABAAA="
RUN = (
    "const script = document.createElement('script');"
    "script.text = this.dataset.script;"
    "document.head.append(script);"
    "script.remove()"
)


def pad_html(client_id: int) -> str:
    """Return the joystick as HTML for the page of one browser."""
    call = f"startPad(document.getElementById('trolley-hand'), {client_id});"
    return _piece("joystick", "pad", call)


def overlays_html(client_id: int) -> str:
    """Return the container of the overlays as HTML for one browser."""
    call = f"startOverlays(document.getElementById('trolley-overlays'), {client_id});"
    return _piece("overlays", "overlays", call)


def gestures_html(client_id: int) -> str:
    """Return the script that reports gestures, as HTML for one browser."""
    call = f"startGestures(document.getElementById('trolley-gestures'), {client_id});"
    return _piece("pointing", "gestures", call)


@functools.cache
def _files(folder: str, name: str) -> tuple[str, str, str]:
    """The style, the markup and the script of a piece, read once for all browsers."""
    all_files = resources.files("trolley_viz")
    files = all_files.joinpath(folder)
    style, markup, script = (
        files.joinpath(f"{name}.{kind}").read_text(encoding="utf-8")
        for kind in ("css", "html", "js")
    )
    connection = all_files.joinpath("server", "connection.js").read_text(encoding="utf-8")
    return style, markup, f"{connection}\n{script}"


def _piece(folder: str, name: str, call: str) -> str:
    """Put the files of a piece together.

    Scripts in such HTML are not run; an image that has been loaded may run one. It makes a script
    of its own of ours, since names mean other things inside of an element.
    """
    style, markup, script = _files(folder, name)
    return (
        f"<style>{style}</style>{markup.strip()}"
        f'<img src="{PIXEL}" alt="" style="display:none" onload="{RUN}" '
        f'data-script="{html.escape(f"{script}{chr(10)}{call}")}">'
    )
