"""Telling a device by its answer to a harmless question.

Sources:
    SLAMTEC rplidar_sdk (`sl_lidar_protocol.h`); YDLIDAR X4 development manual; hbrobotics
    ros_arduino_bridge (`commands.h`).
"""

import re
import struct
from typing import NamedTuple

from trolley_base.detection.results import Found
from trolley_base.drivers.boards import BOARDS
from trolley_base.drivers.lidars.handshake import HEALTH, HEALTH_BYTES, INFO, INFO_BYTES
from trolley_base.drivers.lidars.models import MODELS

RPLIDAR_BAUD, YDLIDAR_BAUD = MODELS["rplidar_a1"].baud, MODELS["ydlidar_x4"].baud
BRIDGE = BOARDS["arduino_bridge"]

_X4 = 6
_FAULTY = 2

_REFUSAL = "Invalid Command"
_BAUD_LINE = re.compile(rb"(?:^|[\r\n])%d\r\n" % BRIDGE.baud)
_COUNTS_LINE = re.compile(rb"(?:^|\n)(-?\d+ -?\d+|Invalid Command)\r\n")


class Info(NamedTuple):
    """What a lidar says of itself."""

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


def rplidar(info: Info, health: tuple[int, int] | None) -> Found:
    """Say which RPLIDAR it is."""
    series = info.model >> 4
    details, problems = _details(info, info.serial.hex().upper(), health)
    if series == 1:
        return Found("lidar", "rplidar_a1", "RPLIDAR A1", RPLIDAR_BAUD, details, problems)
    title = f"RPLIDAR A{series}" if series in (2, 3) else f"RPLIDAR (model 0x{info.model:02X})"
    missing = f"Trolley has no driver for the {title}; `rplidar_a1` with mode standard may do."
    return Found("lidar", None, title, RPLIDAR_BAUD, details, (*problems, missing))


def ydlidar(info: Info, health: tuple[int, int] | None) -> Found:
    """Say which YDLIDAR it is."""
    # 16 numbers from 0 to 9, as the vendor's SDK prints them.
    serial = "".join(f"{digit:X}" for digit in info.serial)
    details, problems = _details(info, serial, health)
    if info.model == _X4:
        return Found("lidar", "ydlidar_x4", "YDLIDAR X4", YDLIDAR_BAUD, details, problems)
    title = f"YDLIDAR (model {info.model})"
    missing = f"Trolley has no driver for the {title}."
    return Found("lidar", None, title, YDLIDAR_BAUD, details, (*problems, missing))


def is_bridge(data: bytes) -> bool:
    """Whether these are a ROSArduinoBridge's words to `b`: its baud rate, on a line of its own."""
    return _BAUD_LINE.search(data) is not None


def read_counts(data: bytes) -> str | None:
    """Find a ROSArduinoBridge's answer to `e`, two counts or a refusal; None until it is there."""
    answer = _COUNTS_LINE.search(data)
    return None if answer is None else answer[1].decode("ascii")


def bridge(counts: str | None) -> Found:
    """Say what a ROSArduinoBridge's answer to `e` tells.

    Args:
        counts: what `read_counts` found.
    """
    details: tuple[str, ...] = ()
    problems: tuple[str, ...] = ()
    if counts is None:
        problems = ("It does not answer the question for its encoders.",)
    elif counts == _REFUSAL:
        problems = (
            "Its sketch was built without USE_BASE and cannot drive: take the // away before "
            '"#define USE_BASE" in ROSArduinoBridge.ino, choose your motor driver, and upload it.',
        )
    else:
        details = (f"encoders at {counts}",)
    return Found("board", "arduino_bridge", BRIDGE.title, BRIDGE.baud, details, problems)


def _body(data: bytes, descriptor: bytes, length: int) -> bytes | None:
    start = data.find(descriptor)
    body = data[start + len(descriptor) :][:length] if start >= 0 else b""
    return body if len(body) == length else None


def _details(
    info: Info, serial: str, health: tuple[int, int] | None
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """What a lidar says of itself in words, and what is wrong with it."""
    details = (f"firmware {info.firmware}", f"serial {serial}")
    if health is None:
        return details, ("It does not say how it is: a weak 5 V supply is the usual cause.",)
    status, code = health
    if status == 0:
        return (*details, "health good"), ()
    if status < _FAULTY:
        return (*details, f"health warning (code {code})"), ()
    problem = (
        f"It reports a fault (code {code}): take its power away for some seconds; if the fault "
        f"stays, is the head free to turn and the 5 V supply strong enough?"
    )
    return (*details, f"health error {code}"), (problem,)
