"""The port behaves as a serial port does: raw, reopened at will, gone when unplugged."""

import os
import stat
from collections.abc import Iterator
from pathlib import Path

import pytest
import serial

from trolley_base.emulators.pseudo_terminal import PortError, PseudoTerminal


@pytest.fixture
def terminal(tmp_path: Path) -> Iterator[PseudoTerminal]:
    made = PseudoTerminal(tmp_path / "port", 57600)
    yield made
    made.unplug()


def open_plainly(terminal: PseudoTerminal) -> int:
    return os.open(terminal.link, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)


def test_a_host_is_noticed_and_heard(terminal: PseudoTerminal):
    assert terminal.look() is False
    assert terminal.fileno is None
    host = open_plainly(terminal)
    assert terminal.look() is True
    assert terminal.look() is False
    os.write(host, b"\x03\r\n\x11\x00hello")  # nothing of it is special
    assert terminal.read() == b"\x03\r\n\x11\x00hello"
    assert terminal.read() == b""
    terminal.write(b"\r\n\x04\xff")
    assert os.read(host, 100) == b"\r\n\x04\xff"
    os.close(host)


def test_nothing_is_echoed_to_a_host_that_sets_nothing(terminal: PseudoTerminal):
    host = open_plainly(terminal)
    terminal.look()
    terminal.write(b"question\r\n")
    assert terminal.read() == b""
    os.close(host)


def test_a_host_may_close_and_open_again_and_finds_nothing_old(terminal: PseudoTerminal):
    host = open_plainly(terminal)
    terminal.look()
    terminal.write(b"never read")
    os.close(host)
    terminal.write(b"said before it was noticed")
    terminal.look()
    assert not terminal.is_open
    terminal.write(b"said to nobody")
    assert terminal.read() == b""
    host = open_plainly(terminal)
    assert terminal.look() is True
    with pytest.raises(BlockingIOError):
        os.read(host, 100)
    terminal.write(b"new")
    assert os.read(host, 100) == b"new"
    os.close(host)


def test_what_a_host_says_before_it_closes_is_heard(terminal: PseudoTerminal):
    host = open_plainly(terminal)
    terminal.look()
    num_written = os.write(host, b"stop" * 1500)
    assert num_written > 4096, "more than the master's side has room for"
    os.close(host)
    terminal.look()
    assert len(terminal.read()) == num_written
    assert terminal.read() == b""


@pytest.mark.parametrize("baud", [57600, 115200, 128000, 230400])
def test_it_knows_the_hosts_speed(terminal: PseudoTerminal, baud: int):
    assert terminal.host_baud() == 57600
    with serial.Serial(str(terminal.link), baud):
        terminal.look()
        assert terminal.host_baud() == baud
    terminal.look()
    assert terminal.host_baud() == 57600


def test_unplugged_it_is_gone_until_it_is_plugged_again(terminal: PseudoTerminal):
    host = open_plainly(terminal)
    terminal.look()
    terminal.unplug()
    assert os.read(host, 100) == b""
    with pytest.raises(OSError, match="error"):
        os.write(host, b"anybody?")
    assert not terminal.link.is_symlink()
    assert terminal.look() is False
    assert terminal.read() == b""
    terminal.plug()
    again = open_plainly(terminal)
    assert terminal.look() is True
    assert stat.S_ISCHR(os.stat(terminal.link).st_mode)
    os.close(again)
    os.close(host)


def test_a_host_that_does_not_read_blocks_nobody(terminal: PseudoTerminal):
    host = open_plainly(terminal)
    terminal.look()
    for _ in range(2000):
        terminal.write(b"x" * 100)
    assert len(os.read(host, 1_000_000)) > 0
    os.close(host)


def test_a_link_left_behind_is_replaced_and_a_file_is_not(tmp_path: Path):
    (tmp_path / "old").symlink_to("/dev/pts/999")
    made = PseudoTerminal(tmp_path / "old", 57600)
    assert os.readlink(tmp_path / "old") == made.device
    made.unplug()
    (tmp_path / "file").write_text("mine")
    with pytest.raises(PortError, match="file exists"):
        PseudoTerminal(tmp_path / "file", 57600)
