"""Where a router listens, and with which keys."""

from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from trolley.cli.running import FOR_OTHERS, listening, security_for
from trolley.config import ConfigError
from trolley.runtime.zenoh_bus import NotConnected, open_router
from trolley.runtime.zenoh_config import client_config, router_config
from trolley.security.access import Security
from trolley.security.keyring import Keyring

LOCAL = "tcp/127.0.0.1:7447"
HOME = "tls/home.local:7448"
NOW = datetime.now(UTC)


@pytest.fixture
def keyring(tmp_path: Path) -> Keyring:
    ring = Keyring(tmp_path / "ring")
    ring.create(NOW)
    return ring


def issue(keyring: Keyring, role: str) -> Path:
    until = NOW + timedelta(days=10)
    if role == "router":
        return keyring.issue("router", "home", until, ["home.local"], replace=False).folder
    return keyring.issue("robot", "kiwi", until, replace=False).folder


def test_without_keys_it_is_for_its_own_host(tmp_path: Path) -> None:
    security = security_for(tmp_path / "none", [LOCAL])
    assert security is None
    assert listening(security, [LOCAL]) == [LOCAL]


def test_with_a_robots_keys_it_lets_nobody_in(keyring: Keyring) -> None:
    security = security_for(issue(keyring, "robot"), [LOCAL, HOME])
    assert security is not None
    assert listening(security, [LOCAL]) == [LOCAL]


def test_with_a_routers_keys_it_listens_for_others(keyring: Keyring) -> None:
    security = security_for(issue(keyring, "router"), [LOCAL])
    assert listening(security, [LOCAL]) == [LOCAL, FOR_OTHERS]


def test_an_uplink_over_tls_needs_keys(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="trolley keys"):
        security_for(tmp_path / "none", [LOCAL, HOME])


def test_broken_keys_are_an_error_of_the_configuration(keyring: Keyring) -> None:
    folder = issue(keyring, "router")
    (folder / "allowed.pem").write_text("rubbish")
    with pytest.raises(ConfigError, match=r"allowed\.pem"):
        security_for(folder, [LOCAL])


def test_zenoh_takes_the_settings(keyring: Keyring) -> None:
    security = security_for(issue(keyring, "router"), [LOCAL])
    assert isinstance(security, Security)
    config = router_config([LOCAL, FOR_OTHERS], [HOME], security, {"scan": 2.0})
    assert '"enable_mtls":true' in config.get_json("transport/link/tls")
    assert '"freq":2.0' in config.get_json("downsampling")
    assert '"default_permission":"deny"' in config.get_json("access_control")
    assert '"congestion_control":"drop"' in config.get_json("qos/network")
    client = client_config([HOME], keys=security.keys)
    assert str(security.keys.key) in client.get_json("transport/link/tls")


@pytest.mark.parametrize(
    "endpoint",
    [
        "quic/127.0.0.1:7449",
        "quic/0.0.0.0:7448",
        "udp/0.0.0.0:7447",
        "udp/127.0.0.1:7447",
        "ws/0.0.0.0:7447",
        "tcp/0.0.0.0:7447",
        "tcp/[::]:7447",
        "tcp/192.168.1.2:7447",
    ],
)
def test_a_router_listens_nowhere_past_the_door_and_the_rules(
    keyring: Keyring, endpoint: str
) -> None:
    security = security_for(issue(keyring, "router"), [LOCAL])
    for keys in (security, None):
        with (
            pytest.raises(NotConnected, match="will not listen at"),
            open_router([LOCAL, endpoint], (), keys),
        ):
            pass


def test_other_hosts_come_in_with_a_routers_keys_only(keyring: Keyring) -> None:
    """With a robot's keys nobody would be told apart: each certificate might do everything."""
    security = security_for(issue(keyring, "robot"), [FOR_OTHERS])
    with (
        pytest.raises(NotConnected, match="trolley keys router"),
        open_router([FOR_OTHERS], (), security),
    ):
        pass


def test_a_router_links_to_others_over_tls_only() -> None:
    with pytest.raises(NotConnected, match="will not link to"), open_router([LOCAL], ["quic/a:1"]):
        pass
