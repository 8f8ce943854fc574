"""Run the bridge as a process: `python -m trolley_mqtt --config robot.toml`."""

import os

from msgspec import structs

from trolley.config import ConfigError, RobotConfig
from trolley.config.mqtt import BROKER_VARIABLE, split_broker
from trolley.runtime.process import main
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


if __name__ == "__main__":
    main(make)
