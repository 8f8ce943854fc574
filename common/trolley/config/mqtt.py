"""`[mqtt]`: the bridge to an MQTT broker, as Home Assistant uses one."""

import re
from typing import Annotated

from msgspec import Meta, Struct

from trolley.network_ports import names_a_host

PORT, TLS_PORT = 1883, 8883
BROKER = re.compile(r"(?P<host>\[[0-9A-Fa-f:.]+\]|[A-Za-z0-9_.-]{1,253})(:(?P<port>[0-9]{1,5}))?")

BROKER_VARIABLE = "TROLLEY_MQTT_BROKER"
"""How `trolley up --mqtt` names a broker that robot.toml does not."""

TopicName = Annotated[
    str, Meta(pattern=r"\A([^+#$/\s\x00-\x1f][^+#\s\x00-\x1f]*)?\Z", max_length=200)
]


class MqttConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The MQTT broker that the robot reports to and takes a few commands from."""

    broker: str = ""
    """`host` or `host:port` of the broker; empty for no bridge."""
    username: str = ""
    """User name for the broker; empty if it asks for none."""
    password_file: str = ""
    """A file whose first line is the password, relative to this file."""
    tls: bool = False
    """Whether to encrypt, trusting the certificate authorities that this computer trusts."""
    tls_ca: str = ""
    """Encrypt, trusting only the certificate authority in this PEM file."""
    base_topic: TopicName = ""
    """The beginning of all topics of this robot; `trolley/<robot>` if empty."""
    discovery_prefix: TopicName = "homeassistant"
    """Where Home Assistant looks for devices; empty to announce nothing."""
    start_tour: str = ""
    """The tour that *Start* begins; the only one that there is if empty."""
    map_every_s: Annotated[float, Meta(ge=0.0, le=3600.0)] = 10.0
    """Shortest time between two pictures of the map; 0 for none."""

    def __post_init__(self) -> None:
        """Refuse a broker that is not an address."""
        if self.broker:
            split_broker(self.broker)

    @property
    def is_encrypted(self) -> bool:
        """Whether TLS is spoken."""
        return self.tls or bool(self.tls_ca)

    @property
    def address(self) -> tuple[str, int]:
        """Host and port of the broker."""
        host, port = split_broker(self.broker)
        return host, port or (TLS_PORT if self.is_encrypted else PORT)


def split_broker(text: str) -> tuple[str, int | None]:
    """Host and port of `host`, `host:port` or `[IPv6]:port`.

    Raises:
        ValueError: It is not an address.
    """
    found = BROKER.fullmatch(text)
    port = int(found["port"]) if found is not None and found["port"] else None
    host = "" if found is None else found["host"].strip("[]")
    if found is None or not names_a_host(host) or port == 0 or (port or 0) > 65_535:
        raise ValueError(f"{text!r} is not a broker: write host or host:port, such as 192.168.1.5")
    return host, port
