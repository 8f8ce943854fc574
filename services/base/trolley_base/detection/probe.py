"""Asks what is at the other end of a serial port, without moving anything on wheels.

First it listens, then it asks in an order in which no question can harm a device that it is not
meant for:

- At each speed at which a lidar talks unasked: what comes. Several send the same frames: those of
  them that can say who they are are asked, and one obeys a stop.
- 57600: boards. A board may reboot when its port is opened, so it is asked until some seconds have
  passed. To an Arduino's line buffer the rosserial question is a word that it does not know, ended
  by the CR that follows; to rosserial, letters are noise between frames.
- The boards that are there at once, at 115200; a hoverboard and a linorobot2 talk unasked. None of
  their questions holds an A5, with which all that the lidars of 115200 are told begins: to a Create
  that was started, A5 and the byte behind it are buttons that are pressed.
- 115200: a Hokuyo, which has USB of its own, by lines of text.
- From 115200 to 1000000: "who are you" of RPLIDAR and YDLIDAR, after "stop" for one that a dead
  program has left streaming. Bits at 57600 are two at 115200 and more at the others, so the
  questions before cannot be read as A5, with which every command to these lidars begins; and a
  question at one of these speeds is none at another, which a test tries for all of them.
- 230400: what starts the lidars that wait (`b` an LDS-01), all at once, and what stops them again.
  A lidar that heard this at another speed would have answered before.

A device of the network has no speed that would keep questions apart. It is listened to; where an
address was called, and not a port listened at, it is then asked what harms no board: the Hokuyo's
lines, and who an RPLIDAR or YDLIDAR is.

DTR stays as Linux sets it on opening: boards with USB of their own want it, an A1 stands and an X4
turns meanwhile. Closing the port brings back what was. The port is opened once, and its speed
changed, so that a board reboots once.
"""

import termios
import threading
import time
from collections.abc import Callable
from functools import partial
from typing import TypeVar

import serial

from trolley_base.detection import answers, streams
from trolley_base.detection.known import (
    ASKED,
    BOOTING,
    GREETINGS,
    IDENTITIES,
    STARTED,
    STREAM_BAUDS,
    KnownBoard,
    guard,
    recognise_talking,
)
from trolley_base.detection.network import NetworkProbePort
from trolley_base.detection.results import FoundDevice
from trolley_base.drivers.boards.models import Answer
from trolley_base.drivers.dialogue import Line
from trolley_base.drivers.lidars import MODELS
from trolley_base.drivers.lidars.models import Identity, LidarDriver
from trolley_base.drivers.serial_port import SerialPort

T = TypeVar("T")

CALLED_S, CALLING_S = 1.5, 4.0
"""How long what is called, and who calls, is listened to. A board on Wi-Fi that looks for an agent
pings each 0.6 s, once it has booted, which takes 3 s."""
LISTEN_S = 0.35
"""Each lidar that streams sends 5 frames in a third of that."""
BOARDS_UNTIL_S = 3.2
"""The slowest boards talk about 2 s after their port was opened."""
BOARD_TRIES = 2
"""On a busy computer a single try may come too late to count."""
LIDAR_S = (0.15, 0.2, 0.5)
"""How long an answer is waited for at each speed, in one round after another."""
QUIET_TRIES = 2
"""So many rounds. The last one only where something talks that nobody has recognised: it may be a
lidar that was left streaming, and on a busy computer its answer comes behind what it said."""
DEAF_TRIES = 1
"""What talks on through every stop at every speed is none that was left streaming: it is asked in
so many rounds, unless the computer is busy."""
GREETED_S = 0.2
SPIN_UP_S = 1.5
STOP_TRIES, OBEYED_ENOUGH, QUIET_S = 3, 2, 0.4
"""A lidar obeys a stop that is silent for so long, in so many of the tries."""
STOPPING_S, MOST_STOPPING = 0.1, 4
"""A lidar that has obeyed a stop is silent for this long; it may take so many times that."""
SILENT_S = 0.03
"""One that was not streaming needs no longer to read a stop."""
POLL_S = 0.05
LATE_S, BUSY_S, MOST_LOOKS = 0.005, 0.5, 3
"""If this process came round later than the first of these, by so much in all, the computer may
have kept the device's answers as well, and it looks again, more patiently, at most so many times in
all."""
PATIENCE = 2.0
"""So many times longer each answer is waited for in later looks."""
NEW_SHARE, FEW_BYTES = 0.25, 256
"""While more bytes come, they are looked through again once this share of them is new; few are
whenever any have come."""
MOST_HELD = 65536
"""At most this many bytes are kept in one step."""


