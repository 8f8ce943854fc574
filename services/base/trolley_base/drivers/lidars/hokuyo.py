"""Hokuyo's lidars on USB that speak SCIP 2.0: asked in lines of text, a whole scan in each answer.

URG-04LX, URG-04LX-UG01, UBG-04LX, UHG-08LX, UTM-30LX. They see a sector and turn on in the dark: a
scan of a turn has its invalid beams there. How many steps a turn has, which of them are seen, how
fast and how far: the sensor says it (`PP`).

A command is a line; the answer is the same line, a status of two digits and its sum, lines of data,
an empty line. All lines but the first end with a sum: 30 and the lowest six bits of the sum of the
characters before it, in answers to VV and PP without the semicolon. `ME` starts the laser and an
endless stream, each scan an answer of its own: status 99, a time [ms] of four characters, then for
each step three characters of distance and three of intensity, in lines of 64. Six bits a character,
above 30, the highest first; distances in mm. One that is nearer or farther than it says it can see
is the number of an error. A sensor that knows no intensities refuses `ME`: `MD` asks for the
distances alone.

Angles grow counter-clockwise. As USB carries all at once, a scan was measured when it arrives.

Source:
    Hokuyo, urg_library 1.2 (urg_sensor.c), as Hokuyo-aut/urg_node2 has it; the SCIP 2.0 manual
    from memory.
"""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from trolley.config.hardware import LidarConfig
from trolley.drivers import API
from trolley_base.drivers.lidars.decoding import Decoded
from trolley_base.drivers.lidars.frames import Bytes, Flags, FrameFinder, FrameFormat, Indices
from trolley_base.drivers.lidars.handshake import ANSWER_S, Handshake, HandshakeLidar, Step
from trolley_base.drivers.lidars.models import Greeting, LidarDriver, LidarFacts
from trolley_base.drivers.lidars.revolutions import Samples

STOP, SPEAK_SCIP2, GET_VERSION, GET_PARAMETERS = b"QT\n", b"SCIP2.0\n", b"VV\n", b"PP\n"
LEAVE_CLOCK = b"TM2\n"
"""A sensor that was left telling its time refuses all that measures."""
WELL = b"00P"
WITH_INTENSITIES, DISTANCES = b"ME", b"MD"
END = b"\n\n"
DRAIN_S, START_S, CONFUSED_PAUSE_S = 0.2, 2.0, 2.0
LINE_CHARS, CHARS = 64, 3
STAMP_AT, DATA_AT = 20, 26
"""Where the time and the first line of data begin: behind 15 characters, 3, and two line feeds."""
STAMPS = 1 << 24
MOST_STEPS = 8192
MOST_TURNS = 100
"""So many turns between two scans [1] are no loss, but a clock that has begun anew."""
SPEEDS = (0.9, 1.1)
"""How slowly and how fast it may turn, of what it says [1]."""

FACTS = LidarFacts(
    title="Hokuyo URG",
    baud=115200,
    range_min_m=0.02,
    range_max_m=5.6,
    turns_hz=(9.0, 11.0),
    usual_hz=10.0,
    clockwise=False,
    has_usb=True,
)
"""Of a URG-04LX; what counts is what the sensor says."""


@dataclass(frozen=True, slots=True)
class Parameters:
    """What a sensor says of itself.

    Attributes:
        near_mm: nearest distance (DMIN).
        far_mm: farthest (DMAX).
        steps: in a turn (ARES).
        first: step that it sees (AMIN).
        last: step that it sees (AMAX).
        front: the step that looks ahead (AFRT).
        rpm: how fast it turns (SCAN).
    """

    near_mm: int
    far_mm: int
    steps: int
    first: int
    last: int
    front: int
    rpm: int

    @property
    def seen(self) -> int:
        """How many steps it sees."""
        return self.last - self.first + 1

    def are_sound(self) -> bool:
        """Whether there can be such a sensor: it sees a sector, and turns."""
        return (
            0 <= self.near_mm < self.far_mm
            and 0 <= self.first <= self.front <= self.last < 10_000
            and 1 < self.seen < self.steps <= MOST_STEPS
            and 60 <= self.rpm <= 60 * 100
        )


def line_sum(data: bytes) -> int:
    """Return the character that ends a line."""
    return (sum(data) & 0x3F) + 0x30


def read_lines(answer: bytes) -> dict[str, str]:
    """Read an answer to VV or PP: what is known by which name; lines with a wrong sum are none."""
    found: dict[str, str] = {}
    for line in answer.split(b"\n"):
        text = line[:-1].removesuffix(b";")
        if not line or line[-1] not in (line_sum(text), line_sum(line[:-1])):
            continue
        name, colon, value = text.decode("ascii", "replace").partition(":")
        if colon:
            found[name] = value.strip()
    return found


