"""A dialogue over a real pseudo-terminal, with a clock of the test's own."""

import os
import termios
import tty
from collections.abc import Iterator

import pytest
from support.waiting import wait_until

from trolley.config.hardware import ChassisConfig, LidarConfig
from trolley.messages import Link
from trolley.serial_diagnosis import explain
from trolley_base.drivers.boards import make_board
from trolley_base.drivers.dialogue import BoardDialogue, LidarDialogue
from trolley_base.drivers.lidars import make_lidar
from trolley_base.drivers.serial_device import Arrived, Lost, Opened, SerialDevice
from trolley_base.drivers.serial_link import SerialLink, joined

SECOND_NS = 1_000_000_000


@pytest.fixture
def port() -> Iterator[str]:
    """A port behind which nobody says anything."""
    master, slave = os.openpty()
    tty.setraw(slave)
    name = os.ttyname(slave)
    os.close(slave)
    yield name
    os.close(master)


def test_a_silent_device_is_named_by_its_port_before_and_after_it_is_given_up(port: str) -> None:
    dialogue: LidarDialogue = make_lidar(LidarConfig(model="ld19"))
    device = SerialDevice(port, dialogue.line, explain)
    talk = SerialLink("lidar", dialogue, device, lambda monotonic_ns: monotonic_ns)
    device.start()

    def is_open() -> Link | None:
        talk.listen(0)
        link = talk.link(0)
        return link if "Waiting" in link.message else None

    wait_until(is_open, "the port is open")
    silent = talk.link(20 * SECOND_NS)
    talk.speak(20 * SECOND_NS)  # which gives it up
    given_up = talk.link(20 * SECOND_NS)
    talk.close()
    assert silent.message.startswith(f"{port}: No answer")
    assert (given_up.state, given_up.message) == ("down", silent.message)


def test_a_port_that_takes_nothing_is_down_and_not_merely_counted(port: str) -> None:
    chassis = ChassisConfig(board="linorobot", port=port)
    dialogue = make_board(chassis, "differential")
    device = SerialDevice(port, dialogue.line, explain)
    talk: SerialLink[BoardDialogue] = SerialLink("chassis", dialogue, device, lambda now: now)
    device.start()

    def is_open() -> bool:
        talk.listen(0)
        return talk.link(0).state == "searching" and "asked" in talk.link(0).message

    wait_until(is_open, "the port is open")
    slave = os.open(port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    termios.tcflow(slave, termios.TCOOFF)
    os.close(slave)
    refused_ns: int | None = None
    for step in range(200):  # a question to the board each second, none of which is taken
        now_ns = step * SECOND_NS // 4
        talk.speak(now_ns)
        link = talk.link(now_ns)
        if refused_ns is None and talk.counts({}).get("chassis/not_sent"):
            refused_ns = now_ns
        if refused_ns is not None:
            assert link.state == "down", "from the first word that is not taken"
            assert "accepts nothing" in link.message
            if now_ns - refused_ns > 2 * SECOND_NS:
                break
    talk.close()
    assert refused_ns is not None


def test_who_comes_second_to_a_port_is_told_that_it_is_in_use(port: str) -> None:
    talks: list[SerialLink[LidarDialogue]] = []
    for _ in range(2):
        dialogue: LidarDialogue = make_lidar(LidarConfig(model="ld19"))
        device = SerialDevice(port, dialogue.line, explain)
        talk = SerialLink("lidar", dialogue, device, lambda now: now)
        device.start()
        talks.append(talk)

        def has_tried(talk: SerialLink[LidarDialogue] = talk) -> bool:
            talk.listen(0)
            return "being opened" not in talk.link(0).message

        wait_until(has_tried, "the port is open, or refused")
    first, second = (talk.link(0) for talk in talks)
    for talk in talks:
        talk.close()
    assert "in use" not in first.message
    assert second.state == "down"
    assert f"{port} is in use" in second.message


def test_what_arrived_in_a_row_is_joined_and_a_break_stays_between() -> None:
    events = [
        Opened(),
        Arrived(b"a", 1),
        Arrived(b"b", 2),
        Lost("unplugged"),
        Arrived(b"c", 3),
    ]
    assert joined(events) == [Opened(), Arrived(b"ab", 2), Lost("unplugged"), Arrived(b"c", 3)]
