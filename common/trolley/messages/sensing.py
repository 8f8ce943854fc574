"""Messages about what sensors see and what it means: images, scan, beam classes, mirrors."""

from msgspec import Struct

from trolley.geometry.pose import Finite
from trolley.messages.types import NonNegative, Point, Positive, Share, StampNs, check_floats

EXPLAINED, NOT_ON_MAP, BEHIND_MIRROR, SUSPECTED, UNUSED = range(5)
"""Beam classes of `BeamClasses`."""


class CameraImage(Struct, frozen=True, kw_only=True):
    """What a camera sees, as the bytes of a JPEG file. From any program that has a camera.

    `stamp_ns` is the robot time at which it was taken.
    """

    stamp_ns: StampNs
    jpeg: bytes


class Scan(Struct, frozen=True, kw_only=True):
    """One lidar revolution in `frame`, counter-clockwise. Owned by `base`, 5-50 Hz.

    Beam i lies at exactly `angle_min + i * angle_increment` [rad] and was measured at
    `stamp_ns` + i * `time_increment` [s] (negative for a sensor that turns clockwise).
    `ranges` [m] and `intensities` (may be empty) are float32 bytes, shape (N,): no echo = +inf,
    invalid = 0.
    """

    stamp_ns: StampNs
    frame: str
    angle_min: Finite
    angle_increment: Positive
    time_increment: Finite
    range_min: NonNegative
    range_max: Positive
    ranges: memoryview
    intensities: memoryview = memoryview(b"")

    def __post_init__(self) -> None:
        """Refuse arrays that are not float32 or differ in length."""
        beams = check_floats("Scan", "ranges", self.ranges)
        intensities = check_floats("Scan", "intensities", self.intensities)
        if intensities not in (0, beams):
            raise ValueError(f"Scan.intensities: {intensities} values for {beams} ranges")


class BeamClasses(Struct, frozen=True, kw_only=True):
    """How the localizer classifies each beam of the scan stamped `stamp_ns`, at most 10 Hz.

    `classes` is uint8, shape (N,): 0 explained by the map, 1 not on the map, 2 behind a mirror or
    glass, 3 suspected to be a reflection, 4 unused.
    """

    stamp_ns: StampNs
    classes: memoryview


class SuspectLine(Struct, frozen=True, kw_only=True):
    """A line in `map` that behaves like a mirror, and how certain that is."""

    points: list[Point]
    score: Share


class Suspects(Struct, frozen=True, kw_only=True):
    """Mirrors that are not on the map, in frame `map`, on change.

    Owned by `localizer`; by `mapper` while it makes a map.
    """

    stamp_ns: StampNs
    lines: list[SuspectLine]
