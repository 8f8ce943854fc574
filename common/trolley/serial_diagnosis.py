"""Why a serial port cannot be used, in a sentence for a person: what is wrong and what to do.

Nothing here opens a port. What it looks at are the device file, the open files of processes
(`/proc`) and udev's notes about the device (`/run/udev/data`).
"""

import errno
import grp
import os
import stat
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

DEVICES = Path("/dev")
PROC = Path("/proc")
UDEV_DATA = Path("/run/udev/data")
MODEM_MANAGER = "ModemManager"
# Either of them keeps ModemManager away from a port.
IGNORED_BY_MODEM_MANAGER = ("ID_MM_DEVICE_IGNORE", "ID_MM_PORT_IGNORE")
MOST_LISTED = 4

GONE = (errno.ENOENT, errno.ENXIO, errno.ENODEV, errno.ENOTDIR)
FORBIDDEN = (errno.EACCES, errno.EPERM)
NOT_SERIAL = (errno.ENOTTY, errno.EINVAL, errno.EISDIR)


@dataclass(frozen=True, slots=True)
class Holder:
    """A process that has a port open."""

    pid: int
    command: str


@dataclass(frozen=True, slots=True)
class Holders:
    """Who has a port open.

    Attributes:
        seen: the processes that could be seen to have it open.
        is_complete: False where processes of other users could not be looked into.
    """

    seen: tuple[Holder, ...]
    is_complete: bool

    def in_words(self, port: str) -> str:
        """Say who it is, such as `by python3 (pid 812)`, and how to learn what cannot be seen."""
        others = [holder for holder in self.seen if holder.pid != os.getpid()]
        if others:
            names = [f"{holder.command} (pid {holder.pid})" for holder in others]
            return f"by {' and '.join(names)}"
        if self.seen:
            return "by this program itself (is one port named for two devices?)"
        if self.is_complete:
            return "by a program that cannot be seen from here (another container?)"
        return f"by a program of another user; `sudo fuser -v {port}` names it"


def explain(port: str, error: OSError) -> str:
    """Say why a port could not be opened, or was lost, and what to do about it.

    Args:
        port: the device, or a link to it.
        error: what opening, reading or writing raised.
    """
    code = error.errno
    if code in GONE or (code == errno.EIO and not Path(port).exists()):
        return f"{port} is not there: is the device unplugged? {ports_in_words()}"
    if code in FORBIDDEN:
        return _explain_forbidden(port, code)
    if code == errno.EBUSY:
        return f"{port} is in use {holders(port).in_words(port)}; end that program first."
    if code in NOT_SERIAL:
        return f"{port} is not a serial port: name a device such as /dev/ttyUSB0."
    if code == errno.EIO:
        return (
            f"{port} does not work (input/output error): the device has lost power or its cable "
            f"is loose; plug it in again."
        )
    return f"{port} cannot be used: {error.strerror or error}."


def holders(port: str, proc: Path = PROC) -> Holders:
    """Return the processes that have a port open, as far as this user may see them.

    Args:
        port: the device, or a link to it.
        proc: where the kernel shows its processes.
    """
    device = os.path.realpath(port)
    seen: list[Holder] = []
    is_complete = True
    for process in _processes(proc):
        try:
            if _has_open(process, device):
                seen.append(Holder(int(process.name), _command(process)))
        except PermissionError:
            is_complete = False
        except (FileNotFoundError, ProcessLookupError):
            continue  # it has just ended
    return Holders(tuple(seen), is_complete)


def modem_manager_warning(port: str, proc: Path = PROC, udev_data: Path = UDEV_DATA) -> str | None:
    """Warn where ModemManager runs and nothing keeps it from writing to a USB port.

    Args:
        port: the device, or a link to it.
        proc: where the kernel shows its processes.
        udev_data: where udev keeps what it knows of devices.
    """
    properties = udev_properties(port, udev_data)
    if properties.get("ID_BUS") != "usb":
        return None
    if any(properties.get(name) == "1" for name in IGNORED_BY_MODEM_MANAGER):
        return None
    if not any(_command(process) == MODEM_MANAGER for process in _processes(proc)):
        return None
    return (
        f"ModemManager runs and may write to {port}, which confuses devices: install the udev "
        f"rule that `trolley detect --udev` prints, or `sudo systemctl disable --now ModemManager`."
    )


