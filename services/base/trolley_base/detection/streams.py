"""Telling a lidar by the frames that it sends unasked."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

from trolley_base.detection.known import guard
from trolley_base.detection.results import FoundDevice
from trolley_base.drivers.lidars import MODELS, LidarDriver
from trolley_base.drivers.lidars.frames import FrameFinder

ENOUGH_FRAMES = 5
"""Each carries a checksum of 8 bits or more besides its header: so many are no coincidence."""


def recognise_stream(data: bytes, baud: int) -> str | None:
    """Recognise a lidar that streams at a speed, if enough sound frames of it are there.

    Returns:
        The first of the models that send such frames.
    """
    for model, driver in MODELS.items():
        if driver.facts.baud == baud and guard(model, _sends)(driver, data):
            return model
    return None


def _sends(driver: LidarDriver, data: bytes) -> bool:
    if driver.frames is None:
        return False
    return len(FrameFinder(driver.frames, Counter()).feed(data)) >= ENOUGH_FRAMES


def describe_stream(model: str, others: Sequence[str] = ()) -> FoundDevice:
    """Describe a lidar that was known by its frames.

    Args:
        model: what it is, or the likeliest.
        others: what it may be as well: nothing that can be asked tells them apart.
    """
    facts = MODELS[model].facts
    unlike = [one for one in others if MODELS[one].facts.clockwise != facts.clockwise]
    details = tuple(
        f'or an {MODELS[one].facts.title}, if left and right are swapped: model = "{one}"'
        for one in unlike
    )
    return FoundDevice("lidar", model, facts.title, facts.baud, details)


def twins_of(model: str) -> list[str]:
    """Return the models that send the same frames at the same speed."""
    own = MODELS[model]
    return [
        name
        for name, driver in MODELS.items()
        if name != model and driver.frames is own.frames and driver.facts.baud == own.facts.baud
    ]


def with_faster_ones(found: FoundDevice) -> FoundDevice:
    """Add the models that send the same frames at another speed, which a network hides."""
    if found.model is None:
        return found
    own = MODELS[found.model]
    alike = tuple(
        f'or an {driver.facts.title}: model = "{name}"'
        for name, driver in MODELS.items()
        if own.frames is not None
        and driver.frames is own.frames
        and driver.facts.baud != own.facts.baud
    )
    return replace(found, details=(*found.details, *alike))
