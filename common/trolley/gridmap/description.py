"""The YAML half of a ROS map: which image, how large a cell is, where it lies, how to read it.

Source:
    ROS `map_server`, section "YAML format" (wiki.ros.org/map_server), and Nav2's
    `nav2_map_server/src/map_io.cpp`, which is followed where the two differ.
"""

import math
import re
import reprlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, cast

from trolley.files import read_file
from trolley.geometry import Pose2D, angle_problem, wrap_angle
from trolley.messages.mapping import MAX_COORDINATE_M

Mode = Literal["trinary", "scale", "raw"]
MODES: tuple[Mode, ...] = ("trinary", "scale", "raw")

# The thresholds that ROS's tools write: a pixel of 205 (unknown) lies just between them.
OCCUPIED_THRESH = 0.65
FREE_THRESH = 0.196

# A description is a dozen lines; a larger file is something else.
_MAX_BYTES = 64 * 1024
# Half of a character pair, which YAML writes as "\ud800", can name no file and be in no message.
_NO_NAME = re.compile("[\0\ud800-\udfff]")
_EXAMPLES = {
    "image": "image: map.pgm",
    "resolution": "resolution: 0.05",
    "origin": "origin: [-5.0, -3.0, 0.0]",
    "negate": "negate: 0",
    "occupied_thresh": f"occupied_thresh: {OCCUPIED_THRESH}",
    "free_thresh": f"free_thresh: {FREE_THRESH}",
}


class MapError(Exception):
    """A map cannot be read or written.

    The text names the file, says what is wrong with it and what to do about it.
    """

    def __init__(self, file: Path, problem: str, remedy: str) -> None:
        super().__init__(f"map {file}: {problem}; {remedy}")
        self.file = file
        self.problem = problem
        self.remedy = remedy


@dataclass(frozen=True, slots=True)
class MapDescription:
    """What a map's YAML file says.

    Attributes:
        image: path of the image, as written: absolute, or relative to the YAML file.
        resolution: edge of a pixel [m].
        origin: `map_T_grid`, the outer corner of the lower left pixel.
        negate: whether white is occupied instead of black.
        occupied_thresh: darkness 0...1 above which a pixel is occupied.
        free_thresh: darkness 0...1 below which a pixel is free.
        mode: `trinary`, `scale` or `raw`, see `trolley.gridmap.image.decode_table`.
    """

    image: str
    resolution: float
    origin: Pose2D
    negate: bool = False
    occupied_thresh: float = OCCUPIED_THRESH
    free_thresh: float = FREE_THRESH
    mode: Mode = "trinary"


def read_description(file: Path) -> MapDescription:
    """Read a map's YAML file. Keys that are not part of the format are ignored, as ROS does.

    Raises:
        MapError: the file cannot be read, is not YAML, or a key is missing or wrong.
    """
    keys = _load_yaml(file)
    for key, example in _EXAMPLES.items():
        if keys.get(key) is None:
            raise MapError(file, f"the key '{key}' is missing", f"add a line like '{example}'")
    mode = keys.get("mode", "trinary")
    if mode not in MODES:
        raise MapError(
            file, f"the mode {_shown(mode)} is unknown", f"use one of {', '.join(MODES)}"
        )
    resolution = _number(file, keys, "resolution")
    if not 0.001 <= resolution <= 1.0:
        raise MapError(
            file, f"a resolution of {resolution:g} m per pixel is not usable", "0.05 is usual"
        )
    free_thresh = _number(file, keys, "free_thresh")
    occupied_thresh = _number(file, keys, "occupied_thresh")
    if not 0.0 <= free_thresh < occupied_thresh <= 1.0:
        raise MapError(
            file,
            f"the thresholds are out of order (free {free_thresh:g}, occupied {occupied_thresh:g})",
            f"0 <= free_thresh < occupied_thresh <= 1 is needed; usual are {FREE_THRESH} and "
            f"{OCCUPIED_THRESH}",
        )
    return MapDescription(
        image=_image(file, keys["image"]),
        resolution=resolution,
        origin=_origin(file, keys["origin"]),
        negate=_negate(file, keys["negate"]),
        occupied_thresh=occupied_thresh,
        free_thresh=free_thresh,
        mode=mode,
    )