def udev_properties(port: str, udev_data: Path = UDEV_DATA) -> dict[str, str]:
    """Return what udev knows of a port, such as ID_PATH and ID_SERIAL_SHORT; {} for none.

    Args:
        port: the device, or a link to it.
        udev_data: where udev keeps what it knows of devices.
    """
    try:
        status = Path(port).stat()
        if not stat.S_ISCHR(status.st_mode):
            return {}
        number = f"c{os.major(status.st_rdev)}:{os.minor(status.st_rdev)}"
        text = (udev_data / number).read_text(encoding="utf-8", errors="replace")
    except OSError:
        return {}  # no udev here, or no device: then nothing is known
    lines = (line.removeprefix("E:").partition("=") for line in text.splitlines())
    return {key: value for key, equals, value in lines if equals}


def own_unit() -> str | None:
    """Return the unit of systemd that this service runs as; None where somebody started it."""
    try:
        groups = (PROC / "self" / "cgroup").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return None
    names = [line.rpartition("/")[2].removesuffix(".service") for line in groups.splitlines()]
    return next((name for name in names if name.startswith("trolley-")), None)


def _explain_forbidden(port: str, code: int | None) -> str:
    """Say how to get at a port: which group may use it, or that the sandbox bars it."""
    try:
        status = Path(port).stat()
    except OSError:
        return f"{port} may not be opened by this user: a folder on the way to it is closed."
    unit = own_unit()
    if unit is not None and code == errno.EPERM:  # of rights alone it is EACCES
        return (
            f"{port} is barred by the sandbox of {unit}: `sudo systemctl edit {unit}`, write "
            f"[Service] and DeviceAllow=char-{os.major(status.st_rdev)} rw, and restart it."
        )
    mode = stat.filemode(status.st_mode)
    may_group = status.st_mode & (stat.S_IRGRP | stat.S_IWGRP) == stat.S_IRGRP | stat.S_IWGRP
    if not may_group or status.st_gid in (0, *os.getgroups()):
        return (
            f"{port} may not be opened by this user (its rights are {mode}): install the udev rule "
            f"that `trolley detect --udev` prints."
        )
    try:
        group = grp.getgrgid(status.st_gid).gr_name
    except KeyError:
        return f"{port} belongs to the group {status.st_gid}, which this system has no name for."
    if unit is not None:
        return (
            f"{port} may only be opened by the group {group}: `sudo usermod -aG {group} trolley`, "
            f"then `sudo systemctl restart {unit}`."
        )
    return (
        f"{port} may only be opened by the group {group}: `sudo usermod -aG {group} $USER`, then "
        f"log out and in again."
    )


def ports_in_words() -> str:
    """Name some ports that are there."""
    places = ("serial/by-id/*", "ttyUSB*", "ttyACM*", "ttyAMA*")
    known: dict[str, str] = {}
    for place in places:
        for path in sorted(DEVICES.glob(place)):
            known.setdefault(os.path.realpath(path), str(path))
    if not known:
        return "No serial port is there (a charge-only cable shows none either)."
    names = list(known.values())
    more = f" and {len(names) - MOST_LISTED} more" if len(names) > MOST_LISTED else ""
    return f"There are {', '.join(names[:MOST_LISTED])}{more}."


def _processes(proc: Path) -> Iterator[Path]:
    return (entry for entry in proc.iterdir() if entry.name.isdigit())


def _has_open(process: Path, device: str) -> bool:
    for link in (process / "fd").iterdir():
        try:
            if os.readlink(link) == device:
                return True
        except FileNotFoundError:
            continue  # closed in the meantime
    return False


def _command(process: Path) -> str:
    """Return the name of a process's program."""
    try:
        return (process / "comm").read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return "a program that has ended"
