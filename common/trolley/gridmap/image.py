"""The image half of a ROS map: what the shade of a pixel says about its cell.

A pixel is the whole number `sum of its channels`, between 0 and `full`; one table per image says
which cell value each number means.
"""

import math
import warnings
import zlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from trolley.files import open_file
from trolley.gridmap.description import MapDescription, MapError
from trolley.gridmap.grid import FREE, OCCUPIED, UNKNOWN

if TYPE_CHECKING:
    from PIL.Image import Image as PillowImage

# A map message may hold 32 MiB; a little of it is not cells.
MAX_CELLS = 32 * 1024 * 1024 - 4096
# What ROS's tools read; Pillow knows many more, each one more way to be attacked.
_FORMATS = ("PPM", "PNG", "BMP", "JPEG")
_REMEDY = "give a PGM or PNG image, 8 bits per pixel"


def read_cells(file: Path, description: MapDescription) -> NDArray[np.int8]:
    """Read an image as cells (rows, cols) int8, row 0 at the bottom.

    Raises:
        MapError: the image is missing, too large, damaged or of an unknown kind.
    """
    from PIL import Image, UnidentifiedImageError

    too_large = (Image.DecompressionBombError, Image.DecompressionBombWarning)
    try:
        with open_file(file) as stream:
            with warnings.catch_warnings():
                warnings.simplefilter("error", Image.DecompressionBombWarning)
                image = Image.open(stream, formats=_FORMATS)
            with image:
                _check_size(file, image.width, image.height)
                return _decode(image, description)[::-1].copy()
    except FileNotFoundError as error:
        raise MapError(
            file, "there is no such image", "check 'image:' in the YAML file beside it"
        ) from error
    except UnidentifiedImageError as error:
        raise MapError(file, "it is not an image that can be read", _REMEDY) from error
    except too_large as error:
        raise MapError(file, "the image is too large", _size_remedy()) from error
    except (OSError, SyntaxError, ValueError, EOFError, OverflowError, zlib.error) as error:
        if isinstance(error, OSError) and error.strerror:  # not of Pillow: the file itself
            remedy = "check 'image:' in the YAML file beside it, and who may read it"
            raise MapError(file, f"it cannot be read ({error.strerror})", remedy) from error
        raise MapError(file, f"the image is damaged or cut short ({error})", _REMEDY) from error


def decode_table(description: MapDescription, full: int) -> NDArray[np.int8]:
    """Return the cell value that each pixel 0...full stands for, (full + 1,) int8.

    With `shade` = pixel / full and `p` = 1 - shade (`shade` itself with negate):

    - trinary: p > occupied_thresh 100, p < free_thresh 0, else -1.
    - scale: the same at both ends, and between them
      round(100 (p - free_thresh) / (occupied_thresh - free_thresh)).
    - raw: round(255 shade) as it is if at most 100, else -1; negate has no effect.

    Source:
        Nav2, `nav2_map_server/src/map_io.cpp`, loadMapFromFile.
    """
    pixels = np.arange(full + 1, dtype=np.float64)
    if description.mode == "raw":
        values = np.floor(255.0 * pixels / full + 0.5)
        return np.where(values <= OCCUPIED, values, UNKNOWN).astype(np.int8)
    p = pixels / full if description.negate else (full - pixels) / full
    free, occupied = description.free_thresh, description.occupied_thresh
    between = np.full_like(p, UNKNOWN)
    if description.mode == "scale":
        between = np.rint(100.0 * (p - free) / (occupied - free))
    values = np.where(p > occupied, OCCUPIED, np.where(p < free, FREE, between))
    return values.astype(np.int8)


def encode_table(description: MapDescription) -> dict[int, int]:
    """Return an 8-bit pixel for each cell value that the description can tell, -1 included.

    Free, occupied and unknown get the pixels that ROS's tools write where these mean the same
    here, every other value the middle of the pixels that stand for it.
    """
    table = decode_table(description, 255)
    usual = {FREE: 254, OCCUPIED: 0, UNKNOWN: 205}
    if description.negate:
        usual = {value: 255 - pixel for value, pixel in usual.items()}
    if description.mode == "raw":
        usual = {UNKNOWN: 255}
    pixels: dict[int, int] = {}
    for value in np.unique(table).tolist():
        candidates = np.flatnonzero(table == value)
        pixel = usual.get(value, -1)
        pixels[value] = pixel if pixel in candidates else int(candidates[len(candidates) // 2])
    return pixels


def encode_image(cells: NDArray[np.int8], description: MapDescription) -> "PillowImage":
    """Draw cells (rows, cols) as an image of mode L, or LA where only alpha can say unknown.

    Raises:
        ValueError: a cell's value cannot be told in this mode with these thresholds.
    """
    from PIL import Image

    pixels = encode_table(description)
    transparent = description.mode == "scale" and bool((cells == UNKNOWN).any())
    if transparent:
        pixels[UNKNOWN] = 0
    table = np.zeros(256, dtype=np.uint8)
    for value in np.unique(cells).tolist():
        if value not in pixels:
            raise ValueError(
                f"a cell value of {value} cannot be written in mode {description.mode}"
            )
        table[value % 256] = pixels[value]
    grey = table[cells[::-1].view(np.uint8)]
    if not transparent:
        return Image.fromarray(grey)
    alpha = np.where(cells[::-1] == UNKNOWN, 0, 255).astype(np.uint8)
    return Image.fromarray(np.stack([grey, alpha], axis=-1))


def _size_remedy() -> str:
    side = math.isqrt(MAX_CELLS)
    return f"at most {MAX_CELLS} pixels fit a message (about {side} x {side}): crop or coarsen it"


def _check_size(file: Path, width: int, height: int) -> None:
    if width < 1 or height < 1:
        raise MapError(file, "the image is empty", _REMEDY)
    if width * height > MAX_CELLS:
        raise MapError(file, f"{width} x {height} pixels are too many", _size_remedy())


def _decode(image: "PillowImage", description: MapDescription) -> NDArray[np.int8]:
    """Return the cells of an open image, top row first."""
    if image.mode.startswith("I"):  # 16 bits a pixel
        deep = np.clip(np.asarray(image), 0, 65535).astype(np.uint16)
        return decode_table(description, 65535)[deep]
    if "transparency" in image.info or image.mode in ("LA", "PA", "La", "RGBa"):
        image = image.convert("RGBA")
    elif image.mode not in ("L", "RGB", "RGBA"):
        image = image.convert("L" if image.mode == "1" else "RGB")
    channels: NDArray[Any] = np.asarray(image)
    if channels.ndim == 2:
        return decode_table(description, 255)[channels]
    # In trinary mode map_server takes alpha for one more colour; elsewhere it leaves it out.
    num_colours = channels.shape[2] if description.mode == "trinary" else 3
    sums = channels[..., :num_colours].sum(axis=-1, dtype=np.uint16)
    cells = decode_table(description, 255 * num_colours)[sums]
    if description.mode == "scale" and channels.shape[2] == 4:
        cells[channels[..., 3] != 255] = UNKNOWN
    return cells
