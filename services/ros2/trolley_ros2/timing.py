"""Robot time as ROS's, and messages that were too long on their way."""

from dataclasses import dataclass

MAX_WANDER_NS = 50_000_000
"""How far robot time may wander from the host's clock before stamps jump after it [ns]."""
MAX_DRIFT = 500e-6
"""How fast two hosts' clocks may drift apart: ten times what quartz does."""
MISTAKEN_NS = 1_000_000_000
"""After so long, late messages are not late: their sender's clock was set back [ns]."""
MOST_SENDERS = 64


class RosClock:
    """Robot time by the host's clock, which ROS nodes compare with their own.

    The difference of the two is kept, so that stamps do not tremble as the clocks are followed.
    """

    def __init__(self) -> None:
        self._offset_ns: int | None = None

    def stamp(self, stamp_ns: int, now_ns: int | None, unix_ns: int) -> int:
        """A stamp [ns since 1970].

        Args:
            stamp_ns: in robot time, 0 where the sender has none.
            now_ns: robot time now, None while it is unknown.
            unix_ns: the host's clock now.
        """
        if now_ns is None or stamp_ns == 0:
            return unix_ns
        measured_ns = unix_ns - now_ns
        if self._offset_ns is None or abs(measured_ns - self._offset_ns) > MAX_WANDER_NS:
            self._offset_ns = measured_ns
        return stamp_ns + self._offset_ns


@dataclass(slots=True)
class _Sender:
    quickest_ns: float
    """The least difference of clocks and way."""
    heard_ns: int
    late_since_ns: int | None = None


class Delays:
    """How much longer messages are on their way than the quickest of the same publisher.

    The hosts' clocks need not agree: only changes count, and a slow drift does not. Who stalls and
    then sends everything at once is found out; how long the first message took is not known.
    """

    def __init__(self) -> None:
        self._senders: dict[bytes, _Sender] = {}

    def is_late(self, gid: bytes, source_ns: int, arrived_ns: int, limit_ns: int) -> bool:
        """Whether a message took `limit_ns` longer than its publisher's quickest.

        Args:
            gid: its publisher.
            source_ns: when it was published, by the publisher's clock.
            arrived_ns: when it arrived, by this host's.
            limit_ns: what is allowed.
        """
        took_ns = float(arrived_ns - source_ns)
        sender = self._senders.get(gid)
        if sender is None:
            while len(self._senders) >= MOST_SENDERS:
                del self._senders[min(self._senders, key=self._last_heard)]
            self._senders[gid] = _Sender(took_ns, arrived_ns)
            return False
        grown_ns = MAX_DRIFT * max(0, arrived_ns - sender.heard_ns)
        sender.quickest_ns = min(took_ns, sender.quickest_ns + grown_ns)
        sender.heard_ns = arrived_ns
        if took_ns - sender.quickest_ns <= limit_ns:
            sender.late_since_ns = None
            return False
        if sender.late_since_ns is None:
            sender.late_since_ns = arrived_ns
        if arrived_ns - sender.late_since_ns > MISTAKEN_NS:
            sender.quickest_ns, sender.late_since_ns = took_ns, None
            return False
        return True

    def _last_heard(self, gid: bytes) -> int:
        return self._senders[gid].heard_ns
