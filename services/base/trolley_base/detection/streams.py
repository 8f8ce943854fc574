"""Telling a lidar by the frames that it sends unasked."""

from collections import Counter

from trolley.config.hardware import LidarModel
from trolley_base.detection.results import Found
from trolley_base.drivers.lidars import ld19, lds01, xv11
from trolley_base.drivers.lidars.frames import FrameFinder, FrameFormat
from trolley_base.drivers.lidars.models import MODELS

# Each frame carries a checksum of 8 bits or more besides its header: this many are no accident.
ENOUGH_FRAMES = 5


def hear_fast(data: bytes) -> Found | None:
    """Recognise what sends at 230400 baud: an LD19 or a running LDS-01."""
    return _hear(data, "ld19", ld19.FORMAT) or _hear(data, "lds01", lds01.FORMAT)


def hear_xv11(data: bytes) -> Found | None:
    """Recognise an XV11, which sends at 115200 baud."""
    return _hear(data, "xv11", xv11.FORMAT)


def _hear(data: bytes, model: LidarModel, form: FrameFormat) -> Found | None:
    """Recognise a model if enough of its frames are there, their checks right."""
    if len(FrameFinder(form, Counter()).feed(data)) < ENOUGH_FRAMES:
        return None
    return Found("lidar", model, MODELS[model].title, MODELS[model].baud)
