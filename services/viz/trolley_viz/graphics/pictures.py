"""Pictures for the scene: grids with row 0 at the top (+y), icons on discs, numbered pins."""

import functools

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from trolley_viz.graphics.icons import icon_image

MAX_SIDE = 2048

FLOOR = (255, 254, 250)
WALL = (58, 66, 80)
UNKNOWN = (176, 183, 194)

PIN_HEIGHT_PX = 96
MAX_PIN_TEXT = 8
_PIN_RIM_PX = 6
_PIN_FONT_PX = 64
_WHITE = (255, 255, 255, 255)


def map_picture(cells: NDArray[np.int8]) -> tuple[NDArray[np.uint8], int]:
    """Colour a map: floor light, walls dark, unknown grey.

    Args:
        cells: (rows, cols) 0 free ... 100 occupied, -1 unknown; row 0 at the bottom.

    Returns:
        The picture (h, w, 3), and how many cells make one of its pixels where the map is too large
        to send whole (its size is then padded to a multiple).
    """
    small, factor = shrink(cells)
    table = np.empty((256, 3), np.uint8)
    table[:] = UNKNOWN
    share = np.linspace(0.0, 1.0, 101)[:, None]
    table[:101] = np.rint((1.0 - share) * np.array(FLOOR) + share * np.array(WALL))
    return table[np.ascontiguousarray(small[::-1]).view(np.uint8)], factor


def costmap_picture(cells: NDArray[np.int8]) -> tuple[NDArray[np.uint8], int]:
    """Colour a costmap: clear where it costs nothing, red where the robot must not be.

    Args and returns as `map_picture`, with a fourth channel; 100 forbidden, 99 inscribed.
    """
    small, factor = shrink(cells)
    table = np.zeros((256, 4), np.uint8)
    share = np.linspace(0.0, 1.0, 99)
    table[:99, 0] = np.rint(90 + 140 * share)
    table[:99, 1] = np.rint(120 - 60 * share)
    table[:99, 2] = np.rint(230 - 130 * share)
    table[1:99, 3] = np.rint(20 + 110 * share[1:])
    table[99] = (236, 72, 90, 150)
    table[100] = (190, 20, 70, 190)
    return table[np.ascontiguousarray(small[::-1]).view(np.uint8)], factor


def shrink(cells: NDArray[np.int8], max_side: int = MAX_SIDE) -> tuple[NDArray[np.int8], int]:
    """Join cells to blocks until the grid is small enough; a block is as bad as its worst cell."""
    factor = -(-max(cells.shape) // max_side)
    if factor <= 1:
        return cells, 1
    rows, cols = (-(-side // factor) * factor for side in cells.shape)
    padded = np.full((rows, cols), -1, np.int8)
    padded[: cells.shape[0], : cells.shape[1]] = cells
    blocks = padded.reshape(rows // factor, factor, cols // factor, factor)
    return blocks.max(axis=(1, 3)), factor


def badge(icon: str, colour: tuple[int, int, int], side: int = 128) -> NDArray[np.uint8]:
    """Draw an icon in white on a disc, clear around it: a picture (side, side, 4)."""
    middle, radius = 0.5 * (side - 1), 0.5 * side - 1.0
    rows, cols = np.indices((side, side))
    inside = np.clip(radius - np.hypot(rows - middle, cols - middle), 0.0, 1.0)
    picture = np.empty((side, side, 4), np.uint8)
    picture[..., :3] = colour
    picture[..., 3] = np.rint(255 * inside)
    lines = icon_image(icon, (255, 255, 255), int(0.66 * side))
    edge = (side - len(lines)) // 2
    part = picture[edge : edge + len(lines), edge : edge + len(lines), :3]
    share = lines[..., 3:] / 255.0
    part[:] = np.rint(share * lines[..., :3] + (1.0 - share) * part)
    return picture


@functools.lru_cache(maxsize=128)
def pin_picture(text: str, colour: tuple[int, int, int]) -> NDArray[np.uint8]:
    """Draw a pin (96, w, 4): a disc, wider where the text needs more room; read-only.

    Args:
        text: a number, or several; of a long text the beginning is shown. (The font knows letters
            and digits, and few signs.)
        colour: of the disc, each part 0 to 255.
    """
    shown = text if len(text) <= MAX_PIN_TEXT else text[: MAX_PIN_TEXT - 1] + "+"
    font = ImageFont.load_default(_PIN_FONT_PX)
    width = max(PIN_HEIGHT_PX, round(font.getlength(shown)) + PIN_HEIGHT_PX // 2)
    picture = Image.new("RGBA", (width, PIN_HEIGHT_PX), (0, 0, 0, 0))
    draw = ImageDraw.Draw(picture)
    box = (1, 1, width - 2, PIN_HEIGHT_PX - 2)
    draw.rounded_rectangle(
        box, PIN_HEIGHT_PX // 2, fill=(*colour, 255), outline=_WHITE, width=_PIN_RIM_PX
    )
    draw.text((width / 2, PIN_HEIGHT_PX / 2), shown, fill=_WHITE, font=font, anchor="mm")
    pixels = np.array(picture)
    pixels.flags.writeable = False
    return pixels
