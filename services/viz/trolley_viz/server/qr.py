"""Links as QR codes, for a page and for a terminal."""

import segno

QUIET = 4
"""Light modules around the code, as ISO/IEC 18004 asks for."""
BLOCKS = " ▄▀█"
"""Two modules of a column in one letter; by 2 for a dark upper and 1 for a dark lower one."""


def qr_image(text: str) -> str:
    """Draw a QR code, as the address of an image that is the image itself."""
    code = segno.make(text, error="m", micro=False)
    return code.svg_data_uri(border=QUIET, light="#fff", dark="#000", omitsize=True)


def qr_lines(text: str) -> list[str]:
    """Draw a QR code with blocks, each half a letter high, to be shown dark on light."""
    code = segno.make(text, error="l", micro=False)
    rows = [list(row) for row in code.matrix_iter(border=QUIET)]
    if len(rows) % 2:
        rows.append([0] * len(rows[0]))
    return [
        "".join(BLOCKS[2 * upper + lower] for upper, lower in zip(*pair, strict=True))
        for pair in zip(rows[::2], rows[1::2], strict=True)
    ]
