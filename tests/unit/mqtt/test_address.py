"""The address of a broker."""

import pytest

from trolley.config import MqttConfig
from trolley.config.mqtt import split_broker


@pytest.mark.parametrize(
    ("text", "address"),
    [
        ("broker", ("broker", 1883)),
        ("192.168.1.5:1884", ("192.168.1.5", 1884)),
        ("[fd00::1]:9", ("fd00::1", 9)),
    ],
)
def test_a_broker_is_a_host_and_perhaps_a_port(text: str, address: tuple[str, int]) -> None:
    assert MqttConfig(broker=text).address == address


@pytest.mark.parametrize(
    "text", ["mqtt://broker", "a b", "host:0", "host:70000", "fd00::1", ":1", "a..b"]
)
def test_what_is_no_broker_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="is not a broker"):
        split_broker(text)


def test_tls_has_a_port_of_its_own() -> None:
    assert MqttConfig(broker="b", tls=True).address == ("b", 8883)
