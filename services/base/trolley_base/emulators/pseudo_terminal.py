"""The serial port of an emulated device: a pseudo terminal with a name of its own.

The host opens `link`, which leads to the terminal's slave side. It may close and open it again;
what is sent while nobody has it open is lost, as on a cable.
"""

import errno
import fcntl
import os
import select
import struct
import termios
import tty
from pathlib import Path

TCGETS2, TCSETS2 = 0x802C542A, 0x402C542B
"""Linux' calls for any speed, asm-generic/ioctls.h; struct termios2 is 44 bytes."""
_TERMIOS2 = "<4I20B2I"
_CBAUD, _CBAUDEX, _BOTHER = 0o10017, 0o10000, 0o10000
MOST_UNREAD = 4096
"""What a host that does not read finds when it does: more is lost."""
READ_BYTES = 4096


class PortError(OSError):
    """A port cannot be made; the text says where and what to do."""


class PseudoTerminal:
    """One port.

    Args:
        link: the name under which the host finds it.
        baud: the device's speed; a host that sets none has this one.

    Raises:
        PortError: there is something else of that name.
    """

    def __init__(self, link: Path, baud: int) -> None:
        self.link = link
        self._baud = baud
        self._poll = select.poll()
        self._master: int | None = None
        self._name = ""
        self.is_open = False
        """Whether a host has it open, as of the last `look`."""
        self._unread = b""
        self._last_words = b""
        self._is_refusing = False
        self.plug()

    @property
    def is_plugged(self) -> bool:
        """Whether there is a terminal."""
        return self._master is not None

    @property
    def fileno(self) -> int | None:
        """What to wait on for the host's bytes; None while no host can send any."""
        return self._master if self.is_open else None

    @property
    def device(self) -> str:
        """The slave's own name, such as /dev/pts/5; "" while there is no terminal."""
        return self._name

    def plug(self) -> None:
        """Make the terminal and its link."""
        if self.link.exists() and not self.link.is_symlink():
            raise PortError(f"{self.link} exists and is not a link; choose another folder")
        self._is_refusing = False
        self._master, slave = os.openpty()
        self._poll.register(self._master, select.POLLIN)
        os.set_blocking(self._master, False)
        self._name = os.ttyname(slave)
        self._settle(slave)
        os.close(slave)
        self.link.unlink(missing_ok=True)
        self.link.symlink_to(self._name)

    def unplug(self) -> None:
        """Take terminal and link away; a host that has it open reads its end."""
        if self._master is None:
            return
        self._poll.unregister(self._master)
        os.close(self._master)
        self._master = None
        self.is_open = False
        self._unread = b""
        if self.link.is_symlink() and os.readlink(self.link) == self._name:
            self.link.unlink()  # unless another emulator has taken it over
        self._name = ""

    def look(self) -> bool:
        """Find out whether a host has it open; True when one has just opened it."""
        if self._master is None:
            return False
        was_open = self.is_open
        self.is_open = not any(event & select.POLLHUP for _, event in self._poll.poll(0))
        if was_open and not self.is_open:
            while data := self._take():
                self._last_words += data
            self._unread = b""
            self._prepare_for_next()
        return self.is_open and not was_open

    def read(self) -> bytes:
        """Return what the host has written since the last call, be it gone meanwhile."""
        data = self._last_words + self._take()
        self._last_words = b""
        return data

    def _take(self) -> bytes:
        if self._master is None:
            return b""
        try:
            return os.read(self._master, READ_BYTES)
        except BlockingIOError:
            return b""
        except OSError as error:
            if error.errno == errno.EIO:  # nobody has the other side open
                return b""
            raise

    def write(self, data: bytes) -> None:
        """Send bytes to the host, if one has it open and reads now and then."""
        if self._master is None or not self.is_open:
            return
        self._unread = (self._unread + data)[:MOST_UNREAD]
        if not self._unread:
            return
        try:
            written = os.write(self._master, self._unread)
        except BlockingIOError:
            return
        self._unread = self._unread[written:]

    def refuse(self, *, is_refused: bool) -> None:
        """Take nothing of what the host writes, as an adapter that hangs; or take it again."""
        if self._master is None or is_refused == self._is_refusing:
            return
        try:
            slave = os.open(self.device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        except OSError as error:
            raise PortError(f"{self.link}: the terminal cannot be held: {error}") from error
        termios.tcflow(slave, termios.TCOOFF if is_refused else termios.TCOON)
        os.close(slave)
        self._is_refusing = is_refused

    def host_baud(self) -> int:
        """The speed that the host has set; the device's own where it has set none."""
        if self._master is None:
            return self._baud
        return struct.unpack(_TERMIOS2, _get(self._master))[-1]

    def _prepare_for_next(self) -> None:
        """Drop what the last host has not read, and its settings."""
        try:
            slave = os.open(self.device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        except OSError as error:
            if error.errno not in (errno.EBUSY, errno.EIO):
                raise
            # A host's TIOCEXCL outlives the host on a pseudo terminal: make another one.
            self.unplug()
            self.plug()
            return
        self._settle(slave)
        os.close(slave)

    def _settle(self, slave: int) -> None:
        """Make it raw, so that nothing is echoed, at the device's speed and empty."""
        tty.setraw(slave)
        fields = list(struct.unpack(_TERMIOS2, _get(slave)))
        fields[2] = fields[2] & ~(_CBAUD | _CBAUDEX) | _BOTHER
        fields[-2:] = self._baud, self._baud
        fcntl.ioctl(slave, TCSETS2, struct.pack(_TERMIOS2, *fields))
        termios.tcflush(slave, termios.TCIOFLUSH)


def _get(terminal: int) -> bytes:
    return fcntl.ioctl(terminal, TCGETS2, bytes(struct.calcsize(_TERMIOS2)))
