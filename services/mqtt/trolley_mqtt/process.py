"""The bridge as it is started: with the broker that the environment names, if it does."""

import os

from msgspec import structs

from trolley.config import ConfigError, RobotConfig
from trolley.config.mqtt import BROKER_VARIABLE, split_broker
from trolley_mqtt.service import MqttService


def make(config: RobotConfig) -> MqttService:
    """The service, with the broker that `trolley up --mqtt` names.

    Raises:
        ConfigError: The settings, or the broker, cannot be used.
    """
    broker = os.environ.get(BROKER_VARIABLE)
    if broker is not None:
        try:
            split_broker(broker)
        except ValueError as problem:
            raise ConfigError(f"{BROKER_VARIABLE}: {problem}") from problem
        config = structs.replace(config, mqtt=structs.replace(config.mqtt, broker=broker))
    return MqttService(config)
