"""Bosch's BNO055, read as an accelerometer and a gyro: what it fuses of them is left out.

Source:
    Bosch BST-BNO055-DS000-18: registers of page 0, operation modes, units.
"""

import math
import struct

from trolley_base.drivers.imus.bus import Bus
from trolley_base.drivers.imus.models import ChipFacts, ImuError, Sample, Wait

CHIP_ID, PAGE_ID, MEASURED, UNITS, MODE, POWER, TRIGGER = 0x00, 0x07, 0x08, 0x3B, 0x3D, 0x3E, 0x3F
NUMBER = 0xA0
CONFIGURE, ACCELERATION_AND_GYRO = 0x00, 0x05
RESET, NORMAL = 0x20, 0x00
METRES_AND_DEGREES = 0x00
BOOTS_S, ASK_S, MOST_S = 0.65, 0.05, 1.5
"""It answers 650 ms after a reset; what it says before is no answer."""
SWITCHES_S = 0.03
ACCELERATION, RATE = 0.01, math.radians(1.0 / 16.0)
"""A count [m/s^2], [rad/s]."""


class Bno055:
    """The chip.

    Args:
        address: 0x28, or 0x29 where ADR (COM3) is high.
    """

    def __init__(self, address: int) -> None:
        self._address = address

    def begin(self, bus: Bus, wait: Wait) -> None:
        """Reset it, see that it is the right one, and start it."""
        self._identify(bus)
        self._set(bus, MODE, CONFIGURE)
        wait(SWITCHES_S)
        self._set(bus, TRIGGER, RESET)
        wait(BOOTS_S)
        self._wait_until_it_is_back(bus, wait)
        self._set(bus, POWER, NORMAL)
        self._set(bus, PAGE_ID, 0)
        self._set(bus, UNITS, METRES_AND_DEGREES)
        self._set(bus, MODE, ACCELERATION_AND_GYRO)
        wait(SWITCHES_S)

    def _identify(self, bus: Bus) -> None:
        found = bus.read_register(self._address, CHIP_ID, 1)[0]
        if found != NUMBER:
            raise ImuError(f"says it is 0x{found:02X}, which is no BNO055")

    def _wait_until_it_is_back(self, bus: Bus, wait: Wait) -> None:
        for _ in range(round(MOST_S / ASK_S)):
            try:
                self._identify(bus)
            except (OSError, ImuError):
                wait(ASK_S)
            else:
                return
        self._identify(bus)

    def _set(self, bus: Bus, register: int, value: int) -> None:
        bus.write(self._address, bytes((register, value)))

    def read(self, bus: Bus) -> Sample:
        """Return what it measured last."""
        data = bus.read_register(self._address, MEASURED, 18)
        ax, ay, az = struct.unpack_from("<3h", data)
        gx, gy, gz = struct.unpack_from("<3h", data, 12)  # between them lies the magnetic field
        return Sample(
            (gx * RATE, gy * RATE, gz * RATE),
            (ax * ACCELERATION, ay * ACCELERATION, az * ACCELERATION),
        )


CHIPS = {"bno055": ChipFacts("BNO055", 0x28, Bno055)}
