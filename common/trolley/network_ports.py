"""Names of devices that are reached over the network: `tcp://host:port` and `udp://host:port`.

Without a host, `udp://:port`, the device calls this computer.
"""

import errno
import re
import socket
from typing import Literal, NamedTuple

ADDRESS = re.compile(
    r"(?P<kind>tcp|udp)://(?P<host>\[[0-9a-fA-F:.]+\]|[A-Za-z0-9.-]*):(?P<port>\d+)"
)
SCHEMES = ("tcp:", "udp:")
MOST_PORT = 65535


class Address(NamedTuple):
    """Where a device is; without a host, where it sends to."""

    kind: Literal["tcp", "udp"]
    host: str
    port: int


class AddressChangedError(OSError):
    """A device that called from one address calls from another."""


def is_network(name: str) -> bool:
    """Whether a port's name is meant to be one of the network, and not a serial port's."""
    return name.startswith(SCHEMES)


def names_a_host(text: str) -> bool:
    """Whether a host's name or address can be looked up: Python raises no `OSError` over others."""
    return all(0 < len(part) < 64 for part in text.removesuffix(".").split("."))


def parse_address(name: str) -> Address:
    """Read a name.

    Raises:
        ValueError: it is none; the text says how one is written.
    """
    match = ADDRESS.fullmatch(name)
    port = 0 if match is None else int(match["port"])
    host = "" if match is None else match["host"].strip("[]")
    is_whole = names_a_host(host) or (match is not None and not host and match["kind"] == "udp")
    if match is None or not is_whole or not 0 < port <= MOST_PORT:
        raise ValueError(
            f"{name} is not an address: write tcp://HOST:PORT or udp://HOST:PORT, such as "
            "tcp://192.168.0.10:10940; for a device that sends to this computer, udp://:PORT"
        )
    kind: Literal["tcp", "udp"] = "tcp" if match["kind"] == "tcp" else "udp"
    return Address(kind, host, port)


def explain_network(name: str, error: OSError) -> str:
    """Say why a device of the network cannot be reached, or was lost, and what to do."""
    address = ADDRESS.fullmatch(name)
    host = name if address is None else address["host"]
    if isinstance(error, AddressChangedError):
        return f"{name}: {error.strerror}"
    if not host:
        return _explain_listening(name, error)
    if isinstance(error, socket.gaierror):
        return f"{name}: nobody in this network is called {host}; give its address (192.168…)."
    if error.errno == errno.ECONNREFUSED:
        return (
            f"{name} refuses the connection: is this the device's port, and has no other program "
            "connected to it?"
        )
    if error.errno in (errno.ECONNRESET, errno.EPIPE):
        return f"{name} has closed the connection: has the device restarted?"
    return (
        f"{name} does not answer ({error.strerror or error}): is the device switched on, its cable "
        f"plugged in, and is this computer in its network (`ping {host}`)?"
    )


def _explain_listening(name: str, error: OSError) -> str:
    """Say why nobody can be listened to."""
    if error.errno == errno.EADDRINUSE:
        return (
            f"{name}: another program listens there already; end it (a micro_ros_agent, perhaps, "
            "its service or container), or choose another port here and on the device."
        )
    if error.errno == errno.EACCES:
        return f"{name}: ports below 1024 are for the system; choose a higher one."
    return f"{name} cannot be listened to: {error.strerror or error}."
