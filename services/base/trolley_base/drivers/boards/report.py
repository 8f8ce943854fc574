"""What a motor board's dialogue keeps for the next `take`: bounded, however seldom that comes."""

import re
from collections import Counter, deque
from typing import Literal

from trolley.messages import Battery, Imu, Link, Scan
from trolley.messages.motion import CHASSIS
from trolley_base.drivers.dialogue import Status
from trolley_base.drivers.interface import ChassisReading, Contact, MotionSample, Note

SILENCE_NS = 500_000_000
"""A board that has been silent for this long is not merely late."""
REOPEN_AFTER_NS = 5_000_000_000
"""After this much silence the port is closed and opened again."""
MOST_MOTIONS = 256
"""Motions that are kept: 5 s of a board that reports 50 times a second."""
MOST_IMU = 64
"""Inertial readings that are kept."""
MOST_RANGES = 64
"""Readings of range sensors that are kept."""
MOST_KINDS_OF_LINES = 32
"""Lines that differ in more than their numbers; a board that says more only fills logs."""
MOST_LETTERS = 200
"""Number of characters of such a line that are kept."""
NUMBER = re.compile(r"[+-]?\d[\d.]*")


class Report:
    """Collects motions, readings of inertial units and range sensors, notes and counts."""

    def __init__(self) -> None:
        self._motions: list[MotionSample] = []
        self._imu: deque[Imu] = deque(maxlen=MOST_IMU)
        self._ranges: deque[Scan] = deque(maxlen=MOST_RANGES)
        self._notes: dict[str, Note] = {}
        self._kinds: set[str] = set()
        self._counts: Counter[str] = Counter()
        self._num_jumps = 0

    def add_motion(self, motion: MotionSample) -> None:
        """Keep a motion; if too many wait, it is joined to the last, so that none is lost."""
        if len(self._motions) >= MOST_MOTIONS:
            last = self._motions.pop()
            whole = last.previous_T_base @ motion.previous_T_base
            motion = MotionSample(motion.stamp_ns, whole, motion.twist)
        self._motions.append(motion)

    def add_imu(self, imu: Imu) -> None:
        """Keep an inertial reading; of too many the oldest are forgotten."""
        self._imu.append(imu)

    def add_range(self, scan: Scan) -> None:
        """Keep what a range sensor measured; of too many the oldest are forgotten."""
        self._ranges.append(scan)

    def note(self, level: Literal["info", "warning", "error"], text: str) -> None:
        """Keep a line for people; lines that differ in their numbers alone are one kind."""
        text = text.strip()[:MOST_LETTERS]
        kind = f"chassis/{NUMBER.sub('#', text)}"
        if kind not in self._kinds and len(self._kinds) >= MOST_KINDS_OF_LINES:
            kind = "chassis/other"
        self._kinds.add(kind)
        self._notes[kind] = Note(level, kind, text)

    def count(self, name: str, number: int = 1) -> None:
        """Count what happened; `name` without the leading `chassis/`."""
        self._counts[f"chassis/{name}"] += number

    def add_jump(self) -> None:
        """Keep that a motion was left out, since no robot can do it."""
        self._num_jumps += 1

    def take(
        self,
        status: Status,
        alarms: tuple[str, ...] = (),
        battery: Battery | None = None,
        contacts: tuple[Contact, ...] = (),
    ) -> ChassisReading:
        """Hand over everything and begin anew."""
        reading = ChassisReading(
            motions=tuple(self._motions),
            link=Link(name=CHASSIS, state=status.state, message=status.message),
            imu=tuple(self._imu),
            battery=battery,
            alarms=alarms,
            notes=tuple(self._notes.values()),
            counts=dict(self._counts),
            num_jumps=self._num_jumps,
            contacts=contacts,
            ranges=tuple(self._ranges),
        )
        self._motions.clear()
        self._imu.clear()
        self._ranges.clear()
        self._notes.clear()
        self._counts.clear()
        self._num_jumps = 0
        return reading
