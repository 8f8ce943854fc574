"""What is published: how often each topic comes, how large it is, and how often it should come."""

import dataclasses
import re
import threading
import time
from collections.abc import Mapping
from typing import Any

from trolley.runtime.bus import Sample
from trolley.topics import Topic

MOST_KEYS = 5000
"""Number of keys that are kept: anybody on the network can make some up."""
LARGEST_KEPT = 1 << 16
"""Larger messages (maps, meshes) are counted and not kept."""


@dataclasses.dataclass(frozen=True, slots=True)
class Tally:
    """What came under a key so far."""

    messages: int = 0
    size: int = 0
    """Bytes of all of them together."""
    last_s: float = 0.0
    """When the newest came, on the local monotonic clock."""
    last: tuple[bytes, str] | None = None
    """The newest one with its encoding; None if it is too large to keep."""


class Traffic:
    """Counts what is published; fed on threads of the bus."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._tallies: dict[str, Tally] = {}

    def take(self, sample: Sample) -> None:
        """Count a message (to be given to `Connection.listen`)."""
        size = len(sample.payload)
        kept = (sample.payload, sample.encoding) if size <= LARGEST_KEPT else None
        with self._lock:
            known = self._tallies.get(sample.key)
            if known is None:
                if len(self._tallies) >= MOST_KEYS:
                    return
                known = Tally()
            self._tallies[sample.key] = Tally(
                known.messages + 1, known.size + size, time.monotonic(), kept
            )

    def so_far(self) -> dict[str, Tally]:
        """What came so far, by key."""
        with self._lock:
            return dict(self._tallies)


@dataclasses.dataclass(frozen=True, slots=True)
class Flow:
    """How much comes under a key at present."""

    hz: float
    bytes_per_s: float
    age_s: float
    """Since the newest message."""


def flows(
    before: Mapping[str, Tally], after: Mapping[str, Tally], seconds: float, now_s: float
) -> dict[str, Flow]:
    """What came between two moments that lie `seconds` apart, by key.

    Args:
        before: what had come at the first.
        after: what had come at the second.
        seconds: the time between them.
        now_s: the second moment, on the local monotonic clock.
    """
    found: dict[str, Flow] = {}
    for key, tally in after.items():
        was = before.get(key, Tally())
        found[key] = Flow(
            (tally.messages - was.messages) / seconds,
            (tally.size - was.size) / seconds,
            max(0.0, now_s - tally.last_s),
        )
    return found


@dataclasses.dataclass(frozen=True, slots=True)
class Expected:
    """How often a topic should come, as its row of the table says [Hz]."""

    low: float | None = None
    """At least so often all the time; None: it may be silent."""
    high: float | None = None
    """At most so often; None: no limit is said."""
    is_each_scan: bool = False
    """Whether it is sent with each scan."""

    def __str__(self) -> str:
        """As it stands in a table."""
        if self.is_each_scan:
            return "each scan"
        match self.low, self.high:
            case None, None:
                return ""
            case None, high:
                return f"≤ {high:g}"
            case low, None:
                return f"≥ {low:g}"
            case low, high:
                return f"{low:g}" if low == high else f"{low:g}-{high:g}"


_NUMBER = r"(\d+(?:\.\d+)?)"
ON_CHANGE_ONLY = ("on change", "if any", "stored", "while it runs")


def expected(topic: Topic[Any]) -> Expected:
    """How often a topic should come while its owner runs.

    Raises:
        ValueError: The words of its row are not understood.
    """
    words = topic.rate
    if words in ON_CHANGE_ONLY:
        return Expected()
    if words == "each scan":
        return Expected(is_each_scan=True)
    if found := re.fullmatch(rf"(?:on change, )?at most {_NUMBER} Hz", words):
        return Expected(high=float(found[1]))
    if found := re.fullmatch(rf"on change, {_NUMBER} Hz(?: on a trip)?", words):
        return Expected(low=float(found[1]))
    if found := re.fullmatch(rf"{_NUMBER} Hz", words):
        return Expected(low=float(found[1]), high=float(found[1]))
    if found := re.fullmatch(rf"{_NUMBER}-{_NUMBER} Hz", words):
        return Expected(low=float(found[1]), high=float(found[2]))
    raise ValueError(f"the rate {words!r} of {topic.name} is not understood")
