"""DDS-XRCE against bytes that others have published, and the agent's streams."""

import struct
from collections import Counter

import pytest

from trolley_base.drivers.boards import xrce_messages as xrce
from trolley_base.drivers.boards.xrce_agent import DEPTH, XrceAgent
from trolley_base.drivers.boards.xrce_frames import FrameDecoder, crc16, encode
from trolley_base.drivers.boards.xrce_pings import PingResponder
from trolley_base.emulators.micro_ros import Cdr

S = 1_000_000_000
# What Micro-XRCE-DDS-Client sends, derived from its sources: its serial transport has address 1.
PING = bytes.fromhex("80000000 02010800 000AFFFD 02000000")
PING_FRAME = bytes.fromhex("7E01001000 80000000 02010800 000AFFFD 02000000 CF12")
OPEN_FRAME = bytes.fromhex(
    "7E01001800 80000000 00011000 58524345 0100 010F 12345678 81 00 0002 1A77"
)
# The fixtures of micro_xrce_dds_rs (Baker-Tanaka), src/session.rs, `mod wire_tests`.
OPEN = bytes.fromhex("80000000 00011000 58524345 0100 010F BACEA105 81 00 0002")
CREATE_PARTICIPANT = bytes.fromhex(
    "81010000 01071600 0001 0011 01 02 0000 08000000 6D795F6E6F646500 0000"
)
WRITE_FLOAT = bytes.fromhex("81010000 07010800 0000 0015 0000803F")
# Made by functions of Micro-XRCE-DDS-Client and Micro-CDR, compiled from a copy by hand: what
# creates a topic in binary, and its writer.
JUDGED_TOPIC = bytes.fromhex(
    "81800100 01054D00 000B0002 02030000 3F000000"
    "13000000 72742F6F646F6D2F756E66696C7465726564 00 00 01 000000"
    "1F000000 6E61765F6D7367733A3A6D73673A3A6464735F3A3A4F646F6D657472795F 00 0001 000000"
)
JUDGED_WRITER = bytes.fromhex(
    "81800300 01051900 000D0005 05030000 0B000000 0002 01 00 0300 00000000 00 0003 000000"
)
# How Micro-XRCE-DDS-Agent answers: Processor.cpp, Root.cpp, and a checker for ClearCore boards.
STATUS_AGENT = bytes.fromhex("81000000 04010B00 0000 58524345 0100 010F 00")
PONG = bytes.fromhex(
    "80000000 06011C00 000AFFFD 0000 01 0D 58524345 0100 010F 00 01 0D 00 0100 0000 00000000"
)


def agent() -> tuple[XrceAgent, Counter[str]]:
    counts: Counter[str] = Counter()

    def count(name: str, number: int) -> None:
        counts[name] += number

    return XrceAgent(count), counts


def opened() -> tuple[XrceAgent, Counter[str]]:
    one, counts = agent()
    one.take(OPEN, 0)
    one.outgoing(0)
    return one, counts


def reliable(number: int, *parts: bytes) -> bytes:
    return struct.pack("<BBH", 0x81, 0x80, number & 0xFFFF) + b"".join(parts)


def write(body: bytes, writer: bytes = b"\x00\x05") -> bytes:
    return xrce.submessage(xrce.WRITE_DATA, b"\0\x0b" + writer + body)


def writer_of(name: str) -> bytes:
    """CREATE of a writer, described by reference: the shortest way."""
    text = f"{name}__dw\0".encode()
    inner = struct.pack("<I", len(text)) + text
    return xrce.submessage(
        xrce.CREATE,
        bytes.fromhex("000A 0005 05 01 0000") + inner + b"\0" * (-len(text) % 4) + b"\0\x03",
    )


def parts_of(messages: list[bytes]) -> list[xrce.Submessage]:
    return [part for one in messages for part in xrce.submessages(one, 4)]


def acknowledgements(messages: list[bytes]) -> list[tuple[int, int, int] | None]:
    return [
        xrce.parse_acknack(one.payload) for one in parts_of(messages) if one.kind == xrce.ACKNACK
    ]


