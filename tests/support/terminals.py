"""Terminals for tests: programs run on real pseudo-terminals, as a person's would."""

import fcntl
import os
import pty
import re
import select
import signal
import struct
import subprocess
import sys
import termios
import threading
from collections.abc import Mapping, Sequence
from pathlib import Path

from support.waiting import PATIENCE_S, wait_until

FLAGS = 31
LOOK_S = 0.05
"""How often its reader sees whether it was closed."""
END = b"\0"
"""Written behind a program's last words, to know when they have been read."""


class Terminal:
    """A program on a terminal of its own, which answers as some terminals do.

    Args:
        arguments: the program and its arguments.
        environment: what differs from this process's own.
        tells_releases: whether it speaks the kitty keyboard protocol.
    """

    def __init__(
        self,
        arguments: Sequence[str],
        environment: Mapping[str, str],
        *,
        tells_releases: bool = False,
        columns: int = 120,
    ) -> None:
        self.tells_releases = tells_releases
        self.is_reachable = True
        """Whether it answers; one behind a broken connection does not."""
        self._master, slave = pty.openpty()
        fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack("HHHH", 30, columns, 0, 0))
        self._found = termios.tcgetattr(slave)
        self._popen = subprocess.Popen(
            arguments,
            stdin=slave,
            stdout=slave,
            stderr=slave,
            env={**os.environ, "TERM": "xterm-256color", **environment},
            start_new_session=True,
            preexec_fn=lambda: fcntl.ioctl(0, termios.TIOCSCTTY, 0),
        )
        self._slave = slave  # kept open, so that its modes can be read after the program's end
        self._output = b""
        self._is_closed = False
        self._reader = threading.Thread(target=self._read)
        self._reader.start()

    @property
    def pid(self) -> int:
        """The process id of the program."""
        return self._popen.pid

    @property
    def output(self) -> str:
        """All that was written to it."""
        return self._output.replace(END, b"").decode(errors="replace")

    @property
    def last_line(self) -> str:
        """The last line that was written, without colours and the like."""
        return re.sub(r"\x1b\[[0-9;?<>]*[a-zA-Z]", "", self.output).rstrip().rpartition("\n")[2]

    @property
    def is_as_found(self) -> bool:
        """Whether its modes are those of the beginning."""
        return termios.tcgetattr(self._slave) == self._found

    @property
    def echoes(self) -> bool:
        """Whether it shows what is typed, as a shell needs it."""
        return bool(termios.tcgetattr(self._slave)[3] & termios.ECHO)

    def type(self, text: str) -> None:
        """Send keys."""
        os.write(self._master, text.encode())

    def wait_for(self, text: str) -> None:
        """Wait until something is written to it."""
        wait_until(lambda: text in self.output, lambda: f"{text!r} in {self.output!r}")

    def send(self, number: signal.Signals) -> None:
        """Send the program a signal."""
        self._popen.send_signal(number)

    def wait(self) -> int:
        """Return the program's exit code, once its last words have been read, too."""
        exit_code = self._popen.wait(PATIENCE_S)
        if not self._is_closed:
            os.write(self._slave, END)
            wait_until(lambda: END in self._output, "the program's last words")
        return exit_code

    def hang_up(self) -> None:
        """Close it, as when its window is closed."""
        if not self._is_closed:
            self._is_closed = True
            self._reader.join()
            os.close(self._master)
            os.close(self._slave)

    def end(self) -> None:
        """Kill the program and close the terminal."""
        if self._popen.poll() is None:
            self._popen.kill()
            self._popen.wait()
        self.hang_up()

    def _read(self) -> None:
        """Keep what is written, and answer questions."""
        while not self._is_closed:
            ready, _, _ = select.select([self._master], [], [], LOOK_S)
            if not ready:
                continue
            try:
                data = os.read(self._master, 65536)
            except OSError:
                return
            self._output += data
            if not self.is_reachable:
                continue
            for question in re.findall(rb"\x1b\[\?u|\x1b\[5n", data):
                if question == b"\x1b[5n":
                    os.write(self._master, b"\x1b[0n")
                elif self.tells_releases:
                    os.write(self._master, f"\x1b[?{FLAGS}u".encode())


def trolley(*arguments: str) -> list[str]:
    """Return the command line of `trolley` as installed beside this Python."""
    return [str(Path(sys.executable).with_name("trolley")), *arguments]
