"""Hokuyo's URG-04LX, over SCIP 2.0, and a UTM-30LX, which tells intensities."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from bench.base.lidars.record import (
    Frame,
    Judged,
    LidarRecord,
    PlainFrames,
    Polar,
    Start,
    distance_m,
    distances,
)

from trolley_base.drivers.lidars import hokuyo as driver
from trolley_base.emulators import hokuyo


def hokuyo_stream() -> Iterator[Frame]:
    """Ten scans a second: 682 of 1024 steps in sight, the 384th of them ahead."""
    seen = range(hokuyo.FIRST, hokuyo.LAST + 1)
    values = [round(1000 * distance_m((one - hokuyo.FRONT) * 360.0 / 1024.0)) for one in seen]
    turn = 0
    while True:
        at_s = 0.1 * (turn + (hokuyo.LAST - hokuyo.FRONT) / 1024.0)
        yield Frame(at_s, hokuyo.encode("MD0044072501000", "99", round(1000 * at_s), values))
        turn += 1


class Answer(NamedTuple):
    """What a sensor sends for each scan, as SCIP 2.0 lays it down."""

    command: bytes
    steps: int
    front: int
    """Steps before the one that looks ahead."""
    step_deg: float
    characters: int
    """For each step; the first three are the distance."""
    least_mm: int
    greatest_mm: int
    """The distances that it measures; others mean that it saw nothing."""

    def length(self, data: bytes) -> int | None:
        """The command and status 99, a time, full lines and one that is not."""
        head = self.command + b"99b\n"
        if not head.startswith(data[:20]):
            return 0
        full, rest = divmod(self.characters * self.steps, 64)
        return None if len(data) < 20 else 20 + 6 + full * 66 + rest + 2 + 1

    def check(self, frame: bytes) -> bool:
        """A sum behind each line, and nothing in the last one."""
        lines = frame[20:].split(b"\n")
        full, rest = divmod(self.characters * self.steps, 64)
        if [len(line) for line in lines] != [5, *[65] * full, rest + 1, 0, 0]:
            return False
        return all(
            line[-1] == sum(line[:-1]) % 64 + 48 and all(48 <= one < 112 for one in line[:-1])
            for line in lines[:-2]
        )

    def samples(self, frame: bytes) -> Polar:
        """Six bits in each character, the highest first."""
        text = b"".join(line[:-1] for line in frame[26:].split(b"\n"))
        found: Polar = []
        for i in range(self.steps):
            high, middle, low = (one - 48 for one in text[self.characters * i :][:3])
            mm = high * 4096 + middle * 64 + low
            seen = self.least_mm <= mm <= self.greatest_mm
            found.append(((i - self.front) * self.step_deg % 360, mm if seen else 0))
        return found


COMMAND = b"MD0044072501000\n"
ACCEPTED = COMMAND + b"00P\n\n"
URG = Answer(COMMAND, 682, 340, 360 / 1024, 3, 20, 5600)
REFUSED = b"ME0044072501000\n"
"""Asks for intensities, too, which it does not know."""
PARAMETERS = driver.Parameters(20, 5600, 1024, 44, 725, 384, 600)


def hokuyo_frames(rng: np.random.Generator) -> list[bytes]:
    """Make three scans."""
    return [
        hokuyo.encode(COMMAND.decode().strip(), "99", 100 * i, distances(rng, 6000, 682))
        for i in range(3)
    ]


UTM_STEPS, UTM_FRONT = 1081, 540
UTM_COMMAND = b"ME0000108001000\n"
UTM_ACCEPTED = UTM_COMMAND + b"00P\n\n"
UTM = Answer(UTM_COMMAND, UTM_STEPS, UTM_FRONT, 0.25, 6, 23, 60000)
UTM_SAYS = ["DMIN:23", "DMAX:60000", "ARES:1440", "AMIN:0", "AMAX:1080", "AFRT:540", "SCAN:2400"]
UTM_PARAMETERS = driver.Parameters(23, 60000, 1440, 0, 1080, UTM_FRONT, 2400)


def utm_stream() -> Iterator[Frame]:
    """Forty scans a second: 1081 of 1440 steps in sight, the 540th of them ahead."""
    command, values = UTM_COMMAND.decode().strip(), list[int]()
    for step in range(UTM_STEPS):
        away_m = distance_m((step - UTM_FRONT) * 0.25)
        values += [round(1000 * away_m), intensity_of(step)]
    turn = 0
    while True:
        at_s = 0.025 * (turn + UTM_FRONT / 1440.0)
        yield Frame(at_s, hokuyo.encode(command, "99", round(1000 * at_s), values))
        turn += 1


def intensity_of(step: int) -> int:
    """What the echoes of `utm_stream` are worth, in the sensor's own unit."""
    return 1000 + 3 * step


def utm_frames(rng: np.random.Generator) -> list[bytes]:
    """Make three scans."""
    return [
        hokuyo.encode(UTM_COMMAND.decode().strip(), "99", 25 * i, values)
        for i, values in enumerate(distances(rng, 65000, 2 * UTM_STEPS) for _ in range(3))
    ]


RECORDS = {
    "Hokuyo URG": LidarRecord(
        model="hokuyo_urg",
        baud=4_000_000,
        turns_hz=10.0,
        samples_per_s=6820.0,
        is_counter_clockwise=True,
        most_unseen=0.45,
        sees_deg=(-119.6, 120.0),
        sends_whole_turns=True,
        stream=hokuyo_stream,
        finder=lambda: PlainFrames(URG.length, URG.check),
        reader=lambda: URG.samples,
        answers={
            b"VV\n": b"VV\n00P\nPROD:SOKUIKI Sensor URG-04LX-UG01(Simple-URG);[\n"
            b"PROT:SCIP 2.0;N\n\n",
            b"PP\n": b"PP\n00P\nDMIN:20;4\nDMAX:5600;_\nARES:1024;\\\nAMIN:44;7\nAMAX:725;o\n"
            b"AFRT:384;6\nSCAN:600;e\n\n",
            REFUSED: REFUSED + b"0Ee\n\n",
        },
        begins={COMMAND: ACCEPTED},
        ends=frozenset({b"\nQT\nTM2\n", b"QT\n"}),
        emulated=Start(COMMAND, ACCEPTED),
        form=driver.form_of(PARAMETERS),
        header=COMMAND + b"99b\n",
        judged=Judged(lambda counts: driver.ScipDecoder(PARAMETERS, counts), hokuyo_frames),
    ),
    "Hokuyo UTM-30LX": LidarRecord(
        model="hokuyo_urg",
        baud=12_000_000,
        turns_hz=40.0,
        samples_per_s=40.0 * UTM_STEPS,
        is_counter_clockwise=True,
        most_unseen=0.35,
        sees_deg=(-135.0, 135.0),
        is_twin=True,
        sends_whole_turns=True,
        stream=utm_stream,
        finder=lambda: PlainFrames(UTM.length, UTM.check),
        reader=lambda: UTM.samples,
        answers={
            b"VV\n": b"VV\n00P\nPROD:SOKUIKI Sensor TOP-URG UTM-30LX;B\nPROT:SCIP 2.0;N\n\n",
            b"PP\n": hokuyo.answer("PP", "00", hokuyo.about(*UTM_SAYS)),
        },
        begins={UTM_COMMAND: UTM_ACCEPTED},
        ends=frozenset({b"\nQT\nTM2\n", b"QT\n"}),
        emulated=None,
        judged=Judged(
            lambda counts: driver.ScipDecoder(UTM_PARAMETERS, counts, driver.WITH_INTENSITIES),
            utm_frames,
        ),
    ),
}
