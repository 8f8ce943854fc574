"""What devices say of themselves; the bytes are those of the vendors' documents."""

import struct
from functools import partial

import pytest
from hypothesis import given
from hypothesis import strategies as st

from trolley_base.detection import answers, known, streams
from trolley_base.detection.known import (
    GREETINGS,
    IDENTITIES,
    STREAM_BAUDS,
    KnownBoard,
    recognise_talking,
)
from trolley_base.detection.results import FoundDevice
from trolley_base.drivers.boards import (
    BOARDS,
    arduino_bridge,
    linorobot2,
    rosserial_answer,
    waveshare_ugv,
)
from trolley_base.drivers.boards.lino_messages import TOPICS
from trolley_base.drivers.boards.models import Answer, BoardQuestion
from trolley_base.drivers.boards.rosserial import PUBLISHER, SUBSCRIBER, encode
from trolley_base.drivers.lidars import MODELS, coin_d4, hokuyo
from trolley_base.emulators.line import misheard
from trolley_base.emulators.micro_ros import framed

LD19 = bytes.fromhex(
    "54 2C 68 08 AB 7E E0 00 E4 DC 00 E2 D9 00 E5 D5 00 E3 D3 00 E4 D0 00 E9 CD 00 E4 CA 00 E2"
    "C7 00 E9 C5 00 E5 C2 00 E5 C0 00 E5 BE 82 3A 1A 50"
)
XV11 = bytes.fromhex("FA A0 00 4B E8 03 64 00 E9 03 64 00 EA 03 64 00 EB 03 64 00 99 30")
LDS01 = bytes.fromhex(
    "FA A0 B8 0B C8 00 E8 03 00 00 C8 00 E9 03 00 00 C8 00 EA 03 00 00 C8 00 EB 03 00 00"
    "C8 00 EC 03 00 00 C8 00 ED 03 00 00 61 61"
)
BOARD_QUESTIONS = [one for driver in BOARDS.values() for one in driver.questions]
INFO = bytes.fromhex("A55A 1400 0000 04")
HEALTH = bytes.fromhex("A55A 0300 0000 06")


@pytest.mark.parametrize(("frame", "model"), [(LD19, "ld19"), (LDS01, "lds01"), (XV11, "xv11")])
@given(before=st.binary(max_size=60), flipped=st.integers(0, 20))
def test_a_lidar_is_known_by_sound_frames_only(
    frame: bytes, model: str, before: bytes, flipped: int
) -> None:
    hear = partial(streams.recognise_stream, baud=115200 if model == "xv11" else 230400)
    spoilt = bytearray(frame)
    spoilt[flipped] ^= 0x10
    found = hear(before + frame[7:] + (bytes(spoilt) + frame) * 6)
    assert found == model
    assert hear(before + bytes(spoilt) * 20) is None
    assert hear(frame * 4) is None


def test_lidars_with_the_same_frames_at_the_same_speed_are_twins() -> None:
    assert streams.twins_of("ld19") == ["ld14p"]
    assert streams.twins_of("stl27l") == []
    assert streams.twins_of("ydlidar_x4") == ["ydlidar_x4_pro"]
    assert streams.twins_of("ydlidar_x2") == []


@given(st.binary(max_size=4000))
def test_rubbish_is_no_device(data: bytes) -> None:
    assert all(streams.recognise_stream(data, baud) is None for baud in STREAM_BAUDS)
    assert rosserial_answer.read_topics(data) == {}
    assert all(one.recognise(data) is None for one in BOARD_QUESTIONS)
    assert recognise_talking(data, 115200) is None


def info(model: int) -> bytes:
    return INFO + struct.pack("<4B", model, 29, 1, 7) + bytes(range(16))


def describe(model: str, told: answers.Info, health: tuple[int, int] | None) -> FoundDevice:
    identity = MODELS[model].identity
    assert identity is not None
    return answers.describe_lidar(identity, MODELS[model].facts.baud, told, health)


def test_an_rplidar_says_who_it_is() -> None:
    told = answers.read_info(b"\x00\xa5" + info(0x18))
    assert told is not None
    found = describe("rplidar_a1", told, answers.read_health(HEALTH + b"\x00\x00\x00"))
    assert (found.model, found.title) == ("rplidar_a1", "RPLIDAR A1")
    serial = "000102030405060708090A0B0C0D0E0F"
    assert found.details == ("firmware 1.29", f"serial {serial}", "health good")
    assert found.problems == ()


