"""What a motor board's driver module says of its board, for base and for `trolley detect`."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

from trolley import drivers
from trolley.config.hardware import ChassisConfig
from trolley.drivers import Driver
from trolley.messages.motion import Drive
from trolley_base.drivers.dialogue import BoardDialogue, Datagrams

SETTINGS = "base.chassis.settings"
"""The table of a board's own settings."""


@dataclass(frozen=True, slots=True)
class BoardFacts:
    """What is known of a firmware.

    Attributes:
        title: how people call it.
        baud: bits per second, if the firmware was not changed.
        watchdog_s: after what silence it stops the motors by itself [s], as delivered or as it is
            told on each connection; infinite where it never does.
        has_imu: it can report an inertial sensor.
        has_inputs: its pins can be read: bumpers, cliff sensors, a battery.
        drives_sideways: it can have four motors and mecanum wheels.
        radius_m: of the round robot that it is built into [m]; None for a board of its own.
    """

    title: str
    baud: int
    watchdog_s: float
    has_imu: bool = False
    has_inputs: bool = False
    drives_sideways: bool = False
    radius_m: float | None = None


@dataclass(frozen=True, slots=True)
class Answer:
    """What a board that was recognised says of itself.

    Attributes:
        details: such as `battery at 12.1 V`.
        problems: what is wrong with it: sentences with what to do.
        is_usable: its driver can drive it.
        title: what people call it where that is not the driver's title.
    """

    details: tuple[str, ...] = ()
    problems: tuple[str, ...] = ()
    is_usable: bool = True
    title: str = ""


@dataclass(frozen=True, slots=True)
class FollowUp:
    """What a board that was recognised is asked or listened to for as well.

    Attributes:
        wait_s: how long, at most.
        is_complete: whether what has arrived will do.
        describe: tells what it says.
        ask: another question, once answers to those before have come; b"" where it goes on by
            itself, and what came before counts.
    """

    wait_s: float
    is_complete: Callable[[bytes], bool]
    describe: Callable[[bytes], Answer]
    ask: bytes = b""


@dataclass(frozen=True, slots=True)
class BoardQuestion:
    """How `trolley detect` tells a board, without moving it; it must harm no other device.

    Attributes:
        baud: at which speed it is asked [bits/s].
        ask: the question; () for a board that talks unasked.
        recognise: finds the answer in what has arrived; None while it is not there.
        leave: what is sent once it has answered, so that it is as it was before; b"" for nothing.
        wait_s: how long an answer is waited for; 0 for a board that never stops talking.
        rest_s: how long a device has rest between two parts of the question.
        boots: opening the port restarts such a board, so it is asked until it must have booted.
        follow_up: what it is asked when it has answered.
        datagrams: how a board that calls its host over UDP is heard.
    """

    baud: int
    ask: tuple[bytes, ...]
    recognise: Callable[[bytes], Answer | None]
    leave: bytes = b""
    wait_s: float = 0.25
    rest_s: float = 0.05
    boots: bool = False
    follow_up: FollowUp | None = None
    datagrams: Datagrams | None = None


def _track_of_wheels(config: ChassisConfig) -> float | None:
    return None if config.wheels is None else config.wheels.track_m


@dataclass(frozen=True, slots=True)
class BoardDriver(Driver):
    """A motor board's entry in the table `BOARDS`.

    Attributes:
        facts: of its firmware.
        make: makes the dialogue, of the settings, the line's baud rate and how the wheels stand;
            raises DriverError where the settings do not fit the board.
        questions: how `trolley detect` tells it.
        needs: the tables of `[base.chassis]` that it cannot do without, such as `wheels`.
        track_m: the track that it counts with [m]; None where only its firmware knows.
    """

    group: ClassVar[str] = drivers.BOARDS
    facts: BoardFacts
    make: Callable[[ChassisConfig, int, Drive], BoardDialogue]
    questions: tuple[BoardQuestion, ...] = ()
    needs: tuple[str, ...] = ()
    track_m: Callable[[ChassisConfig], float | None] = _track_of_wheels


def count_nothing(_name: str, _number: int) -> None:
    """In place of a counter, for detection: what is not a frame is some other device's."""
