"""Decides which messages of a robot are recorded, and with which time."""

from collections.abc import Sequence
from typing import Any

from trolley.foxglove.views import Views
from trolley.messages import Clock
from trolley.recording.layout import is_wanted, recorded_topic, split_key
from trolley.recording.writer import RecordingWriter
from trolley.runtime import codec
from trolley.runtime.bus import Sample
from trolley.runtime.robot_time import FollowedTime
from trolley.topics import Qos, Topic

LAST_NS = 2**63 - 1
MAX_KEYS = 2000
"""How many keys are recorded at most: what a stranger can make the file list."""


class Recorder:
    """Records what a robot publishes, in the order of arrival.

    Args:
        writer: The file.
        patterns: Names below the robot's key, with Zenoh's wildcards; none for all.
    """

    def __init__(self, writer: RecordingWriter, robot: str, patterns: Sequence[str] = ()) -> None:
        self.counts: dict[str, int] = {}
        """What was left out, by reason."""
        self._writer = writer
        self._patterns = patterns
        self._views = Views(robot)
        self._time = FollowedTime()
        self._heard: dict[str, tuple[int, int]] = {}
        """Stamp and hash of the last message of each key."""
        self._last_ns = 0
        self._last_arrived_ns = 0

    def update_clock(self, sample: Sample, arrived_ns: int) -> None:
        """Update robot time from a clock message before it is recorded."""
        try:
            clock = codec.decode(Clock, sample.payload, sample.encoding)
        except codec.BadPayload:
            return
        self._time.hear(clock, arrived_ns)

    def take(
        self, sample: Sample, arrived_ns: int, unix_ns: int, *, is_latest: bool = False
    ) -> None:
        """Record a message.

        Args:
            sample: What came.
            arrived_ns: Local monotonic time of its arrival.
            unix_ns: The host's clock, which counts only until robot time is known.
            is_latest: It was asked for, and is recorded only if it is new.

        Raises:
            OSError: The file cannot be written.
        """
        found = split_key(sample.key)
        topic = None if found is None else recorded_topic(sample.key)
        if found is None or topic is None or not is_wanted(found[1], self._patterns):
            return
        # What changes all the time need not be asked for, and is old by the time it is answered.
        if is_latest and topic.qos is not Qos.STATE:
            return
        if sample.key not in self._heard and len(self._heard) >= MAX_KEYS:
            self._leave_out("too many keys")
            return
        if len(sample.payload) > topic.max_bytes or not (sample.payload or sample.is_delete):
            self._leave_out("too large" if sample.payload else "empty")
            return
        message = self._decode(topic, sample)
        own_stamp_ns = getattr(message, "stamp_ns", 0)
        if is_latest and self._is_known(sample, own_stamp_ns):
            return
        self._heard[sample.key] = own_stamp_ns, hash(sample.payload)
        if isinstance(message, Clock):
            self._time.hear(message, arrived_ns)
        at_ns = self._robot_ns(arrived_ns, unix_ns)
        stamp_ns = own_stamp_ns or at_ns
        self._writer.add(at_ns, sample.key, topic, sample.payload, sample.encoding, stamp_ns)
        if sample.is_delete:
            seen = self._views.without(sample.key, at_ns)
        elif message is not None:
            matched = topic.match(sample.key)
            parts = () if matched is None else matched[1]
            seen = self._views.of(topic, parts, message, at_ns)
        else:
            seen = iter(())
        for name, data in seen:
            self._writer.add_view(at_ns, name, data, stamp_ns)

    def _is_known(self, sample: Sample, stamp_ns: int) -> bool:
        """Whether this latest value, or a newer message of its key, has been recorded already."""
        heard = self._heard.get(sample.key)
        if heard is None:
            return False
        return heard[1] == hash(sample.payload) or 0 < stamp_ns <= heard[0]

    def _decode(self, topic: Topic[Any], sample: Sample) -> Any | None:
        if sample.is_delete:
            return None
        try:
            return codec.decode(topic.message, sample.payload, sample.encoding)
        except codec.BadPayload:  # recorded as it came, but nothing to show
            self.counts["not understood"] = self.counts.get("not understood", 0) + 1
            return None

    def _robot_ns(self, arrived_ns: int, unix_ns: int) -> int:
        """Robot time of an arrival; it runs on while the clock is silent, and never goes back."""
        now_ns = self._time.now(arrived_ns)
        if now_ns is None and self._last_ns:
            passed_ns = arrived_ns - self._last_arrived_ns
            now_ns = self._last_ns + round(self._time.rate * passed_ns)
        moment_ns = unix_ns if now_ns is None else now_ns
        self._last_ns = min(max(self._last_ns, moment_ns), LAST_NS)
        self._last_arrived_ns = arrived_ns
        return self._last_ns

    def _leave_out(self, reason: str) -> None:
        self.counts[reason] = self.counts.get(reason, 0) + 1
