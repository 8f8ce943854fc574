"""Inertial units on an I2C bus, register by register as their data sheets have it.

Written from InvenSense RM-MPU-6000A and DS-000189, Bosch BST-BNO055-DS000 and CEVA 1000-3625 and
1000-3535, apart from the drivers. The bus is what `smbus2.SMBus` is to its user.
"""

import errno
import math
import random
import struct
import time
from typing import Any

READS = 1
"""I2C_M_RD."""


class Motion:
    """What the chips feel: along and about their own axes."""

    def __init__(self) -> None:
        self.rates = (0.0, 0.0, 0.0)
        self.accelerations = (0.0, 0.0, 9.81)
        self.is_frozen = False
        self._noise = random.Random(7)

    def counts(self, values: tuple[float, ...], per_unit: float) -> tuple[int, ...]:
        """In whole counts, the last one trembling."""
        shake = 0 if self.is_frozen else 1
        told = (round(one * per_unit) + self._noise.randint(-shake, shake) for one in values)
        return tuple(max(-32768, min(32767, one)) for one in told)


class RegisterChip:
    """A chip whose first written byte is a register's number, which goes on by itself."""

    def __init__(self, motion: Motion) -> None:
        self.motion = motion
        self.registers = bytearray(256)
        self._at = 0
        self.power_up()

    def power_up(self) -> None:
        """All registers as after a reset."""
        raise NotImplementedError

    def written(self, register: int, value: int) -> None:
        """Take what was written to a register."""
        self.registers[register] = value

    def refresh(self) -> None:
        """Put the newest measurement into the registers."""

    def write(self, data: bytes) -> None:
        self._at = data[0]
        for value in data[1:]:
            self.written(self._at, value)
            self._at = self._at + 1 & 0xFF

    def read(self, count: int) -> bytes:
        self.refresh()
        found = bytes(self.registers[self._at + place & 0xFF] for place in range(count))
        self._at = self._at + count & 0xFF
        return found


class FakeMpu6050(RegisterChip):
    """It sleeps after a reset, and measures nothing then."""

    who = 0x68

    def power_up(self) -> None:
        self.registers = bytearray(256)
        self.registers[0x75] = self.who
        self.registers[0x6B] = 0x40  # SLEEP

    def written(self, register: int, value: int) -> None:
        if register == 0x6B and value & 0x80:
            self.power_up()
        elif register != 0x75:
            self.registers[register] = value

    def refresh(self) -> None:
        if self.registers[0x6B] & 0x40:
            return
        per_g = 16384 >> (self.registers[0x1C] >> 3 & 3)
        per_degree = 131.0 / (1 << (self.registers[0x1B] >> 3 & 3))
        pulled = self.motion.counts(self.motion.accelerations, per_g / 9.80665)
        turned = self.motion.counts(self.motion.rates, math.degrees(per_degree))
        self.registers[0x3B:0x49] = struct.pack(">7h", *pulled, -521, *turned)


class FakeIcm20948(RegisterChip):
    """Four banks of registers; which of them is in force stands in the last one."""

    def power_up(self) -> None:
        self._banks = [bytearray(128) for _ in range(4)]
        self._banks[0][0x00] = 0xEA
        self._banks[0][0x06] = 0x41
        self._banks[2][0x01] = 0x01
        self._banks[2][0x14] = 0x01
        self._bank = 0

    def written(self, register: int, value: int) -> None:
        if register == 0x7F:
            self._bank = value >> 4 & 3
        elif (self._bank, register) == (0, 0x06) and value & 0x80:
            self.power_up()
        else:
            self._banks[self._bank][register] = value

    def read(self, count: int) -> bytes:
        if not self._banks[0][0x06] & 0x40:
            wide = self._banks[2][0x01] >> 1 & 3, self._banks[2][0x14] >> 1 & 3
            turned = self.motion.counts(self.motion.rates, math.degrees(131.0 / (1 << wide[0])))
            per_g = 16384 >> wide[1]
            pulled = self.motion.counts(self.motion.accelerations, per_g / 9.80665)
            self._banks[0][0x2D:0x3B] = struct.pack(">7h", *pulled, *turned, 300)
        bank = self._banks[self._bank]
        found = bytes(bank[self._at + place & 0x7F] for place in range(count))
        self._at = self._at + count & 0x7F
        return found


