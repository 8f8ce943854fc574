"""The agent that a micro-ROS board looks for: a session, its streams, and what the board creates.

Messages go in, messages come out; there is no port, clock or frame here. A board pings until an
agent answers, opens a session, creates topics, writers and readers one after the other, asks for
what its readers are to get, and asks for the time. It waits a second for each answer, and of a
`reliable` publisher for each acknowledgement, so nothing here may wait. Its pings, and its question
for the time, are answered elsewhere (`xrce_pings.py`), sooner still.

Counts: `bad_messages` (no message, or not one of this protocol), `lost_messages` (that the board
will not repeat), `unknown_topics` (data of a writer that was not created here).

Source:
    OMG DDS-XRCE 1.0, chapter 8; eProsima Micro-XRCE-DDS-Agent, Processor.cpp;
    Micro-XRCE-DDS-Client, session.c and stream/ (`uxr_update_output_stream_heartbeat_timestamp`).
"""

from collections.abc import Callable, Iterator
from typing import NamedTuple

from trolley_base.drivers.boards import xrce_messages as xrce
from trolley_base.drivers.boards.xrce_messages import Header, Submessage

DEPTH = 16
"""Messages of a reliable stream that are kept until they are in order, or acknowledged."""
MOST_FRAGMENTS = 16384
"""A message in fragments is at most this long [bytes]."""
HEARTBEAT_NS = 100_000_000
"""After this long without an acknowledgement one is asked for. After this long without a message of
a reliable stream the board is told again what is missing: it asks by itself only when it has heard
nothing for 100 ms, and commands come more often."""
REPEAT_NS = 40_000_000
"""So soon a message is not sent again: the board had not got it yet when it asked."""
UNANSWERED_PINGS = 2
"""So many pings of a board that talks in a session of another agent are not answered, so that it
gives that session up."""
MOST_OBJECTS = 64
INCOMPATIBLE = 0x86


class Topic(NamedTuple):
    """What a writer or reader is of; "" where the board has not said it."""

    name: str
    type_name: str


class Delivery(NamedTuple):
    """What the board has published."""

    topic: Topic
    body: bytes


def _newer(number: int, than: int) -> int:
    """Return how much newer a number of 16 bits is, negative if it is older."""
    return (number - than + 0x8000 & 0xFFFF) - 0x8000


class InputStream:
    """Puts the messages of a reliable stream in order, and knows which are missing."""

    def __init__(self) -> None:
        self._next = 0
        self._last = -1 & 0xFFFF
        self._waiting: dict[int, bytes] = {}
        self.told_ns = 0
        """When the board was told last what has come."""

    def take(self, number: int, data: bytes) -> Iterator[bytes]:
        """Yield the submessages that can be handled now."""
        ahead = _newer(number, self._next)
        if 0 <= ahead < DEPTH:
            self._waiting[number] = data
            if _newer(number, self._last) > 0:
                self._last = number
        while (following := self._waiting.pop(self._next, None)) is not None:
            self._next = self._next + 1 & 0xFFFF
            yield following

    def expect(self, first: int, last: int) -> int:
        """Note that the board has messages `first` to `last`; return how many are lost."""
        lost = max(0, _newer(first, self._next))
        if lost:
            self._next = first
            if _newer(self._last, first) < 0:
                self._last = first - 1 & 0xFFFF
            self._waiting = {
                number: data
                for number, data in self._waiting.items()
                if _newer(number, self._next) >= 0
            }
        if 0 <= _newer(last, self._next) < DEPTH and _newer(last, self._last) > 0:
            self._last = last
        return lost

    def acknowledgement(self, stream: int, *, is_quiet: bool) -> bytes:
        """Say what has come and what is missing; the next message, too, where nothing comes."""
        count = max(is_quiet, _newer(self._last, self._next) + 1)
        missing = sum(
            1 << place for place in range(count) if self._next + place & 0xFFFF not in self._waiting
        )
        return xrce.acknack(self._next, missing, stream)


