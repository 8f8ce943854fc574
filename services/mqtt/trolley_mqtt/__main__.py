"""Run the bridge as a process: `python -m trolley_mqtt --config robot.toml`."""

import os

from msgspec import structs

from trolley.config import RobotConfig
from trolley.config.mqtt import BROKER_VARIABLE
from trolley.runtime.process import main
from trolley_mqtt.service import MqttService


def make(config: RobotConfig) -> MqttService:
    """The service, with the broker that `trolley up --mqtt` names."""
    broker = os.environ.get(BROKER_VARIABLE)
    mqtt = config.mqtt if broker is None else structs.replace(config.mqtt, broker=broker)
    return MqttService(structs.replace(config, mqtt=mqtt))


if __name__ == "__main__":
    main(make)