def test_the_sum_is_crc_16_arc() -> None:
    assert crc16(b"123456789") == 0xBB3D


@pytest.mark.parametrize("frame", [PING_FRAME, OPEN_FRAME])
def test_frames_of_the_c_library_are_read(frame: bytes) -> None:
    (found,) = FrameDecoder(lambda *_: None).feed(frame)
    assert (found.source, found.message) == (1, frame[5:-2])


def test_7e_and_7d_are_escaped() -> None:
    frame = encode(b"\x7e\x7d\x20", 1)
    assert frame[:8] == bytes.fromhex("7E 00 01 03 00 7D5E 7D")
    assert b"\x7e" not in frame[1:]
    (found,) = FrameDecoder(lambda *_: None).feed(frame)
    assert found.message == b"\x7e\x7d\x20"


def test_what_is_escaped_is_read_as_the_c_library_writes_it() -> None:
    """Bytes that a copy by hand of its framing (Micro-XRCE-DDS-Client, 0d47a98a) made of these."""
    message = bytes.fromhex("81010000 07011000 00017E7D 7475767778797A7B7C7D7E7F")
    frame = bytes.fromhex(
        "7E01001800 81010000 07011000 00017D5E7D5D 7475767778797A7B7C7D5D7D5E7F 2A0C"
    )
    (found,) = FrameDecoder(lambda _name, _number: None).feed(frame)
    assert (found.source, found.message) == (1, message)


def test_a_ping_is_answered_as_by_eprosima_s_agent() -> None:
    """Old boards find the answer's availability at a fixed place, behind the configuration."""
    pings = PingResponder()
    assert pings.respond(PING_FRAME[:9], 0) == b""
    assert pings.respond(PING_FRAME[9:] + OPEN_FRAME, 0) == encode(PONG, 1)
    pings.has_session = True
    assert pings.respond(PING_FRAME, 0) == encode(PONG[:13] + b"\1" + PONG[14:], 1)
    in_session = encode(b"\x81" + PING[1:], 0)
    assert pings.respond(in_session, 0)[5:9] == bytes.fromhex("81000000"), "as it was asked"
    pings.is_silent = True
    assert pings.respond(PING_FRAME, 0) == b""


def test_a_session_is_opened() -> None:
    one, _ = agent()
    one.take(OPEN, 0)
    assert one.outgoing(0) == [STATUS_AGENT]
    assert one.has_session
    one.take(bytes.fromhex("81000000 03010400 0002FFFE"), 0)  # DELETE of the client
    assert not one.has_session
    assert one.outgoing(0) == [bytes.fromhex("81000000 05010600 0002FFFE 0000")]


def test_another_version_opens_none() -> None:
    one, _ = agent()
    one.take(OPEN[:12] + b"\x02" + OPEN[13:], 0)
    assert one.outgoing(0)[0][8] == 0x86
    assert one.is_incompatible
    assert not one.has_session


def test_a_session_with_a_key_has_it_in_each_message() -> None:
    one, _ = agent()
    one.take(OPEN[:20] + b"\x01" + OPEN[21:], 0)
    assert one.outgoing(0)[0][:8] == bytes.fromhex("01000000 BACEA105")
    one.take(bytes.fromhex("01000000 BACEA105") + xrce.heartbeat(0, 0, 0x80), 3 * S)
    (answer,) = one.outgoing(4 * S)
    assert answer[:8] == bytes.fromhex("01000000 BACEA105")
    assert answer[8] == xrce.ACKNACK
    one.take(bytes.fromhex("01000000 BACEA106") + xrce.heartbeat(0, 0, 0x80), 3 * S)
    assert one.is_estranged


