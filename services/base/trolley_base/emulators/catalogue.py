"""The devices that can be emulated, by name, and their options."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trolley_base.emulators import (
    camsense,
    coin_d4,
    delta2,
    hokuyo,
    ld19,
    lds01,
    rplidar,
    xv11,
    ydlidar,
)
from trolley_base.emulators.arduino_bridge import ArduinoBridge, WheelFacts
from trolley_base.emulators.create2 import Create2
from trolley_base.emulators.device import Board, Device, DeviceError
from trolley_base.emulators.hoverboard import Hoverboard
from trolley_base.emulators.lidar import MakeLidar, Mount
from trolley_base.emulators.linorobot import Linorobot, LinorobotOptions
from trolley_base.emulators.linorobot2 import Linorobot2, Linorobot2Options
from trolley_base.emulators.waveshare_ugv import WaveshareUgv
from trolley_base.world import LidarSpec

FAMILIES = (rplidar, ydlidar, ld19, xv11, lds01, camsense, hokuyo, delta2, coin_d4)
"""The emulators' modules; each knows one protocol, and its models by name in `LIDARS`."""
LIDARS: dict[str, MakeLidar] = {
    name: make for family in FAMILIES for name, make in family.LIDARS.items()
}
BOARDS = {
    "linorobot": {
        "exact": "its wheel speeds are not rounded to whole revolutions per minute",
        "quiet": "built without DEBUG: no log lines",
        "no-imu": "no inertial unit answers",
    },
    "linorobot2": {
        "uart": "an ESP32 behind a serial adapter at 115200 baud; else on USB of its own",
        "fast": "the same at 921600 baud, as a fork has it",
        "stops": "it stops its motors when it has lost its agent, as a fork does",
        "no-wdt": "nothing restarts it when it has given up",
        "2021": "the first version, whose reports are not acknowledged",
    },
    "arduino_bridge": {"no-base": "built without USE_BASE, as the sketch ships"},
    "waveshare_ugv": {
        "beast": "a UGV Beast, which has tracks; else a UGV Rover",
        "general": "with ugv_base_general: no counts, and a UGV Rover drives without encoders",
    },
    "create2": {"asleep": "it sleeps until its port is opened"},
    "hoverboard": {
        "tank": "built with TANK_STEERING",
        "voltage": "built with VLT_MODE, as it ships: its targets are no speeds",
    },
}
"""Boards and their options."""
NAMES = (*BOARDS, *LIDARS)


@dataclass(frozen=True, slots=True)
class Surroundings:
    """What devices are built from.

    Attributes:
        mount: how the lidars sit on the robot.
        errors: of the world's lidar.
        wheels: of a board that counts ticks.
    """

    mount: Mount
    errors: LidarSpec
    wheels: WheelFacts


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
        kind, _, options = text.partition(":")
        number = sum(name.partition("-")[0] == kind for name in devices) + 1
        name = kind if number == 1 else f"{kind}-{number}"
        devices[name] = _make(kind, options, surroundings, np.random.default_rng(stream))
    boards = [name for name, device in devices.items() if isinstance(device, Board)]
    if len(boards) > 1:
        raise DeviceError(f"a robot has one motor board, not {' and '.join(boards)}")
    return devices


def _make(kind: str, options: str, surroundings: Surroundings, rng: np.random.Generator) -> Device:
    given = set(filter(None, options.split(",")))
    known = BOARDS.get(kind, {})
    if kind not in NAMES:
        raise DeviceError(f"there is no device {kind!r}; there are {', '.join(NAMES)}")
    if given - set(known):
        have = f"only {', '.join(known)}" if known else "none"
        raise DeviceError(f"{kind} has no option {', '.join(sorted(given - set(known)))}; {have}")
    match kind:
        case "linorobot":
            built = LinorobotOptions(
                truncates="exact" not in given,
                debug="quiet" not in given,
                has_imu="no-imu" not in given,
            )
            return Linorobot(built, rng)
        case "linorobot2":
            build = Linorobot2Options(
                is_uart="uart" in given,
                is_fast="fast" in given,
                stops="stops" in given,
                is_of_2021="2021" in given,
                has_wdt="no-wdt" not in given,
            )
            return Linorobot2(build, rng)
        case "arduino_bridge":
            return ArduinoBridge(surroundings.wheels, use_base="no-base" not in given)
        case "waveshare_ugv":
            robot = "ugv_beast" if "beast" in given else "ugv_rover"
            return WaveshareUgv(robot, is_general="general" in given)
        case "create2":
            return Create2(is_asleep="asleep" in given)
        case "hoverboard":
            return Hoverboard(is_tank="tank" in given, is_voltage="voltage" in given)
        case _:
            return LIDARS[kind](surroundings.mount, surroundings.errors, rng)
