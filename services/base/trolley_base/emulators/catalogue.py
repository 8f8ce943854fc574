"""The devices that can be emulated, by name, and their options: what the drivers name."""

from collections.abc import Mapping, Sequence
from typing import Any, cast

import numpy as np

from trolley.drivers import Driver, DriverUnusable, load_named
from trolley_base.drivers import boards, lidars
from trolley_base.emulators.device import Board, Device, DeviceError
from trolley_base.emulators.lidar import MakeLidar
from trolley_base.emulators.surroundings import EmulatedBoard, Surroundings

LEFT_OUT: dict[str, str] = {}
"""Emulators that cannot be used, by name, and why."""


def _emulators(drivers: Mapping[str, Driver]) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name, driver in drivers.items():
        try:
            if driver.emulator:
                found[name] = load_named(driver.emulator, name)
        except DriverUnusable as error:
            LEFT_OUT[name] = str(error)
    return found


def _boards() -> dict[str, EmulatedBoard]:
    found: dict[str, EmulatedBoard] = {}
    for name, emulator in _emulators(boards.BOARDS).items():
        if isinstance(emulator, EmulatedBoard):
            found[name] = emulator
        else:
            LEFT_OUT[name] = "its emulator is no EmulatedBoard"
    return found


def _lidars() -> dict[str, MakeLidar]:
    found: dict[str, MakeLidar] = {}
    for name, emulator in _emulators(lidars.MODELS).items():
        if callable(emulator):
            found[name] = cast("MakeLidar", emulator)
        else:
            LEFT_OUT[name] = "its emulator cannot be called to make a device"
    return found


BOARDS: Mapping[str, EmulatedBoard] = _boards()
LIDARS: Mapping[str, MakeLidar] = _lidars()
NAMES = (*BOARDS, *LIDARS)


def make_devices(wanted: Sequence[str], surroundings: Surroundings, seed: int) -> dict[str, Device]:
    """Build devices, each with random errors of its own.

    Args:
        wanted: such as "ld19" or "linorobot:quiet,exact".
        surroundings: what they are built from.
        seed: fixes all their errors.

    Returns:
        The devices by the names of their ports: a second "ld19" is "ld19-2".

    Raises:
        DeviceError: there is no such device or option, or more than one board.
    """
    if not wanted:
        raise DeviceError(f"name a device: {', '.join(NAMES)}")
    devices: dict[str, Device] = {}
    streams = np.random.SeedSequence(seed).spawn(len(wanted))
    for text, stream in zip(wanted, streams, strict=True):
        kind, options = parse_device(text)
        number = sum(kind_of(name) == kind for name in devices) + 1
        name = kind if number == 1 else f"{kind}-{number}"
        rng = np.random.default_rng(stream)
        if kind in BOARDS:
            devices[name] = BOARDS[kind].make(options, surroundings, rng)
        else:
            devices[name] = LIDARS[kind](surroundings.mount, surroundings.errors, rng)
    found = [name for name, device in devices.items() if isinstance(device, Board)]
    if len(found) > 1:
        raise DeviceError(f"a robot has one motor board, not {' and '.join(found)}")
    return devices


def parse_device(text: str) -> tuple[str, frozenset[str]]:
    """Read a device such as "linorobot:quiet,exact": its name, and its options.

    Raises:
        DeviceError: there is no such device or option.
    """
    kind, _, options = text.partition(":")
    given = frozenset(filter(None, options.split(",")))
    if kind not in NAMES:
        why = f"; {kind}: {LEFT_OUT[kind]}" if kind in LEFT_OUT else ""
        raise DeviceError(f"there is no device {kind!r}; there are {', '.join(NAMES)}{why}")
    known: Mapping[str, str] = BOARDS[kind].options if kind in BOARDS else {}
    if given - set(known):
        have = f"only {', '.join(known)}" if known else "none"
        raise DeviceError(f"{kind} has no option {', '.join(sorted(given - set(known)))}; {have}")
    return kind, given


def kind_of(port: str) -> str:
    """Return which device a port's name stands for: that of "ld19-2" is "ld19"."""
    return port.partition("-")[0]
