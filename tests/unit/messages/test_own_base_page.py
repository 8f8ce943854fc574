"""What docs/own-base.md says of the bytes, to those who write a base of their own, is true."""

import re
import struct
from pathlib import Path
from typing import Any

import pytest

from trolley import topics
from trolley.geometry import Pose2D, Twist2D
from trolley.messages import Odometry, VelocityCommand
from trolley.runtime import codec

STAMP_NS = 1_800_000_000_000_000_000
TWIST = Twist2D(0.25, 0.0, -0.5)
SHOWN = [
    Odometry(stamp_ns=STAMP_NS, pose=Pose2D(1.5, -0.25, 0.5), twist=TWIST),
    VelocityCommand(stamp_ns=STAMP_NS, twist=TWIST, valid_for=0.25),
]
PAGE = (Path(__file__).resolve().parents[3] / "docs/own-base.md").read_text("utf-8")


def dump(block: str) -> bytes:
    """Read the left column of a listing: pairs of hexadecimal digits up to the wide gap."""
    lines = (re.split(r" {9,}", line)[0] for line in block.splitlines())
    return bytes.fromhex("".join(lines))


def pack(value: Any) -> bytes:
    """Pack by msgpack's specification, with numbers of 4 bytes as small boards have them."""
    match value:
        case dict():
            items = b"".join(pack(key) + pack(one) for key, one in value.items())
            return bytes([0x80 | len(value)]) + items
        case str():
            return bytes([0xA0 | len(value)]) + value.encode()
        case float():
            return b"\xca" + struct.pack(">f", value)
        case int():
            return b"\xd3" + struct.pack(">q", value)
        case _:
            raise TypeError(value)


def test_the_page_shows_the_bytes_that_are_sent() -> None:
    blocks = re.findall(r"^```text\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
    assert [dump(block) for block in blocks] == [codec.encode(one, "msgpack") for one in SHOWN]
    for message in SHOWN:
        assert f"{len(codec.encode(message, 'msgpack'))} bytes:" in PAGE


@pytest.mark.parametrize("message", SHOWN, ids=lambda one: type(one).__name__)
def test_what_a_small_board_would_pack_is_understood(message: Any) -> None:
    plain = codec.to_plain(message)
    backwards = dict(reversed(plain.items())) | {"of_another_kind": "ignored"}
    backwards.pop("scan_ns", None)  # it has a default
    assert codec.decode(type(message), pack(backwards)) == message
    assert codec.decode(type(message), codec.encode(message, "json")) == message
    whole = dict(plain, twist={"vx": 1, "vy": 0, "wz": -1})
    assert codec.decode(type(message), pack(whole)).twist == Twist2D(1.0, 0.0, -1.0)


def test_the_page_names_every_stream_of_base() -> None:
    owned = {topic.name for topic in topics.TOPICS if topic.first_owner == "base"} - {"tf/{child}"}
    assert {name for name in owned | {"tf/laser"} if f"`{name}`" not in PAGE} == set()
