"""Checks of the serial ports that robot.toml names. None of them is opened."""

import dataclasses
import grp
import itertools
import os
import stat
from pathlib import Path

from trolley.config import RobotConfig
from trolley.doctor.finding import Finding, note, ok, problem, warning
from trolley.doctor.users import READ, WRITE, User, closed_at, rights_in_words
from trolley.drivers import BOARDS, LIDARS, Driver, Drivers
from trolley.network_ports import is_network
from trolley.serial_diagnosis import (
    Holder,
    Holders,
    holders,
    modem_manager_warning,
    ports_in_words,
)

BY_ORDER = ("ttyUSB", "ttyACM")
"""Names that go by the order in which devices were found."""


@dataclasses.dataclass(frozen=True)
class Port:
    """A serial port that a key of robot.toml names."""

    key: str
    path: str
    device: str = ""
    """The device itself, no link; "" where it is not there."""
    is_serial: bool = True
    forbidden: str = ""
    """The user that the services run as, and what keeps it out; "" if nothing does."""
    remedy: str = ""
    """How to let it in."""
    held_by: tuple[Holder, ...] = ()
    """Programs that have it open, those of Trolley's base left out."""
    is_seen_whole: bool = True
    """Whether it could be seen of every program what it has open."""
    others: str = ""
    """The ports that are there, in words."""
    modem_manager: str = ""
    is_of_network: bool = False
    """Whether it is no serial port but an address."""


def configured_ports(config: RobotConfig) -> list[tuple[str, str]]:
    """Key and port of each device that is set."""
    base = config.base
    if base.driver != "hardware":
        return []
    ports = [("base.lidar.port", base.lidar.port)]
    if base.chassis.board is not None:
        ports.append(("base.chassis.port", base.chassis.port))
    return ports


def read_ports(config: RobotConfig, user: User, proc: Path = Path("/proc")) -> list[Port]:
    """Look at each port that is set."""
    found: list[Port] = []
    for key, name in configured_ports(config):
        if is_network(name):
            found.append(Port(key, name, is_of_network=True))
            continue
        path = str(config.path(name)) if name else ""
        if not path or not Path(path).exists():
            found.append(Port(key, path, others=ports_in_words()))
            continue
        device = os.path.realpath(path)
        closed = closed_at(user, Path(device), READ | WRITE)
        seen = holders(path, proc)
        found.append(
            Port(
                key,
                path,
                device,
                is_serial=stat.S_ISCHR(Path(device).stat().st_mode),
                forbidden=""
                if closed is None
                else f"{user.name} may not use it ({closed} is {rights_in_words(closed)})",
                remedy="" if closed is None else _way_in(closed, user),
                held_by=_strangers(seen, proc),
                is_seen_whole=seen.is_complete,
                modem_manager=modem_manager_warning(path, proc) or "",
            )
        )
    return found


def _strangers(seen: Holders, proc: Path) -> tuple[Holder, ...]:
    """Who has a port open and is not Trolley's base, whose right that is."""
    found: list[Holder] = []
    for holder in seen.seen:
        try:
            words = (proc / str(holder.pid) / "cmdline").read_bytes().decode("utf-8", "replace")
        except OSError:  # it has just ended
            continue
        if not _is_base(words.split("\0")):
            found.append(holder)
    return tuple(found)


def _is_base(words: list[str]) -> bool:
    """Whether a command line is `trolley run base`, or the module behind it."""
    pairs = list(itertools.pairwise(words))
    return ("run", "base") in pairs or ("-m", "trolley_base") in pairs


def _way_in(closed: Path, user: User) -> str:
    status = closed.stat()
    groups_may = status.st_mode >> 3 & (READ | WRITE) == READ | WRITE and status.st_gid != 0
    if not groups_may:
        return "Install the udev rule that `trolley detect --udev` prints."
    try:
        group = grp.getgrgid(status.st_gid).gr_name
    except KeyError:
        group = str(status.st_gid)
    return f"`sudo usermod -aG {group} {user.name}`, then start its services (or log in) again."


def check_ports(ports: list[Port]) -> list[Finding]:
    """Whether each device is there, is the service's to use, and is its alone."""
    found = [finding for port in ports for finding in _check_port(port)]
    devices: dict[str, str] = {}
    for port in ports:
        if port.device and port.device in devices:
            found.append(
                problem(
                    "devices",
                    f"[{devices[port.device]}] and [{port.key}] name the same device, "
                    f"{port.device}.",
                    "`trolley detect` tells which is which.",
                )
            )
        devices.setdefault(port.device, port.key)
    return found


def _check_port(port: Port) -> list[Finding]:
    if port.is_of_network:
        text = f"{port.path} ([{port.key}]) is in the network: base says whether it answers."
        return [ok("devices", text)]
    if not port.path:
        return [problem("devices", f"[{port.key}] is not set.", "`trolley detect` finds the port.")]
    if not port.device:
        return [
            problem(
                "devices",
                f"{port.path} ([{port.key}]) is not there.",
                f"Plug it in, or find it with `trolley detect`. {port.others}",
            )
        ]
    if not port.is_serial:
        return [
            problem(
                "devices",
                f"{port.path} ([{port.key}]) is not a serial port.",
                f"`trolley detect` finds it. {port.others}",
            )
        ]
    found: list[Finding] = []
    if port.forbidden:
        found.append(problem("devices", f"{port.path}: {port.forbidden}.", port.remedy))
    if port.held_by:
        names = " and ".join(f"{one.command} (pid {one.pid})" for one in port.held_by)
        found.append(
            problem("devices", f"{port.path} is in use by {names}.", "End that program first.")
        )
    if port.modem_manager:
        found.append(
            warning(
                "devices",
                f"ModemManager may write to {port.path}, which confuses devices.",
                "Install the udev rule that `trolley detect --udev` prints, or "
                "`sudo systemctl disable --now ModemManager`.",
            )
        )
    if Path(port.path).name.startswith(BY_ORDER):
        found.append(
            warning(
                "devices",
                f"{port.path} ([{port.key}]) may be a different device after the next restart.",
                "`trolley detect` finds a name that stays the same.",
            )
        )
    if not found and not port.is_seen_whole:
        return [
            note(
                "devices",
                f"{port.path} ([{port.key}]) is there, but you may not see which program has it "
                "open.",
                "Run this again with `sudo`.",
            )
        ]
    return found or [ok("devices", f"{port.path} ([{port.key}]) is there and free to use.")]


def check_drivers() -> list[Finding]:
    """Whether the drivers that other packages bring along can be used; imports all there are."""
    found: list[Finding] = []
    for group in (BOARDS, LIDARS):
        known = Drivers(Driver, group)
        remedy = "Correct or uninstall that package; everything else works without it."
        found += [warning("devices", str(one), remedy) for one in known.refused()]
        good = [name for name in known.added if name in known]
        found += [ok("devices", f"The driver {name} can be used.") for name in good]
    return found
