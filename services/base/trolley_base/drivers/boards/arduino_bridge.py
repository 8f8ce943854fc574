"""A board with ROSArduinoBridge: lines of text, an answer to each, never a word unasked.

One question is on the line at a time; only a stop does not wait for its answer. What is not
answered in time is given up, and the board is asked for its baud rate, which no other answer looks
like, until the line is clear. The board stops its motors by itself only after 2 s.

Counts, below `chassis/`: `timeouts` (questions without an answer), `stray_lines` (answers that do
not fit the question), `invalid_commands` (questions that the board did not understand),
`encoder_jumps`, `restarts` (of the board).

Source:
    ros_arduino_bridge, ROSArduinoBridge.ino, commands.h and diff_controller.h (BSD).
"""

import re
from collections import deque
from dataclasses import dataclass

from trolley.config.hardware import ChassisConfig, PidConfig, WheelsConfig
from trolley.drivers import API
from trolley.geometry import Twist2D
from trolley.messages.motion import Drive
from trolley_base.drivers.boards.inputs import Inputs
from trolley_base.drivers.boards.last_heard import LastHeard
from trolley_base.drivers.boards.models import (
    Answer,
    BoardDriver,
    BoardFacts,
    BoardQuestion,
    FollowUp,
)
from trolley_base.drivers.boards.report import SILENCE_NS, Report
from trolley_base.drivers.boards.wheel_ticks import Counts, TickTargets, WheelOdometry
from trolley_base.drivers.dialogue import Line, Status
from trolley_base.drivers.interface import ChassisReading, DriverError

SETTLE_S = 1.5
"""An Arduino reboots when its port is opened; its boot loader then waits for a new program."""
ANSWER_NS = 150_000_000
GREET_EVERY_NS = 500_000_000
ENCODERS_EVERY_NS = 50_000_000
MOTORS_EVERY_NS = 100_000_000
NEW_MOTORS_EVERY_NS = 50_000_000
"""A new velocity waits no longer than this, so that a robot can be steered."""
MOST_ARGUMENT = 15
"""The firmware copies an argument into 16 letters without looking."""
MOST_LINE = 64
MOST_INVALID = 3
"""One command that is not understood was garbled on the line; this many in a row were not."""
MOST_STRAYS = 3
"""A board that boots may begin with a line or two that were cut."""

BAUD, ENCODERS, MOTORS, STOP = "b", "e", "m", "m 0 0"
INVALID = b"Invalid Command"
LINE = re.compile(rb"[^\r\n]+(?=[\r\n])")
ANSWERS = {
    "e": re.compile(rb"-?\d{1,10} -?\d{1,10}"),
    "d": re.compile(rb"[01]"),
    "a": re.compile(rb"\d{1,4}"),
    "p": re.compile(rb"\d{1,5}"),
    "m": re.compile(rb"OK"),
    "u": re.compile(rb"OK"),
}


@dataclass(slots=True)
class Question:
    """Something that is asked repeatedly."""

    text: str
    period_ns: int
    due_ns: int = 0


def pid_command(pid: PidConfig) -> str:
    """Return the line that sets the gains.

    Raises:
        DriverError: they are not what the firmware can read.
    """
    gains = [pid.p, pid.d, pid.i, pid.o]
    if not all(gain.is_integer() for gain in gains):
        raise DriverError(
            "[base.chassis.pid] must be whole numbers for arduino_bridge, which computes with "
            "nothing else; multiply p, i, d and o by the same factor"
        )
    argument = ":".join(str(int(gain)) for gain in gains)
    if len(argument) > MOST_ARGUMENT:
        raise DriverError(
            f"[base.chassis.pid] is too long for arduino_bridge: {argument} has more than "
            f"{MOST_ARGUMENT} characters; use smaller numbers"
        )
    return f"u {argument}"


