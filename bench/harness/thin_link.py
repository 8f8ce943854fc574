"""A thin network link on this machine: a namespace whose only way out is slow and late.

Two TUN devices, one in the namespace and one outside, and a thread that carries packets from one to
the other as a poor radio does: so many bits a second each way, each packet so much later, and what
does not fit into the queue is lost. Needs root, `ip` (iproute2) and /dev/net/tun.
"""

import contextlib
import fcntl
import heapq
import os
import selectors
import struct
import subprocess
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, field

TUNSETIFF, IFF_TUN, IFF_NO_PI = 0x400454CA, 0x0001, 0x1000
OUTSIDE, INSIDE = "10.231.7.1", "10.231.7.2"
QUEUE_BYTES = 60_000
"""What waits in a cheap access point before packets are lost."""
MTU = 1500


@dataclass
class Way:
    """One direction."""

    source: int
    target: int
    bytes_per_s: float
    delay_s: float
    free_s: float = 0.0
    """When the last packet that waits has left."""
    under_way: list[tuple[float, int, bytes]] = field(default_factory=list)
    num_lost: int = 0

    def take(self, packet: bytes, number: int, now_s: float) -> None:
        """Let a packet queue up."""
        start_s = max(self.free_s, now_s)
        if (start_s - now_s) * self.bytes_per_s > QUEUE_BYTES:
            self.num_lost += 1
            return
        self.free_s = start_s + len(packet) / self.bytes_per_s
        heapq.heappush(self.under_way, (self.free_s + self.delay_s, number, packet))

    def hand_over(self, now_s: float) -> None:
        """Hand over what has come through."""
        while self.under_way and self.under_way[0][0] <= now_s:
            os.write(self.target, heapq.heappop(self.under_way)[2])


def may_open() -> bool:
    """Whether this machine lets us."""
    if os.geteuid() != 0 or not os.access("/dev/net/tun", os.W_OK):
        return False
    name = f"trolley-try-{os.getpid()}"
    tried = subprocess.run(["ip", "netns", "add", name], capture_output=True, check=False)
    if tried.returncode == 0:
        subprocess.run(["ip", "netns", "del", name], check=False)
    return tried.returncode == 0


@contextlib.contextmanager
def thin_link(kbit_per_s: float, round_trip_s: float) -> Iterator[str]:
    """Open a namespace behind a thin link; gives its name, for `ip netns exec`.

    Servers of this host are at `OUTSIDE` for whoever is inside.
    """
    name = f"trolley-{os.getpid()}"
    _ip("netns", "add", name)
    try:
        outer, inner = _open_tun("tthin0"), _open_tun("tthin1")
        _ip("link", "set", "tthin1", "netns", name)
        _ip("addr", "add", f"{OUTSIDE}/30", "dev", "tthin0")
        _ip("link", "set", "tthin0", "mtu", str(MTU), "up")
        inside = ("netns", "exec", name, "ip")
        _ip(*inside, "addr", "add", f"{INSIDE}/30", "dev", "tthin1")
        _ip(*inside, "link", "set", "tthin1", "mtu", str(MTU), "up")
        _ip(*inside, "link", "set", "lo", "up")
        rate, delay_s = kbit_per_s * 125.0, 0.5 * round_trip_s
        ways = [Way(outer, inner, rate, delay_s), Way(inner, outer, rate, delay_s)]
        ends = threading.Event()
        carrier = threading.Thread(target=_carry, args=(ways, ends), daemon=True)
        carrier.start()
        try:
            yield name
        finally:
            ends.set()
            carrier.join()
            os.close(outer)
            os.close(inner)
    finally:
        _ip("netns", "del", name)


def _carry(ways: list[Way], ends: threading.Event) -> None:
    waiting = selectors.DefaultSelector()
    for way in ways:
        waiting.register(way.source, selectors.EVENT_READ, way)
    number = 0
    while not ends.is_set():
        for key, _ in waiting.select(0.002):
            number += 1
            key.data.take(os.read(key.data.source, MTU + 100), number, time.monotonic())
        for way in ways:
            way.hand_over(time.monotonic())


def _open_tun(name: str) -> int:
    tun = os.open("/dev/net/tun", os.O_RDWR)
    fcntl.ioctl(tun, TUNSETIFF, struct.pack("16sH", name.encode(), IFF_TUN | IFF_NO_PI))
    return tun


def _ip(*arguments: str) -> None:
    subprocess.run(["ip", *arguments], check=True)
