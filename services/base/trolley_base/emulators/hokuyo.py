"""Hokuyo URG-04LX-UG01: SCIP 2.0 over USB, 682 of 1024 steps in sight, 10 turns a second.

Seen from above its steps go round counter-clockwise; step 384 looks ahead. It measures while a
stream runs, and sends a scan as soon as its last step has been taken. A head that does not turn
never gets there: it sends nothing then.

Source:
    Hokuyo's urg_library 1.2; the answer of a real one to VV, as published by its users; the
    SCIP 2.0 manual from memory for the numbers of errors.
"""

from dataclasses import dataclass

import numpy as np

from trolley_base.emulators.lidar import LidarFacts, MakeLidar, Mount, Samples, SpinningLidar
from trolley_base.world import LidarSpec

STEPS, FIRST, LAST, FRONT = 1024, 44, 725, 384
FACTS = LidarFacts(
    baud=115200,
    turns_hz=10.0,
    range_min_m=0.02,
    range_max_m=5.6,
    steps=STEPS,
    clockwise=False,
)
NO_ECHO = 7
"""The number that stands for a distance where there is none."""
VERSION = (
    "VEND:Hokuyo Automatic Co.,Ltd.",
    "PROD:SOKUIKI Sensor URG-04LX-UG01(Simple-URG)",
    "FIRM:3.4.03(17/Dec./2012)",
    "PROT:SCIP 2.0",
    "SERI:H1510998",
)
PARAMETERS = (
    "MODL:URG-04LX-UG01(Simple-URG)",
    "DMIN:20",
    "DMAX:5600",
    f"ARES:{STEPS}",
    f"AMIN:{FIRST}",
    f"AMAX:{LAST}",
    f"AFRT:{FRONT}",
    "SCAN:600",
)
MOST_LINE = 40


def with_sum(text: str) -> str:
    """Put the sum behind a line."""
    return text + chr((sum(text.encode("ascii")) % 64) + 48)


def in_characters(value: int, count: int) -> str:
    """Write a number in so many characters of six bits, the highest first."""
    return "".join(chr((value >> 6 * i) % 64 + 48) for i in reversed(range(count)))


def answer(command: str, status: str, lines: tuple[str, ...] = ()) -> bytes:
    """Answer a command; lines come with their sums."""
    return "\n".join((command, with_sum(status), *lines, "", "")).encode("ascii")


def about(*texts: str) -> tuple[str, ...]:
    """Make lines whose sums do not count the semicolon."""
    return tuple(f"{text};{with_sum(text)[-1]}" for text in texts)


def encode(command: str, status: str, stamp_ms: int, values: list[int]) -> bytes:
    """Make a scan.

    Args:
        command: as it is repeated; MS has two characters a step, MD three.
        status: 99 in a stream.
        stamp_ms: the sensor's time.
        values: distances [mm].
    """
    width = 2 if command[1] == "S" else 3
    data = "".join(in_characters(min(value, 64**width - 1), width) for value in values)
    lines = [data[i : i + 64] for i in range(0, len(data), 64)]
    stamp = in_characters(stamp_ms % (1 << 24), 4)
    return answer(command, status, tuple(map(with_sum, (stamp, *lines))))


@dataclass(slots=True)
class Stream:
    """What the host has asked for.

    Attributes:
        command: MD or MS with first and last step, cluster and skipped scans.
        first: step.
        last: step.
        cluster: of so many steps the nearest distance is sent.
        skip: so many scans are left out after each.
        left: scans that are still to be sent; None: for ever.
        wait: scans until the next one is sent.
    """

    command: str
    first: int
    last: int
    cluster: int
    skip: int
    left: int | None
    wait: int = 0


class Hokuyo(SpinningLidar):
    """The sensor; see the module."""

    is_usb = True
    buffer_bytes = 8192

    def __init__(self, mount: Mount, errors: LidarSpec, rng: np.random.Generator) -> None:
        super().__init__(FACTS, mount, errors, rng)
        self._line = ""
        self._stream: Stream | None = None
        self._ranges_mm = np.zeros(STEPS, np.int64)
        self._started_ns = 0

    def restart(self, now_ns: int) -> None:
        """Wait for a command."""
        self._line, self._stream, self._started_ns = "", None, now_ns
        self._halt()

    def receive(self, data: bytes, now_ns: int) -> None:
        """Obey lines of text; what is too long for one is none."""
        for char in data.decode("latin-1"):
            if char not in "\r\n":
                self._line = (self._line + char)[-MOST_LINE:]
            elif self._line:
                self._obey(self._line, now_ns)
                self._line = ""

    def _obey(self, command: str, now_ns: int) -> None:
        if not command.isascii() or not command.isprintable():
            return
        match command:
            case "VV":
                said = answer(command, "00", about(*VERSION))
            case "PP":
                said = answer(command, "00", about(*PARAMETERS))
            case "II":
                state = "ON" if self._stream else "OFF"
                lines = (
                    "MODL:URG-04LX-UG01(Simple-URG)",
                    f"LASR:{state}",
                    "SCSP:Initial(600[rpm])",
                )
                more = ("MESM:IDLE", "SBPS:USB only", "TIME:000000", "STAT:Sensor works well.")
                said = answer(command, "00", about(*lines, *more))
            case "QT" | "RS":
                self._stream = None
                self._halt()
                said = answer(command, "00")
            case "BM" | "SCIP2.0":
                said = answer(command, "00" if command == "BM" else "0E")
            case _:
                said = answer(command, self._begin(command, now_ns))
        self._send(now_ns, said)

    def _begin(self, command: str, now_ns: int) -> str:
        """Start a stream; the status of that."""
        kind, numbers = command[:2], command[2:]
        if kind not in ("MD", "MS"):
            return "0E"
        if len(numbers) != 13 or not numbers.isdigit():
            return "0C"
        first, last = int(numbers[:4]), int(numbers[4:8])
        cluster, skip, count = int(numbers[8:10]), int(numbers[10]), int(numbers[11:])
        if last > LAST:
            return "04"
        if first < FIRST or last <= first:
            return "05"
        left = count or None
        self._stream = Stream(command[:-2], first, last, max(1, cluster), skip, left)
        if self._head is None:
            self._ranges_mm[:] = 0
            self._spin(now_ns)
        return "00"

    def _emit(self, samples: Samples) -> None:
        steps = (FRONT + np.rint(samples.heads_deg * (STEPS / 360.0)).astype(np.int64)) % STEPS
        for time_ns, step, range_mm in zip(
            samples.times_ns.tolist(), steps.tolist(), samples.ranges_mm.tolist(), strict=True
        ):
            self._ranges_mm[step] = range_mm or NO_ECHO
            if step == LAST and not self.is_stuck:
                self._finish(time_ns)

    def _finish(self, now_ns: int) -> None:
        stream = self._stream
        if stream is None:
            return
        if stream.wait:
            stream.wait -= 1
            return
        stream.wait = stream.skip
        if stream.left is not None:
            stream.left -= 1
        values = self._ranges_mm[stream.first : stream.last + 1].tolist()
        width = stream.cluster
        nearest = [min(values[i : i + width]) for i in range(0, len(values), width)]
        command = f"{stream.command}{stream.left or 0:02d}"
        stamp_ms = (now_ns - self._started_ns) // 1_000_000
        self._send(now_ns, encode(command, "99", stamp_ms, nearest))
        if stream.left == 0:
            self._stream = None
            self._halt()


LIDARS: dict[str, MakeLidar] = {"hokuyo_urg": Hokuyo}
