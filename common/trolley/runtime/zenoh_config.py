"""Settings of Zenoh's sessions: a client's, and a router's with its keys and its uplink.

Measured with eclipse-zenoh 1.10: with these, clients of a router and routers of an uplink reconnect
by themselves within half a second, and nothing is found by multicast.
"""

# Zenoh's stubs leave most of its results without a type.

import json
from collections.abc import Mapping, Sequence

import zenoh

from trolley import topics
from trolley.security.access import Security
from trolley.security.host_keys import HostKeys

_RETRY = {"period_init_ms": 200, "period_max_ms": 500, "period_increase_factor": 1.5}
OPEN_TIMEOUT_MS = 4000
"""A new link is tried anew after so long: Linux asks more and more rarely who is there."""
LARGE_WAIT_US = 200_000
"""How long a large message, such as a map, may wait for room on its way to another host."""
_COMMON: dict[str, object] = {
    "connect/retry": _RETRY,
    "scouting/multicast/enabled": False,
    "scouting/gossip/enabled": False,
    "timestamping/enabled": True,
    "transport/shared_memory/enabled": False,
    "transport/link/tx/lease": 1000,
}

_PEERS_MEET: dict[str, object] = {
    "scouting/gossip": {
        "enabled": True,
        "target": {"router": ["peer"]},
        "autoconnect": {"router": []},
    }
}
"""Nodes of ROS 2 are peers, to whom the router must tell of each other; Trolley's programs are not.
Not where other hosts come in: their peers would link with this host's directly, past the roles."""


def client_config(
    endpoints: Sequence[str], timeout_ms: int = -1, keys: HostKeys | None = None
) -> zenoh.Config:
    """Settings of a client of the router at `endpoints`; `timeout_ms` -1 waits for it forever."""
    return _config(
        {
            "mode": "client",
            "connect/endpoints": list(endpoints),
            "connect/timeout_ms": timeout_ms,
            "connect/exit_on_failure": True,
            "listen/endpoints": [],
            **_COMMON,
            **_tls(keys),
        }
    )


def router_config(
    listen: Sequence[str],
    uplink: Sequence[str] = (),
    security: Security | None = None,
    downsample: Mapping[str, float] | None = None,
) -> zenoh.Config:
    """Settings of a router.

    Args:
        listen: endpoints for this host's programs and, where it has a router's keys, for others.
        uplink: endpoints of the router, or routers, that it links itself to.
        security: this host's keys and who may do what; without it there is no TLS.
        downsample: at most so many messages a second of these topics leave over TLS.
    """
    return _config(
        {
            "mode": "router",
            "listen/endpoints": list(listen),
            "listen/exit_on_failure": True,
            "connect/endpoints": list(uplink),
            "connect/timeout_ms": -1,
            "connect/exit_on_failure": False,
            "scouting/delay": 0,
            "transport/unicast/open_timeout": OPEN_TIMEOUT_MS,
            **_COMMON,
            **(_tls(security.keys) if security is not None else {}),
            **_access_control(security),
            **_unblocked(),
            **_downsampling(downsample or {}),
        }
    )


def _tls(keys: HostKeys | None) -> dict[str, object]:
    if keys is None:
        return {}
    certificate, key = str(keys.certificate), str(keys.key)
    return {
        "transport/link/tls": {
            "root_ca_certificate": str(keys.authority),
            "connect_certificate": certificate,
            "connect_private_key": key,
            "listen_certificate": certificate,
            "listen_private_key": key,
            "enable_mtls": True,
            "verify_name_on_connect": True,
        }
    }


def _access_control(security: Security | None) -> dict[str, object]:
    rules = None if security is None else security.access_control
    return _PEERS_MEET if rules is None else {"access_control": dict(rules)}


def _unblocked() -> dict[str, object]:
    """Let no other host's slow link block this host's own programs.

    By itself a router reads no more from a program while what it said, of class `state`, cannot be
    passed on: with costmaps on their way and the radio link cut, programs on the robot did not hear
    each other for 5 s. So what does not go out over TLS soon is dropped; answers to `get`, which
    late joiners ask for, still wait.
    """
    others = {
        "link_protocols": ["tls"],
        "flows": ["egress"],
        "messages": ["put", "delete"],
        "overwrite": {"congestion_control": "drop"},
    }
    drop = "transport/link/tx/queue/congestion_control/drop/max_wait_before_drop_fragments"
    return {"qos/network": [others], drop: LARGE_WAIT_US}


def _downsampling(rates: Mapping[str, float]) -> dict[str, object]:
    """Rates of what leaves over TLS; this host's own programs come by TCP and get everything."""
    if not rates:
        return {}
    rules = [
        {"key_expr": topic.key("*"), "freq": rates[topic.name]}
        for topic in topics.TOPICS
        if topic.name in rates
    ]
    uplink = {
        "id": "uplink",
        "link_protocols": ["tls"],
        "flows": ["egress"],
        "messages": ["put"],
        "rules": rules,
    }
    return {"downsampling": [uplink]}


def _config(settings: Mapping[str, object]) -> zenoh.Config:
    config = zenoh.Config()
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    return config
