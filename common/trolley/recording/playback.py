"""Playing a recording: its time, and its messages under another name."""

from collections.abc import Iterator

import msgspec

from trolley import topics
from trolley.messages import Clock
from trolley.recording.reader import Entry
from trolley.runtime import codec
from trolley.runtime.bus import matches
from trolley.runtime.robot_time import SILENCE_NS
from trolley.topics import Qos

LONGEST_GAP_NS = 10_000_000_000
"""A longer gap between two messages is not a pause: base was restarted, or a part is missing."""
PATIENCE_NS = 500_000_000
LOWER_TO = 0.95
SLOWEST = 0.001
TURN_NS = 1_000_000_000
"""Epochs of different turns differ by less than this."""
MAX_KEYS = 4000
OTHER_WORLD = "replay"
"""The name of the simulated world when it is replayed, so that no simulation shares it."""


class Pace:
    """Which robot time is played at which moment of the local monotonic clock.

    Where this machine cannot keep up, the speed is lowered and nothing is skipped.
    """

    def __init__(self, speed: float) -> None:
        self.rate = speed
        """Robot seconds per real second."""
        self._anchor_ns = 0
        self._anchor_monotonic_ns = 0
        self._late: tuple[int, int] | None = None

    def begin(self, at_ns: int, monotonic_ns: int) -> None:
        """Play from robot time `at_ns` on."""
        self._anchor_ns, self._anchor_monotonic_ns = at_ns, monotonic_ns
        self._late = None

    def now(self, monotonic_ns: int) -> int:
        """Robot time [ns]."""
        return self._anchor_ns + round(self.rate * (monotonic_ns - self._anchor_monotonic_ns))

    def wait_s(self, at_ns: int, monotonic_ns: int) -> float:
        """How long to wait until a message of robot time `at_ns` is due; long gaps are skipped."""
        ahead_ns = at_ns - self.now(monotonic_ns)
        if ahead_ns > LONGEST_GAP_NS:
            self.begin(at_ns, monotonic_ns)
            return 0.0
        return max(0.0, ahead_ns * 1e-9 / self.rate)

    def played(self, at_ns: int, monotonic_ns: int) -> None:
        """Note that a message of robot time `at_ns` was sent; lower the speed if it was late."""
        late_s = (self.now(monotonic_ns) - at_ns) * 1e-9 / self.rate
        if late_s < 0.1:
            self._late = None
            return
        if self._late is None:
            self._late = at_ns, monotonic_ns
        late_at_ns, late_since_ns = self._late
        passed_ns = monotonic_ns - late_since_ns
        if passed_ns < PATIENCE_NS:
            return
        # While late the messages follow each other without a pause: this is what can be done.
        possible = (at_ns - late_at_ns) / passed_ns
        self.begin(at_ns, monotonic_ns)
        self.rate = min(self.rate, max(SLOWEST, LOWER_TO * possible))


class Replica:
    """The robot that a recording is played as, and what it said last.

    Args:
        name: What it is called.
        turn_ns: Less than `TURN_NS` and different at each turn, so that receivers notice that time
            starts over: it makes the epochs.
    """

    def __init__(self, name: str, turn_ns: int) -> None:
        self.name = name
        self.latest: dict[str, Entry] = {}
        """By name below the robot's key."""
        self._turn_ns = turn_ns % TURN_NS
        self._clock: tuple[int, Clock] | None = None

    def take(self, entry: Entry) -> Entry | None:
        """What to publish of an entry: the entry itself, a changed one, or None.

        Velocity commands are never published. The clock has a rate of its own, see `clock`.
        """
        if entry.topic is topics.COMMAND:
            return None
        if entry.topic is topics.CLOCK:
            self._hear(entry)
            return None
        if entry.topic is topics.ROBOT:
            changed = _changed(entry, name=self.name, replayed=True)
        elif entry.topic is topics.SIM_TRUTH:
            # A simulation of the recorded world would run into it.
            changed = _changed(entry, world=OTHER_WORLD)
        else:
            changed = entry
        if changed is None:
            return None
        entry = changed
        if entry.is_delete:
            for name in list(_matching(self.latest, entry.name)):
                del self.latest[name]
        elif entry.name in self.latest or len(self.latest) < MAX_KEYS:
            self.latest[entry.name] = entry
        return entry

    def kept(self) -> list[Entry]:
        """What a late joiner gets: the latest values of everything that is published on change."""
        return [entry for entry in self.latest.values() if entry.topic.qos is Qos.STATE]

    def clock(self, now_ns: int, rate: float) -> Clock | None:
        """The clock at a moment of the recording, None where the recorded one was silent."""
        if self._clock is None:
            return None
        heard_ns, clock = self._clock
        if now_ns - heard_ns > SILENCE_NS * max(1.0, clock.rate):
            return None
        # Before the true beginning, since nothing may be stamped earlier than its epoch.
        epoch_ns = max(0, clock.epoch - TURN_NS) + self._turn_ns
        return Clock(stamp_ns=max(0, now_ns), rate=rate, epoch=epoch_ns)

    @property
    def epoch(self) -> int | None:
        """The epoch of the run that is played now."""
        return None if self._clock is None else self._clock[1].epoch

    def _hear(self, entry: Entry) -> None:
        try:
            self._clock = entry.at_ns, codec.decode(Clock, entry.payload, entry.encoding)
        except codec.BadPayload:
            return  # whoever listened then did not understand it either


def _changed(entry: Entry, **changes: str | bool) -> Entry | None:
    """An entry with a changed message, None if it cannot be decoded."""
    try:
        message = codec.decode(entry.topic.message, entry.payload, entry.encoding)
    except codec.BadPayload:
        return None
    payload = codec.encode(msgspec.structs.replace(message, **changes), "msgpack")
    return Entry(entry.at_ns, entry.name, entry.topic, payload, codec.MIME["msgpack"])


def _matching(names: dict[str, Entry], pattern: str) -> Iterator[str]:
    return (name for name in names if matches(pattern, name))
