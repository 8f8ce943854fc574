"""What docs/own-base.md says of the bytes, to those who write a base of their own, is true."""

import math
import re
from pathlib import Path
from typing import Any

import pytest
from support.examples import load_example

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
BARE: Any = load_example("bare_base")
"""It packs and unpacks by msgpack's specification, with numbers of 4 bytes as small boards do."""
PAGE = (Path(__file__).resolve().parents[3] / "docs/own-base.md").read_text("utf-8")


def dump(block: str) -> bytes:
    """Read the left column of a listing: pairs of hexadecimal digits up to the wide gap."""
    lines = (re.split(r" {9,}", line)[0] for line in block.splitlines())
    return bytes.fromhex("".join(lines))


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
    assert codec.decode(type(message), BARE.pack(backwards)) == message
    assert codec.decode(type(message), codec.encode(message, "json")) == message
    whole = dict(plain, twist={"vx": 1, "vy": 0, "wz": -1})
    assert codec.decode(type(message), BARE.pack(whole)).twist == Twist2D(1.0, 0.0, -1.0)


@pytest.mark.parametrize("message", SHOWN, ids=lambda one: type(one).__name__)
def test_the_bare_base_unpacks_what_is_sent(message: Any) -> None:
    assert BARE.unpack(codec.encode(message, "msgpack"))[0] == codec.to_plain(message)


def test_the_bare_base_drops_what_is_no_command() -> None:
    good = codec.encode(SHOWN[1], "msgpack")
    assert BARE.read_command(good) == (STAMP_NS, 0.25, 0.25, -0.5)
    damaged = [good[:length] for length in range(len(good) - 9)]  # scan_ns is not needed
    damaged += [bytes([kind]) + good[1:] for kind in range(256) if kind not in (0x83, 0x84)]
    damaged += [b"\x81" * 5000, b"{}", b"\x80", b"\xc0", good.replace(b"\xcf", b"\xcb")]
    nan = VelocityCommand(stamp_ns=STAMP_NS, twist=Twist2D(math.nan, 0.0, 0.0), valid_for=0.25)
    damaged.append(codec.encode(nan, "msgpack"))
    assert [one for one in damaged if BARE.read_command(one) is not None] == []


def test_the_page_names_every_stream_of_base() -> None:
    owned = {topic.name for topic in topics.TOPICS if topic.first_owner == "base"} - {"tf/{child}"}
    assert {name for name in owned | {"tf/laser"} if f"`{name}`" not in PAGE} == set()
