"""Pictograms by name: the Tabler icons (MIT licence) that viser carries, as pictures in any colour.

Names are Tabler's, such as `home` or `tools-kitchen`; Font Awesome's (`fa-robot`) are understood
where they mean the same.
"""

import functools
import io
import zipfile
from importlib import resources

import numpy as np
import resvg_py
from numpy.typing import NDArray
from PIL import Image

UNKNOWN_ICON = "question-mark"
MAX_PX = 512
STROKE = 2.6
"""How wide lines are, where the icon is 24 wide: a little wider than Tabler's, to be seen afar."""

ALIASES = {
    "bathtub": "bath",
    "bolt": "bolt",
    "charging-station": "charging-pile",
    "child": "mood-kid",
    "circle-exclamation": "alert-circle",
    "couch": "sofa",
    "cutlery": "tools-kitchen-2",
    "door-closed": "door",
    "door-open": "door-enter",
    "gamepad": "device-gamepad",
    "house": "home",
    "kitchen": "tools-kitchen-2",
    "location-dot": "map-pin",
    "location-pin": "map-pin",
    "map-marker": "map-pin",
    "mug-hot": "coffee",
    "person": "user",
    "triangle-exclamation": "alert-triangle",
    "tv": "device-tv",
    "utensils": "tools-kitchen-2",
    "warning": "alert-triangle",
}
"""Other names, as Font Awesome has them, for icons that Tabler calls differently."""

Rgb = tuple[int, int, int]
"""Red, green, blue, each 0 to 255."""


@functools.lru_cache(maxsize=1)
def icon_names() -> frozenset[str]:
    """All names that there are pictures for, besides the aliases."""
    with _archive() as archive:
        return frozenset(name.removesuffix(".svg") for name in archive.namelist())


def known_icon(name: str) -> str | None:
    """The icon that a name means, None for one that nothing is known of."""
    plain = name.strip().lower().replace("_", "-").replace(" ", "-").removeprefix("fa-")
    plain = ALIASES.get(plain, plain)
    return plain if plain in icon_names() else None


@functools.lru_cache(maxsize=256)
def icon_svg(name: str) -> str | None:
    """Return an icon whose lines are `currentColor`, None for an unknown name."""
    known = known_icon(name)
    if known is None:
        return None
    with _archive() as archive:
        return archive.read(f"{known}.svg").decode()


@functools.lru_cache(maxsize=256)
def icon_png(name: str, colour: Rgb, px: int = 128, opacity: float = 1.0) -> bytes:
    """Draw an icon as a square PNG, clear around its lines; a question mark for an unknown name.

    Args:
        name: see `known_icon`.
        colour: of the lines.
        px: the length of its side, at most 512.
        opacity: 0 to 1.
    """
    svg = icon_svg(name) or icon_svg(UNKNOWN_ICON) or ""
    hex_colour = "#{:02x}{:02x}{:02x}".format(*(min(max(part, 0), 255) for part in colour))
    svg = svg.replace("currentColor", hex_colour)
    svg = svg.replace('stroke-width="2"', f'stroke-width="{STROKE}"')
    svg = svg.replace("<svg ", f'<svg opacity="{min(max(opacity, 0.0), 1.0):.3f}" ', 1)
    side = min(max(px, 8), MAX_PX)
    return resvg_py.svg_to_bytes(svg_string=svg, width=side, height=side, skip_system_fonts=True)


@functools.lru_cache(maxsize=256)
def icon_image(name: str, colour: Rgb, px: int = 128, opacity: float = 1.0) -> NDArray[np.uint8]:
    """Draw an icon as a read-only picture (px, px, 4), row 0 at the top; see `icon_png`."""
    with Image.open(io.BytesIO(icon_png(name, colour, px, opacity))) as picture:
        pixels = np.array(picture.convert("RGBA"), dtype=np.uint8)
    pixels.setflags(write=False)
    return pixels


def _archive() -> zipfile.ZipFile:
    # viser's own reader of it caches 32 icons only and hands out no list of them.
    path = resources.files("viser").joinpath("_icons/tabler-icons.zip")
    return zipfile.ZipFile(io.BytesIO(path.read_bytes()))
