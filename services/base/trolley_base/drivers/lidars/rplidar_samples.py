"""The standard scan of an RPLIDAR: samples of 5 bytes without a checksum, 2000 a second and more.

Sample: quality (6 bits), not S, S (first of a revolution); angle [1/64 deg] (15 bits) above a check
bit; distance [mm / 4], 0 for none. A sample is *good* if S and not S differ, the check bit is 1 and
the angle is below 360 deg.

Since there is no checksum, where samples begin is found by being in step:

- Behind the answer to the command the first sample begins: in step.
- In step, the next sample is accepted if it is good, unless it has S and is less than 50 samples
  behind another with S (none turns 40 times a second at that rate), or is the 4000th behind the
  last with S or, while there was none, behind the first in step (one turn in 2 s). The first that
  is not accepted ends being in step, and the search begins at the byte behind its first.
- Out of step, a sample begins at the first byte at which eight good ones in a row begin, of which
  at most one has S, with angles that each differ from the one before by less than 20 deg either way
  and have gone forward by more than 0 and less than 60 deg in all.

The angles are corrected by the distance, so now and then one is less than that before; a revolution
begins where the farthest passes zero, which holds where the sample with S is lost too.

Counts: `lidar/bad_checksum` once each time that it falls out of step, `lidar/skipped_bytes` what it
skips until it is in step again.

Source:
    SLAMTEC RPLIDAR interface protocol; the rule for getting into step is our own.
"""

from collections import Counter
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley_base.drivers.lidars.decoding import Decoded, words
from trolley_base.drivers.lidars.frames import BAD_CHECKSUM, SKIPPED_BYTES, Bytes, Flags
from trolley_base.drivers.lidars.revolutions import Rotation, Samples
from trolley_base.drivers.lidars.scan_grid import Floats

SAMPLE_BYTES = 5
USUAL_HZ = 5.5
SAMPLE_S = 508e-6
IN_STEP = 8
FEWEST_A_TURN, MOST_A_TURN = 50, 4000
CIRCLE = 360 * 64
MOST_STEP, MOST_ADVANCE = 20 * 64, 60 * 64
BLOCK_BYTES = 1024
"""The search considers at most this much at once."""
JUMP_DEG = 15.0
"""A step in angle this long is no change of distance: samples are missing [deg]."""


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """Samples that follow each other without a gap.

    Attributes:
        data: (n, 5) uint8, n > 0.
        behind: bytes that had arrived behind the last.
        missed: bytes skipped before the first.
    """

    data: Bytes
    behind: int
    missed: int


class SampleFinder:
    """Finds the samples of one stream; keeps less than eight of them between two calls.

    Args:
        counts: what goes wrong is added here.
        in_step: whether the first byte is the first of a sample.
    """

    def __init__(self, counts: Counter[str], *, in_step: bool) -> None:
        self._counts = counts
        self._in_step = in_step
        self._rest: Bytes = np.empty(0, np.uint8)
        self._missed = 0
        # How far the next sample is behind the last with S, or behind the first in step.
        self._since = 0
        self._has_start = False

    def feed(self, data: bytes) -> list[Run]:
        """Return the samples that these bytes complete."""
        runs: list[Run] = []
        for start in range(0, len(data), BLOCK_BYTES):
            block = np.frombuffer(data[start : start + BLOCK_BYTES], np.uint8)
            runs += self._search(
                np.concatenate([self._rest, block]), len(data) - start - len(block)
            )
        return runs

    def _search(self, buffer: Bytes, behind: int) -> list[Run]:
        runs: list[Run] = []
        position = 0
        while True:
            if not self._in_step:
                skipped, self._in_step = _into_step(buffer[position:])
                self._skip(skipped)
                position += skipped
                if not self._in_step:
                    break
                self._since, self._has_start = 0, False
            whole = (len(buffer) - position) // SAMPLE_BYTES
            samples = buffer[position : position + whole * SAMPLE_BYTES].reshape(-1, SAMPLE_BYTES)
            accepted = self._accept(samples)
            position += accepted * SAMPLE_BYTES
            if accepted:
                left = behind + len(buffer) - position
                runs.append(Run(samples[:accepted], left, self._missed))
                self._missed = 0
            if accepted == whole:
                break
            self._in_step = False
            self._counts[BAD_CHECKSUM] += 1
            self._skip(1)
            position += 1
        self._rest = buffer[position:].copy()
        return runs

    def _accept(self, samples: Bytes) -> int:
        """Return how many samples from the first on are accepted."""
        bad = np.flatnonzero(~_is_good(samples[:, 0], _angles(samples[:, 1], samples[:, 2])))
        end = int(bad[0]) if len(bad) else len(samples)
        reference = -self._since
        for start in np.flatnonzero(samples[:end, 0] & 1).tolist():
            if start - reference >= MOST_A_TURN:
                break
            if self._has_start and start - reference < FEWEST_A_TURN:
                end = start
                break
            reference, self._has_start = start, True
        end = min(end, reference + MOST_A_TURN)
        self._since = end - reference
        return end

    def _skip(self, count: int) -> None:
        if count:
            self._counts[SKIPPED_BYTES] += count
            self._missed += count


