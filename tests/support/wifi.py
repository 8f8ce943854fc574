"""Two hosts on one machine, joined by a radio link that can be made as bad as one likes.

Each host is a network namespace with a TUN device; this process carries their packets, and loses,
delays or cuts them. Needs root. (`tc netem` would do the same where the kernel has it.)
"""

import ctypes
import fcntl
import heapq
import itertools
import os
import random
import select
import shutil
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Self

TUNSETIFF, IFF_TUN, IFF_NO_PI = 0x400454CA, 0x0001, 0x1000
CLONE_NEWNET = 0x40000000
MAX_PACKET = 65536
NETWORK = "10.77.0"
HOME, ROBOT = "home", "robot"
ADDRESSES = {HOME: f"{NETWORK}.1", ROBOT: f"{NETWORK}.2"}


def why_not() -> str | None:
    """Why there can be no such link here, None where there can."""
    if os.geteuid() != 0:
        return "needs root for network namespaces"
    if shutil.which("ip") is None:
        return "needs `ip` (iproute2)"
    try:
        os.close(os.open("/dev/net/tun", os.O_RDWR))
    except OSError as error:
        return f"/dev/net/tun: {error.strerror}"
    made = subprocess.run(
        ["ip", "netns", "add", _unique("probe")], capture_output=True, text=True, check=False
    )
    if made.returncode != 0:
        return f"network namespaces: {made.stderr.strip()}"
    subprocess.run(["ip", "netns", "del", _unique("probe")], check=True)
    return None


def _unique(host: str) -> str:
    return f"trolley-{host}-{os.getpid()}"


def _device(host: str) -> str:
    return f"{host[0]}{os.getpid()}"  # 15 characters at most


def enter(namespace: str) -> None:
    """Move this thread, and what it starts, into a namespace."""
    with Path("/run/netns", namespace).open("rb") as file:
        if ctypes.CDLL(None, use_errno=True).setns(file.fileno(), CLONE_NEWNET) != 0:
            raise OSError(ctypes.get_errno(), "setns")


class Wifi:
    """The link; a context manager. `loss`, `delay_s`, `jitter_s` and `is_cut` may be set any time.

    Each holds in both directions: a delay of 0.1 s is 0.2 s there and back.
    """

    def __init__(self, seed: int = 1) -> None:
        self.loss = 0.0
        self.delay_s = 0.0
        self.jitter_s = 0.0
        self.is_cut = False
        self._random = random.Random(seed)
        self._ends: list[int] = []
        self._is_over = False
        self._thread = threading.Thread(target=self._carry, name="wifi", daemon=True)

    def namespace(self, host: str) -> str:
        """The name of a host's namespace."""
        return _unique(host)

    def __enter__(self) -> Self:
        for host in (HOME, ROBOT):
            _ip("netns", "add", _unique(host))
            _ip("-n", _unique(host), "link", "set", "lo", "up")
            self._ends.append(_tun(host))
            _ip("link", "set", _device(host), "netns", _unique(host))
            self.set_address(host, ADDRESSES[host])
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._is_over = True
        self._thread.join()
        for end in self._ends:
            os.close(end)
        for host in (HOME, ROBOT):
            _ip("netns", "del", _unique(host))

    def set_address(self, host: str, address: str) -> None:
        """Give a host another address, as DHCP does after a change of access point."""
        inside = ("-n", _unique(host))
        _ip(*inside, "addr", "flush", "dev", _device(host))
        _ip(*inside, "addr", "add", f"{address}/24", "dev", _device(host))
        _ip(*inside, "link", "set", _device(host), "up")

    def start(
        self,
        host: str,
        arguments: Sequence[str],
        log: Path,
        environment: Mapping[str, str] | None = None,
    ) -> subprocess.Popen[bytes]:
        """Start Python on a host; its output goes to a file."""
        inherited = {name: os.environ[name] for name in os.environ if name != "NOTIFY_SOCKET"}
        paths = [path for path in sys.path if path]
        with log.open("ab") as output:
            return subprocess.Popen(
                ["ip", "netns", "exec", _unique(host), sys.executable, *arguments],
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=output,
                env={**inherited, "PYTHONPATH": os.pathsep.join(paths), **(environment or {})},
            )

    def _carry(self) -> None:
        flying: list[tuple[float, int, int, bytes]] = []
        number = itertools.count()
        while not self._is_over:
            wait_s = flying[0][0] - time.monotonic() if flying else 0.05
            readable, _, _ = select.select(self._ends, [], [], min(max(wait_s, 0.0), 0.05))
            for end in readable:
                packet = os.read(end, MAX_PACKET)
                if self.is_cut or self._random.random() < self.loss:
                    continue
                other = self._ends[1 - self._ends.index(end)]
                late_s = self.delay_s + self._random.uniform(0.0, self.jitter_s)
                heapq.heappush(flying, (time.monotonic() + late_s, next(number), other, packet))
            now_s = time.monotonic()
            while flying and flying[0][0] <= now_s:
                _, _, end, packet = heapq.heappop(flying)
                if not self.is_cut:
                    _deliver(end, packet)


def _deliver(end: int, packet: bytes) -> None:
    try:
        os.write(end, packet)
    except OSError:  # the device is down for the moment: its address is being changed
        return


def _tun(host: str) -> int:
    end = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK)
    name = _device(host).encode()
    fcntl.ioctl(end, TUNSETIFF, struct.pack("16sH", name, IFF_TUN | IFF_NO_PI))
    return end


def _ip(*arguments: str) -> None:
    subprocess.run(["ip", *arguments], check=True)
