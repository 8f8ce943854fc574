"""Telling a linorobot by the topics that it announces over rosserial.

Source:
    rosserial protocol v2 (`rosserial_msgs/TopicInfo`); messages of `lino_msgs` and `geometry_msgs`.
"""

import struct
from collections.abc import Iterator
from typing import NamedTuple

from trolley_base.detection.found import Found

ROSSERIAL_BAUD = 57600
ASK_FOR_TOPICS = bytes.fromhex("FFFE 0000 FF 0000 FF")
# The board is to fall silent again.
STOP_SENDING = bytes.fromhex("FFFE 0000 FF 0B00 F4")

_HEADER = b"\xff\xfe"
_OVERHEAD_BYTES = 8
_MOST_PAYLOAD_BYTES = 512
_ANNOUNCES = (0, 1)

LINOROBOT_TOPICS = {
    "raw_vel": ("lino_msgs/Velocities", "0ee8ad4cb7809be2d5a0a76352fea86a"),
    "cmd_vel": ("geometry_msgs/Twist", "9f195f881246fdfa2798d1d3eebca84a"),
    "raw_imu": ("lino_msgs/Imu", "275110405f08e1b7c0c0f1aba3e19c67"),
    "pid": ("lino_msgs/PID", "a559df187bdf63f426d5f304b6b28bb4"),
}
"""What the firmware announces: topic, its type and its md5."""
_NEEDED = ("raw_vel", "cmd_vel")


class Topic(NamedTuple):
    """A topic that a board announces."""

    name: str
    type: str
    md5: str


def read_topics(data: bytes) -> dict[str, Topic]:
    """Return the topics announced so far, by name."""
    topics: dict[str, Topic] = {}
    for number, payload in _frames(data):
        topic = _read_topic(payload) if number in _ANNOUNCES else None
        if topic is not None:
            topics[topic.name] = topic
    return topics


def is_complete(topics: dict[str, Topic]) -> bool:
    """Whether all that a linorobot announces is there."""
    return topics.keys() >= LINOROBOT_TOPICS.keys()


def describe(topics: dict[str, Topic]) -> Found:
    """Say what board announces these topics."""
    names = f"topics {', '.join(sorted(topics))}"
    missing = [name for name in _NEEDED if name not in topics]
    if missing:
        problem = (
            f"It speaks rosserial but does not announce {' and '.join(missing)}, so this is no "
            f"linorobot firmware that Trolley can drive."
        )
        return Found("board", None, "a rosserial board", ROSSERIAL_BAUD, (names,), (problem,))
    problems = tuple(
        f"Its firmware sends {name} as {topic.type} with md5 {topic.md5} instead of {type_name} "
        f"with {md5}: upload the firmware of linorobot (ROS 1) unchanged."
        for name, (type_name, md5) in LINOROBOT_TOPICS.items()
        if (topic := topics.get(name)) is not None and (topic.type, topic.md5) != (type_name, md5)
    )
    model = None if problems else "linorobot"
    return Found("board", model, "linorobot", ROSSERIAL_BAUD, (names,), problems)


def _frames(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield topic id and payload of each frame whose two checksums hold."""
    start = data.find(_HEADER)
    while 0 <= start <= len(data) - _OVERHEAD_BYTES:
        length, number = struct.unpack_from("<HxH", data, start + 2)
        end = start + _OVERHEAD_BYTES + length
        lengths_hold = (sum(data[start + 2 : start + 5]) & 0xFF) == 0xFF
        is_good = (
            lengths_hold
            and length <= _MOST_PAYLOAD_BYTES
            and end <= len(data)
            and (sum(data[start + 5 : end]) & 0xFF) == 0xFF
        )
        if is_good:
            yield number, data[start + 7 : end - 1]
        start = data.find(_HEADER, end if is_good else start + 1)


def _read_topic(payload: bytes) -> Topic | None:
    """Read a TopicInfo: id, three strings, the buffer's size."""
    texts: list[str] = []
    at = 2
    for _ in range(3):
        if at + 4 > len(payload):
            return None
        (length,) = struct.unpack_from("<I", payload, at)
        at += 4 + length
        if at > len(payload):
            return None
        texts.append(payload[at - length : at].decode("ascii", "replace"))
    return Topic(*texts)
