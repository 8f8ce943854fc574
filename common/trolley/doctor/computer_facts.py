"""Reads what `computer` checks from /proc, /sys and a few programs; all below a root of choice."""

import datetime
import os
import platform
import re
import struct
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from trolley.doctor.computer import Disk, Memory, Processor, System, WallClock, Wifi
from trolley.runtime.process import clock_is_synchronised

PROGRAM_PATIENCE_S = 5.0
_KIB = 1024


def run_program(words: Sequence[str]) -> str | None:
    """What a program prints; None where it is not installed, fails, or hangs."""
    try:
        done = subprocess.run(
            list(words), capture_output=True, timeout=PROGRAM_PATIENCE_S, check=False
        )
    except (OSError, subprocess.TimeoutExpired):
        return None
    return done.stdout.decode("utf-8", "replace") if done.returncode == 0 else None


class Host:
    """A computer as its files and programs show it.

    Args:
        root: where /proc, /sys, /run and /dev begin.
        run: runs a program; None where it is not there.
    """

    def __init__(
        self,
        root: Path = Path("/"),
        run: Callable[[Sequence[str]], str | None] = run_program,
    ) -> None:
        self.root = root
        self.run = run

    def text(self, path: str) -> str | None:
        """The content of a file, None if there is none.

        Raises:
            OSError: It is there and cannot be read.
        """
        try:
            return (self.root / path.lstrip("/")).read_text("utf-8", "replace").strip()
        except (FileNotFoundError, NotADirectoryError):
            return None

    def find(self, pattern: str) -> list[Path]:
        """Files by a pattern such as `sys/class/net/*`."""
        return sorted(self.root.glob(pattern.lstrip("/")))

    def first(self, pattern: str) -> str | None:
        """The content of the first file of a pattern, None if there is none."""
        found = self.find(pattern)
        return found[0].read_text("utf-8", "replace").strip() if found else None


def read_system() -> System:
    """What this Python is and runs on."""
    return System(
        8 * struct.calcsize("P"), sys.version_info[:2], platform.system(), platform.machine()
    )


def read_clock() -> WallClock:
    """What the host's clock says."""
    return WallClock(datetime.datetime.now(datetime.UTC).year, clock_is_synchronised())


def read_processor(host: Host) -> Processor:
    """Governor, load, throttling and temperature."""
    frequencies = "sys/devices/system/cpu/cpu[0-9]*/cpufreq"
    governors = [path.read_text().strip() for path in host.find(f"{frequencies}/scaling_governor")]
    load = host.text("proc/loadavg")
    return Processor(
        cores=len(host.find("sys/devices/system/cpu/cpu[0-9]*")) or os.cpu_count() or 1,
        load=None if load is None else float(load.split()[0]),
        governors=tuple(governors),
        driver=host.first(f"{frequencies}/scaling_driver") or "",
        throttled=_throttled(host),
        celsius=_hottest_c(host),
    )


def _throttled(host: Host) -> int | None:
    """The firmware's word; the kernel's file of it is readable by all, `vcgencmd` by a group."""
    text = host.first("sys/devices/platform/soc*/*firmware/get_throttled")
    if text is None:
        said = host.run(["vcgencmd", "get_throttled"])
        text = None if said is None else said.partition("=")[2].strip()
    if not text:
        return None
    return int(text.removeprefix("0x"), 16)


def _hottest_c(host: Host) -> float | None:
    degrees: list[float] = []
    for file in host.find("sys/class/thermal/thermal_zone*/temp"):
        try:
            degrees.append(int(file.read_text()) * 1e-3)
        except (OSError, ValueError):  # a sensor that is switched off
            continue
    return max(degrees, default=None)


def read_memory(host: Host) -> Memory | None:
    """Memory and swap; None where the kernel does not tell."""
    text = host.text("proc/meminfo")
    if text is None:
        return None
    kib = {name: int(value) for name, value in re.findall(r"^(\w+):\s+(\d+)", text, re.MULTILINE)}
    events = dict(re.findall(r"^(\w+) (\d+)", host.text("proc/vmstat") or "", re.MULTILINE))
    return Memory(
        total=kib["MemTotal"] * _KIB,
        available=kib["MemAvailable"] * _KIB,
        swap_total=kib.get("SwapTotal", 0) * _KIB,
        swap_free=kib.get("SwapFree", 0) * _KIB,
        killed=int(events.get("oom_kill", 0)),
    )


def read_disk(path: Path) -> Disk:
    """The file system below a folder, which need not be there yet."""
    there = next(one for one in (path, *path.absolute().parents) if one.exists())
    numbers = os.statvfs(there)
    return Disk(
        path=str(path),
        free=numbers.f_bavail * numbers.f_frsize,
        is_read_only=bool(numbers.f_flag & os.ST_RDONLY),
        files=numbers.f_files,
        files_free=numbers.f_favail,
    )


def read_loopback(host: Host) -> bool | None:
    """Whether the loopback interface is up (`IFF_UP`), None where the kernel does not tell."""
    flags = host.text("sys/class/net/lo/flags")
    return None if flags is None else bool(int(flags, 16) & 1)


def read_wifi(host: Host) -> list[Wifi]:
    """Wireless interfaces that are connected."""
    levels: dict[str, float] = {}
    for line in (host.text("proc/net/wireless") or "").splitlines()[2:]:
        name, _, rest = line.partition(":")
        levels[name.strip()] = float(rest.split()[2].rstrip("."))
    for folder in host.find("sys/class/net/*/phy80211"):  # not every kernel has the table
        name = folder.parent.name
        said = host.run(["iw", "dev", name, "link"]) if name not in levels else None
        signal = re.search(r"signal: (-?[0-9.]+) dBm", said or "")
        if signal is not None:
            levels[name] = float(signal[1])
    return [Wifi(name, level_dbm, _saves_power(host, name)) for name, level_dbm in levels.items()]


def _saves_power(host: Host, name: str) -> bool | None:
    said = host.run(["iw", "dev", name, "get", "power_save"])
    return None if said is None else said.strip().endswith("on")
