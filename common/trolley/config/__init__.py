"""One `robot.toml` per robot, decoded once into frozen structs; one module per section.

Unknown keys, wrong types and values out of range are refused with file, key and what is allowed.
"""

from trolley.config.base import BaseConfig
from trolley.config.load import (
    ConfigError,
    HostConfig,
    RobotConfig,
    find_config,
    load_config,
    load_host_config,
)
from trolley.config.localizer import LocalizerConfig
from trolley.config.mapper import MapperConfig
from trolley.config.mcp import McpConfig
from trolley.config.mqtt import MqttConfig
from trolley.config.planner import PlannerConfig
from trolley.config.robot import (
    FootprintConfig,
    MapSection,
    PoseConfig,
    RobotSection,
    StartSection,
    ZenohSection,
)
from trolley.config.ros2 import Ros2Config
from trolley.config.tour import TourConfig
from trolley.config.viz import VizConfig
from trolley.config.webhook import WebhookConfig

__all__ = [
    "BaseConfig",
    "ConfigError",
    "FootprintConfig",
    "HostConfig",
    "LocalizerConfig",
    "MapSection",
    "MapperConfig",
    "McpConfig",
    "MqttConfig",
    "PlannerConfig",
    "PoseConfig",
    "RobotConfig",
    "RobotSection",
    "Ros2Config",
    "StartSection",
    "TourConfig",
    "VizConfig",
    "WebhookConfig",
    "ZenohSection",
    "find_config",
    "load_config",
    "load_host_config",
]
