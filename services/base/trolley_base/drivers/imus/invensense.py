"""InvenSense's chips that answer register by register: MPU-6050 and its like, ICM-20948.

Both give accelerations and rates as big-endian words of 16 bits, here ±2 g and ±500 °/s, low-passed
at 42 and 51 Hz so that motors do not alias into what is read 50 times a second.

Source:
    InvenSense RM-MPU-6000A-00 4.2 (MPU-6000/6050 register map); DS-000189 1.3 (ICM-20948).
"""

import math
import struct

from trolley_base.drivers.imus.bus import Bus
from trolley_base.drivers.imus.models import ONE_G, ChipFacts, ImuError, Sample, Wait

RESET, AWAKE = 0x80, 0x01
"""Of the first register of power management: all as at power-up; awake, by the gyro's clock."""
RESET_S, STARTS_S = 0.1, 0.05
ACCELERATION = ONE_G / 16384.0
"""A count at ±2 g [m/s^2]."""
RATE = math.radians(1.0 / 65.5)
"""A count at ±500 °/s [rad/s]."""


def _sample(accelerations: bytes, rates: bytes) -> Sample:
    ax, ay, az = struct.unpack(">3h", accelerations)
    gx, gy, gz = struct.unpack(">3h", rates)
    return Sample(
        (gx * RATE, gy * RATE, gz * RATE),
        (ax * ACCELERATION, ay * ACCELERATION, az * ACCELERATION),
    )


class Mpu6050:
    """An MPU-6050, or one of those with the same registers.

    Args:
        address: 0x68, or 0x69 where AD0 is high.
    """

    POWER, IDENTITY, MEASURED, CONFIG = 0x6B, 0x75, 0x3B, 0x1A
    KNOWN = frozenset((0x68, 0x70, 0x71, 0x73))
    """MPU-6050, 6500, 9250, 9255; clones of the first say one of these, too."""
    SETTINGS = bytes((3, 1 << 3, 0 << 3))
    """From CONFIG on: low pass of 42 Hz, ±500 °/s, ±2 g."""

    def __init__(self, address: int) -> None:
        self._address = address

    def begin(self, bus: Bus, wait: Wait) -> None:
        """Reset it, see that it is the right one, and start it."""
        found = bus.read_register(self._address, self.IDENTITY, 1)[0]
        if found not in self.KNOWN:
            raise ImuError(f"says it is 0x{found:02X}, which is no MPU-6050")
        bus.write(self._address, bytes((self.POWER, RESET)))
        wait(RESET_S)
        bus.write(self._address, bytes((self.POWER, AWAKE)))
        bus.write(self._address, bytes((self.CONFIG,)) + self.SETTINGS)
        wait(STARTS_S)

    def read(self, bus: Bus) -> Sample:
        """Return what it measured last, all of the same moment."""
        data = bus.read_register(self._address, self.MEASURED, 14)
        return _sample(data[:6], data[8:])  # between them lies the temperature


class Icm20948:
    """An ICM-20948, whose registers lie in four banks.

    Args:
        address: 0x68, or 0x69 where AD0 is high (as on SparkFun's board).
    """

    BANK, IDENTITY, POWER, MEASURED = 0x7F, 0x00, 0x06, 0x2D
    NUMBER = 0xEA
    GYRO, ACCELEROMETER = 0x01, 0x14
    """In bank 2."""
    LOW_PASS, WIDE = 3 << 3 | 1, 1 << 1
    """Of both: 51 and 50 Hz, low pass on; ±500 °/s (±2 g is 0)."""

    def __init__(self, address: int) -> None:
        self._address = address

    def begin(self, bus: Bus, wait: Wait) -> None:
        """Reset it, see that it is the right one, and start it."""
        self._select(bus, 0)
        found = bus.read_register(self._address, self.IDENTITY, 1)[0]
        if found != self.NUMBER:
            raise ImuError(f"says it is 0x{found:02X}, which is no ICM-20948")
        bus.write(self._address, bytes((self.POWER, RESET)))
        wait(RESET_S)
        bus.write(self._address, bytes((self.POWER, AWAKE)))
        wait(STARTS_S)
        self._select(bus, 2)
        bus.write(self._address, bytes((self.GYRO, self.LOW_PASS | self.WIDE)))
        bus.write(self._address, bytes((self.ACCELEROMETER, self.LOW_PASS)))
        self._select(bus, 0)
        wait(STARTS_S)

    def _select(self, bus: Bus, bank: int) -> None:
        bus.write(self._address, bytes((self.BANK, bank << 4)))

    def read(self, bus: Bus) -> Sample:
        """Return what it measured last, all of the same moment."""
        data = bus.read_register(self._address, self.MEASURED, 12)
        return _sample(data[:6], data[6:])


CHIPS = {
    "mpu6050": ChipFacts("MPU-6050", 0x68, Mpu6050),
    "icm20948": ChipFacts("ICM-20948", 0x69, Icm20948),
}