class QuestionSchedule:
    """Which question is asked next.

    Args:
        questions: all that are asked again and again.
    """

    def __init__(self, questions: list[Question]) -> None:
        self._questions = questions

    def begin(self, now_ns: int) -> None:
        """Make all of them due."""
        for question in self._questions:
            question.due_ns = now_ns

    def hasten(self, text: str, at_ns: int) -> None:
        """Make one due at a time if it is not due before."""
        for question in self._questions:
            if question.text == text:
                question.due_ns = min(question.due_ns, at_ns)

    def pop_due(self, now_ns: int) -> str | None:
        """Return what is to be asked now, None if nothing is due."""
        # The one that waits longest, measured by its own pace: if there are too many for the
        # line, all of them become slower alike.
        due = max(self._questions, key=lambda known: (now_ns - known.due_ns) / known.period_ns)
        if due.due_ns > now_ns:
            return None
        due.due_ns = max(due.due_ns + due.period_ns, now_ns)
        return due.text


class MotorCommands:
    """What the motors shall do, and what they were told last.

    Args:
        targets: turns velocities into ticks.
    """

    def __init__(self, targets: TickTargets) -> None:
        self._targets = targets
        self.wanted = Twist2D.zero()
        self.driven: Twist2D | None = None
        """What they were told last, None if that is not known."""
        self.told_ns = 0
        """When that was."""

    @property
    def are_stopped(self) -> bool:
        """Whether they were told to stand."""
        return self.driven is not None and self.driven.is_zero

    def want(self, twist: Twist2D) -> None:
        """Set the wanted velocity."""
        self.wanted = twist

    def forget(self) -> None:
        """Note that what they do is not known."""
        self.driven = None

    def lose(self) -> None:
        """Note that it is not known either when they were told something."""
        self.driven, self.told_ns = None, 0

    def tell(self, twist: Twist2D, now_ns: int) -> str:
        """Return the command, which is sent now."""
        self.driven, self.told_ns = twist, now_ns
        left, right = self._targets.of(twist)
        return f"{MOTORS} {left} {right}"