class OutputStream:
    """Numbers the messages of a reliable stream, and keeps them until they are acknowledged."""

    def __init__(self) -> None:
        self._next = 0
        # Messages, and when they were sent last, by their numbers.
        self._kept: dict[int, tuple[bytes, int]] = {}
        self._asked_ns = 0

    @property
    def is_full(self) -> bool:
        """Whether the board has not acknowledged anything for long."""
        return len(self._kept) >= DEPTH

    def add(self, data: bytes, now_ns: int) -> int:
        """Keep a message; return its number."""
        number, self._next = self._next, self._next + 1 & 0xFFFF
        if not self._kept:
            self._asked_ns = now_ns
        self._kept[number] = data, now_ns
        return number

    def acknowledge(self, first_missing: int, missing: int, now_ns: int) -> list[tuple[int, bytes]]:
        """Forget what has come; return what must be sent again."""
        self._kept = {
            number: kept
            for number, kept in self._kept.items()
            if _newer(number, first_missing) >= 0
        }
        again = [
            (number, data)
            for number, (data, sent_ns) in self._kept.items()
            if missing >> min(_newer(number, first_missing), 63) & 1
            and now_ns - sent_ns >= REPEAT_NS
        ]
        self._kept |= {number: (data, now_ns) for number, data in again}
        return again

    def heartbeat(self, now_ns: int, stream: int) -> bytes:
        """Return a question for what has come, b"" while there is no need."""
        if not self._kept or now_ns - self._asked_ns < HEARTBEAT_NS:
            return b""
        self._asked_ns = now_ns
        return xrce.heartbeat(
            min(self._kept, key=self._age), max(self._kept, key=self._age), stream
        )

    def _age(self, number: int) -> int:
        return _newer(number, self._next)


class Session:
    """A session with a board: what it has created and what it is to get.

    Args:
        number: of the session.
        key: the board's, in each message where the session's number is low; else b"".
    """

    def __init__(self, number: int, key: bytes) -> None:
        self.number, self.key = number, key
        self.inputs: dict[int, InputStream] = {}
        self.outputs: dict[int, OutputStream] = {}
        self.acknowledged: set[int] = set()
        """Streams of which an acknowledgement is due."""
        self.newest: dict[int, int] = {}
        """Of each stream that is not reliable, the newest number."""
        self.numbers: dict[int, int] = {}
        """Of each stream that is not reliable, the next number to the board."""
        self.fragments = b""
        self.objects: dict[bytes, Topic] = {}
        self.reads: dict[bytes, tuple[bytes, int]] = {}
        """What a reader asked for: the number of the request, and the stream."""

    def header(self, stream: int = xrce.NO_STREAM, number: int = 0) -> bytes:
        """Return the header of a message to the board."""
        return Header(self.number, stream, number, self.key).encode()


