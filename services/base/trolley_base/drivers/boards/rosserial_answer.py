"""Telling a linorobot by the topics that it announces over rosserial."""

from trolley_base.drivers.boards.lino_messages import TOPICS
from trolley_base.drivers.boards.models import Answer, count_nothing
from trolley_base.drivers.boards.rosserial import (
    PUBLISHER,
    SUBSCRIBER,
    FrameDecoder,
    TopicInfo,
    parse_topic_info,
)

TITLE = "linorobot (Teensy)"


def read_topics(data: bytes) -> dict[str, TopicInfo]:
    """Return the topics announced so far, by name."""
    frames = FrameDecoder(count_nothing).feed(data)
    announced = (
        parse_topic_info(frame.payload)
        for frame in frames
        if frame.topic_id in (PUBLISHER, SUBSCRIBER)
    )
    return {topic.name: topic for topic in announced if topic is not None}


def recognise(data: bytes) -> Answer | None:
    """Find a board that announces topics, whichever."""
    return describe(data) if read_topics(data) else None


def is_complete(data: bytes) -> bool:
    """Whether all that a linorobot announces is there."""
    topics = read_topics(data)
    return all(topic.name in topics for topic in TOPICS)


def describe(data: bytes) -> Answer:
    """Say what board announces these topics."""
    topics = read_topics(data)
    names = f"topics {', '.join(sorted(topics))}"
    missing = [topic.name for topic in TOPICS if topic.is_needed and topic.name not in topics]
    if missing:
        problem = (
            f"It speaks rosserial but does not announce {' and '.join(missing)}, so this is not a "
            "linorobot firmware that Trolley can drive."
        )
        return Answer((names,), (problem,), is_usable=False, title="a rosserial board")
    problems = tuple(
        f"Its firmware has {topic.name} as {other.type_name} with md5 {other.md5} instead of "
        f"{topic.type_name} with {topic.md5}: upload the firmware of linorobot (ROS 1) unchanged."
        for topic in TOPICS
        if (other := topics.get(topic.name)) is not None
        and (other.type_name, other.md5) != (topic.type_name, topic.md5)
    )
    return Answer((names,), problems, is_usable=not problems)
