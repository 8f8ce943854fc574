"""Why the robot may not drive, whatever the commands and the echoes say."""

from dataclasses import dataclass

from trolley import codes
from trolley.messages import Link
from trolley_base.drivers import ChassisReading
from trolley_base.safety.velocity_limiter import Block, Hindrance

# Without a scan for this long the robot stands [ns].
SCAN_SILENCE_NS = 500_000_000

STOPPED_MESSAGE = "The robot was stopped and stays so until it is resumed."
FIRST_SCAN_MESSAGE = "The robot waits for the lidar's first scan."


@dataclass(frozen=True, slots=True)
class Condition:
    """What base knows about itself.

    Attributes:
        cannot_drive: why commands go nowhere at all, "" where they drive.
        is_stopped: the stop latch.
        chassis: the newest reading.
        lidar: the connection to the lidar.
        scan_age_ns: since the newest scan arrived, None before the first.
    """

    cannot_drive: str
    is_stopped: bool
    chassis: ChassisReading
    lidar: Link
    scan_age_ns: int | None


def find_hindrance(now: Condition) -> Hindrance | None:
    """Return what matters most of all that forbids to drive, None if nothing does."""
    if now.cannot_drive:
        return Hindrance(Block.ALL, "ok", "", now.cannot_drive)
    if now.is_stopped:
        return Hindrance(Block.ALL, "stopped", codes.BUTTON, STOPPED_MESSAGE)
    if now.chassis.link.state != "up":
        return _held(Block.ALL, codes.LINK_LOST, now.chassis.link.message)
    if now.lidar.state == "down":
        return _held(Block.ALL, codes.SCAN_LOST, now.lidar.message)
    # What a lidar saw before it was lost says nothing any more, though it is looked for again.
    if now.lidar.state != "up" or now.scan_age_ns is None:
        return _held(Block.ALL, codes.SCAN_LOST, now.lidar.message or FIRST_SCAN_MESSAGE)
    if now.scan_age_ns > SCAN_SILENCE_NS:
        return _held(Block.ALL, codes.SCAN_LOST, now.lidar.message)
    return _alarm(now.chassis.alarms)


def _alarm(alarms: tuple[str, ...]) -> Hindrance | None:
    unknown = sorted(set(alarms) - {codes.BUTTON, codes.BATTERY, codes.BUMPER, codes.CLIFF})
    if unknown:
        message = codes.SENTENCES.get(unknown[0], f"The motor board reports {unknown[0]}.")
        return Hindrance(Block.ALL, "fault", unknown[0], message)
    if codes.BATTERY in alarms:
        return _held(Block.ALL, codes.BATTERY)
    for code in (codes.CLIFF, codes.BUMPER):
        if code in alarms:
            return _held(Block.ALL_BUT_BACK, code)
    return None


def _held(block: Block, code: str, message: str = "") -> Hindrance:
    return Hindrance(block, "held", code, message or codes.SENTENCES[code])
