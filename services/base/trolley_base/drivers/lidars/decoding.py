"""What the decoder of a model does: bytes in, samples out."""

from collections import Counter
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from trolley_base.drivers.lidars.frames import (
    Bytes,
    Flags,
    FrameFinder,
    FrameFormat,
    Frames,
    Indices,
)
from trolley_base.drivers.lidars.revolutions import Rotation, Samples
from trolley_base.drivers.lidars.scan_grid import Floats


class Decoded(NamedTuple):
    """Samples, and what tells when they were measured.

    Attributes:
        samples: in the order in which they were measured, at least one.
        closing: (f,) indices of those that close a frame.
        behind: (f,) bytes sent since each of these was measured, its frame included.
        turns_hz: how fast the head turns as the newest frame says it; None: it does not.
        ahead_s: so much later than `closing` the frames' bytes began to leave.
    """

    samples: Samples
    closing: Indices
    behind: Indices
    turns_hz: float | None = None
    ahead_s: float = 0.0


class Decoder(Protocol):
    """Of one model and one opening of its port."""

    def decode(self, data: bytes) -> Decoded | None:
        """Return the samples that these bytes complete; None if there are none."""
        ...


class FrameDecoder:
    """Decodes frames that hold samples at even steps; subclasses say where.

    Args:
        form: of the frames.
        usual_hz: how fast the head turns where a frame does not say it.
        counts: what goes wrong is added here.
    """

    def __init__(self, form: FrameFormat, usual_hz: float, counts: Counter[str]) -> None:
        self._finder = FrameFinder(form, counts)
        self._rotation = Rotation(usual_hz)

    def decode(self, data: bytes) -> Decoded | None:
        """Return the samples that these bytes complete; None if there are none."""
        frames = self._finder.feed(data)
        return self._samples(frames) if len(frames) else None

    def _samples(self, frames: Frames) -> Decoded:
        """Read frames, of which there is at least one."""
        raise NotImplementedError

    def _evenly(
        self,
        frames: Frames,
        angle_deg: Floats,
        rate_dps: Floats,
        values: tuple[Floats, Floats],
        shift_deg: Floats | None = None,
    ) -> Decoded:
        """Put frames of equal size together.

        Args:
            frames: n of them.
            angle_deg: (n, m) where the head pointed at each sample, any turn.
            rate_dps: (n,) how fast the head turned.
            values: (n, m) ranges [m], and (n, m) intensities.
            shift_deg: (n, m) to add for where the beams looked; None: nothing.
        """
        per_frame = angle_deg.shape[1]
        angle_deg = angle_deg.ravel() % 360.0
        angle_deg, elapsed_s, begins = self._rotation.follow(
            angle_deg, np.repeat(rate_dps, per_frame)
        )
        shift_deg = np.zeros(len(angle_deg)) if shift_deg is None else shift_deg.ravel()
        samples = Samples(
            angle_deg, shift_deg, elapsed_s, begins, *(value.ravel() for value in values)
        )
        closing = np.arange(1, len(frames) + 1) * per_frame - 1
        hz = float(rate_dps[-1]) / 360.0
        return Decoded(samples, closing, frames.behind + frames.lengths, hz)


def latest(before: float, tells: Flags, told: Floats) -> Floats:
    """Return what holds at each of n frames (n,): the newest of what was told until then.

    Args:
        before: what held before the first.
        tells: (n,) whether a frame tells it.
        told: (n,) what it tells.
    """
    return np.concatenate([[before], told[tells]])[np.cumsum(tells)]


def turned_deg(first_deg: Floats, last_deg: Floats) -> Floats:
    """Return how far a head has turned from one angle to another [deg].

    One that stands trembles: a step back is none, rather than nearly a whole turn.
    """
    return np.maximum((last_deg - first_deg + 180.0) % 360.0 - 180.0, 0.0)


def words(data: Bytes) -> NDArray[np.uint16]:
    """Return rows of bytes as rows of little-endian words."""
    return np.ascontiguousarray(data).view("<u2")
