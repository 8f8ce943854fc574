"""Telling a linorobot by the topics that it announces over rosserial."""

from collections.abc import Mapping

from trolley_base.detection.results import FoundDevice
from trolley_base.drivers.boards import BOARDS
from trolley_base.drivers.boards.lino_messages import TOPICS
from trolley_base.drivers.boards.rosserial import (
    PUBLISHER,
    SUBSCRIBER,
    FrameDecoder,
    TopicInfo,
    parse_topic_info,
)

LINOROBOT = BOARDS["linorobot"]


def read_topics(data: bytes) -> dict[str, TopicInfo]:
    """Return the topics announced so far, by name."""
    frames = FrameDecoder(_ignore).feed(data)
    announced = (
        parse_topic_info(frame.payload)
        for frame in frames
        if frame.topic_id in (PUBLISHER, SUBSCRIBER)
    )
    return {topic.name: topic for topic in announced if topic is not None}


def is_complete(topics: Mapping[str, TopicInfo]) -> bool:
    """Whether all that a linorobot announces is there."""
    return all(topic.name in topics for topic in TOPICS)


def describe(topics: Mapping[str, TopicInfo]) -> FoundDevice:
    """Say what board announces these topics."""
    names = f"topics {', '.join(sorted(topics))}"
    missing = [topic.name for topic in TOPICS if topic.is_needed and topic.name not in topics]
    if missing:
        problem = (
            f"It speaks rosserial but does not announce {' and '.join(missing)}, so this is not a "
            "linorobot firmware that Trolley can drive."
        )
        return FoundDevice("board", None, "a rosserial board", LINOROBOT.baud, (names,), (problem,))
    problems = tuple(
        f"Its firmware has {topic.name} as {other.type_name} with md5 {other.md5} instead of "
        f"{topic.type_name} with {topic.md5}: upload the firmware of linorobot (ROS 1) unchanged."
        for topic in TOPICS
        if (other := topics.get(topic.name)) is not None
        and (other.type_name, other.md5) != (topic.type_name, topic.md5)
    )
    model = None if problems else "linorobot"
    return FoundDevice("board", model, LINOROBOT.title, LINOROBOT.baud, (names,), problems)


def _ignore(_name: str, _number: int) -> None:
    """Count nothing: what is not a frame is some other device's."""
