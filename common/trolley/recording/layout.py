"""What stands where in a recording."""

from collections.abc import Sequence
from typing import Any

from trolley import topics
from trolley.names import canonical
from trolley.runtime.bus import has_wildcard, matches
from trolley.topics import Kind, Topic

ABOUT = "trolley"
"""The metadata record that says what the file is."""
SCHEMA_PREFIX = "trolley."
WIRE = "encoding"
"""Metadata of a channel that holds messages as they were on the wire: their Zenoh encoding."""
MAX_RECORD_BYTES = 128 << 20
"""No chunk that Trolley writes is larger: a map and the rest of a second."""

DRAWINGS = tuple(topic for topic in topics.TOPICS if topic.is_drawing)
"""Stored keys that are recorded, since there is no list of them."""


def recorded_topic(key: str) -> Topic[Any] | None:
    """The topic of a key that is recorded, None for wishes, requests and strangers.

    The key of a deletion of drawings may hold wildcards.
    """
    if has_wildcard(key):
        return next((one for one in DRAWINGS if matches(key, one.key("*"))), None)
    found = topics.find(key)
    if found is None:
        return None
    topic, _, parts = found
    if parts in topic.get_only_parts:
        return None
    return topic if topic.kind is Kind.STREAM or topic in DRAWINGS else None


def split_key(key: str) -> tuple[str, str] | None:
    """The robot and the rest of a key, None if it is not a key of Trolley."""
    root, _, rest = key.partition("/")
    robot, _, name = rest.partition("/")
    return (robot, name) if root == topics.ROOT and robot and name else None


def key_of(robot: str, name: str) -> str:
    """The key of a name below a robot."""
    return "/".join((topics.ROOT, robot, name))


ALWAYS = ("clock", "robot")
"""Names that every recording holds: without them nothing could be replayed."""


def bad_pattern(patterns: Sequence[str]) -> str | None:
    """The first pattern that no topic matches, such as a misspelt name."""
    keys = [topic.key("*") for topic in topics.TOPICS if topic.kind is Kind.STREAM]
    keys += [topic.key("*") for topic in DRAWINGS]
    for pattern in patterns:
        if not pattern or not any(matches(key_of("*", pattern), key) for key in keys):
            return pattern
    return None


def is_wanted(name: str, patterns: Sequence[str]) -> bool:
    """Whether a name below a robot is among the patterns; all are where there are none."""
    if not patterns or name in ALWAYS:
        return True
    plain = canonical(name)
    return any(matches(pattern, plain) for pattern in patterns)
