"""Why the robot may not drive, independent of commands and echoes."""

from dataclasses import dataclass

from trolley import codes
from trolley.messages import Link
from trolley_base.drivers import ChassisReading
from trolley_base.safety.velocity_limiter import Block, Restriction

SCAN_SILENCE_NS = 500_000_000
"""Without a scan for this long the robot stands [ns]."""

STOPPED_MESSAGE = "Stopped. `trolley resume` lets it drive."
UNKNOWN_MESSAGE = "A stop holds, but it is not known whether the robot stands still: {why}"
FIRST_SCAN_MESSAGE = "The robot is waiting for the lidar's first scan."
OVERLOADED_MESSAGE = (
    "The robot's computer is too slow or too busy: for {seconds:.1f} s it did not look where it "
    "drives."
)


@dataclass(frozen=True, slots=True)
class SafetyState:
    """What base knows about itself.

    Attributes:
        cannot_drive: why commands go nowhere at all, "" where they drive.
        is_stopped: the emergency-stop latch.
        own_pause_ns: for how long base itself was held up lately, 0 where it was not.
        chassis: the newest reading.
        lidar: the connection to the lidar.
        scan_age_ns: since the newest scan arrived, None before the first.
        lidar_is_gone: its port has gone or cannot be opened.
    """

    cannot_drive: str
    is_stopped: bool
    own_pause_ns: int
    chassis: ChassisReading
    lidar: Link
    scan_age_ns: int | None
    lidar_is_gone: bool = False


def find_restriction(now: SafetyState) -> Restriction | None:
    """Return the gravest reason not to drive, None if there is none."""
    if now.cannot_drive:
        return Restriction(Block.ALL, "ok", "", now.cannot_drive)
    if now.is_stopped:
        return Restriction(Block.ALL, "stopped", codes.BUTTON, _stopped(now.chassis.link))
    if now.chassis.is_gone:
        return _held(Block.ALL, codes.LINK_LOST, now.chassis.link.message)
    if now.lidar_is_gone:
        return _held(Block.ALL, codes.SCAN_LOST, now.lidar.message)
    if now.own_pause_ns:
        # Before what else is with the devices: one not listened to only seems silent or damaged.
        seconds = now.own_pause_ns * 1e-9
        return _held(Block.ALL, codes.OVERLOADED, OVERLOADED_MESSAGE.format(seconds=seconds))
    if now.chassis.link.state != "up":
        return _held(Block.ALL, codes.LINK_LOST, now.chassis.link.message)
    if now.lidar.state == "down":
        return _held(Block.ALL, codes.SCAN_LOST, now.lidar.message)
    # While a lost lidar is searched for, what it saw before says nothing any more.
    if now.lidar.state != "up" or now.scan_age_ns is None:
        return _held(Block.ALL, codes.SCAN_LOST, now.lidar.message or FIRST_SCAN_MESSAGE)
    if now.scan_age_ns > SCAN_SILENCE_NS:
        return _held(Block.ALL, codes.SCAN_LOST, now.lidar.message)
    return _alarm(now.chassis.alarms)


def _stopped(board: Link) -> str:
    """Say that it is stopped, where the motor board can confirm it."""
    if board.state == "up":
        return STOPPED_MESSAGE
    return UNKNOWN_MESSAGE.format(why=board.message or codes.SENTENCES[codes.LINK_LOST])


def _alarm(alarms: tuple[str, ...]) -> Restriction | None:
    unknown = sorted(set(alarms) - {codes.BUTTON, codes.BATTERY, codes.BUMPER, codes.CLIFF})
    if unknown:
        message = codes.SENTENCES.get(unknown[0], f"The motor board reports {unknown[0]}.")
        return Restriction(Block.ALL, "fault", unknown[0], message)
    if codes.BATTERY in alarms:
        return _held(Block.ALL, codes.BATTERY)
    for code in (codes.CLIFF, codes.BUMPER):
        if code in alarms:
            return _held(Block.ALL_BUT_BACK, code)
    return None


def _held(block: Block, code: str, message: str = "") -> Restriction:
    return Restriction(block, "held", code, message or codes.SENTENCES[code])
