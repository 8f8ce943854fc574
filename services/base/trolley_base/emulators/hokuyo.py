"""Hokuyo URG-04LX-UG01: SCIP 2.0 over USB, 682 of 1024 steps in sight, 10 turns a second.

Seen from above its steps go round counter-clockwise; step 384 looks ahead. It measures while a
stream runs, and sends a scan as soon as its last step has been taken. A head that does not turn
never gets there: it sends nothing then.

Switched on by BM, it gives one scan for each GD or GS; TM sets aside everything but its clock.

Source:
    Hokuyo's urg_library 1.2; the answer of a real one to VV, as published by its users; hokuyolx
    0.9.0 for TM, BM and single scans; the SCIP 2.0 manual from memory for the numbers of errors.
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
        command: what each scan begins with: MD or MS with first and last step, cluster and skipped
            scans, GD or GS without the last.
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

    @property
    def is_single(self) -> bool:
        """Whether it is one scan of a laser that stays on."""
        return self.command[0] == "G"


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
        self._shows_time = False

    def restart(self, now_ns: int) -> None:
        """Wait for a command."""
        self._line, self._started_ns, self._shows_time = "", now_ns, False
        self._stop()

    def _stop(self) -> None:
        self._stream = None
        self._halt()

    def receive(self, data: bytes, now_ns: int) -> None:
        """Obey lines of text; what is too long for one is none."""
        for char in data.decode("latin-1"):
            if char not in "\r\n":
                self._line = (self._line + char)[-MOST_LINE:]
            else:
                line, self._line = self._line, ""
                if line.isascii() and line.isprintable() and line:
                    self._obey(line, now_ns)

    def _obey(self, command: str, now_ns: int) -> None:
        match command:
            case "VV":
                said = answer(command, "00", about(*VERSION))
            case "II":
                said = answer(command, "00", about(*self._state()))
            case "QT":
                self._stop()
                said = answer(command, "00")
            case "RS":
                self.restart(now_ns)
                said = answer(command, "00")
            case "TM0" | "TM1" | "TM2":
                said = self._clock(command, now_ns)
            case _ if self._shows_time:
                said = answer(command, "10")
            case "PP":
                said = answer(command, "00", about(*PARAMETERS))
            case "BM":
                said = answer(command, "02" if self._head else "00")
                self._light(now_ns)
            case _:
                said = self._begin(command, now_ns)
        if said:
            self._send(now_ns, said)

    def _state(self) -> tuple[str, ...]:
        return (
            "MODL:URG-04LX-UG01(Simple-URG)",
            f"LASR:{'ON' if self._head else 'OFF'}",
            "SCSP:Initial(600[rpm])",
            "MESM:IDLE",
            "SBPS:USB only",
            "TIME:000000",
            "STAT:Sensor works well.",
        )

    def _clock(self, command: str, now_ns: int) -> bytes:
        """Enter, read or leave the state in which it tells its time."""
        if command == "TM1" and self._shows_time:
            return answer(command, "00", (with_sum(in_characters(self._stamp_ms(now_ns), 4)),))
        if command == "TM1":
            return answer(command, "04")
        was, self._shows_time = self._shows_time, command == "TM0"
        if self._shows_time:
            self._stop()
        if was != self._shows_time:
            return answer(command, "00")
        return answer(command, "02" if was else "03")  # it was in that state already

    def _stamp_ms(self, now_ns: int) -> int:
        return (now_ns - self._started_ns) // 1_000_000 % (1 << 24)

    def _light(self, now_ns: int) -> None:
        if self._head is None:
            self._ranges_mm[:] = 0
            self._spin(now_ns)

    def _begin(self, command: str, now_ns: int) -> bytes:
        """Start a stream, or wait for one scan, which is its own answer."""
        status = self._start(command, now_ns)
        is_waiting = status == "00" and command[0] == "G"
        return b"" if is_waiting else answer(command, status)

    def _start(self, command: str, now_ns: int) -> str:
        """Note what is wanted; the status of that."""
        kind, numbers = command[:2], command[2:]
        if kind not in ("MD", "MS", "GD", "GS"):
            return "0E"
        is_single = kind[0] == "G"
        if len(numbers) != (10 if is_single else 13) or not numbers.isdigit():
            return "0C"
        first, last, cluster = int(numbers[:4]), int(numbers[4:8]), int(numbers[8:10])
        skip, count = (0, 1) if is_single else (int(numbers[10]), int(numbers[11:]))
        if last > LAST:
            return "04"
        if first < FIRST or last <= first:
            return "05"
        if is_single and self._head is None:
            return "10"
        begin = command if is_single else command[:-2]
        self._stream = Stream(begin, first, last, max(1, cluster), skip, count or None)
        self._light(now_ns)
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
        command, status = stream.command, "00"
        if not stream.is_single:
            command, status = f"{command}{stream.left or 0:02d}", "99"
        self._send(now_ns, encode(command, status, self._stamp_ms(now_ns), nearest))
        if stream.left == 0:
            self._stream = None
            if not stream.is_single:
                self._halt()


LIDARS: dict[str, MakeLidar] = {"hokuyo_urg": Hokuyo}
