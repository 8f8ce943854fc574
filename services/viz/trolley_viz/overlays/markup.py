"""Untrusted text made safe for the page: a few tags and colours, nothing that acts or loads."""

import html
import re

import nh3

from trolley.messages.types import Colour

MAX_TEXT = 4000
TAGS = {"b", "strong", "i", "em", "u", "small", "br", "span", "font"}

_COLOUR = re.compile(r"#[0-9a-f]{3,8}|[a-z]{3,20}|rgba?\([\d\s.,%/]{1,40}\)", re.IGNORECASE)
_STYLE = re.compile(r"(?:^|;)\s*color\s*:\s*([^;]+)", re.IGNORECASE)


def safe_markup(text: str) -> str:
    """Return HTML with everything but weight, line breaks and text colours removed.

    Kept: `<b>`, `<i>`, `<u>`, `<small>`, `<br>`, `<span style="color:...">` and
    `<font color=...>`. Other tags go, their text stays; scripts and styles go with their text.
    """
    return nh3.clean(
        text[:MAX_TEXT],
        tags=TAGS,
        attributes={"span": {"style"}, "font": {"color"}},
        attribute_filter=_keep_colour,
        url_schemes=set(),
        link_rel=None,
    )


def escaped(text: str, length: int = 200) -> str:
    """Return a text as it stands, for a place in the page that holds no markup."""
    return html.escape(text if len(text) <= length else f"{text[: length - 1]}…")


def css_colour(colour: Colour) -> str:
    """Write a colour of the contract as CSS."""
    red, green, blue = (round(255 * part) for part in colour[:3])
    return f"rgba({red},{green},{blue},{colour[3]:.3g})"


def _keep_colour(_tag: str, attribute: str, value: str) -> str | None:
    found = _STYLE.search(value) if attribute == "style" else None
    colour = value if found is None else found[1]
    if (attribute == "style" and found is None) or not _COLOUR.fullmatch(colour.strip()):
        return None
    return f"color:{colour.strip()}" if attribute == "style" else colour.strip()