def test_what_is_created_is_confirmed_and_known() -> None:
    one, counts = opened()
    one.take(CREATE_PARTICIPANT, 0)
    assert one.outgoing(0) == [bytes.fromhex("81800000 05010600 00010011 0000")]
    one.take(WRITE_FLOAT, 0)
    assert counts["unknown_topics"] == 0, "its number is not newer than that of the message before"
    one.take(WRITE_FLOAT[:2] + b"\1\0" + WRITE_FLOAT[4:], 0)
    assert counts["unknown_topics"] == 1
    one.take(reliable(0, writer_of("odom/unfiltered")), 0)
    (delivery,) = one.take(reliable(1, write(b"body")), 0)
    assert (delivery.topic.name, delivery.body) == ("odom/unfiltered", b"body")


@pytest.mark.parametrize("form", ["binary", "xml"])
def test_topics_have_their_names_however_they_are_described(form: str) -> None:
    one, _ = opened()
    name, kind = b"rt/robot/cmd_vel\0", b"geometry_msgs::msg::dds_::Twist_\0"
    if form == "binary":
        inner = struct.pack("<I", len(name)) + name + b"\0\1"
        inner += bytes(-len(inner) % 4) + struct.pack("<I", len(kind)) + kind
        topic = bytes.fromhex("000A 0012 02 03 0000") + struct.pack("<I", len(inner)) + inner
        one.take(reliable(0, xrce.submessage(xrce.CREATE, topic + b"\0\x01")), 0)
        inner = bytes.fromhex("0012 01 00 0000 000000000000")
        reader = bytes.fromhex("000B 0006 06 03 0000") + struct.pack("<I", len(inner)) + inner
    else:
        text = b"<dds><data_reader><topic><kind>NO_KEY</kind><name>" + name[:-1]
        text += b"</name><dataType>" + kind[:-1] + b"</dataType></topic></data_reader></dds>\0"
        reader = bytes.fromhex("000B 0006 06 02 0000") + struct.pack("<I", len(text)) + text
        one.take(reliable(0), 0)
    one.take(reliable(1, xrce.submessage(xrce.CREATE, reader + b"\0\x04")), 0)
    assert (name[:-1].decode(), kind[:-1].decode()) in one.topics
    assert one.reader_of("cmd_vel") is None, "it has not asked for its data"
    assert not one.send(b"\0\x06", b"", 0)
    asked = bytes.fromhex("000C 0006 80 00 00 01 FFFF FFFF FFFF 0000")
    one.take(reliable(2, xrce.submessage(xrce.READ_DATA, asked)), 0)
    one.outgoing(0)
    assert one.reader_of("cmd_vel") == b"\0\x06"
    assert one.reader_of("vel") is None
    assert one.send(b"\0\x06", b"body", 0)
    number = {"binary": 2, "xml": 1}[form]
    assert one.outgoing(0) == [reliable(number, bytes.fromhex("09010800 000C0006") + b"body")]


def test_topics_of_the_c_library_have_their_types() -> None:
    one, counts = opened()
    one.take(reliable(0, CREATE_PARTICIPANT[4:]), 0)
    one.take(JUDGED_TOPIC, 0)
    one.take(reliable(2), 0)
    one.take(JUDGED_WRITER, 0)
    assert one.topics == 2 * [("rt/odom/unfiltered", "nav_msgs::msg::dds_::Odometry_")]
    assert not counts


def test_a_reader_that_asks_for_no_more_gets_none() -> None:
    """As `uxr_buffer_cancel_data` does before a reader is deleted."""
    one, _ = opened()
    ask = bytes.fromhex("000C 0006 80 00 00 01 FFFF 0000 0000 0000")
    one.take(reliable(0, xrce.submessage(xrce.READ_DATA, ask)), 0)
    assert one.send(b"\0\x06", b"body", 0)
    cancel = bytes.fromhex("000D 0006 00 00 00 01 0000 0000 0000 0000")
    one.take(reliable(1, xrce.submessage(xrce.READ_DATA, cancel)), 0)
    assert not one.send(b"\0\x06", b"body", 0)