def _recognise_unasked(data: bytes, baud: int) -> str | FoundDevice | None:
    return streams.recognise_stream(data, baud) or recognise_talking(data, baud)


class Interrupted(Exception):
    """The person does not want to wait any longer."""


class ProbePort(SerialPort):
    """A port whose speed can be changed while it is open."""

    def set_baud(self, baud: int) -> None:
        """Change the speed, and forget what came at the old one.

        Raises:
            OSError: the device is gone.
        """
        try:
            self._serial.baudrate = baud
        except (termios.error, serial.SerialException) as error:
            raise OSError(*error.args) from error
        self.discard_input()


class Probe:
    """One look at one port.

    Args:
        port: as it was just opened, a serial one at `OPENING`.
        interrupt: set when the look is to end early.
    """

    OPENING = Line(baud=STREAM_BAUDS[0])

    def __init__(self, port: ProbePort | NetworkProbePort, interrupt: threading.Event) -> None:
        self._port = port
        self._interrupt = interrupt
        self._opened_s = time.monotonic()
        self._late_s, self._is_patient = 0.0, False
        self._has_obeyed = False
        self.received: dict[int, int] = {}
        """How many bytes came at each speed before the first question."""

    def identify(self) -> FoundDevice | None:
        """Find out what is there; None if nothing answered as a known device does.

        Raises:
            OSError: the port was lost.
            Interrupted: the look was to end.
        """
        for look in range(MOST_LOOKS):
            self._late_s, self._is_patient = 0.0, look > 0
            found = self._look()
            if found is not None or self._late_s < BUSY_S:
                return found
        return None

    def identify_in_network(self, *, only_listens: bool) -> FoundDevice | None:
        """Find out who is at an address, or calls; None if nobody known.

        Raises:
            OSError: the connection was lost.
            Interrupted: the look was to end.
        """

        def recognise(data: bytes) -> FoundDevice | str | None:
            found = (_recognise_unasked(data, baud) for baud in STREAM_BAUDS)
            return next(filter(None, found), None)

        data = bytearray()
        found = self._read(CALLING_S if only_listens else CALLED_S, recognise, data)
        self.received[0] = len(data)
        if isinstance(found, FoundDevice):
            return found
        told = None
        if found is not None:
            told = streams.describe_stream(found) if only_listens else self._tell_apart(found)
        if told is None:
            return None if only_listens else self._greet_lidars() or self._ask_lidars()
        return streams.with_faster_ones(told)

    def _look(self) -> FoundDevice | None:
        return (
            self._listen_to_streams()
            or self._ask_booting_boards()
            or self._ask_boards()
            or self._greet_lidars()
            or self._ask_lidars()
            or self._start_lidars()
        )

    def _listen_to_streams(self) -> FoundDevice | None:
        for baud in STREAM_BAUDS:
            self._port.set_baud(baud)
            data = bytearray()
            model = self._read(LISTEN_S, partial(_recognise_unasked, baud=baud), data)
            self.received[baud] = len(data)
            if isinstance(model, FoundDevice):
                return model
            if model is not None:
                found = self._tell_apart(model)
                if found is not None:
                    return found
        return None

    def _tell_apart(self, model: str) -> FoundDevice | None:
        """Find out which of the models that send the same frames at the same speed this is.

        Some say who they are; one that was left streaming is stopped for that. Of the others one
        obeys a stop, and is started again; where none does it is called the first of them. None:
        nothing that it can be answers.
        """
        kin: list[str] = [model, *streams.twins_of(model)]
        identities = dict.fromkeys(MODELS[one].identity for one in kin)
        for wait_s in LIDAR_S:
            for identity in filter(None, identities):
                found = self._ask_lidar(identity, MODELS[model].facts.baud, wait_s)
                if found is not None:
                    return found
        mute: list[str] = [one for one in kin if MODELS[one].identity is None]
        for one in mute:
            if len(mute) > 1 and self._obeys_stop(MODELS[one]):
                return streams.describe_stream(one)
        return streams.describe_stream(mute[0], mute[1:]) if mute else None

    def _obeys_stop(self, driver: LidarDriver) -> bool:
        """Tell a lidar to stop and to start again, more than once: it may be silent by chance."""
        obeyed = 0
        for _ in range(STOP_TRIES if driver.stop else 0):
            self._port.write(driver.stop)
            try:
                self._pause(STOPPING_S)
                self._port.discard_input()
                obeyed += not self._read(QUIET_S, bool)
            finally:
                self._port.write(driver.start)
                time.sleep(POLL_S)  # closing drops what has not left
            self._read(SPIN_UP_S, bool)
        return obeyed >= OBEYED_ENOUGH

    def _ask_booting_boards(self) -> FoundDevice | None:
        for baud, boards in BOOTING.items():
            self._port.set_baud(baud)
            data = bytearray()
            num_asked = 0
            while num_asked < BOARD_TRIES or time.monotonic() - self._opened_s < BOARDS_UNTIL_S:
                num_asked += 1
                for known in boards:
                    found = self._ask_board(known, [known], data)
                    if found is not None:
                        return found
        return None

    def _ask_boards(self) -> FoundDevice | None:
        """Ask the boards that are there at once, and listen to those that just talk.

        What comes while others are asked counts, so at a speed it takes no longer than the longest.
        """
        for is_first in (True, *(BOARD_TRIES - 1) * (False,)):
            for baud, boards in ASKED.items():
                asked = [known for known in boards if known.question.ask]
                listened = [known for known in boards if not known.question.ask]
                self._port.set_baud(baud)
                began_s = time.monotonic()
                data = bytearray()
                for known in asked:
                    found = self._ask_board(known, boards, data)
                    if found is not None:
                        return found
                for known in listened if is_first else ():
                    left_s = known.question.wait_s - (time.monotonic() - began_s)
                    found = self._hear_board(left_s, boards, data)
                    if found is not None:
                        return found
        return None

    def _ask_board(
        self, known: KnownBoard, all_here: list[KnownBoard], data: bytearray
    ) -> FoundDevice | None:
        """Ask a question.

        Args:
            known: whose.
            all_here: those that may answer.
            data: what has come at this speed; is added to.
        """
        question = known.question
        for part in question.ask:
            self._port.write(part)
            self._pause(question.rest_s)

        return self._hear_board(question.wait_s, all_here, data)

    def _hear_board(
        self, wait_s: float, all_here: list[KnownBoard], data: bytearray
    ) -> FoundDevice | None:
        """Wait for one of them to answer, or to talk."""

        def recognise(received: bytes) -> tuple[KnownBoard, Answer] | None:
            found = ((one, one.recognise(received)) for one in all_here)
            return next(((one, answer) for one, answer in found if answer is not None), None)

        heard = self._read(wait_s, recognise, data)
        return None if heard is None else self._hear_out(*heard, data)

    def _hear_out(self, known: KnownBoard, answer: Answer, data: bytearray) -> FoundDevice:
        """Hear the rest of what a board has to say, and leave it as it was."""
        more, leave = known.question.follow_up, known.question.leave
        try:
            if more is not None:
                if more.ask:
                    self._pause(known.question.rest_s)  # what comes until then answers the last one
                    self._port.discard_input()
                    self._port.write(more.ask)
                    data = bytearray()
                self._read(more.wait_s, guard(known.model, more.is_complete), data)
                answer = guard(known.model, more.describe)(bytes(data)) or answer
        finally:
            if leave:
                self._port.write(leave)
                time.sleep(POLL_S)  # closing drops what has not left
        return known.describe(answer)

    def _greet_lidars(self) -> FoundDevice | None:
        for model, greeting, baud in QUIET_TRIES * GREETINGS:
            self._port.set_baud(baud)
            for part in greeting.ask:
                self._port.write(part)
                self._pause(POLL_S)
            answer = self._read(GREETED_S, guard(model, greeting.recognise))
            if answer is not None:
                title, details = answer
                return FoundDevice("lidar", model, title, baud, details)
        return None

    def _ask_lidars(self) -> FoundDevice | None:
        talks = any(self.received.values())
        self._has_obeyed = False
        for number, wait_s in enumerate(LIDAR_S[: len(LIDAR_S) if talks else QUIET_TRIES]):
            if number >= DEAF_TRIES and talks and not (self._has_obeyed or self._is_patient):
                return None
            for identity, baud in IDENTITIES:
                self._port.set_baud(baud)
                found = self._ask_lidar(identity, baud, wait_s)
                if found is not None:
                    return found
        return None

    def _ask_lidar(self, identity: Identity, baud: int, wait_s: float) -> FoundDevice | None:
        for command in identity.stop:
            self._port.write(command)
            self._await_silence()
        info = self._ask(identity.get_info, wait_s, answers.read_info)
        if info is None:
            return None
        health = self._ask(identity.get_health, LIDAR_S[-1], answers.read_health)
        return answers.describe_lidar(identity, baud, info, health)

    def _ask(self, question: bytes, wait_s: float, read: Callable[[bytes], T | None]) -> T | None:
        self._port.discard_input()
        self._port.write(question)
        return self._read(wait_s, read)

    def _await_silence(self) -> bool:
        """Wait until what was told to stop has stopped; False where it does not mean to."""
        may_stream = self._is_patient or any(self.received.values())
        pause_s = STOPPING_S if may_stream else SILENT_S
        for _ in range(MOST_STOPPING):
            self._port.discard_input()
            self._pause(pause_s)
            if not self._port.wait(0.0):
                self._has_obeyed = True
                return True
        return False

    def _start_lidars(self) -> FoundDevice | None:
        for baud, started in STARTED.items():
            self._port.set_baud(baud)
            try:
                for model in started:
                    self._port.write(MODELS[model].start)
                    self._pause(POLL_S)
                found = self._read(SPIN_UP_S, partial(streams.recognise_stream, baud=baud))
            finally:
                for model in started:
                    self._port.write(MODELS[model].stop)
                    time.sleep(POLL_S)  # closing drops what has not left
            if found is not None:
                # What was silent until it was told to start is that one and no twin of it.
                frames = MODELS[found].frames
                alike: list[str] = [one for one in started if MODELS[one].frames is frames]
                return streams.describe_stream(alike[0] if alike else found)
        return None

    def _read(
        self,
        seconds: float,
        recognise: Callable[[bytes], T | None],
        data: bytearray | None = None,
    ) -> T | None:
        """Collect input until it is recognised or time is up.

        All of it is looked through each time, so the more there is, the more must come before it
        is looked through again.
        """
        received = bytearray() if data is None else data
        left_s = PATIENCE * seconds if self._is_patient else seconds
        unseen = 0
        while left_s > 0.0:
            if self._interrupt.is_set():
                raise Interrupted
            asked_s = time.monotonic()
            has_come = self._port.wait(min(left_s, POLL_S))
            if has_come:
                new = self._port.read()
                received += new
                unseen += len(new)
                del received[:-MOST_HELD]
            # A busy computer may come back here late; the device has had no longer for that.
            took_s = time.monotonic() - asked_s
            left_s -= min(took_s, POLL_S)
            self._late_s += took_s - POLL_S if took_s > POLL_S + LATE_S else 0.0
            is_enough = unseen >= len(received) * NEW_SHARE or len(received) <= FEW_BYTES
            if unseen and (is_enough or not has_come or left_s <= 0.0):
                unseen = 0
                result = recognise(bytes(received))
                if result:
                    return result
        return None

    def _pause(self, seconds: float) -> None:
        if self._interrupt.wait(seconds):
            raise Interrupted