def read_parameters(lines: Mapping[str, str]) -> Parameters | None:
    """Return what the sensor says of itself; None where that is incomplete or makes no sense."""
    names = ("DMIN", "DMAX", "ARES", "AMIN", "AMAX", "AFRT", "SCAN")
    values = [lines.get(name, "") for name in names]
    if not all(value.isascii() and value.isdigit() and len(value) <= 9 for value in values):
        return None
    parameters = Parameters(*map(int, values))
    return parameters if parameters.are_sound() else None


def start_of(parameters: Parameters, kind: bytes) -> bytes:
    """Return the command of this kind that starts an endless stream of all that it sees."""
    return b"%b%04d%04d01000\n" % (kind, parameters.first, parameters.last)


def values_of(kind: bytes) -> int:
    """Return how many values a step has."""
    return 2 if kind == WITH_INTENSITIES else 1


def form_of(parameters: Parameters, kind: bytes = DISTANCES) -> FrameFormat:
    """Return what a scan looks like that was started by `start_of`."""
    head = np.frombuffer(start_of(parameters, kind) + b"99b\n", np.uint8)
    chars = CHARS * values_of(kind) * parameters.seen
    lines, rest = divmod(chars, LINE_CHARS)
    size = DATA_AT + lines * (LINE_CHARS + 2) + (rest + 2 if rest else 0) + 1

    def lengths(heads: Bytes) -> Indices:
        return np.where((heads == head).all(axis=1), size, 0)

    def check(frames: Bytes) -> Flags:
        full = frames[:, DATA_AT : DATA_AT + lines * (LINE_CHARS + 2)]
        good = _are_lines(frames[:, None, STAMP_AT:DATA_AT])
        good &= _are_lines(full.reshape(len(frames), lines, LINE_CHARS + 2))
        if rest:
            good &= _are_lines(frames[:, None, -rest - 3 : -1])
        return good & (frames[:, -1] == 0x0A)

    return FrameFormat(len(head), size, lengths, check)


def _are_lines(lines: Bytes) -> Flags:
    """Say of (n, m, w) lines with their sums and line feeds whether all m are sound."""
    text = lines[:, :, :-2]
    sums = (text.sum(axis=2, dtype=np.int64) & 0x3F) + 0x30
    good = (sums == lines[:, :, -2]) & (lines[:, :, -1] == 0x0A)
    good &= ((text >= 0x30) & (text < 0x70)).all(axis=2)
    return good.all(axis=1)


