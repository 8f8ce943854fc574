"""The records of all lidars, and what reads them plainly."""

import importlib
import math

from bench.base.lidars.record import LidarRecord

from trolley.drivers import BUILT_IN, LIDARS

RECORDS: dict[str, LidarRecord] = {
    title: record
    for family in BUILT_IN[LIDARS]
    for title, record in importlib.import_module(f"bench.base.lidars.{family}").RECORDS.items()
}
"""By title, in the order of the drivers."""


def record_of(model: str) -> LidarRecord | None:
    """Return the record of a model, None if it sends what another does."""
    return next((one for one in RECORDS.values() if one.model == model), None)


class PlainDriver:
    """Finds frames and sorts their samples into the degrees of a turn, the nearest first."""

    def __init__(self, title: str) -> None:
        self._finder = RECORDS[title].finder()
        self._samples = RECORDS[title].reader()
        self._degrees = [math.inf] * 360
        self._last_deg = 0.0
        self.turns: list[list[float]] = []

    def feed(self, data: bytes) -> None:
        """Take bytes; whole turns are added to `turns`."""
        for frame in self._finder.feed(data):
            for angle, mm in self._samples(frame):
                if angle < self._last_deg - 180:
                    self.turns.append(self._degrees)
                    self._degrees = [math.inf] * 360
                self._last_deg = angle
                if mm:
                    degree = int(angle)
                    self._degrees[degree] = min(self._degrees[degree], mm)
