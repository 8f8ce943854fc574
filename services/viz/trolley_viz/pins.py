"""Numbered pins as pictures: coloured discs with a number, clear around them."""

import functools

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

HEIGHT_PX = 96
MAX_TEXT = 8
_RIM_PX = 6
_FONT_PX = 64
_WHITE = (255, 255, 255, 255)


@functools.lru_cache(maxsize=128)
def pin_picture(text: str, colour: tuple[int, int, int]) -> NDArray[np.uint8]:
    """Draw a pin (96, w, 4): a disc, wider where the text needs more room; read-only.

    Args:
        text: a number, or several; of a long text the beginning is shown. (The font knows letters
            and digits, and few signs.)
        colour: of the disc, each part 0 to 255.
    """
    shown = text if len(text) <= MAX_TEXT else text[: MAX_TEXT - 1] + "+"
    font = ImageFont.load_default(_FONT_PX)
    width = max(HEIGHT_PX, round(font.getlength(shown)) + HEIGHT_PX // 2)
    picture = Image.new("RGBA", (width, HEIGHT_PX), (0, 0, 0, 0))
    draw = ImageDraw.Draw(picture)
    box = (1, 1, width - 2, HEIGHT_PX - 2)
    draw.rounded_rectangle(box, HEIGHT_PX // 2, fill=(*colour, 255), outline=_WHITE, width=_RIM_PX)
    draw.text((width / 2, HEIGHT_PX / 2), shown, fill=_WHITE, font=font, anchor="mm")
    pixels = np.array(picture)
    pixels.flags.writeable = False
    return pixels
