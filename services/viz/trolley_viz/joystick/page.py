"""The pad as a piece of the page: markup, style and script are files beside this one."""

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
    """Return what viser is given to put into the page of one browser.

    Scripts in such HTML are not run; an image that has been loaded may run one. It makes a script
    of its own of ours, since names mean other things inside of an element.
    """
    script = f"{_read('pad.js')}\nstartPad(document.getElementById('trolley-hand'), {client_id});"
    return (
        f"<style>{_read('pad.css')}</style>{_read('pad.html').strip()}"
        f'<img src="{PIXEL}" alt="" style="display:none" onload="{RUN}" '
        f'data-script="{html.escape(script)}">'
    )


def _read(name: str) -> str:
    return resources.files("trolley_viz.joystick").joinpath(name).read_text(encoding="utf-8")