class XrceAgent:
    """Answers one board.

    Args:
        count: adds to a counter.
    """

    def __init__(self, count: Callable[[str, int], None]) -> None:
        self._count = count
        self.reset()

    def reset(self) -> None:
        """The port has been opened: there is no session."""
        self._session: Session | None = None
        self._messages: list[bytes] = []
        self._num_unanswered: int | None = None
        self.is_incompatible = False
        """Whether the board speaks another version."""
        self.num_synchronized = 0
        """How often it was asked for the time."""
        self.num_sessions = 0

    @property
    def has_session(self) -> bool:
        """Whether a board has opened a session."""
        return self._session is not None

    def give_up(self) -> None:
        """Forget the session: the board is a stranger until it opens another."""
        self._session = None

    @property
    def topics(self) -> list[Topic]:
        """The topics that the board writes or reads."""
        return [] if self._session is None else list(self._session.objects.values())

    @property
    def is_estranged(self) -> bool:
        """Whether the board talks in a session of another agent."""
        return self._num_unanswered is not None

    # What arrives.
    def take(self, message: bytes, now_ns: int) -> list[Delivery]:
        """Take a message; return what the board has published with it."""
        parsed = xrce.parse_header(message)
        if parsed is None:
            self._count("bad_messages", 1)
            return []
        header, at = parsed
        if header.session & ~xrce.KEYLESS == 0:
            self._take_outside(message[at:])
            return []
        session = self._session
        if session is None or (header.session, header.key) != (session.number, session.key):
            has_ended = any(_ends_session(part) for part in xrce.submessages(message, at))
            self._num_unanswered = None if has_ended else 0
            return []
        deliveries: list[Delivery] = []
        for data in self._in_order(session, header, message[at:]):
            for part in xrce.submessages(data):
                deliveries += self._take_part(session, header, part, now_ns)
        return deliveries

    def _in_order(self, session: Session, header: Header, data: bytes) -> Iterator[bytes]:
        stream = header.stream
        if stream == xrce.NO_STREAM:
            yield data
        elif stream >= xrce.RELIABLE:
            session.acknowledged.add(stream)
            yield from session.inputs.setdefault(stream, InputStream()).take(header.number, data)
        elif _newer(header.number, session.newest.get(stream, -1 & 0xFFFF)) > 0:
            session.newest[stream] = header.number
            yield data

    def _take_outside(self, data: bytes) -> None:
        """Take what belongs to no session: a ping, or the wish for one."""
        for part in xrce.submessages(data):
            if part.kind == xrce.GET_INFO:
                self._note_ping()
            elif part.kind == xrce.CREATE_CLIENT and len(part.payload) >= 14:
                self._open(part.payload)

    def _note_ping(self) -> None:
        """A ping has come; `PingResponder` answers it."""
        if self._num_unanswered is not None:
            self._num_unanswered += 1
            if self._num_unanswered >= UNANSWERED_PINGS:
                self._num_unanswered = None

    def _open(self, payload: bytes) -> None:
        """Open a session; one that was open before is forgotten with all that it held."""
        cookie, major, key, number = payload[:4], payload[4], payload[8:12], payload[12]
        if cookie != xrce.COOKIE:
            self._count("bad_messages", 1)
            return
        self.is_incompatible = major != 1
        result = bytes((INCOMPATIBLE, 0)) if self.is_incompatible else xrce.OK
        session = Session(number, b"" if number >= xrce.KEYLESS else key)
        answer = xrce.submessage(xrce.STATUS_AGENT, result + xrce.IDENTITY)
        self._messages.append(session.header() + answer)
        self._session = None if self.is_incompatible else session
        self._num_unanswered = None
        self.num_sessions += not self.is_incompatible

    def _take_part(
        self, session: Session, header: Header, part: Submessage, now_ns: int
    ) -> list[Delivery]:
        payload = part.payload
        if part.kind == xrce.FRAGMENT:
            return self._take_fragment(session, header, part, now_ns)
        if part.kind == xrce.WRITE_DATA and len(payload) >= 4:
            topic = session.objects.get(payload[2:4])
            if topic is None:
                self._count("unknown_topics", 1)
                return []
            return [Delivery(topic, payload[4:])]
        if part.kind == xrce.CREATE:
            self._create(session, payload, now_ns)
        elif part.kind == xrce.DELETE and len(payload) >= 4:
            self._delete(session, part, now_ns)
        elif part.kind == xrce.READ_DATA and len(payload) >= 5:
            if xrce.cancels(payload):
                session.reads.pop(payload[2:4], None)
            else:
                session.reads[payload[2:4]] = (payload[:2], payload[4])
        else:
            self._take_upkeep(session, part, now_ns)
        return []

    def _take_upkeep(self, session: Session, part: Submessage, now_ns: int) -> None:
        """Take what keeps streams and clocks together."""
        if part.kind == xrce.TIMESTAMP and len(part.payload) >= 8:
            self.num_synchronized += 1
        elif part.kind == xrce.ACKNACK:
            self._take_acknack(session, part.payload, now_ns)
        elif part.kind == xrce.HEARTBEAT:
            self._take_heartbeat(session, part.payload)

    def _take_fragment(
        self, session: Session, header: Header, part: Submessage, now_ns: int
    ) -> list[Delivery]:
        session.fragments += part.payload
        whole = session.fragments
        if len(whole) > MOST_FRAGMENTS or part.flags & xrce.LAST_FRAGMENT:
            session.fragments = b""
        if not part.flags & xrce.LAST_FRAGMENT:
            return []
        deliveries: list[Delivery] = []
        for inner in xrce.submessages(whole):
            if inner.kind != xrce.FRAGMENT:
                deliveries += self._take_part(session, header, inner, now_ns)
        return deliveries

    def _create(self, session: Session, payload: bytes, now_ns: int) -> None:
        creation = xrce.parse_creation(payload)
        if creation is None:
            self._count("bad_messages", 1)
            return
        is_known = creation.object in session.objects
        if creation.kind in (xrce.TOPIC, xrce.WRITER, xrce.READER) and (
            is_known or len(session.objects) < MOST_OBJECTS
        ):
            own = Topic(creation.name, creation.type_name)
            session.objects[creation.object] = session.objects.get(creation.topic, own)
        self._answer(session, creation.request + creation.object, now_ns)

    def _delete(self, session: Session, part: Submessage, now_ns: int) -> None:
        payload = part.payload
        if _ends_session(part):
            self._messages.append(
                session.header() + xrce.submessage(xrce.STATUS, payload[:4] + xrce.OK)
            )
            self._session = None
            return
        session.objects.pop(payload[2:4], None)
        session.reads.pop(payload[2:4], None)
        self._answer(session, payload[:4], now_ns)

    def _answer(self, session: Session, request_and_object: bytes, now_ns: int) -> None:
        status = xrce.submessage(xrce.STATUS, request_and_object + xrce.OK)
        self._send_reliably(session, xrce.RELIABLE, status, now_ns)

    def _take_acknack(self, session: Session, payload: bytes, now_ns: int) -> None:
        parsed = xrce.parse_acknack(payload)
        if parsed is None or parsed[2] not in session.outputs:
            return
        first, missing, stream = parsed
        for number, data in session.outputs[stream].acknowledge(first, missing, now_ns):
            self._messages.append(session.header(stream, number) + data)

    def _take_heartbeat(self, session: Session, payload: bytes) -> None:
        parsed = xrce.parse_heartbeat(payload)
        if parsed is None or parsed[2] < xrce.RELIABLE:
            return
        first, last, stream = parsed
        lost = session.inputs.setdefault(stream, InputStream()).expect(first, last)
        if lost:
            session.fragments = b""
            self._count("lost_messages", lost)
        session.acknowledged.add(stream)

    # What is sent.
    def reader_of(self, name: str) -> bytes | None:
        """Return the number of a reader that has asked for its data, None if there is none."""
        if self._session is None:
            return None
        for number, topic in self._session.objects.items():
            is_asking = number[1] & 0x0F == xrce.READER and number in self._session.reads
            if is_asking and matches(topic.name, name):
                return number
        return None

    def send(self, reader: bytes, body: bytes, now_ns: int) -> bool:
        """Send a reader its data; False if the board has acknowledged nothing for long."""
        session = self._session
        if session is None or reader not in session.reads:
            return False
        request, stream = session.reads[reader]
        data = xrce.submessage(xrce.DATA, request + reader + body)
        if stream >= xrce.RELIABLE:
            return self._send_reliably(session, stream, data, now_ns)
        number = session.numbers.get(stream, 0)
        session.numbers[stream] = number + 1 & 0xFFFF
        self._messages.append(session.header(stream, number) + data)
        return True

    def _send_reliably(self, session: Session, stream: int, data: bytes, now_ns: int) -> bool:
        output = session.outputs.setdefault(stream, OutputStream())
        if output.is_full:
            return False
        number = output.add(data, now_ns)
        self._messages.append(session.header(stream, number) + data)
        return True

    def outgoing(self, now_ns: int) -> list[bytes]:
        """Return the messages that are to be sent now."""
        session = self._session
        if session is not None:
            self._acknowledge(session, now_ns)
            for stream, output in session.outputs.items():
                if question := output.heartbeat(now_ns, stream):
                    self._messages.append(session.header() + question)
        messages, self._messages = self._messages, []
        return messages

    def _acknowledge(self, session: Session, now_ns: int) -> None:
        for stream, taken in sorted(session.inputs.items()):
            is_quiet = stream not in session.acknowledged
            if is_quiet and now_ns - taken.told_ns < HEARTBEAT_NS:
                continue
            taken.told_ns = now_ns
            acknowledgement = taken.acknowledgement(stream, is_quiet=is_quiet)
            self._messages.append(session.header() + acknowledgement)
        session.acknowledged.clear()


def _ends_session(part: Submessage) -> bool:
    return part.kind == xrce.DELETE and part.payload[3:4] == bytes((0xF0 | xrce.CLIENT,))


def matches(topic: str, name: str) -> bool:
    """Whether a topic is the one of this name, whatever namespace or prefix it has."""
    return f"/{topic}".endswith(f"/{name}")
