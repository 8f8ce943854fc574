"""An I2C bus of this computer, by `smbus2`: plain writes and reads, as the makers draw them."""

from typing import Protocol

MOST_READ = 1024


class Bus(Protocol):
    """What a chip's driver needs of a bus."""

    def write(self, address: int, data: bytes) -> None:
        """Send bytes.

        Raises:
            OSError: nobody acknowledges.
        """
        ...

    def read(self, address: int, count: int) -> bytes:
        """Receive bytes.

        Raises:
            OSError: nobody acknowledges.
        """
        ...

    def read_register(self, address: int, register: int, count: int) -> bytes:
        """Send a register's number and, without a stop between, receive what it holds.

        Raises:
            OSError: nobody acknowledges.
        """
        ...

    def close(self) -> None:
        """Let go of the bus."""
        ...


class LinuxBus:
    """`/dev/i2c-N`.

    Args:
        number: N.

    Raises:
        ImportError: `smbus2` is not installed.
        OSError: there is no such bus, or it may not be used.
    """

    def __init__(self, number: int) -> None:
        import smbus2

        self._message = smbus2.i2c_msg
        self._bus = smbus2.SMBus(number)

    def write(self, address: int, data: bytes) -> None:
        """Send bytes."""
        self._bus.i2c_rdwr(self._message.write(address, data))

    def read(self, address: int, count: int) -> bytes:
        """Receive bytes."""
        answer = self._message.read(address, count)
        self._bus.i2c_rdwr(answer)
        return bytes(answer)

    def read_register(self, address: int, register: int, count: int) -> bytes:
        """Send a register's number, and receive what it holds."""
        answer = self._message.read(address, count)
        self._bus.i2c_rdwr(self._message.write(address, [register]), answer)
        return bytes(answer)

    def close(self) -> None:
        """Let go of the bus."""
        self._bus.close()