def render_description(description: MapDescription) -> str:
    """Return a map's YAML file as text."""
    import yaml

    origin = description.origin
    keys = {
        "image": description.image,
        "mode": description.mode,
        "resolution": float(description.resolution),
        "origin": [float(origin.x), float(origin.y), float(origin.yaw)],
        "negate": int(description.negate),
        "occupied_thresh": float(description.occupied_thresh),
        "free_thresh": float(description.free_thresh),
    }
    return yaml.safe_dump(keys, sort_keys=False, default_flow_style=None, allow_unicode=True)


def parse_yaml(content: bytes) -> object:
    """Return what a YAML file holds.

    Raises:
        yaml.YAMLError: it is not YAML, or full of references.
        ValueError: it is not text (`UnicodeError`), or a value is not what it is marked as.
        RecursionError: it is nested too deeply.
    """
    import yaml

    from trolley.yaml_loader import FewReferencesLoader

    try:
        return yaml.load(content, FewReferencesLoader)
    except UnicodeError:
        raise
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
        # PyYAML lets all of these through: `2001-99-99`, `!!int ""`, `!!bool maybe`.
        raise ValueError("a value is not what it is marked as") from error


def _load_yaml(file: Path) -> dict[str, Any]:
    """Return the top-level keys of a YAML file."""
    import yaml

    remedy = "give the .yaml file that lies beside the image, as map_saver writes it"
    try:
        if file.stat().st_size > _MAX_BYTES:
            raise MapError(file, "it is too large for a map's description", remedy)
        document = parse_yaml(read_file(file))
    except OSError as error:
        raise MapError(file, f"it cannot be read ({error.strerror})", remedy) from error
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        where = getattr(error, "problem_mark", None)
        line = f" at line {where.line + 1}" if where is not None else ""
        is_text = not isinstance(error, yaml.YAMLError | UnicodeError)
        reason = getattr(error, "problem", None) or (str(error) if is_text else "not text")
        raise MapError(file, f"it is not valid YAML{line} ({reason})", remedy) from error
    if not isinstance(document, dict):
        raise MapError(file, "it holds no 'key: value' lines", remedy)
    return {
        key: value
        for key, value in cast("dict[object, Any]", document).items()
        if isinstance(key, str)
    }


def _shown(value: object) -> str:
    """Return a value for a message, cut short: what YAML repeats by reference is endless."""
    try:
        return f"{reprlib.repr(value):.60}"
    except ValueError:  # Python writes no whole number of more than 4300 digits
        return "a number of thousands of digits"


def _as_float(value: object) -> float | None:
    """Return a finite number, also one that YAML took for text ('5e-2'), else None."""
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        return None
    try:
        number = float(value)
    except (ValueError, OverflowError):
        return None
    return number if math.isfinite(number) else None


def _number(file: Path, keys: dict[str, Any], key: str) -> float:
    number = _as_float(keys[key])
    if number is None:
        raise MapError(
            file, f"'{key}' is not a number ({_shown(keys[key])})", f"write '{_EXAMPLES[key]}'"
        )
    return number


def _image(file: Path, value: object) -> str:
    if not isinstance(value, str) or not value.strip() or _NO_NAME.search(value):
        raise MapError(file, "'image' is not a file name", f"write '{_EXAMPLES['image']}'")
    return value.strip()


def _origin(file: Path, value: object) -> Pose2D:
    items = cast("list[object]", value) if isinstance(value, list) else []
    numbers = [number for item in items if (number := _as_float(item)) is not None]
    if len(items) != 3 or len(numbers) != 3:
        raise MapError(
            file,
            f"'origin' must be a list of three numbers x, y, yaw, not {_shown(value)}",
            f"write '{_EXAMPLES['origin']}'",
        )
    if max(abs(numbers[0]), abs(numbers[1])) > MAX_COORDINATE_M:
        raise MapError(
            file,
            f"the origin lies too far away ({_shown(value)})",
            f"use coordinates of at most {MAX_COORDINATE_M:.0f} m",
        )
    if problem := angle_problem(numbers[2]):
        raise MapError(file, f"the yaw of 'origin' {problem}", f"write '{_EXAMPLES['origin']}'")
    return Pose2D(numbers[0], numbers[1], wrap_angle(numbers[2]))


def _negate(file: Path, value: object) -> bool:
    # Numbers and words, bare or quoted: Nav2 takes an int first and a bool second.
    word = value.strip().lower() if isinstance(value, str) else value
    if word in (1, "1", "true", "yes", "on"):
        return True
    if word in (0, "0", "false", "no", "off"):
        return False
    raise MapError(file, f"'negate' must be 0 or 1, not {_shown(value)}", "write 'negate: 0'")
