"""Telling a lidar by the frames that it sends unasked."""

from collections import Counter

from trolley_base.detection.results import FoundDevice
from trolley_base.drivers.lidars import MODELS
from trolley_base.drivers.lidars.frames import FrameFinder

ENOUGH_FRAMES = 5
"""Each carries a checksum of 8 bits or more besides its header: so many are no coincidence."""

STREAM_BAUDS = tuple(
    dict.fromkeys(driver.facts.baud for driver in MODELS.values() if driver.frames is not None)
)
"""The speeds at which a lidar may talk unasked."""


def recognise_stream(data: bytes, baud: int) -> FoundDevice | None:
    """Recognise a lidar that streams at a speed, if enough sound frames of it are there."""
    for model, driver in MODELS.items():
        if driver.frames is None or driver.facts.baud != baud:
            continue
        if len(FrameFinder(driver.frames, Counter()).feed(data)) >= ENOUGH_FRAMES:
            return FoundDevice("lidar", model, driver.facts.title, baud)
    return None
