"""What was measured, set in a robot.toml without touching the rest."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from trolley.config.robot_toml import Values, read_text, replace_text, with_values
from trolley_base.odometry.wheel_scales import WheelScales

TABLE = ("base", "odometry")
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
    _write(path, {(*TABLE, name): value for name, value in settings.items()})


def write_proposed(path: Path, settings: Mapping[str, float]) -> None:
    """Set what is proposed, by full names such as `base.odometry.linear_scale`.

    Raises:
        ConfigError: as `write_settings`.
    """
    values: dict[tuple[str, ...], Any] = {}
    for name, value in settings.items():
        *table, key = name.split(".")
        if table[-1] == "pose":  # a pose is one value, which the file may say by a quaternion
            values.setdefault(tuple(table), {})[key] = value
        else:
            values[(*table, key)] = value
    _write(path, values)


def _write(path: Path, values: Values) -> None:
    replace_text(path, with_values(read_text(path), values))
