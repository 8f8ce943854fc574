"""Telling a lidar by its answer to "who are you".

Sources:
    SLAMTEC rplidar_sdk (`sl_lidar_protocol.h`); YDLIDAR X4 development manual.
"""

import struct
from typing import NamedTuple

from trolley_base.detection.known import guard
from trolley_base.detection.results import FoundDevice
from trolley_base.drivers.lidars import MODELS
from trolley_base.drivers.lidars.handshake import HEALTH, HEALTH_BYTES, INFO, INFO_BYTES
from trolley_base.drivers.lidars.models import Identity

_FAULTY = 2
"""The health status of a lidar that does not measure."""


class Info(NamedTuple):
    """A lidar's identification."""

    model: int
    firmware: str
    hardware: int
    serial: bytes


def read_info(data: bytes) -> Info | None:
    """Find the answer to "who are you" of an RPLIDAR or YDLIDAR; None while it is not there."""
    body = _body(data, INFO, INFO_BYTES)
    if body is None:
        return None
    model, minor, major, hardware = struct.unpack_from("<4B", body)
    return Info(model, f"{major}.{minor:02d}", hardware, body[4:])


def read_health(data: bytes) -> tuple[int, int] | None:
    """Find the answer to "how are you": status (0 good, 1 warning, 2 error) and error code."""
    body = _body(data, HEALTH, HEALTH_BYTES)
    if body is None:
        return None
    status, code = struct.unpack("<BH", body)
    return status, code


def describe_lidar(
    identity: Identity, baud: int, info: Info, health: tuple[int, int] | None
) -> FoundDevice:
    """Say which lidar it is.

    Args:
        identity: whose questions it answered.
        baud: at which speed.
        info: who it says it is.
        health: how it says it is, None where it did not answer.
    """
    details, problems = _describe_health(info, identity.serial(info.serial), health)
    for model, driver in MODELS.items():
        if driver.identity is identity and guard(model, driver.is_model)(info.model):
            return FoundDevice("lidar", model, driver.facts.title, baud, details, problems)
    title, advice = identity.other_model(info.model)
    return FoundDevice("lidar", None, title, baud, details, (*problems, advice))


def _body(data: bytes, descriptor: bytes, length: int) -> bytes | None:
    start = data.find(descriptor)
    body = data[start + len(descriptor) :][:length] if start >= 0 else b""
    return body if len(body) == length else None


def _describe_health(
    info: Info, serial: str, health: tuple[int, int] | None
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return a lidar's identification in words, and its problems."""
    details = (f"firmware {info.firmware}", f"serial {serial}")
    if health is None:
        return details, ("It does not report its health: a weak 5 V supply is the usual cause.",)
    status, code = health
    if status == 0:
        return (*details, "health good"), ()
    if status < _FAULTY:
        return (*details, f"health warning (code {code})"), ()
    problem = (
        f"It reports a fault (code {code}): unplug its power for a few seconds; if the fault "
        f"stays, is the head free to turn and the 5 V supply strong enough?"
    )
    return (*details, f"health error {code}"), (problem,)
