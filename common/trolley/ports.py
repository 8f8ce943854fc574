"""The routers' TCP ports, and who listens on a port of this host."""

import contextlib
import errno
import socket
from ipaddress import ip_address
from pathlib import Path

ROUTER_PORT = 7447
"""Where a host's router listens for that host's own programs."""
ROUTER_TLS_PORT = 7448
"""Where it listens for other hosts, if it has keys."""
ROS_ROUTER = "rmw_zenohd"
"""The router that ROS 2 brings along, which takes the same port as ours."""
_LOOPBACK = ("127.0.0.1", "localhost", "[::1]")
_LISTENING = "0A"


def port_of(endpoint: str) -> int | None:
    """The port of a TCP endpoint on this host, None for any other endpoint."""
    address = endpoint.partition("/")[2].partition("?")[0].partition("#")[0]
    host, _, port = address.rpartition(":")
    return int(port) if host in _LOOPBACK and port.isdigit() else None


def is_loopback_host(host: str) -> bool:
    """Whether a server that binds `host` is reached from this host alone."""
    return host == "localhost" or is_loopback(host)


def is_loopback(address: str) -> bool:
    """Whether an IP address is this host's own, which no other host reaches."""
    try:
        return ip_address(address).is_loopback
    except ValueError:
        return False


def is_free(port: int, host: str = "127.0.0.1") -> bool:
    """Whether a server could listen on this port now."""
    with socket.socket() as probe:
        # As servers do: a connection of an earlier run that still lingers is no hindrance.
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
            probe.listen(1)
        except OSError as error:
            if error.errno in (errno.EADDRINUSE, errno.EACCES):
                return False
            raise
    return True


def is_listening(port: int) -> bool:
    """Whether a server of this host listens on this port; it does not notice being asked."""
    return bool(_listening_inodes(port))


def first_free(port: int, tries: int = 100) -> int:
    """The first free port from `port` on.

    Raises:
        OSError: All of them are taken.
    """
    for candidate in range(port, min(port + tries, 65536)):
        if is_free(candidate):
            return candidate
    raise OSError(errno.EADDRINUSE, f"all ports from {port} on are taken")


def owner(port: int) -> str | None:
    """The process that listens on a port as "name (pid 123)", None where it cannot be seen."""
    inodes = _listening_inodes(port)
    for folder in Path("/proc").iterdir() if inodes else ():
        if not folder.name.isdigit():
            continue
        try:
            if inodes & _open_files(folder):
                words = (folder / "cmdline").read_bytes().split(b"\0")
                return f"{_readable(words)} (pid {folder.name})"
        except OSError:  # another user's process, or one that has just ended
            continue
    return None


def taken(port: int) -> str:
    """Say who has a port that is taken."""
    return f"port {port} is taken by {owner(port) or 'another program'}"


def _open_files(process: Path) -> set[str]:
    """What the descriptors of a process stand for."""
    found: set[str] = set()
    for link in (process / "fd").iterdir():
        with contextlib.suppress(FileNotFoundError):  # closed meanwhile
            found.add(str(link.readlink()))
    return found


def _listening_inodes(port: int) -> set[str]:
    """The sockets that listen on a port, as the kernel calls them in /proc/<pid>/fd."""
    found: set[str] = set()
    for table in ("/proc/net/tcp", "/proc/net/tcp6"):
        try:
            lines = Path(table).read_text().splitlines()[1:]
        except OSError:
            continue
        for line in lines:
            fields = line.split()
            if fields[3] == _LISTENING and int(fields[1].rpartition(":")[2], 16) == port:
                found.add(f"socket:[{fields[9]}]")
    return found


def _readable(words: list[bytes]) -> str:
    """A command line without the path of the interpreter and with the script's name only."""
    texts = [word.decode("utf-8", "replace") for word in words if word]
    if len(texts) > 1 and "python" in Path(texts[0]).name and not texts[1].startswith("-"):
        texts = texts[1:]
    return " ".join([Path(texts[0]).name, *texts[1:3]]) if texts else "a process"