def test_an_answer_that_is_not_all_there_is_none() -> None:
    for length in range(len(info(0x18))):
        assert answers.read_info(info(0x18)[:length]) is None


@pytest.mark.parametrize(
    ("number", "model", "title"),
    [
        (0x28, "rplidar_a2", "RPLIDAR A2"),
        (0x31, "rplidar_a3", "RPLIDAR A3"),
        (0x41, "rplidar_c1", "RPLIDAR C1"),
        (0x61, "rplidar_s1", "RPLIDAR S1"),
        (0x71, "rplidar_s2", "RPLIDAR S2"),
        (0x82, "rplidar_s3", "RPLIDAR S3"),
        (0x91, None, "RPLIDAR (model 0x91)"),
    ],
)
def test_an_rplidar_is_known_by_its_number(number: int, model: str | None, title: str) -> None:
    told = answers.read_info(info(number))
    assert told is not None
    found = describe("rplidar_a1", told, (0, 0))
    assert (found.model, found.title) == (model, title)


def test_no_question_at_one_speed_is_heard_as_one_at_another() -> None:
    bauds = {baud for _, baud in IDENTITIES} | set(STREAM_BAUDS)
    said = {
        (baud, text)
        for identity, baud in IDENTITIES
        for text in (*identity.stop, identity.get_info, identity.get_health)
    }
    said |= {
        (driver.facts.baud, text)
        for driver in MODELS.values()
        for text in (driver.start, driver.stop)
        if text
    }
    commands = {text for _, text in said}
    for baud, text in said:
        for heard_baud in bauds - {baud}:
            heard = misheard(text, baud, heard_baud)
            assert not any(command in heard for command in commands), (text, baud, heard_baud)
            # A COIN-D4 is started and stopped last, when whoever knows such a byte has been asked.
            assert b"\xa5" not in heard or text in (coin_d4.START, coin_d4.STOP)


def test_a_faulty_lidar_is_said() -> None:
    told = answers.read_info(info(6))
    assert told is not None
    found = describe("ydlidar_x4", told, (2, 0x8002))
    assert found.model == "ydlidar_x4"
    assert f"serial {'0123456789ABCDEF'}" in found.details
    assert "reports a fault (code 32770)" in found.problems[0]
    assert describe("ydlidar_x4", told._replace(model=4), (0, 0)).model is None


def test_an_arduino_is_known_by_its_baud_rate_on_a_line() -> None:
    assert arduino_bridge.recognise(b"Invalid Command\r\n57600\r\n")
    assert not arduino_bridge.recognise(b"157600\r\n")
    assert not arduino_bridge.recognise(b"57600")
    found = arduino_bridge.describe(b"57600\r\n-12 3456\r\n")
    assert found.details == ("encoders at -12 3456",)


def test_an_arduino_without_motors_is_told_what_to_do() -> None:
    found = arduino_bridge.describe(b"Invalid Command\r\n")
    assert found.is_usable
    assert "USE_BASE" in found.problems[0]
    assert "does not answer" in arduino_bridge.describe(b"").problems[0]


def announce(name: str, kind: int, type_name: str, md5: str) -> bytes:
    texts = b"".join(
        struct.pack("<I", len(text)) + text.encode() for text in (name, type_name, md5)
    )
    return encode(kind, struct.pack("<H", 125) + texts + struct.pack("<i", 512))


def announced(**other_md5: str) -> bytes:
    return b"".join(
        announce(
            topic.name,
            PUBLISHER if topic.is_published else SUBSCRIBER,
            topic.type_name,
            other_md5.get(topic.name, topic.md5),
        )
        for topic in TOPICS
    )


def test_a_linorobot_is_known_by_its_topics() -> None:
    data = b"\xff\xfe\x00" + announced()
    assert rosserial_answer.recognise(data[:-20])
    assert not rosserial_answer.is_complete(data[:-20])
    assert rosserial_answer.is_complete(data)
    found = rosserial_answer.describe(data)
    assert (found.is_usable, found.problems) == (True, ())


def test_a_linorobot_with_other_messages_is_not_driven() -> None:
    found = rosserial_answer.describe(announced(raw_vel="0" * 32))
    assert not found.is_usable
    assert "raw_vel" in found.problems[0]
    assert "0" * 32 in found.problems[0]


def test_another_rosserial_board_is_none() -> None:
    answer = rosserial_answer.describe(announce("chatter", PUBLISHER, "std_msgs/String", "1" * 32))
    found = KnownBoard("linorobot", BOARDS["linorobot"].questions[0]).describe(answer)
    assert (found.model, found.title) == (None, "a rosserial board")
    assert "does not announce raw_vel and cmd_vel" in found.problems[0]


