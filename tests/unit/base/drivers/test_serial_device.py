"""Ports on real pseudo-terminals: opened, lost, flooded, blocked, and opened again."""

import contextlib
import errno
import fcntl
import os
import sys
import termios
import threading
import time
import tty
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType

import pytest
from support.waiting import wait_until

from trolley_base.drivers import serial_device
from trolley_base.drivers.dialogue import Line
from trolley_base.drivers.serial_device import (
    MOST_STORED,
    Arrived,
    Event,
    Lost,
    Opened,
    SerialDevice,
)
from trolley_base.drivers.serial_port import FULL_BYTES, SerialPort

pytestmark = pytest.mark.drives

LINE = Line(115_200)


class Terminal:
    """A pseudo-terminal behind a stable name, as a USB device behind /dev/serial/by-id."""

    def __init__(self, link: Path) -> None:
        self.link = link
        self.master = -1
        self.plug_in()

    def plug_in(self) -> None:
        self.master, slave = os.openpty()
        tty.setraw(slave)
        os.set_blocking(self.master, False)
        self.link.unlink(missing_ok=True)
        self.link.symlink_to(os.ttyname(slave))
        os.close(slave)

    def unplug(self) -> None:
        if self.master >= 0:
            os.close(self.master)
            self.master = -1
            self.link.unlink()

    def send(self, data: bytes) -> None:
        os.write(self.master, data)

    def received(self) -> bytes:
        try:
            return os.read(self.master, 65536)
        except (BlockingIOError, OSError):
            return b""


@pytest.fixture
def terminal(tmp_path: Path) -> Iterator[Terminal]:
    made = Terminal(tmp_path / "port")
    yield made
    made.unplug()


def explain(port: str, error: OSError) -> str:
    return f"{Path(port).name}: {errno.errorcode[error.errno or 0]}"


@pytest.fixture
def device(terminal: Terminal) -> Iterator[SerialDevice]:
    made = SerialDevice(str(terminal.link), LINE, explain)
    made.start()
    yield made
    made.close()


def waiting_bytes(port: int) -> int:
    """How many bytes wait in a port to be read."""
    return int.from_bytes(fcntl.ioctl(port, termios.FIONREAD, bytes(4)), sys.byteorder)


class Heard:
    """All events of a device since the test began."""

    def __init__(self, device: SerialDevice) -> None:
        self._device = device
        self.events: list[Event] = []

    def until(self, condition: Callable[["Heard"], bool]) -> None:
        def is_so() -> bool:
            self.events += self._device.take()
            return condition(self)

        wait_until(is_so, "the event")

    @property
    def data(self) -> bytes:
        return b"".join(event.data for event in self.events if isinstance(event, Arrived))

    def count(self, kind: type[Event]) -> int:
        return sum(isinstance(event, kind) for event in self.events)


@pytest.mark.parametrize("baud", [57_600, 115_200, 128_000, 230_400])
def test_a_port_is_opened_at_any_baud_rate(terminal: Terminal, baud: int) -> None:
    port = SerialPort(str(terminal.link), Line(baud, dtr=False, dtr_after=True))
    assert port.write(b"\x00\xff\r\n\x03")
    assert not port.wait(0.0)
    wait_until(lambda: terminal.received() == b"\x00\xff\r\n\x03", "the bytes")
    port.close()
    port.close()


def test_a_port_is_opened_once(terminal: Terminal) -> None:
    first = SerialPort(str(terminal.link), LINE)
    with pytest.raises(OSError, match=os.strerror(errno.EBUSY)):
        SerialPort(str(terminal.link), LINE)
    first.close()
    SerialPort(str(terminal.link), LINE).close()


@pytest.mark.parametrize(("name", "number"), [("missing", errno.ENOENT), ("file", errno.ENOTTY)])
def test_what_is_no_port_says_so(tmp_path: Path, name: str, number: int) -> None:
    (tmp_path / "file").write_text("no terminal")
    with pytest.raises(OSError, match=os.strerror(number)):
        SerialPort(str(tmp_path / name), LINE)


def test_bytes_arrive_in_order_with_their_time(device: SerialDevice, terminal: Terminal) -> None:
    heard = Heard(device)
    heard.until(lambda h: h.count(Opened) == 1)
    for part in (b"first ", b"second ", b"third"):
        terminal.send(part)
    heard.until(lambda h: h.data == b"first second third")
    stamps = [event.monotonic_ns for event in heard.events if isinstance(event, Arrived)]
    assert stamps == sorted(stamps)


def test_what_must_be_answered_at_once_is_though_nobody_takes_anything(terminal: Terminal) -> None:
    line = Line(115_200, responder=lambda data, _: b"pong" if data.endswith(b"ping") else b"")
    device = SerialDevice(str(terminal.link), line, explain)
    device.start()
    heard = bytearray()

    def answered() -> bool:
        terminal.send(b"a ping")
        heard.extend(terminal.received())
        return b"pong" in heard

    wait_until(answered, "the answer")
    assert set(heard) == set(b"pong")
    Heard(device).until(lambda h: b"a ping" in h.data)
    device.close()


