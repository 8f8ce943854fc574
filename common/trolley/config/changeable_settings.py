"""Settings that are changed while the robot runs: which may be, when they count, and by what rules.

`base` answers `config/get` and `config/set`. What counts at once is on the stream `config`, from
which each service takes what is its own (`with_changes`).
"""

import functools
import tomllib
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple, cast

import msgspec

from trolley.config.describe import Key, sections
from trolley.config.load import ConfigError, RobotConfig
from trolley.invalid import in_words_of_a_file
from trolley.messages import ChangedSetting, Setting
from trolley.messages.settings import Acts, Source

Values = Mapping[str, Any]
"""Settings of one section by their keys; None: back to the default."""

AT_ONCE: Mapping[str, frozenset[str]] = {
    section: frozenset(keys.split())
    for section, keys in {
        "base.limits": "max_speed_mps max_wz_radps acceleration_mps2",
        "localizer": """
            update_distance_m update_turn_rad num_beams lost_after_s max_spread_m search_again_s""",
        "planner": """
            turn_to_find max_speed_mps max_turn_radps acceleration_mps2 angular_acceleration_radps2
            slow_speed_mps unsure_speed_mps caution_distance_m clearance_m unknown_is_free
            inflation_falloff_m inflation_height odom_size_m odom_resolution_m mark_range_m
            clear_range_m mirror_tolerance_m fade_s fade_per_sighting_s fade_max_s controller
            control_rate_hz horizon_s rollouts replan_s progress_distance_m progress_s patience_s
            back_up_m give_up_s""",
        "tour": "stop_timeout_s retry_wait_s low_battery",
    }.items()
}
"""The settings that count at once. Their services take them from the stream `config`."""

AFTER_RESTART: Mapping[str, frozenset[str]] = {
    section: frozenset(keys.split())
    for section, keys in {
        "start": "pose always",
        "localizer": """
            min_particles max_particles kld_error kld_quantile alpha1 alpha2 alpha3 alpha4 slip_m
            slip_rad refine_beams max_range_m sigma_hit_m good_support poor_support z_rand
            independent_beams explained_within_m through_margin_m search_margin propose_changes
            change_after_s""",
        "mapper": """
            resolution_m max_range_m keyframe_distance_m keyframe_turn_rad local_way_m local_reach_m
            local_keyframes keyframes_per_place drift_share lost_after_s explore_radius_m
            explore_area_m2""",
    }.items()
}
"""The settings that may be set over the wire and count after a restart of their service.

All others say what the robot is, what it can surely do, what the stop field reckons with, who may
drive it, or who may reach it: nobody who may only drive it changes those.
"""

LIMITS = "base.limits"
"""What people wrote there for the robot holds: over the wire it is lowered, never raised."""

DEFAULT = "default"
"""What people type for what a setting is without a line in the file."""

_SERVICES = {"start": "localizer"}
_SHARED = ("map", "robot", "zenoh")
_UNITS = {
    "mps": "m/s",
    "mps2": "m/s²",
    "radps": "rad/s",
    "radps2": "rad/s²",
    "m": "m",
    "m2": "m²",
    "rad": "rad",
    "deg": "°",
    "s": "s",
    "hz": "Hz",
    "v": "V",
    "days": "days",
}


class Name(NamedTuple):
    """Which setting."""

    section: str
    key: str

    def __str__(self) -> str:
        return f"[{self.section}] {self.key}"


def acts(name: Name) -> Acts:
    """When a change of a setting counts."""
    if name.key in AT_ONCE.get(name.section, ()):
        return "at_once"
    return "restart" if name.key in AFTER_RESTART.get(name.section, ()) else "file"


def service_of(section: str) -> str:
    """The service that reads a section, "" where several do."""
    first = section.partition(".")[0]
    return "" if first in _SHARED else _SERVICES.get(first, first)


@functools.cache
def all_keys() -> Mapping[Name, Key]:
    """All settings, in the order of the file."""
    return {Name(one.name, key.name): key for one in sections() for key in one.keys}


def value_of(config: RobotConfig, name: Name) -> Any:
    """What a setting is, in plain values; None where it is not given."""
    table: Any = config
    for part in (*name.section.split("."), name.key):
        if table is None:
            return None
        table = getattr(table, part)
    return msgspec.to_builtins(table)


def with_values(config: RobotConfig, section: str, values: Values) -> RobotConfig:
    """Settings with some of one section changed, checked as when the file is read.

    Raises:
        ConfigError: A key is unknown, or a value is not allowed; the text names it.
    """
    plain = cast("dict[str, Any]", msgspec.to_builtins(config))
    table = plain
    for part in section.split("."):
        found = table.get(part)
        table[part] = table = cast("dict[str, Any]", found if isinstance(found, dict) else {})
    for key, value in values.items():
        if value is None:
            table.pop(key, None)
        else:
            table[key] = value
    try:
        return msgspec.convert(plain, type=RobotConfig)
    except msgspec.ValidationError as error:
        raise ConfigError(in_words_of_a_file(str(error), RobotConfig)) from error


def with_changes(
    config: RobotConfig, changes: Iterable[ChangedSetting]
) -> tuple[RobotConfig, list[Name]]:
    """What a service runs with: its file, and what was set since.

    Returns:
        The settings, and those changes that this Trolley does not understand and leaves out.
    """
    left_out: list[Name] = []
    for change in changes:
        name = Name(change.section, change.key)
        if acts(name) != "at_once":
            left_out.append(name)
            continue
        try:
            config = with_values(config, name.section, {name.key: change.value})
        except ConfigError:
            left_out.append(name)
    return config, left_out


def parse_value(text: str) -> Any:
    """Read a value that a person typed: as TOML writes it, else a bare word as itself.

    Returns:
        The value, None for `default`.
    """
    if text == DEFAULT:
        return None
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except (ValueError, RecursionError):
        return text


def describe(
    name: Name,
    config: RobotConfig,
    after: RobotConfig,
    *,
    is_saved: bool,
    is_kept: bool = False,
) -> Setting:
    """A setting in words.

    Args:
        name: which.
        config: what the robot runs with.
        after: what it will run with after a restart.
        is_saved: whether a file says so.
        is_kept: whether that is the one in the state folder.
    """
    key = all_keys()[name]
    source: Source = "robot_toml"
    if not is_saved:
        source = "not_saved"
    elif is_kept:
        source = "settings_toml"
    elif value_of(after, name) == key.plain_default:
        source = "default"
    return Setting(
        section=name.section,
        key=name.key,
        value=value_of(config, name),
        next=value_of(after, name),
        default=key.plain_default,
        meaning=key.meaning,
        allowed=key.allowed.replace("`", ""),
        unit=_UNITS.get(name.key.rpartition("_")[2], "") if "_" in name.key else "",
        least=key.least,
        greatest=key.greatest,
        choices=list(key.choices),
        acts=acts(name),
        service=service_of(name.section),
        saved=is_saved,
        source=source,
    )