class ArduinoBridgeDialogue:
    """Talks to the firmware.

    Args:
        wheels: what a tick stands for.
        baud: bits per second.

    Raises:
        DriverError: the gains are not what the firmware can read.
    """

    def __init__(self, config: ChassisConfig, wheels: WheelsConfig, baud: int) -> None:
        self._baud = baud
        self._greeting = re.compile(rb"57600|%d" % baud)
        self._gains = "" if config.pid is None else pid_command(config.pid)
        self._report = Report()
        self._wheels = WheelOdometry(wheels, self._report.count)
        self._motors = MotorCommands(TickTargets(wheels))
        self._inputs = Inputs(config.inputs)
        questions = [Question(MOTORS, MOTORS_EVERY_NS), Question(ENCODERS, ENCODERS_EVERY_NS)]
        questions += [Question(*item) for item in self._inputs.questions().items()]
        self._schedule = QuestionSchedule(questions)
        self.begin(0)

    @property
    def line(self) -> Line:
        """How the port is opened."""
        return Line(self._baud, settle_s=SETTLE_S, is_prompt=True, restarts=True)

    def begin(self, now_ns: int) -> None:
        """The port has been opened: ask who is there, command nothing."""
        self._wheels.reset()
        self._inputs.reset()
        self._motors.want(Twist2D.zero())
        self._partial = b""
        self._in_flight: deque[tuple[str, int]] = deque()
        self._heard = LastHeard(now_ns)
        self._greeted_ns: int | None = None
        self._strays = 0
        self._invalid_in_row = 0
        self._is_known = self._is_greeted = self._owes_gains = False
        self._lose_step()

    def _lose_step(self) -> None:
        """Which answer belongs to which question is not known: nor is what the motors do."""
        self._in_flight.clear()
        self._partial = b""
        self._is_in_step = False
        self._motors.lose()

    # What arrives.
    def receive(self, data: bytes, arrived_ns: int) -> None:
        """Take bytes."""
        data = self._partial + data
        end = max(data.rfind(b"\r"), data.rfind(b"\n")) + 1
        for found in LINE.finditer(data, 0, end):
            # When the board began to answer, which is when it looked.
            late_ns = (len(data) - found.start()) * 10_000_000_000 // self._baud
            self._take_line(found[0].strip(), arrived_ns - late_ns, arrived_ns)
        self._partial = data[end:]
        if len(self._partial) > MOST_LINE:
            self._report.count("stray_lines")
            self._strays += 1
            self._partial = b""

    def _take_line(self, line: bytes, stamp_ns: int, arrived_ns: int) -> None:
        question = self._in_flight[0][0] if self._in_flight else ""
        is_awaited = any(text == BAUD for text, _ in self._in_flight)
        if is_awaited and self._greeting.fullmatch(line):
            self._meet(arrived_ns)
        elif question not in ("", BAUD) and line == INVALID:
            self._report.count("invalid_commands")
            self._invalid_in_row += question[0] in "emu"
            if question[0] == MOTORS and self._invalid_in_row < MOST_INVALID:
                self._motors.forget()  # the wheels did not hear it
        elif question not in ("", BAUD) and ANSWERS[question[0]].fullmatch(line):
            self._take_answer(question, line, stamp_ns, arrived_ns)
        else:
            self._report.count("stray_lines")
            self._strays += 1
            return
        self._heard.hear(arrived_ns)
        self._in_flight.popleft()

    def _meet(self, now_ns: int) -> None:
        """The board has answered who it is, so the line is clear."""
        while self._in_flight[0][0] != BAUD:
            # Not answered: a stop, perhaps not heard.
            self._in_flight.popleft()
            self._motors.forget()
        self._is_in_step = self._is_known = True
        if self._is_greeted:
            return
        self._is_greeted = self._owes_gains = True
        self._schedule.begin(now_ns)

    def _take_answer(self, question: str, line: bytes, stamp_ns: int, arrived_ns: int) -> None:
        if question[0] in "em":
            self._invalid_in_row = 0
        if question == self._gains:
            self._owes_gains = False
        elif question[0] in "dap":
            scan = self._inputs.answer(question, int(line), arrived_ns)
            if scan is not None:
                self._report.add_range(scan)
        elif question == ENCODERS:
            self._heard.take_report(arrived_ns)
            left, right = (int(number) for number in line.split())
            motion = self._wheels.add(Counts(left, right, stamp_ns))
            if motion is not None:
                self._report.add_motion(motion)
            if self._wheels.has_jumped:
                self._report.add_jump()
            if self._wheels.has_restarted:
                self._report.count("restarts")
                self._owes_gains = True
                self._motors.forget()

    # What is sent.
    def drive(self, twist: Twist2D) -> None:
        """Set the wanted velocity; what it says of sideways is left out."""
        self._motors.want(Twist2D(twist.vx, 0.0, twist.wz))

    def outgoing(self, now_ns: int) -> bytes:
        """Return a stop at once, anything else when the line is free."""
        self._give_up(now_ns)
        wanted = self._motors.wanted if self._heard.is_reporting(now_ns) else Twist2D.zero()
        if self._is_known and wanted.is_zero and not self._motors.are_stopped:
            # Even to a board that does not answer: it may hear.
            stop = self._command(wanted, now_ns)
            return stop if self._is_in_step else stop + self._greet(now_ns)
        if self._in_flight:
            return b""
        if not self._is_in_step:
            return self._greet(now_ns)
        if self._gains and self._owes_gains:
            return self._ask(self._gains, now_ns)
        if wanted != self._motors.driven:
            self._schedule.hasten(MOTORS, self._motors.told_ns + NEW_MOTORS_EVERY_NS)
        due = self._schedule.pop_due(now_ns)
        if due is None:
            return b""
        return self._command(wanted, now_ns) if due == MOTORS else self._ask(due, now_ns)

    def _command(self, twist: Twist2D, now_ns: int) -> bytes:
        return self._ask(self._motors.tell(twist, now_ns), now_ns)

    def _greet(self, now_ns: int) -> bytes:
        waited = self._greeted_ns is None or now_ns - self._greeted_ns >= GREET_EVERY_NS
        if not (waited or self._is_greeted):
            return b""
        self._greeted_ns = now_ns
        return self._ask(BAUD, now_ns)

    def _ask(self, text: str, now_ns: int) -> bytes:
        self._in_flight.append((text, now_ns))
        return text.encode() + b"\r"

    def _give_up(self, now_ns: int) -> None:
        """Wait no longer for an answer that is late; after a longer silence greet it again."""
        if not self._in_flight or now_ns - self._in_flight[0][1] <= ANSWER_NS:
            return
        if self._is_greeted:
            self._report.count("timeouts")
        self._lose_step()
        if now_ns - self._heard.heard_ns >= SILENCE_NS:
            self._is_greeted = False

    def goodbye(self) -> tuple[bytes, ...]:
        """Stop the wheels."""
        return (STOP.encode() + b"\r",) if self._is_known else ()

    # How it goes.
    def status(self, now_ns: int) -> Status:
        """Say how it goes."""
        is_silent = self._heard.is_silent(now_ns)
        if not self._heard.has_reported and self._strays >= MOST_STRAYS:
            sentence = (
                "What arrives is not ROSArduinoBridge's: is this the motor board's port, and is "
                f"{self._baud} the firmware's baud rate?"
            )
            return Status("down" if is_silent else "searching", sentence, reopen=is_silent)
        if is_silent:
            return Status(
                "down",
                "The motor board is silent. Is it powered, and does it run ROSArduinoBridge?",
                reopen=True,
            )
        if self._invalid_in_row >= MOST_INVALID:
            return Status(
                "down",
                "The motor board knows no motors: its sketch was built without USE_BASE. Remove "
                "the comment slashes before #define USE_BASE and flash it again.",
            )
        if self._heard.is_reporting(now_ns):
            return Status("up")
        if self._heard.has_reported:
            return Status("down", "The motor board has stopped answering; it is asked again.")
        return Status("searching", "The motor board is being greeted.")

    def take(self, now_ns: int) -> ChassisReading:
        """Hand over what was reported."""
        inputs = self._inputs
        contacts = inputs.contacts() if self._heard.is_reporting(now_ns) else ()
        return self._report.take(self.status(now_ns), inputs.alarms(), inputs.battery, contacts)


