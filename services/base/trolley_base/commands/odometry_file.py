"""`[base.odometry]` in a robot.toml: what is in force, and setting it without touching the rest."""

from collections.abc import Mapping
from pathlib import Path

from trolley.config.robot_toml import read_text, replace_text, with_values
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
    values = {(*TABLE, name): value for name, value in settings.items()}
    replace_text(path, with_values(read_text(path), values, {}, ""))