def _angles(low: Bytes, high: Bytes) -> NDArray[np.int64]:
    """Return angles with the check bit below [1/128 deg]."""
    return low.astype(np.int64) | high.astype(np.int64) << 8


def _is_good(flags: Bytes, checked_angle: NDArray[np.int64]) -> Flags:
    differ = (flags ^ (flags >> 1)) & 1
    return (differ == 1) & (checked_angle & 1 == 1) & (checked_angle >> 1 < CIRCLE)


def _into_step(buffer: Bytes) -> tuple[int, bool]:
    """Return how many bytes to skip, and whether a sample in step begins behind them."""
    count = len(buffer) - IN_STEP * SAMPLE_BYTES + 1
    if count <= 0:
        return 0, False
    checked = _angles(buffer[1:-3], buffer[2:-2])
    good, starts = _is_good(buffer[:-4], checked), buffer[:-4] & 1
    angles = checked >> 1
    fits, num_starts = np.ones(count, np.bool_), np.zeros(count, np.int64)
    advance = np.zeros(count, np.int64)
    for offset in range(0, IN_STEP * SAMPLE_BYTES, SAMPLE_BYTES):
        fits &= good[offset : offset + count]
        num_starts += starts[offset : offset + count]
        if offset:
            step = angles[offset : offset + count] - angles[offset - SAMPLE_BYTES :][:count]
            step = (step + CIRCLE // 2) % CIRCLE - CIRCLE // 2
            fits &= np.abs(step) < MOST_STEP
            advance += step
    fits &= (num_starts <= 1) & (advance > 0) & (advance < MOST_ADVANCE)
    first = int(np.argmax(fits))
    return (first, True) if fits[first] else (count, False)


class StandardDecoder:
    """Reads samples.

    Args:
        counts: what goes wrong is added here.
        sample_s: between two samples, as the sensor says.
        in_step: whether the first byte is the first of a sample.
    """

    def __init__(
        self, counts: Counter[str], sample_s: float = SAMPLE_S, *, in_step: bool = True
    ) -> None:
        self._finder = SampleFinder(counts, in_step=in_step)
        self._rotation = Rotation(USUAL_HZ)
        self._sample_s = sample_s
        self._last_deg: float | None = None
        self._step_deg = 1.0

    def decode(self, data: bytes) -> Decoded | None:
        """Return the samples that these bytes complete; None if there are none."""
        runs = self._finder.feed(data)
        if not runs:
            return None
        rows = np.concatenate([run.data for run in runs])
        lengths = np.array([len(run.data) for run in runs])
        closing = np.cumsum(lengths) - 1
        missed = np.zeros(len(rows))
        missed[closing - lengths + 1] = [run.missed / SAMPLE_BYTES for run in runs]
        seen_deg = (_angles(rows[:, 1], rows[:, 2]) >> 1) / 64.0
        angle_deg, _, begins = self._rotation.follow(seen_deg, np.zeros(len(rows)))
        samples = Samples(
            angle_deg,
            np.zeros(len(rows)),
            self._elapsed_s(seen_deg, missed),
            begins,
            words(rows[:, 3:5])[:, 0] / 4000.0,
            (rows[:, 0] >> 2).astype(np.float64),
        )
        behind = np.array([run.behind + SAMPLE_BYTES for run in runs])
        return Decoded(samples, closing, behind)

    def _elapsed_s(self, angle_deg: Floats, missed: Floats) -> Floats:
        """Return the time since the sample before (n,) [s], what is missing included."""
        first = angle_deg[0] if self._last_deg is None else self._last_deg
        step = (np.diff(angle_deg, prepend=first) + JUMP_DEG) % 360.0 - JUMP_DEG
        self._last_deg = float(angle_deg[-1])
        if len(step) >= IN_STEP:
            self._step_deg = max(float(np.median(step)), 0.1)
        by_angle = np.where(step > JUMP_DEG, step / self._step_deg, 1.0)
        return np.maximum(by_angle, 1.0 + missed) * self._sample_s
