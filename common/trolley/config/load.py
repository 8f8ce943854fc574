"""Reading `robot.toml`."""

import os
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

import msgspec
from msgspec import Struct

from trolley.config.base import BaseConfig
from trolley.config.hints import in_words_of_robot_toml, typed_hint
from trolley.config.localizer import LocalizerConfig
from trolley.config.mapper import MapperConfig
from trolley.config.mcp import McpConfig
from trolley.config.mqtt import MqttConfig
from trolley.config.planner import PlannerConfig
from trolley.config.robot import MapSection, RobotSection, StartSection, ZenohSection
from trolley.config.ros2 import Ros2Config
from trolley.config.tour import TourConfig
from trolley.config.viz import VizConfig
from trolley.config.webhook import WebhookConfig
from trolley.files import expand_home, read_text

DEFAULT_PATH = Path("/etc/trolley/robot.toml")


SET_ON_LOADING = ("folder", "file", "kept")
"""What a `HostConfig` knows besides what stands in the file."""


class ConfigError(Exception):
    """The configuration cannot be used; the text names file, key and what is allowed."""


class KeptSetting(Struct, frozen=True, kw_only=True):
    """A setting that counts in place of what `robot.toml` says of it."""

    section: str
    key: str
    value: Any = None
    """What was set; None: the default."""
    instead_of: Any = None
    """What `robot.toml` says; None: nothing."""


class HostConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """All of the `robot.toml` of any host: a PC or a home router has no robot of its own."""

    robot: RobotSection | None
    map: MapSection = MapSection()
    start: StartSection = StartSection()
    zenoh: ZenohSection = ZenohSection()
    base: BaseConfig = BaseConfig()
    localizer: LocalizerConfig = LocalizerConfig()
    planner: PlannerConfig = PlannerConfig()
    tour: TourConfig = TourConfig()
    viz: VizConfig = VizConfig()
    mqtt: MqttConfig = MqttConfig()
    webhook: WebhookConfig = WebhookConfig()
    mcp: McpConfig = McpConfig()
    ros2: Ros2Config = Ros2Config()
    mapper: MapperConfig = MapperConfig()
    folder: str = ""
    """Where the file lies (set on loading): paths in it are relative to this."""
    file: str = ""
    """The file itself (set on loading); "" where there is none."""
    kept: tuple[KeptSetting, ...] = ()
    """What counts from the state folder (set on loading): `kept_settings` tells how."""

    def path(self, name: str) -> Path:
        """A file named in the configuration; a relative name counts from the file's folder."""
        return Path(self.folder) / expand_home(name)


class RobotConfig(HostConfig, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """All of the `robot.toml` of a robot's host, which is what services run with."""

    robot: RobotSection

    @property
    def idle_services(self) -> frozenset[str]:
        """Services that these settings give nothing to do: `mqtt` without broker or webhook."""
        is_used = self.mqtt.broker or self.webhook.urls
        return frozenset() if is_used else frozenset({"mqtt"})


C = TypeVar("C", bound=HostConfig)


def find_config(given: Path | None, environment: Mapping[str, str] = os.environ) -> Path | None:
    """The file to use: `given`, then `TROLLEY_CONFIG`, then /etc; None if there is none."""
    if given is not None:
        return given
    if environment.get("TROLLEY_CONFIG"):
        return Path(environment["TROLLEY_CONFIG"])
    return DEFAULT_PATH if DEFAULT_PATH.exists() else None


def read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file without looking at what it says.

    Raises:
        ConfigError: It cannot be read.
    """
    text = ""
    try:
        text = read_text(path)
        if text.startswith("\ufeff"):
            raise ConfigError(
                f"{path}: begins with a byte order mark; save it as UTF-8 without one (BOM)"
            )
        return tomllib.loads(text)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        line = error.object.count(b"\n", 0, error.start) + 1
        raise ConfigError(f"{path}: line {line} is not UTF-8 text; save it as UTF-8") from error
    except RecursionError as error:
        raise ConfigError(f"{path}: is nested too deeply") from error
    except ValueError as error:  # a number of 5000 digits is a plain one
        raise ConfigError(f"{path}: is not valid TOML: {error}{typed_hint(text, error)}") from error


def load_host_config(path: Path) -> HostConfig:
    """Read and validate the `robot.toml` of a host with or without a robot.

    Returns:
        A `RobotConfig` where it has a robot.

    Raises:
        ConfigError: It cannot be read, or a key in it is unknown or not allowed.
    """
    plain = read_toml(path)
    return (
        checked(plain, path)
        if "robot" in plain
        else _converted({**plain, "robot": None}, path, HostConfig)
    )


def load_config(path: Path) -> RobotConfig:
    """Read and validate the `robot.toml` of a robot, and nothing but this file.

    A service runs with `kept_settings.load_with_kept`.

    Raises:
        ConfigError: It cannot be read, or a key in it is unknown or not allowed.
    """
    return checked(read_toml(path), path)


def checked(plain: Mapping[str, Any], path: Path) -> RobotConfig:
    """Validate what stands in the `robot.toml` of a robot.

    Raises:
        ConfigError: It names no robot, or a key in it is unknown or not allowed.
    """
    if "robot" not in plain:
        _converted({**plain, "robot": None}, path, HostConfig)  # it may be misspelt
        raise ConfigError(
            f"{path}: has no [robot], so it is that of a host without a robot; this needs one: "
            "`trolley init` writes a whole file"
        )
    return _converted(plain, path, RobotConfig)


def _converted(plain: Mapping[str, Any], path: Path, kind: type[C]) -> C:
    for key in SET_ON_LOADING:
        if key in plain:
            raise ConfigError(f"{path}: unknown key `{key}`")
    file = path.resolve()
    try:
        return msgspec.convert({**plain, "folder": str(file.parent), "file": str(file)}, type=kind)
    except msgspec.ValidationError as error:
        raise ConfigError(f"{path}: {in_words_of_robot_toml(str(error), kind)}") from error
