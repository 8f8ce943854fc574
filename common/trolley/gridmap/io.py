"""Reading and writing maps as ROS's `map_server` does: a YAML file and an image."""

import io
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from trolley.files import write_atomically
from trolley.gridmap.description import (
    FREE_THRESH,
    OCCUPIED_THRESH,
    MapDescription,
    MapError,
    Mode,
    read_description,
    render_description,
)
from trolley.gridmap.grid import FREE, OCCUPIED, UNKNOWN, GridMap
from trolley.gridmap.image import MAX_CELLS, encode_image, read_cells

ImageFormat = Literal["pgm", "png"]

__all__ = [
    "MAX_CELLS",
    "ImageFormat",
    "MapError",
    "MapFiles",
    "Mode",
    "load_map",
    "render_map",
    "save_map",
]


def load_map(path: str | Path, name: str | None = None) -> GridMap:
    """Read a map from its YAML file.

    Args:
        path: the YAML file.
        name: what to call the map; by default the file's stem.

    Returns:
        The map; the image's bottom row is row 0 of its cells.

    Raises:
        MapError: with the file, what is wrong and what to do.
    """
    file = Path(path)
    description = read_description(file)
    cells = read_cells(file.parent / description.image, description)
    return GridMap(name or file.stem, description.resolution, description.origin, cells)


@dataclass(frozen=True, slots=True)
class MapFiles:
    """The two files of a map, as they are to be written."""

    image: str
    """Name of the image, as the YAML file has it."""
    image_bytes: bytes
    yaml: str


def save_map(
    grid: GridMap,
    path: str | Path,
    mode: Mode | None = None,
    image_format: ImageFormat | None = None,
    negate: bool = False,
    thresholds: tuple[float, float] = (FREE_THRESH, OCCUPIED_THRESH),
) -> Path:
    """Write a map so that reading it gives the same cells, resolution and origin.

    Each of the two files is complete or not there at all, whenever the power fails.

    Args:
        grid: the map.
        path: the YAML file; the image goes beside it under the same stem.
        mode: by default `trinary` where all cells are 0, 100 or -1, else `scale`.
        image_format: by default `pgm`, or `png` in mode `scale`.
        negate: whether white means occupied.
        thresholds: `free_thresh` and `occupied_thresh`; `scale` tells values apart only
            where they are at least 0.4 apart.

    Returns:
        The path of the image.

    Raises:
        MapError: the files cannot be written, or the mode or format cannot hold the cells.
    """
    file = Path(path)
    try:
        files = render_map(grid, file.stem, mode, image_format, negate, thresholds)
    except ValueError as error:
        raise MapError(file, *error.args) from error
    image_file = file.with_name(files.image)
    try:  # the image first: a YAML file never names an image that is not there
        write_atomically(image_file, files.image_bytes)
        write_atomically(file, files.yaml.encode())
    except OSError as error:
        raise MapError(
            file, f"it cannot be written ({error.strerror})", "check the folder and its rights"
        ) from error
    return image_file


def render_map(
    grid: GridMap,
    stem: str,
    mode: Mode | None = None,
    image_format: ImageFormat | None = None,
    negate: bool = False,
    thresholds: tuple[float, float] = (FREE_THRESH, OCCUPIED_THRESH),
) -> MapFiles:
    """Return what `save_map` writes.

    Args:
        grid: the map.
        stem: name of the image without its suffix; the others are those of `save_map`.
        mode: see there.
        image_format: see there.
        negate: see there.
        thresholds: see there.

    Raises:
        ValueError: what is wrong and what to do, two texts: the mode or format cannot hold the
            cells.
    """
    if mode is None:
        mode = "trinary" if np.isin(grid.cells, (FREE, OCCUPIED, UNKNOWN)).all() else "scale"
    suffix = image_format or ("png" if mode == "scale" else "pgm")
    free_thresh, occupied_thresh = thresholds
    description = MapDescription(
        image=f"{stem}.{suffix}",
        resolution=grid.resolution,
        origin=grid.origin,
        negate=negate,
        occupied_thresh=occupied_thresh,
        free_thresh=free_thresh,
        mode=mode,
    )
    try:
        image = encode_image(grid.cells, description)
    except ValueError as error:
        raise ValueError(str(error), "write it in mode scale or raw") from error
    if image.mode == "LA" and suffix == "pgm":
        raise ValueError(
            "a PGM image cannot say unknown in mode scale", "write it as png or in mode raw"
        )
    content = io.BytesIO()
    image.save(content, format="PNG" if suffix == "png" else "PPM")
    return MapFiles(description.image, content.getvalue(), render_description(description))
