"""Acme M1: lines of text. `V 200 -100` drives 200 mm/s and -100 mrad/s; it stops after 0.4 s.

Once it has been driven, with zeros too, it reports each 20 ms what its wheels do: `S 199 -98`.
`?` asks what it is: `Acme M1 firmware 7`.
"""

import re

from trolley.config.hardware import ChassisConfig
from trolley.geometry import Twist2D
from trolley.messages.motion import Drive
from trolley_base.drivers.boards.command_pace import CommandPace
from trolley_base.drivers.boards.models import Answer, BoardDriver, BoardFacts, BoardQuestion
from trolley_base.drivers.boards.report import REOPEN_AFTER_NS, SILENCE_NS, Report
from trolley_base.drivers.boards.velocities import VelocityIntegrator
from trolley_base.drivers.dialogue import Line, Status, travel_ns
from trolley_base.drivers.interface import ChassisReading

FACTS = BoardFacts("Acme M1", 115200, watchdog_s=0.4)
PERIOD_NS = 20_000_000
SPEEDS = re.compile(rb"S (-?\d{1,4}) (-?\d{1,4})")
NAME = re.compile(rb"Acme M1 firmware (\d+)\r\n")
STOP = b"V 0 0\n"


class AcmeDialogue:
    """Talks to the board.

    Args:
        baud: bits per second.
    """

    def __init__(self, baud: int) -> None:
        self._baud = baud
        self._report = Report()
        self._wheels = VelocityIntegrator(PERIOD_NS, self._report.count)
        self._pace = CommandPace()
        self.begin(0)

    @property
    def line(self) -> Line:
        """How the port is opened."""
        return Line(self._baud)

    def begin(self, now_ns: int) -> None:
        """The port has been opened: command nothing."""
        self._partial = b""
        self._wanted = Twist2D.zero()
        self._byte_ns = now_ns
        self._reported_ns: int | None = None
        self._wheels.reset()
        self._pace.reset()

    def receive(self, data: bytes, arrived_ns: int) -> None:
        """Take bytes."""
        if data:
            self._byte_ns = arrived_ns
        *lines, self._partial = (self._partial + data).split(b"\n")
        self._partial = self._partial[-64:]
        following = sum(len(line) + 1 for line in lines) + len(self._partial)
        for line in lines:
            left_ns = arrived_ns - travel_ns(following, self._baud)
            following -= len(line) + 1
            speeds = SPEEDS.fullmatch(line.strip())
            if speeds is None:
                self._report.count("stray_lines")
                continue
            self._reported_ns = arrived_ns
            forward, turn = (float(number) * 1e-3 for number in speeds.groups())
            motion = self._wheels.add(Twist2D(forward, 0.0, turn), left_ns)
            if motion is not None:
                self._report.add_motion(motion)

    def drive(self, twist: Twist2D) -> None:
        """Set the wanted velocity."""
        self._wanted = twist

    def outgoing(self, now_ns: int) -> bytes:
        """Return a command: zeros until it reports."""
        wanted = self._wanted if self._is_reporting(now_ns) else Twist2D.zero()
        if not self._pace.is_due(now_ns, stands=wanted.is_zero):
            return b""
        self._pace.note(now_ns, stands=wanted.is_zero)
        return b"V %d %d\n" % (round(wanted.vx * 1e3), round(wanted.wz * 1e3))

    def goodbye(self) -> tuple[bytes, ...]:
        """Stop the wheels."""
        return (STOP,)

    def _is_reporting(self, now_ns: int) -> bool:
        return self._reported_ns is not None and now_ns - self._reported_ns <= SILENCE_NS

    def status(self, now_ns: int) -> Status:
        """Say how it goes."""
        if self._is_reporting(now_ns):
            return Status("up")
        is_silent = now_ns - self._byte_ns >= REOPEN_AFTER_NS
        return Status("down" if is_silent else "searching", "No Acme M1 reports.", reopen=is_silent)

    def take(self, now_ns: int) -> ChassisReading:
        """Hand over what was reported."""
        return self._report.take(self.status(now_ns))


def recognise(data: bytes) -> Answer | None:
    """Find the answer to `?`."""
    found = NAME.search(data)
    return None if found is None else Answer((f"firmware {found[1].decode()}",))


def _make(config: ChassisConfig, baud: int, drive: Drive) -> AcmeDialogue:
    del config, drive
    return AcmeDialogue(baud)


DRIVERS = {
    "acme_m1": BoardDriver(
        FACTS,
        _make,
        # An empty line ends what other questions have left in its buffer.
        (BoardQuestion(FACTS.baud, (b"\n?\n",), recognise),),
        api=1,
        page="https://acme.example/m1",
        emulator="trolley_acme.emulators:BOARDS",
    )
}
