"""CEVA's BNO085 (BNO080, BNO086): a computer of its own, which sends reports in packets (SHTP).

A packet begins with its length, 15 bits of two bytes, its channel and its number. Who reads four
bytes learns the length; the next read brings the whole packet, with such a head again. After a
reset it tells what it can, which is read and left out. It is asked for calibrated rates and
accelerations every 20 ms; each comes as a report behind a time stamp.

Source:
    CEVA 1000-3625 (SHTP), 1000-3535 (SH-2 reference manual): channels, reports, Q points.
"""

import struct

from trolley_base.drivers.imus.bus import MOST_READ, Bus
from trolley_base.drivers.imus.models import PERIOD_S, ChipFacts, ImuError, Sample, Vector, Wait

EXECUTABLE, CONTROL, REPORTS = 1, 2, 3
"""Channels."""
RESET_COMMAND, RESET_DONE = 1, 1
"""On the channel of the executable."""
ASK_ID, ID, SET_FEATURE = 0xF9, 0xF8, 0xFD
ACCELERATION, RATES = 0x01, 0x02
Q = {ACCELERATION: 1.0 / (1 << 8), RATES: 1.0 / (1 << 9)}
"""A count of each [m/s^2], [rad/s]."""
LENGTHS = {0xFB: 5, 0xFA: 5, ACCELERATION: 10, RATES: 10}
"""Of what comes on the channel of reports: two time stamps, and the two that were asked for."""
BOOTS_S, ASK_S, MOST_TRIES = 0.3, 0.02, 50
MOST_AT_ONCE = 8
"""Packets that are taken at each look: two are due."""


class Bno085:
    """The chip.

    Args:
        address: 0x4A, or 0x4B where DI (SA0) is high.
    """

    def __init__(self, address: int) -> None:
        self._address = address
        self._numbers = [0] * 6
        self._accelerations: Vector | None = None

    def begin(self, bus: Bus, wait: Wait) -> None:
        """Reset it, see that it is the right one, and ask for reports."""
        self._send(bus, EXECUTABLE, bytes((RESET_COMMAND,)))
        wait(BOOTS_S)
        self._numbers = [0] * 6
        self._accelerations = None
        self._send(bus, CONTROL, bytes((ASK_ID, 0)))
        for _ in range(MOST_TRIES):
            packet = self._receive(bus)
            if packet is None:
                wait(ASK_S)
            elif packet[0] == CONTROL and packet[1][:1] == bytes((ID,)):
                break
        else:
            raise ImuError("does not say who it is: is it a BNO085 with both PS pins low (I2C)?")
        for report in (ACCELERATION, RATES):
            asked = struct.pack("<BBBHIII", SET_FEATURE, report, 0, 0, round(PERIOD_S * 1e6), 0, 0)
            self._send(bus, CONTROL, asked)

    def _send(self, bus: Bus, channel: int, body: bytes) -> None:
        number, self._numbers[channel] = self._numbers[channel], self._numbers[channel] + 1 & 0xFF
        bus.write(self._address, struct.pack("<HBB", len(body) + 4, channel, number) + body)

    def _receive(self, bus: Bus) -> tuple[int, bytes] | None:
        """Return a packet's channel and body; None where none waits."""
        (length,) = struct.unpack_from("<H", bus.read(self._address, 4))
        length &= 0x7FFF
        if length <= 4 or length == 0x7FFF:
            return None
        data = bus.read(self._address, min(length, MOST_READ))
        return data[2], data[4:]

    def read(self, bus: Bus) -> Sample | None:
        """Return the newest rates with the newest accelerations; None while nothing new is there.

        A look takes several packets, since two are due.
        """
        rates: Vector | None = None
        for _ in range(MOST_AT_ONCE):
            packet = self._receive(bus)
            if packet is None:
                break
            channel, body = packet
            if channel == EXECUTABLE and body[:1] == bytes((RESET_DONE,)):
                raise ImuError("has restarted: is its supply weak, or its reset pin loose?")
            if channel == REPORTS:
                rates = self._take(body) or rates
        if rates is None or self._accelerations is None:
            return None
        return Sample(rates, self._accelerations)

    def _take(self, body: bytes) -> Vector | None:
        """Read reports; return the newest rates among them."""
        rates: Vector | None = None
        while body and len(body) >= (length := LENGTHS.get(body[0], len(body) + 1)):
            if body[0] in Q:
                x, y, z = struct.unpack_from("<3h", body, 4)
                unit = Q[body[0]]
                found = (x * unit, y * unit, z * unit)
                if body[0] == RATES:
                    rates = found
                else:
                    self._accelerations = found
            body = body[length:]
        return rates


CHIPS = {"bno085": ChipFacts("BNO085", 0x4A, Bno085)}