class FakeBno055(RegisterChip):
    """It boots for 650 ms, and measures in an operation mode alone."""

    boots_s = 0.65

    def __init__(self, motion: Motion) -> None:
        super().__init__(motion)
        self._up_s = 0.0  # it has had its supply for long

    def power_up(self) -> None:
        self.registers = bytearray(256)
        self.registers[0x00:0x07] = bytes((0xA0, 0xFB, 0x32, 0x0F, 0x11, 0x03, 0x15))
        self.registers[0x3B] = 0x80
        self.registers[0x3D] = 0x10
        self._up_s = time.monotonic() + self.boots_s

    @property
    def is_deaf(self) -> bool:
        return time.monotonic() < self._up_s

    def written(self, register: int, value: int) -> None:
        if register == 0x3F and value & 0x20:
            self.power_up()
            return
        is_configuring = self.registers[0x3D] & 0x0F == 0
        if register in (0x07, 0x3D, 0x3E) or is_configuring:
            self.registers[register] = value

    def refresh(self) -> None:
        mode = self.registers[0x3D] & 0x0F
        if mode == 0:
            return
        pulls, turns = mode in (1, 4, 5, 7, 8, 9, 10, 11, 12), mode in (3, 5, 6, 7, 8, 11, 12)
        in_radians = self.registers[0x3B] & 2
        per_rate = 900.0 if in_radians else math.degrees(16.0)
        none = (0, 0, 0)
        pulled = self.motion.counts(self.motion.accelerations, 100.0) if pulls else none
        turned = self.motion.counts(self.motion.rates, per_rate) if turns else none
        self.registers[0x08:0x1A] = struct.pack("<9h", *pulled, *none, *turned)


class FakeBno085:
    """A computer of its own behind SHTP."""

    def __init__(self, motion: Motion) -> None:
        self.motion = motion
        self._numbers = [0] * 6
        self._began_s = time.monotonic()
        self.reset()

    def reset(self) -> None:
        self._packets: list[tuple[int, bytes]] = [
            (0, bytes((0, 1, 4)) + bytes(269)),  # what it can: longer than one would think
            (1, bytes((1,))),
            (2, bytes((0xF1, 0, 0x84, 0, 0, 0, 1)) + bytes(9)),
        ]
        self._intervals: dict[int, float] = {}
        self._due_s: dict[int, float] = {}
        self._head: bytes | None = None
        self._sequence = 0

    def write(self, data: bytes) -> None:
        length, channel = struct.unpack_from("<HB", data)
        assert length == len(data), "the length does not count its own head"
        body = data[4:]
        if channel == 1 and body == b"\1":
            self.reset()
        elif channel == 2 and body[0] == 0xF9:
            told = struct.pack("<BBBBIIHH", 0xF8, 1, 3, 2, 10003608, 370, 6, 0)
            self._packets.append((2, told))
        elif channel == 2 and body[0] == 0xFD:
            feature, interval = body[1], struct.unpack_from("<I", body, 5)[0]
            self._intervals[feature] = interval * 1e-6
            self._due_s[feature] = time.monotonic()
            self._packets.append((2, bytes((0xFC,)) + body[1:]))

    def _measure(self) -> None:
        now_s = time.monotonic()
        for feature, due_s in list(self._due_s.items()):
            if now_s < due_s:
                continue
            self._due_s[feature] = max(due_s + self._intervals[feature], now_s - 0.1)
            values, per_unit = {
                0x01: (self.motion.accelerations, 256.0),
                0x02: (self.motion.rates, 512.0),
            }[feature]
            self._sequence = self._sequence + 1 & 0xFF
            stamp = struct.pack("<Bi", 0xFB, 12)
            told = self.motion.counts(values, per_unit)
            report = struct.pack("<BBBB3h", feature, self._sequence, 3, 0, *told)
            self._packets.append((3, stamp + report))

    def read(self, count: int) -> bytes:
        self._measure()
        if not self._packets:
            return bytes(count)
        channel, body = self._packets[0]
        whole = struct.pack("<HBB", len(body) + 4, channel, self._numbers[channel]) + body
        if count >= len(whole):
            self._packets.pop(0)
            self._numbers[channel] = self._numbers[channel] + 1 & 0xFF
        return whole[:count] + bytes(max(0, count - len(whole)))


class FakeSMBus:
    """`/dev/i2c-1` with chips on it."""

    def __init__(self) -> None:
        self.chips: dict[int, Any] = {}
        self.num_opened = 0
        self.failures = 0
        """So many of the next transfers fail."""

    def open(self, number: int) -> "FakeSMBus":
        if number != 1:
            raise FileNotFoundError(errno.ENOENT, "No such file or directory")
        self.num_opened += 1
        return self

    def i2c_rdwr(self, *messages: Any) -> None:
        if self.failures > 0:
            self.failures -= 1
            raise OSError(errno.EIO, "Input/output error")
        for message in messages:
            chip = self.chips.get(message.addr)
            if chip is None or getattr(chip, "is_deaf", False):
                raise OSError(errno.EREMOTEIO, "Remote I/O error")
            if message.flags & READS:
                for place, octet in enumerate(chip.read(message.len)):
                    message.buf[place] = bytes((octet,))
            elif message.len:  # else somebody only asks who is there
                chip.write(bytes(message))

    def close(self) -> None:
        """Nothing is left open."""
