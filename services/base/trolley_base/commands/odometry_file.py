"""`[base.odometry]` in a robot.toml: what is in force, and setting it without touching the rest."""

import re
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import tomlkit
from tomlkit.exceptions import TOMLKitError

from trolley.config import ConfigError, load_config
from trolley.files import write_atomically
from trolley_base.wheel_scales import WheelScales

DIGITS = 4


def settings_of(scales: WheelScales, *, with_track: bool) -> dict[str, float]:
    """Return what is to stand in `[base.odometry]`."""
    settings = {
        "linear_scale": scales.linear,
        "angular_scale": scales.angular,
        "wheel_ratio": scales.wheel_ratio,
    }
    if with_track and scales.track_m is not None:
        settings["track_m"] = scales.track_m
    return {name: round(value, DIGITS) for name, value in settings.items()}


def as_toml(settings: Mapping[str, float]) -> str:
    """Return the table as it stands in the file."""
    return "\n".join(
        ["[base.odometry]", *(f"{name} = {value}" for name, value in settings.items())]
    )


def write_settings(path: Path, settings: Mapping[str, float]) -> None:
    """Set `[base.odometry]` in a file; comments and everything else stay as they are.

    Raises:
        ConfigError: the file cannot be read or written, or would not be a valid robot.toml.
    """
    path = path.resolve()  # of a link the target is replaced
    try:
        document: Any = tomlkit.parse(_with_places(path.read_text(encoding="utf-8"), settings))
        table: Any = document
        for name in ("base", "odometry"):
            if name not in table:
                table[name] = tomlkit.table(is_super_table=name == "base")
            table = table[name]
        for name, value in settings.items():
            table[name] = value
        content = tomlkit.dumps(document).encode("utf-8")  # pyright: ignore[reportUnknownMemberType]
        _refuse_invalid(path, content)
        write_atomically(path, content)
    except (OSError, UnicodeDecodeError, TOMLKitError, TypeError) as error:
        raise ConfigError(f"{path}: [base.odometry] cannot be set there: {error}") from error


def _with_places(text: str, settings: Mapping[str, float]) -> str:
    """Take the `#` from settings that stand as comments in the table, as `trolley init` writes.

    A key that is new to the table would come behind all its comments.
    """
    head, title, rest = text.partition("\n[base.odometry]")
    body, following, tail = rest.partition("\n[")
    for name, value in settings.items():
        if not re.search(rf"(?m)^\s*{name}\s*=", body):
            body = re.sub(rf"(?m)^# {name} =.*$", f"{name} = {value}", body, count=1)
    return head + title + body + following + tail


def _refuse_invalid(path: Path, content: bytes) -> None:
    """Load the new text from a file beside the old one, where its relative names hold."""
    with tempfile.NamedTemporaryFile(prefix=f".{path.name}.", dir=path.parent) as trial:
        trial.write(content)
        trial.flush()
        load_config(Path(trial.name))