def test_a_type_s_reference_may_come_before_its_name() -> None:
    one, _ = opened()
    inner = Cdr().text("rt/x").put("B", 1).text("profile").put("B", 1).text("pkg::Type").data
    topic = bytes.fromhex("000A 0012 02 03 0000") + struct.pack("<I", len(inner)) + inner
    one.take(reliable(0, xrce.submessage(xrce.CREATE, topic + b"\0\x01")), 0)
    assert one.topics == [("rt/x", "pkg::Type")]


def test_the_time_is_told() -> None:
    asked = bytes.fromhex("81000000 0E010800 05000000 06000000")
    one, _ = opened()
    one.take(asked, 0)
    assert one.num_synchronized == 1
    assert one.outgoing(0) == [], "it has been answered"
    pings = PingResponder()
    assert pings.respond(encode(asked, 0), 7 * S + 8) == b"", "of no session here"
    pings.has_session = True
    answer = bytes.fromhex("81000000 0F011800") + struct.pack("<6I", 7, 8, 7, 8, 5, 6)
    assert pings.respond(encode(asked, 0), 7 * S + 8) == encode(answer, 0)


def test_fragments_are_put_together_in_order_and_acknowledged() -> None:
    one, _ = opened()
    one.take(reliable(0, writer_of("odom/unfiltered")), 0)
    whole = write(bytes(range(200)))
    pieces = [
        xrce.submessage(xrce.FRAGMENT, whole[at : at + 96], 3 if at + 96 >= len(whole) else 1)
        for at in range(0, len(whole), 96)
    ]
    one.outgoing(0)
    assert one.take(reliable(1, pieces[0]), 0) == []
    assert one.take(reliable(3, pieces[2]), 0) == []
    assert acknowledgements(one.outgoing(0)) == [(2, 0b01, 0x80)]
    (delivery,) = one.take(reliable(2, pieces[1]), 0)
    assert delivery.body == bytes(range(200))
    assert acknowledgements(one.outgoing(0)) == [(4, 0, 0x80)]
    assert one.take(reliable(2, pieces[1]), 0) == [], "what comes twice counts once"
    assert acknowledgements(one.outgoing(0)) == [(4, 0, 0x80)]


def test_a_long_message_may_begin_behind_a_short_one() -> None:
    """As Micro-XRCE-DDS-Client's reliable stream lays both out in blocks of 508 bytes."""
    one, _ = opened()
    one.take(reliable(0, writer_of("odom/unfiltered")), 0)
    short, long = bytes(range(40)), bytes(place * 7 & 255 for place in range(724))
    whole = write(long)
    first = write(short) + bytes.fromhex("0D01C401") + whole[:452]
    second = bytes.fromhex("0D031801") + whole[452:]
    assert [len(reliable(0, first)), len(reliable(0, second))] == [508, 288]
    deliveries = one.take(reliable(1, first), 0) + one.take(reliable(2, second), 0)
    assert [delivery.body for delivery in deliveries] == [short, long]


def test_a_heartbeat_says_what_is_missing_and_what_is_lost() -> None:
    one, counts = opened()
    one.take(reliable(0, writer_of("odom/unfiltered")), 0)
    one.outgoing(0)
    beat = bytes.fromhex("81000000") + xrce.heartbeat(1, 2, 0x80)
    one.take(beat, 0)
    assert acknowledgements(one.outgoing(0)) == [(1, 0b11, 0x80)]
    one.take(bytes.fromhex("81000000") + xrce.heartbeat(5, 5, 0x80), 0)
    assert counts["lost_messages"] == 4
    assert acknowledgements(one.outgoing(0)) == [(5, 0b1, 0x80)]
    assert len(one.take(reliable(5, write(b"")), 0)) == 1


def test_whatever_a_heartbeat_says_can_be_acknowledged() -> None:
    one, _ = opened()
    for first in (30_000, 60_000, 20_000):
        one.take(bytes.fromhex("81000000") + xrce.heartbeat(first, first + 100, 0x80), 0)
        assert acknowledgements(one.outgoing(0)) == [(first, 0, 0x80)]