def test_a_waveshare_board_is_known_by_a_report() -> None:
    whole = b'oot\r\n{"T":130}\n{"T":1001,"L":0,"R":0.0,"r":1.5,"p":2,"v":11.93}\r\n'
    found = waveshare_ugv.recognise(whole)
    assert found is not None
    assert found.details == ("battery at 11.9 V",)
    assert waveshare_ugv.recognise(whole[:-2]) is None
    assert waveshare_ugv.recognise(b'{"T":1001,"L":null,"R":1}\n{"T":1002}\n') is None


def test_no_question_to_a_board_begins_a_lidars_command() -> None:
    for question in BOARD_QUESTIONS:
        assert b"\xa5" not in b"".join((*question.ask, question.leave))


def test_a_hoverboard_is_known_by_its_feedback() -> None:
    frame = bytes.fromhex("CD AB 00 00 64 00 62 00 61 00 D8 0E 36 01 00 00 44 A4")
    found = recognise_talking(b"\xab" + frame * 5, 115200)
    assert found is not None
    assert (found.model, found.details) == ("hoverboard", ("battery at 38.0 V",))
    assert recognise_talking(frame * 5, 230400) is None
    assert recognise_talking(frame * 4, 115200) is None


def test_a_linorobot2_is_known_by_its_pings_at_its_two_speeds() -> None:
    ping = bytes.fromhex("7E00001000 80000000 02010800 000AFFFD 02000000 CF12")
    for baud in (115200, 921600):
        found = recognise_talking(b"boot\r\n" + ping, baud)
        assert found is not None
        assert (found.model, found.baud, found.problems) == ("linorobot2", baud, ())
    assert recognise_talking(ping, 230400) is None
    assert linorobot2.recognise(ping[:-1]) is None


def test_a_linorobot2_that_talks_to_an_agent_is_known_too() -> None:
    frame = framed(bytes.fromhex("81010000 07010800 0000 0015 0000803F"))
    found = linorobot2.recognise(frame * 3)
    assert found is not None
    assert "restart it" in found.problems[0]
    assert linorobot2.recognise(frame * 2) is None


def test_a_hokuyo_is_known_by_what_it_says_of_itself() -> None:
    answer = (
        b"\n0Ee\n\nVV\n00P\nVEND:Hokuyo Automatic Co.,Ltd.;[\n"
        b"PROD:SOKUIKI Sensor URG-04LX-UG01(Simple-URG);[\nFIRM:3.4.03(17/Dec./2012);T\n"
        b"PROT:SCIP 2.0;N\nSERI:H1510998;V\n\n"
    )
    details = ("firmware 3.4.03(17/Dec./2012)", "serial H1510998")
    assert hokuyo.recognise(answer) == ("Hokuyo URG-04LX-UG01", details)
    assert hokuyo.recognise(answer[:-1]) is None
    assert hokuyo.recognise(answer.replace(b"SCIP 2.0;N", b"SCIP 2.0;M")) is None


def test_no_question_to_a_hokuyo_is_one_to_another_lidar() -> None:
    bauds = {baud for _, baud in IDENTITIES} | set(STREAM_BAUDS)
    commands = {
        (driver.facts.baud, command)
        for driver in MODELS.values()
        for command in (driver.start, driver.stop)
        if command
    }
    for _, greeting, baud in GREETINGS:
        text = b"".join(greeting.ask)
        for heard_baud in bauds:
            heard = text if heard_baud == baud else misheard(text, baud, heard_baud)
            assert b"\xa5" not in heard
            own = {command for at, command in commands if at == heard_baud}
            assert not any(command in heard for command in own), heard_baud


def test_of_two_that_only_turn_differently_the_person_hears() -> None:
    found = streams.describe_stream("xv11", streams.twins_of("xv11"))
    assert found.model == "xv11"
    assert found.details == ('or an LDS02RR, if left and right are swapped: model = "lds02rr"',)
    assert streams.describe_stream("ld19", ["ld14p"]).details == ()


def test_a_driver_that_fails_at_what_others_send_is_left_out_and_named(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def fail(data: bytes) -> Answer | None:
        raise IndexError(len(data))

    monkeypatch.setattr(known, "FAILED", {})
    board = KnownBoard("acme_m1", BoardQuestion(115200, (b"?",), fail))
    assert board.recognise(b"anything") is None
    assert known.what_is_left_out() == ["The driver of acme_m1 has failed: IndexError: 8."]
