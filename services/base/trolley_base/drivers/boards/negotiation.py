"""Asks a linorobot board for its topics and judges what it announces.

A round begins with each topic request and is judged as a whole when no more announcements come.
One of which a part may have been lost is not judged: where base itself stood still, or a frame came
damaged, and something is missing. The board is asked again, and must lack the same twice: what it
says may also come late.
Ids are taken from the announcements alone: the firmware looks up what it receives by id without
checking its bounds. Of a round that announces one of the four topics with another layout nothing is
used, and so nothing is ever sent.
"""

from collections.abc import Callable

from trolley_base.drivers.boards.lino_messages import TOPICS, Topic
from trolley_base.drivers.boards.rosserial import TopicInfo

ASK_EVERY_NS = 1_000_000_000
ASK_AGAIN_NS = 5_000_000_000
"""A firmware that does not match will not match a second later."""
LAST_WORD_NS = 200_000_000
"""A board announces everything in one go."""

NEEDED = frozenset(topic for topic in TOPICS if topic.is_needed)


class Negotiation:
    """Which topics the board has, under which ids.

    Attributes:
        fault: why the board cannot be used, as a sentence; "" if nothing is known against it.

    Args:
        count: adds to a counter: `unknown_topics`, frames of an id that was not announced.
    """

    def __init__(self, count: Callable[[str, int], None]) -> None:
        self._count = count
        self.begin()

    def begin(self) -> None:
        """Forget the board."""
        self.fault = ""
        self._ids: dict[Topic, int] = {}
        self._pause_ns = ASK_EVERY_NS
        self._asked_ns: int | None = None
        self._lacked: frozenset[Topic] = frozenset()  # of what is needed, by the last round
        self._begin_round()

    def _begin_round(self) -> None:
        self._heard: dict[Topic, int] = {}
        self._heard_ids: set[int] = set()
        self._heard_ns: int | None = None  # the last announcement that was not judged yet
        self._mismatch = ""
        self._has_unknown = False
        self._is_damaged = False

    @property
    def is_usable(self) -> bool:
        """Whether everything that driving needs is announced, as it should be."""
        return bool(self._ids)

    def id_of(self, topic: Topic) -> int | None:
        """Return the id under which a topic was announced."""
        return self._ids.get(topic)

    def should_ask(self, now_ns: int, *, is_forgotten: bool) -> bool:
        """Say whether a topic request is due.

        Args:
            now_ns: the time.
            is_forgotten: the board does not behave as one that has announced its topics.
        """
        if self._asked_ns is None:
            return True
        is_wanted = is_forgotten or self._has_unknown or not self.is_usable
        return is_wanted and now_ns - self._asked_ns >= self._pause_ns

    def note_request(self, now_ns: int) -> None:
        """Begin a round: a topic request is being sent."""
        self._asked_ns, self._pause_ns = now_ns, ASK_EVERY_NS
        self._begin_round()

    def add_topic(self, info: TopicInfo, now_ns: int, *, is_published: bool) -> None:
        """Take an announcement."""
        self._heard_ids.add(info.topic_id)
        self._heard_ns = now_ns
        for topic in TOPICS:
            if (topic.name, topic.is_published) != (info.name, is_published):
                continue
            self._heard[topic] = info.topic_id
            if info.md5 != topic.md5:
                self._mismatch = (
                    f"The motor board's topic {topic.name} is not laid out like linorobot's: it "
                    f"is {info.type_name} with md5 {info.md5}, not {topic.type_name} with "
                    f"md5 {topic.md5}. The robot does not drive; flash linorobot's firmware with "
                    "unchanged lino_msgs."
                )

    def meet_unknown(self, topic_id: int, now_ns: int) -> None:
        """Take notice of a frame of no known topic: another firmware may speak since."""
        if topic_id in self._heard_ids or self._asked_ns is None:
            return
        # Before the answer every id is unknown.
        if now_ns - self._asked_ns >= ASK_EVERY_NS:
            self._count("unknown_topics", 1)
            self._has_unknown = True

    def note_damage(self) -> None:
        """Take notice that something of this round came damaged."""
        self._is_damaged = True

    def note_stall(self, now_ns: int) -> None:
        """Take notice that base stood still: what waits is discarded, an answer to come with it."""
        if self._asked_ns is not None:
            self.note_request(now_ns)

    def judge(self, now_ns: int) -> frozenset[Topic]:
        """Judge a round that is over; return, once, which topics it lacked."""
        if self._heard_ns is None or now_ns - self._heard_ns < LAST_WORD_NS:
            return frozenset()
        self._heard_ns = None
        missing = frozenset(TOPICS) - self._heard.keys()
        lacked, self._lacked = self._lacked, missing & NEEDED
        is_doubtful = self._is_damaged or self._lacked != lacked
        if self._lacked and is_doubtful and not self._mismatch:
            self._has_unknown = True
            return frozenset()
        self.fault = self._mismatch or _lament(self._lacked)
        self._ids = {} if self.fault else self._heard
        if self._mismatch:
            self._pause_ns = ASK_AGAIN_NS
        return missing


def _lament(missing: frozenset[Topic]) -> str:
    """Return what to do about topics that are needed; "" if none is missing."""
    if not missing:
        return ""
    lacks = " and ".join(
        f"does not {'publish' if topic.is_published else 'subscribe to'} {topic.name}"
        for topic in sorted(missing)
    )
    return (
        f"The motor board {lacks}: it does not run linorobot's firmware. Flash linorobot's, "
        "or set [base.chassis] board to what it runs."
    )