def test_numbers_go_round() -> None:
    one, _ = opened()
    one.take(reliable(0, writer_of("odom/unfiltered")), 0)
    taken = sum(len(one.take(reliable(number, write(b"")), 0)) for number in range(1, 0x10005))
    assert taken == 0x10004


def test_what_was_not_acknowledged_is_asked_for_and_sent_again() -> None:
    one, _ = opened()
    for number in range(3):
        one.take(reliable(number, writer_of("x")), 0)
    answers = [message for message in one.outgoing(0) if message[1] == 0x80]
    assert len(answers) == 3
    assert one.outgoing(S // 20) == []
    question = parts_of(one.outgoing(S // 5))[-1]
    assert xrce.parse_heartbeat(question.payload) == (0, 2, 0x80)
    one.take(bytes.fromhex("81000000") + xrce.acknack(1, 0b10, 0x80), S // 5)
    assert one.outgoing(S // 5) == [answers[2]]
    one.take(bytes.fromhex("81000000") + xrce.acknack(3, 0, 0x80), 0)
    assert [part.kind for part in parts_of(one.outgoing(2 * S))] == [xrce.ACKNACK]


def test_what_has_just_been_sent_again_is_not_sent_for_what_the_board_said_before() -> None:
    one, _ = opened()
    for number in range(8):
        one.take(reliable(number, writer_of("x")), 0)
    answers = [message for message in one.outgoing(0) if message[1] == 0x80]
    sent: list[bytes] = []
    for at_ms, first in ((60, 0), (61, 1), (62, 2), (63, 3), (110, 3)):  # as they arrive there
        missing = (1 << len(answers) - first) - 1
        one.take(bytes.fromhex("81000000") + xrce.acknack(first, missing, 0x80), at_ms * S // 1000)
        sent += [message for message in one.outgoing(at_ms * S // 1000) if message[1] == 0x80]
    assert sent == answers + answers[3:]


def test_of_a_quiet_stream_it_says_again_what_is_missing() -> None:
    """For the library puts its own question off whenever something arrives, as commands do."""
    one, _ = opened()
    one.take(reliable(0, writer_of("odom/unfiltered")), 0)
    assert acknowledgements(one.outgoing(0)) == [(1, 0, 0x80)]
    assert acknowledgements(one.outgoing(S // 20)) == []
    assert acknowledgements(one.outgoing(S // 10)) == [(1, 1, 0x80)], "an answer that got lost"
    assert acknowledgements(one.outgoing(S // 10)) == []
    assert acknowledgements(one.outgoing(S // 5)) == [(1, 1, 0x80)]
    one.take(reliable(1, write(b"")), S // 4)
    assert acknowledgements(one.outgoing(S // 4)) == [(2, 0, 0x80)]


def test_of_a_board_that_acknowledges_nothing_not_more_than_so_much_is_kept() -> None:
    one, _ = opened()
    one.take(reliable(0, xrce.submessage(xrce.READ_DATA, bytes.fromhex("000C 0006 80 00"))), 0)
    one.take(reliable(0, xrce.submessage(xrce.READ_DATA, bytes.fromhex("000C 0006 80 00 00"))), 0)
    one.take(reliable(1, xrce.submessage(xrce.READ_DATA, bytes.fromhex("000C 0006 80 00 00"))), 0)
    sent = sum(one.send(b"\0\x06", b"", 0) for _ in range(100))
    assert sent == DEPTH


def test_a_board_in_a_session_of_another_agent_is_a_stranger_until_it_has_given_it_up() -> None:
    one, _ = agent()
    for _ in range(2):
        one.take(reliable(77, write(b"")), 0)
        one.take(PING, 0)
        assert one.is_estranged
        one.take(PING, 0)
        assert not one.is_estranged
    one.take(reliable(78, write(b"")), 0)
    assert one.is_estranged
    one.take(bytes.fromhex("81000000 03010400 0002FFFE"), 0)
    assert not one.is_estranged
    assert one.outgoing(0) == []
