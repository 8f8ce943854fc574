"""A serial port as drivers need it: exclusive, never blocking, any baud rate."""

import errno
import fcntl
import os
import select
import sys
import termios

import serial

from trolley_base.drivers.dialogue import BITS_PER_BYTE, Line

MOST_READ = 4096
"""At most this much is read at a time; a device that floods cannot keep the reader in one call."""
FULL_BYTES = 4000
"""Linux keeps 4095 bytes of a port; beyond them more may wait or be lost."""
LEAST_QUEUED, QUEUED_S = 256, 0.1
"""What a line needs longer for, or more bytes than that, waits because nobody takes it [s]."""
PSEUDO_TERMINALS = "/dev/pts/"
NO_SUCH_LINE = (errno.ENOTTY, errno.EINVAL, errno.EIO, errno.ENODEV, errno.ENXIO)
"""Errors of modem lines where there are none (a pseudo-terminal), and of a lost device."""


class SerialPort:
    """An open port, for one reading and one writing thread.

    Args:
        path: the device, or a link to it.

    Raises:
        OSError: it cannot be opened; `errno` says why (EBUSY: somebody else has it).
    """

    full_bytes = FULL_BYTES
    """After a read of so many, more may wait that is old."""

    def __init__(self, path: str, line: Line) -> None:
        self._line = line
        self._most_queued = max(LEAST_QUEUED, round(QUEUED_S * line.baud / BITS_PER_BYTE))
        self._serial = serial.Serial(None, line.baud, timeout=0, write_timeout=0, exclusive=True)
        self._serial.port = path
        if line.dtr is not None:
            self._serial.dtr = line.dtr
        self._unsent = b""
        self._is_pseudo = os.path.realpath(path).startswith(PSEUDO_TERMINALS)
        # A device may be unplugged at any of these steps.
        try:
            self._serial.open()
            self._prepare()
        except (OSError, termios.error, ValueError) as error:
            self._serial.close()
            raise _as_os_error(path, error) from error

    def _prepare(self) -> None:
        handle = self._serial.fileno()
        # pyserial's lock stops its own kind only, this one everybody. A pseudo-terminal would keep
        # it beyond a crash, as long as its other end lives.
        if not self._is_pseudo:
            fcntl.ioctl(handle, termios.TIOCEXCL)
        if self._line.dtr_after:
            # Else Linux clears DTR when the port is closed.
            attributes = termios.tcgetattr(handle)
            attributes[2] &= ~termios.HUPCL
            termios.tcsetattr(handle, termios.TCSANOW, attributes)

    def wait(self, timeout_s: float) -> bool:
        """Wait for bytes; whether there are any (or the device is gone, which `read` tells)."""
        return bool(select.select([self._serial.fileno()], [], [], timeout_s)[0])

    def read(self) -> bytes:
        """Return what has arrived, at most 4096 bytes; to be called when `wait` said so.

        Raises:
            OSError: the device is gone.
        """
        data = os.read(self._serial.fileno(), MOST_READ)
        if not data:
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        return data

    def write(self, data: bytes) -> bool:
        """Send bytes without waiting; False where the line took nothing and they were dropped.

        What the line took in part is completed first at the next call, so that no frame is cut.

        Raises:
            OSError: the device is gone.
        """
        waiting = self._unsent + data
        if not waiting:
            return True
        try:
            is_stuck = self._queued() > self._most_queued
            sent = 0 if is_stuck else os.write(self._serial.fileno(), waiting)
        except BlockingIOError:
            sent = 0
        if sent == 0 or sent < len(self._unsent):
            # A command that waits would be driven late: better none than an old one.
            self._flush(termios.TCOFLUSH)
            self._unsent = b""
            return False
        self._unsent = waiting[sent:]
        return True

    def _queued(self) -> int:
        """Return how many bytes wait to leave; 0 where the port does not say."""
        try:
            answer = fcntl.ioctl(self._serial.fileno(), termios.TIOCOUTQ, bytes(4))
        except OSError as error:
            if error.errno in NO_SUCH_LINE:
                return 0
            raise
        return int.from_bytes(answer, sys.byteorder)

    def discard_input(self) -> None:
        """Drop what has arrived and was not read.

        Raises:
            OSError: the device is gone.
        """
        self._flush(termios.TCIFLUSH)

    def clear_rts(self) -> None:
        """Clear RTS, if there is such a line.

        Raises:
            OSError: the device is gone.
        """
        try:
            self._serial.rts = False
        except OSError as error:
            if error.errno not in NO_SUCH_LINE:
                raise

    def close(self) -> None:
        """Set DTR as the line says, and let go of the port; may be called more than once."""
        if not self._serial.is_open:
            return
        try:
            if self._line.dtr_after is not None:
                self._serial.dtr = self._line.dtr_after
            if not self._is_pseudo:
                fcntl.ioctl(self._serial.fileno(), termios.TIOCNXCL)
        except OSError as error:
            if error.errno not in NO_SUCH_LINE:
                raise
        finally:
            self._serial.close()

    def _flush(self, queue: int) -> None:
        try:
            termios.tcflush(self._serial.fileno(), queue)
        except termios.error as error:
            raise OSError(*error.args) from error


def _as_os_error(path: str, error: Exception) -> OSError:
    """Return the system's error behind what opening raised: pyserial's, or one of `termios`."""
    number = errno.ENOTTY
    cause: BaseException | None = error
    while cause is not None:  # pyserial leaves some of them in the context only
        if cause.args and isinstance(cause.args[0], int):
            number = cause.args[0]
            break
        cause = cause.__context__
    if number in (errno.EAGAIN, errno.EACCES) and "lock" in str(error):
        number = errno.EBUSY
    return OSError(number, os.strerror(number), path)
