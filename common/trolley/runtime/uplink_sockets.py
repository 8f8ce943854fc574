"""The TCP connections of a router to other hosts: dropped as soon as nothing gets through.

Zenoh drops a silent link after its lease, but closing it waits until Linux has taken what was still
to be written; if the network is gone, that lasts until Linux stops retransmitting: minutes. During
that time no new link to the same router can be made (a cut of 40 s was felt for 54 s, one of 60 s
for 110 s). Zenoh has no setting for this, Linux has one per socket (`man 7 tcp`).
"""

import dataclasses
import os
import re
import socket
import threading
from collections.abc import Callable, Collection, Generator, Sequence
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path

UNANSWERED_MS = 1500
"""What was sent and not acknowledged for so long ends a connection; Zenoh's lease is shorter."""
LOOK_S = 0.5
_FAR = re.compile(r"tls/.*:(\d+)(?:[?#].*)?")


def far_ports(endpoints: Sequence[str]) -> set[int]:
    """Return the ports of TLS endpoints."""
    return {int(found[1]) for found in map(_FAR.fullmatch, endpoints) if found}


@dataclasses.dataclass(frozen=True)
class FarLink:
    """A link with another host over TLS, as Zenoh knows it."""

    own_port: int
    port: int
    """At the other end."""
    certificate: str
    """The common name of the other end's certificate."""


@contextmanager
def given_up_when_unanswered(endpoints: Sequence[str]) -> Generator[None]:
    """While the context lasts, look after this process's connections from and to TLS endpoints."""
    ports = far_ports(endpoints)
    known: set[int] = set()

    def look() -> None:
        nonlocal known
        known = limit_waiting(ports, known)

    with looked_after(look) if ports else nullcontext():
        yield


@contextmanager
def looked_after(look: Callable[[], None]) -> Generator[None]:
    """While the context lasts, call this every `LOOK_S` on a thread of its own."""
    end = threading.Event()

    def repeat() -> None:
        while not end.wait(LOOK_S):
            look()

    thread = threading.Thread(target=repeat, name="far links", daemon=True)
    thread.start()
    try:
        yield
    finally:
        end.set()
        thread.join()


def limit_waiting(ports: Collection[int], known: Collection[int] = ()) -> set[int]:
    """Set the limit on each socket of this process that has one of these ports at either end.

    Args:
        ports: local or remote port.
        known: what the call before returned: these sockets need not be looked at again.

    Returns:
        The inodes of the sockets about which everything is done.
    """
    found: set[int] = set()
    entries = _open_files()
    if not entries:
        return set(known)
    for entry in entries:
        with suppress(OSError):  # closed by now, or no socket
            inode = entry.stat().st_ino
            if inode in known or (entry.is_socket() and _limit(int(entry.name), ports)):
                found.add(inode)
    return found


def hang_up(links: Collection[FarLink]) -> None:
    """End these links; Zenoh has no call for that."""
    ends = {(one.own_port, one.port) for one in links}
    for entry in _open_files() if ends else []:
        with suppress(OSError):  # closed by now, or no socket
            if entry.is_socket():
                _end_if(int(entry.name), ends)


def _open_files() -> list[Path]:
    """Return this process's files; none while it has no file left to look with."""
    try:
        return [*Path("/proc/self/fd").iterdir()]
    except OSError:
        return []


def _end_if(number: int, ends: Collection[tuple[int, int]]) -> None:
    """Shut the socket if its own port and the other are a pair of these."""
    with socket.socket(fileno=os.dup(number)) as link:
        is_tcp = link.family in (socket.AF_INET, socket.AF_INET6)
        if is_tcp and (link.getsockname()[1], link.getpeername()[1]) in ends:
            link.shutdown(socket.SHUT_RDWR)


def _limit(number: int, ports: Collection[int]) -> bool:
    """Set the limit if it is one of these; False where that cannot be told yet."""
    with socket.socket(fileno=os.dup(number)) as link:
        if link.family not in (socket.AF_INET, socket.AF_INET6) or link.proto != socket.IPPROTO_TCP:
            return True
        is_listening = link.getsockopt(socket.SOL_SOCKET, socket.SO_ACCEPTCONN)
        try:
            far = 0 if is_listening else link.getpeername()[1]
        except OSError:  # it is still connecting
            return False
        # What a listening socket accepts inherits the limit from it.
        if far in ports or link.getsockname()[1] in ports:
            link.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, UNANSWERED_MS)
        return True
