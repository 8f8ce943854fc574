"""A lidar that is heard only when a revolution can be complete gives what it gave before."""

from collections import deque
from typing import Any, cast

import pytest
from bench.base.lidars.catalogue import RECORDS
from support.lidars import START_NS, TICK_NS, Asked, Silent, stream

from trolley.config.hardware import LidarConfig
from trolley.messages import Link
from trolley_base.drivers.interface import LidarScan
from trolley_base.drivers.lidars import make_lidar
from trolley_base.drivers.real_hardware import SerialLidar

SECONDS = 4.0
SAME_NS = 2_000_000
"""Fewer looks tell a little less of when bytes have come."""


class StreamLink:
    """What a lidar needs of a link: an honest device streams once it has been started.

    Args:
        title: of its record.
    """

    is_gone = False

    def __init__(self, title: str) -> None:
        record = RECORDS[title]
        self.dialogue = make_lidar(LidarConfig(model=record.model, mode=record.mode))
        self.dialogue.begin(START_NS)
        self.num_heard = self.num_judged = 0
        self._device = Asked(title) if record.begins else Silent()
        self._stream = deque(stream(title, SECONDS, 0.004))
        self._began_ns: int | None = None
        self._waiting = b""
        self._arrived_ns = START_NS

    def pass_time(self, now_ns: int) -> None:
        """Let arrive what the device has sent up to now."""
        if self._device.streams and self._began_ns is None:
            self._began_ns = now_ns
        while self._began_ns is not None and self._stream:
            at_ns = self._began_ns + round(self._stream[0][0] * 1e9)
            if at_ns > now_ns:
                break
            self._waiting += self._stream.popleft()[1]
            self._arrived_ns = at_ns

    def listen(self, now_ns: int) -> None:
        del now_ns
        if self._waiting:
            self.num_heard += 1
            self.dialogue.receive(self._waiting, self._arrived_ns)
            self._waiting = b""

    def speak(self, now_ns: int) -> None:
        answer = self._device.hear(self.dialogue.outgoing(now_ns), now_ns)
        if answer:
            self._waiting, self._arrived_ns = self._waiting + answer, now_ns

    def link(self, now_ns: int) -> Link:
        self.num_judged += 1
        return Link(name="lidar", state=self.dialogue.status(now_ns).state, message="")

    def counts(self, known: dict[str, int]) -> dict[str, int]:
        return known


def scans_of(link: StreamLink, *, listens_always: bool) -> list[tuple[int, LidarScan]]:
    """The scans of a stream, each with the period in which it came."""
    lidar, found = SerialLidar(cast("Any", link), START_NS), list[tuple[int, LidarScan]]()
    for period in range(round((SECONDS + 1.0) * 1e9 / TICK_NS)):
        now_ns = START_NS + period * TICK_NS
        link.pass_time(now_ns)
        if listens_always:
            link.listen(now_ns)
        lidar.advance(now_ns)
        found += [(period, scan) for scan in lidar.read().scans]
    return found


@pytest.mark.parametrize("title", RECORDS)
def test_scans_come_as_soon_as_if_each_byte_were_heard_at_once(title: str) -> None:
    record, often, seldom = RECORDS[title], StreamLink(title), StreamLink(title)
    expected = scans_of(often, listens_always=True)
    found = scans_of(seldom, listens_always=False)
    assert len(expected) > (SECONDS - 2.0) * record.turns_hz
    assert [period for period, _ in found] == [period for period, _ in expected]
    for (_, scan), (_, same) in zip(found, expected, strict=True):
        assert abs(scan.stamp_ns - same.stamp_ns) < SAME_NS
        assert scan.ranges.tolist() == same.ranges.tolist()
    if record.turns_hz <= 10.0 and not record.sends_whole_turns:
        assert seldom.num_heard < 0.7 * often.num_heard
        assert seldom.num_judged < 0.7 * (SECONDS + 1.0) * 1e9 / TICK_NS
