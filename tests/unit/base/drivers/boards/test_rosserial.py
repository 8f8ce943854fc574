"""Vectors of rosserial's frames."""

import struct

import pytest
from support.fake_boards import frame, text, topic_info

from trolley.geometry import Twist2D
from trolley_base.drivers.boards.lino_messages import encode_pid, encode_twist, parse_velocities
from trolley_base.drivers.boards.rosserial import (
    STOP_REQUEST,
    TOPIC_REQUEST,
    FrameDecoder,
    LogLine,
    TopicInfo,
    encode,
    parse_log,
    parse_topic_info,
    time_reply,
)


def ignore(name: str, number: int) -> None:
    """Count nothing."""


def test_frames_are_those_of_the_protocol() -> None:
    twist = "FF FE 30 00 CF 65 00 9A 99 99 99 99 99 C9 3F" + " 00" * 32
    assert encode(101, encode_twist(Twist2D(0.2, 0.0, 0.5))) == bytes.fromhex(
        twist + " 00 00 00 00 00 00 E0 3F DC"
    )
    assert encode(100, encode_pid(p=0.6, i=0.3, d=0.5)) == bytes.fromhex(
        "FF FE 0C 00 F3 64 00 9A 99 19 3F 00 00 00 3F 9A 99 99 3E C7"
    )
    assert bytes.fromhex("FF FE 00 00 FF 00 00 FF") == TOPIC_REQUEST
    assert bytes.fromhex("FF FE 00 00 FF 0B 00 F4") == STOP_REQUEST
    assert time_reply(1_700_000_000 * 10**9) == bytes.fromhex(
        "FF FE 08 00 F7 0A 00 00 F1 53 65 00 00 00 00 4C"
    )


def test_velocities_are_read() -> None:
    data = bytes.fromhex("FF FE 0C 00 F3 7D 00 CD CC 4C 3E 00 00 00 00 00 00 00 3F 20")
    (found,) = FrameDecoder(ignore).feed(data)
    assert found.topic_id == 125
    assert found.following == 20
    twist = parse_velocities(found.payload)
    assert twist is not None
    assert (twist.vx, twist.vy, twist.wz) == pytest.approx((0.2, 0.0, 0.5), abs=1e-7)


def test_an_announcement_is_read() -> None:
    info = topic_info(125, "raw_vel", "lino_msgs/Velocities")
    whole = frame(0, info)
    start = bytes.fromhex("FF FE 4D 00 B2 00 00 7D 00 07 00 00 00 72 61 77 5F 76 65 6C 14 00 00 00")
    assert whole.startswith(start)
    assert whole.endswith(bytes.fromhex("00 02 00 00 F6"))
    assert parse_topic_info(info) == TopicInfo(
        125, "raw_vel", "lino_msgs/Velocities", "0ee8ad4cb7809be2d5a0a76352fea86a"
    )


@pytest.mark.parametrize("cut", range(77))
def test_a_cut_announcement_is_none(cut: int) -> None:
    assert parse_topic_info(topic_info(125, "raw_vel", "lino_msgs/Velocities")[:cut]) is None


def test_a_topic_of_the_protocol_is_not_announced() -> None:
    assert parse_topic_info(topic_info(11, "cmd_vel", "geometry_msgs/Twist")) is None


def test_log_lines_are_read() -> None:
    assert parse_log(b"\x04" + text("IMU failed")) == LogLine(4, "IMU failed")
    assert parse_log(b"\x04\xff\xff\xff\xffIMU") is None
    assert parse_log(b"") is None


@pytest.mark.parametrize(
    "payload",
    [
        b"",
        bytes(11),
        bytes(13),
        struct.pack("<3f", float("nan"), 0, 0),
        struct.pack("<3f", 0, 0, float("nan")),
        struct.pack("<3f", float("inf"), 0, 0),
        struct.pack("<3f", 10.5, 0, 0),
        struct.pack("<3f", 0, 0, -51.0),
    ],
)
def test_what_no_robot_drives_is_refused(payload: bytes) -> None:
    assert parse_velocities(payload) is None


def test_no_frame_overruns_a_board() -> None:
    assert len(encode(101, bytes(512))) == 520
    with pytest.raises(ValueError, match="at most 512"):
        encode(101, bytes(513))


def test_what_is_skipped_is_counted() -> None:
    counts: dict[str, int] = {}

    def count(name: str, number: int) -> None:
        counts[name] = counts.get(name, 0) + number

    good = frame(125, b"abc")
    bad = good[:-1] + bytes([good[-1] ^ 1])
    decoder = FrameDecoder(count)
    assert [found.topic_id for found in decoder.feed(b"xy" + bad + good)] == [125]
    assert counts == {"bad_checksum": 1, "skipped_bytes": 2 + len(bad)}