FACTS = BoardFacts("ROSArduinoBridge (Arduino)", 57600, 2.0, has_inputs=True)
_BAUD_LINE = re.compile(rb"(?:^|[\r\n])%d\r\n" % FACTS.baud)
_COUNTS_LINE = re.compile(rb"(?:^|\n)(-?\d+ -?\d+|%s)\r\n" % INVALID)


def recognise(data: bytes) -> Answer | None:
    """Find a reply to `b`: the baud rate, on a line of its own."""
    return Answer() if _BAUD_LINE.search(data) else None


def read_counts(data: bytes) -> str | None:
    """Find an answer to `e`, two counts or a refusal; None until it is there."""
    answer = _COUNTS_LINE.search(data)
    return None if answer is None else answer[1].decode("ascii")


def describe(data: bytes) -> Answer:
    """Say how it does by its answer to `e`."""
    counts = read_counts(data)
    if counts is None:
        return Answer(problems=("It does not answer when asked for its encoders.",))
    if counts != INVALID.decode():
        return Answer((f"encoders at {counts}",))
    problem = (
        "Its sketch was built without USE_BASE and cannot drive: take the // away before "
        '"#define USE_BASE" in ROSArduinoBridge.ino, choose your motor driver, and upload it.'
    )
    return Answer(problems=(problem,))


# The CR ends what other questions have left in an Arduino's line: to it they are words that it does
# not know, and it says so.
QUESTION = BoardQuestion(
    FACTS.baud,
    (b"\r", b"b\r"),
    recognise,
    wait_s=0.2,
    rest_s=0.2,
    boots=True,
    follow_up=FollowUp(1.0, lambda data: read_counts(data) is not None, describe, ask=b"e\r"),
)


def _make(config: ChassisConfig, baud: int, drive: Drive) -> ArduinoBridgeDialogue:
    del drive
    assert config.wheels is not None
    return ArduinoBridgeDialogue(config, config.wheels, baud)


DRIVERS = {
    "arduino_bridge": BoardDriver(
        FACTS,
        _make,
        (QUESTION,),
        needs=("wheels",),
        api=API,
        page="arduino-bridge.md",
        example={"wheels": {"ticks_per_revolution": 1550.0, "diameter_m": 0.10, "track_m": 0.20}},
        emulator="trolley_base.emulators.arduino_bridge:BOARDS",
    )
}