def test_a_lost_port_is_opened_again_when_it_is_back(
    device: SerialDevice, terminal: Terminal
) -> None:
    heard = Heard(device)
    heard.until(lambda h: h.count(Opened) == 1)
    terminal.unplug()
    heard.until(lambda h: h.count(Lost) >= 2)
    assert not device.write(b"nobody")
    assert {event.why for event in heard.events if isinstance(event, Lost)} <= {
        "port: EIO",
        "port: ENOENT",
    }
    terminal.plug_in()
    heard.until(lambda h: h.count(Opened) == 2)
    terminal.send(b"back")
    heard.until(lambda h: h.data.endswith(b"back"))


# What the kernel says of a device that is unplugged while its port is opened or closed.
UNPLUGGED = [
    (termios, "tcgetattr", termios.error(errno.EIO, "gone"), "EIO"),
    (termios, "tcsetattr", termios.error(errno.EIO, "gone"), "EIO"),
    (termios, "tcflush", termios.error(errno.EIO, "gone"), "EIO"),
    (fcntl, "ioctl", OSError(errno.EPROTO, "gone"), "EPROTO"),
]


@pytest.mark.parametrize(("module", "function", "error", "name"), UNPLUGGED)
@pytest.mark.parametrize("successes", [0, 1, 2, 3])
def test_a_device_unplugged_at_any_moment_is_waited_for(
    terminal: Terminal,
    monkeypatch: pytest.MonkeyPatch,
    *,
    module: ModuleType,
    function: str,
    error: Exception,
    name: str,
    successes: int,
) -> None:
    real = getattr(module, function)
    calls = 0

    def unplugged_once(*arguments: object) -> object:
        nonlocal calls
        calls += 1
        if calls == successes + 1:
            raise error
        return real(*arguments)

    files = len(os.listdir("/proc/self/fd"))
    monkeypatch.setattr(serial_device, "FIRST_PAUSE_S", 0.02)
    monkeypatch.setattr(module, function, unplugged_once)
    device = SerialDevice(
        str(terminal.link), Line(128_000, dtr=False, dtr_after=True, settle_s=0.001), explain
    )
    device.start()
    heard = Heard(device)
    heard.until(lambda h: h.count(Opened) == 1)
    device.reopen()
    heard.until(lambda h: h.count(Opened) == 2)
    device.close()
    whys = {event.why for event in heard.events if isinstance(event, Lost)}
    assert whys <= {f"port: {name}"}
    assert whys or calls <= successes or function == "ioctl"  # DTR of a pty fails anyway
    assert len(os.listdir("/proc/self/fd")) == files


def test_a_port_that_is_asked_to_is_opened_anew(device: SerialDevice) -> None:
    heard = Heard(device)
    heard.until(lambda h: h.count(Opened) == 1)
    device.reopen()
    heard.until(lambda h: h.count(Opened) == 2)
    assert heard.count(Lost) == 0


def test_a_flood_is_bounded_and_counted(device: SerialDevice, terminal: Terminal) -> None:
    Heard(device).until(lambda h: h.count(Opened) == 1)
    sent = 0

    def has_flooded() -> bool:
        nonlocal sent
        with contextlib.suppress(BlockingIOError):
            sent += os.write(terminal.master, bytes(4096))
        return sent > 3 * MOST_STORED

    while not has_flooded():
        time.sleep(0.0005)
    wait_until(lambda: device.take_dropped() > 0, "dropped bytes")
    stored = sum(len(event.data) for event in device.take() if isinstance(event, Arrived))
    assert stored <= MOST_STORED


def test_what_waited_while_the_process_was_stopped_is_not_taken_for_new(
    terminal: Terminal,
) -> None:
    watching = os.open(terminal.link, os.O_RDONLY | os.O_NOCTTY | os.O_NONBLOCK)
    goes_on = threading.Event()

    def stop() -> None:
        goes_on.wait()

    line = Line(115_200, is_prompt=True)
    device = SerialDevice(str(terminal.link), line, explain, wake=stop)
    device.start()
    heard = Heard(device)
    heard.until(lambda h: h.count(Opened) == 1)
    terminal.send(b"first ")
    heard.until(lambda h: h.data == b"first ")  # and there the process stops
    terminal.send(b"old " * (FULL_BYTES // 4))
    wait_until(lambda: waiting_bytes(watching) >= FULL_BYTES, "the port is full")
    goes_on.set()
    wait_until(lambda: device.take_dropped() >= FULL_BYTES, "the old bytes are dropped")
    terminal.send(b"new")
    heard.until(lambda h: h.data == b"first new")
    device.close()
    os.close(watching)


def test_commands_that_nobody_takes_are_dropped_and_not_sent_later(
    device: SerialDevice, terminal: Terminal
) -> None:
    Heard(device).until(lambda h: h.count(Opened) == 1)
    frame = b"<old command>" * 8
    while device.write(frame):
        pass
    while terminal.received():
        pass
    assert device.write(b"<zero>")
    wait_until(lambda: terminal.received() == b"<zero>", "the zero alone")


def test_the_last_words_leave_before_the_port_is_closed(
    device: SerialDevice, terminal: Terminal
) -> None:
    Heard(device).until(lambda h: h.count(Opened) == 1)
    device.close((b"zero", b"stop"))
    assert terminal.received() == b"zerostop"
    assert not device.write(b"more")
