"""Names of devices that are reached over the network: `tcp://host:port` and `udp://host:port`."""

import errno
import re
import socket
from typing import Literal, NamedTuple

ADDRESS = re.compile(
    r"(?P<kind>tcp|udp)://(?P<host>\[[0-9a-fA-F:.]+\]|[A-Za-z0-9.-]+):(?P<port>\d+)"
)
SCHEMES = ("tcp:", "udp:")
MOST_PORT = 65535


class Address(NamedTuple):
    """Where a device is."""

    kind: Literal["tcp", "udp"]
    host: str
    port: int


def is_network(name: str) -> bool:
    """Whether a port's name is meant to be one of the network, and not a serial port's."""
    return name.startswith(SCHEMES)


def parse_address(name: str) -> Address:
    """Read a name.

    Raises:
        ValueError: it is none; the text says how one is written.
    """
    match = ADDRESS.fullmatch(name)
    port = 0 if match is None else int(match["port"])
    if match is None or not 0 < port <= MOST_PORT:
        raise ValueError(
            f"{name} is not an address: write tcp://HOST:PORT or udp://HOST:PORT, such as "
            "tcp://192.168.0.10:10940"
        )
    kind: Literal["tcp", "udp"] = "tcp" if match["kind"] == "tcp" else "udp"
    return Address(kind, match["host"].strip("[]"), port)


def explain_network(name: str, error: OSError) -> str:
    """Say why a device of the network cannot be reached, or was lost, and what to do."""
    address = ADDRESS.fullmatch(name)
    host = name if address is None else address["host"]
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