class ScipDecoder:
    """Reads scans.

    Each is a turn that begins in the dark, behind what the sensor sees: so that it is complete as
    soon as its scan is there, the dark of the next turn follows at once.

    Args:
        parameters: of the sensor.
        counts: what goes wrong is added here.
        kind: of the command that started it.
    """

    def __init__(
        self, parameters: Parameters, counts: Counter[str], kind: bytes = DISTANCES
    ) -> None:
        self._parameters = parameters
        self._finder = FrameFinder(form_of(parameters, kind), counts)
        self._values = values_of(kind)
        self._stamp: int | None = None
        seen, steps = parameters.seen, parameters.steps
        self._places = np.concatenate([np.arange(steps - seen, steps), np.arange(steps - seen)])
        at = np.arange(CHARS * self._values * seen)
        self._chars = DATA_AT + at + 2 * (at // LINE_CHARS)

    def decode(self, data: bytes) -> Decoded | None:
        """Return the samples that these bytes complete; None if there are none."""
        frames = self._finder.feed(data)
        if not len(frames):
            return None
        num, of = len(frames), self._parameters
        step_deg, turn_s = 360.0 / of.steps, 60.0 / of.rpm
        digits = frames.data[:, self._chars].reshape(num, of.seen, self._values, CHARS)
        high, middle, low = np.moveaxis(digits.astype(np.int64) - 0x30, -1, 0)
        values = (high << 12) + (middle << 6) + low
        millimetres = values[:, :, 0]
        is_range = (millimetres >= of.near_mm) & (millimetres <= of.far_mm)
        range_m = np.zeros((num, of.steps))
        range_m[:, : of.seen] = np.where(is_range, millimetres / 1000.0, 0.0)
        more = self._values - 1
        intensity = np.zeros((num, more * of.steps))
        intensity[:, : more * of.seen] = values[:, :, 1:].reshape(num, more * of.seen)
        angle = np.tile(self._places, num).astype(np.float64) * step_deg
        begins = np.tile(self._places == 0, num)
        turns, hz = self._turns(frames.data[:, STAMP_AT : STAMP_AT + 4], turn_s)
        elapsed_s = np.full((num, of.steps), turn_s / of.steps)
        elapsed_s[:, 0] += (turns - 1) * turn_s
        shift = np.full(num * of.steps, (of.last + 1 - of.front) * step_deg - 360.0)
        samples = Samples(
            angle, shift, elapsed_s.ravel(), begins, range_m.ravel(), intensity.ravel()
        )
        closing = np.arange(num) * of.steps + of.seen - 1
        return Decoded(samples, closing, frames.behind + frames.lengths, hz)

    def _turns(self, chars: Bytes, turn_s: float) -> tuple[Indices, float]:
        """Return how many turns lie before each scan (n,), and how fast the newest was [Hz]."""
        stamps = (chars.astype(np.int64) - 0x30) @ (1 << 18, 1 << 12, 1 << 6, 1)
        usual = round(turn_s * 1000.0)
        before = int(stamps[0]) - usual if self._stamp is None else self._stamp
        self._stamp = int(stamps[-1])
        apart_s = np.diff(stamps, prepend=before) % STAMPS / 1000.0
        turns = np.maximum(np.rint(apart_s / turn_s), 1.0)
        is_lost = turns > MOST_TURNS
        turns[is_lost] = 1.0
        hz = float(turns[-1] / apart_s[-1]) if apart_s[-1] > 0.0 and not is_lost[-1] else 0.0
        return turns.astype(np.int64), hz or 1.0 / turn_s


class Hokuyo(HandshakeLidar):
    """The sensor; see the module.

    Raises:
        DriverError: the configuration asks for what it cannot do.
    """

    def __init__(self, config: LidarConfig) -> None:
        usual = Parameters(20, 5600, 1024, 44, 725, 384, 600)
        super().__init__(FACTS, config, partial(ScipDecoder, usual))

    def goodbye(self) -> tuple[bytes, ...]:
        """Stop the stream and the laser."""
        return (STOP,)

    def _handshake(self) -> Handshake:
        while True:
            yield Step(b"\n" + STOP + LEAVE_CLOCK, DRAIN_S)
            # Older firmware begins with SCIP 1.1; to the others it is an unknown command.
            yield Step(SPEAK_SCIP2, DRAIN_S)
            version = yield Step(GET_VERSION, ANSWER_S, GET_VERSION + WELL, end=END)
            if version is None:
                continue
            answer = yield Step(GET_PARAMETERS, ANSWER_S, GET_PARAMETERS + WELL, end=END)
            if answer is None:
                continue
            parameters = read_parameters(read_lines(answer))
            if parameters is None:
                self._fault = (
                    f"The {self.facts.title} does not say in full how it measures: is another "
                    "program asking it, or its cable damaged?"
                )
                yield Step(b"", CONFUSED_PAUSE_S)
                continue
            self._fault = ""
            self._believe(parameters, read_lines(version).get("PROD", ""))
            for kind in (WITH_INTENSITIES, DISTANCES):
                start = start_of(parameters, kind)
                if (yield Step(start, START_S, start, end=END)) == WELL:
                    self._restart(ScipDecoder(parameters, self._counts, kind))
                    return

    def _believe(self, parameters: Parameters, product: str) -> None:
        hz = parameters.rpm / 60.0
        self.facts = replace(
            FACTS,
            title=_title(product),
            range_min_m=parameters.near_mm / 1000.0,
            range_max_m=parameters.far_mm / 1000.0,
            turns_hz=(hz * SPEEDS[0], hz * SPEEDS[1]),
            usual_hz=hz,
        )


def _title(product: str) -> str:
    """Return a product's name without what all of them are called, and what stands in brackets."""
    name = product.removeprefix("SOKUIKI Sensor").partition("(")[0].strip()
    return f"Hokuyo {name}" if name else FACTS.title


def recognise(data: bytes) -> tuple[str, tuple[str, ...]] | None:
    """Find an answer to VV: the title, and what people may want to know of the sensor."""
    _, asked, answer = data.partition(GET_VERSION + WELL)
    body, end, _ = answer.partition(END)
    lines = read_lines(body)
    if not asked or not end or "SCIP" not in lines.get("PROT", ""):
        return None
    known = (("firmware", lines.get("FIRM")), ("serial", lines.get("SERI")))
    return _title(lines.get("PROD", "")), tuple(f"{name} {value}" for name, value in known if value)


DRIVERS: dict[str, LidarDriver] = {
    "hokuyo_urg": LidarDriver(
        FACTS,
        Hokuyo,
        greeting=Greeting((b"\n" + STOP, SPEAK_SCIP2, GET_VERSION), recognise),
        ros_packages=("hokuyo_node", "urg_node", "urg_node2"),
        api=API,
        page="hokuyo-urg.md",
        emulator="trolley_base.emulators.hokuyo:LIDARS",
    )
}
