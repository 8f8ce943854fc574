"""Questions to boards that are told by one answer at their own speed, and harm nobody else.

They are asked before the lidars of 115200 baud: none of them holds an A5, with which all that those
lidars are told begins.

- Waveshare's JSON boards: an empty line ends what other questions have left in the buffer.
- A linorobot2 looks for an agent, twice a second, at one of two speeds; it is listened to for long
  enough. One that has an agent talks in a session.
- A Create: it is started, which moves nothing, asked for its stream, and left off again. To one
  that was started, A5 and the byte behind it are buttons that are pressed.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from trolley_base.detection.results import FoundDevice
from trolley_base.drivers.boards import BOARDS, hoverboard
from trolley_base.drivers.boards.create2 import (
    ASK_STREAM,
    END,
    FRAME,
    PAUSE_STREAM,
    START,
    parse_frame,
)
from trolley_base.drivers.boards.fixed_frames import FrameReader
from trolley_base.drivers.boards.waveshare_ugv import REPORT, SPEED_KEYS, numbers_of, parse_line
from trolley_base.drivers.boards.xrce_frames import FrameDecoder
from trolley_base.drivers.boards.xrce_messages import GET_INFO, KEYLESS, parse_header, submessages

UGV, CREATE = BOARDS["waveshare_ugv"], BOARDS["create2"]
HOVERBOARD, LINOROBOT2 = BOARDS["hoverboard"], BOARDS["linorobot2"]
LINOROBOT2_BAUDS = (LINOROBOT2.baud, 921600)
PING_S = 0.75
"""A board that looks for an agent does so each 0.6 s."""
ENOUGH_UNASKED = 5
"""Frames with two known bytes and a sum of 16 bits."""
ENOUGH = 3
"""Frames with a sum and fifteen numbers of packets: so many are no coincidence."""


@dataclass(frozen=True, slots=True)
class BoardQuestion:
    """How a board is told.

    Attributes:
        baud: at which speed it is asked [bits/s].
        ask: the question; a device has a moment's rest between two parts of it.
        recognise: finds the answer in what has arrived; None while it is not there.
        leave: what is sent once it has answered, so that it is as it was before; b"" for nothing.
        wait_s: how long an answer is waited for.
    """

    baud: int
    ask: tuple[bytes, ...]
    recognise: Callable[[bytes], FoundDevice | None]
    leave: bytes = b""
    wait_s: float = 0.25


def recognise_ugv(data: bytes) -> FoundDevice | None:
    """Find a report of a Waveshare UGV."""
    for line in data.split(b"\n")[:-1]:
        message = parse_line(line)
        if message is None or message.get("T") != REPORT or not numbers_of(message, SPEED_KEYS):
            continue
        voltage = message.get("v")
        details = (f"battery at {voltage:.1f} V",) if isinstance(voltage, float | int) else ()
        return FoundDevice("board", "waveshare_ugv", UGV.title, UGV.baud, details)
    return None


def recognise_create(data: bytes) -> FoundDevice | None:
    """Find frames of a Create's stream."""
    frames, _ = FrameReader(FRAME, _ignore).feed(data)
    if len(frames) < ENOUGH:
        return None
    senses = parse_frame(frames[-1].data)
    details = (f"battery at {senses.millivolts * 1e-3:.1f} V",)
    problems = ("It is being charged, and does not drive meanwhile.",) if senses.is_charged else ()
    return FoundDevice("board", "create2", CREATE.title, CREATE.baud, details, problems)


def recognise_linorobot2(data: bytes, baud: int) -> FoundDevice | None:
    """Find a ping of a board that looks for an agent, or that it talks to one that has gone."""
    messages = [frame.message for frame in FrameDecoder(_ignore).feed(data)]
    num_pings = sum(map(_is_ping, messages))
    if not num_pings and len(messages) < ENOUGH:
        return None
    details, problems = ("looks for an agent",), ()
    if not num_pings:
        details, problems = (
            ("talks to an agent",),
            (
                "It talks to an agent that has gone, and may be one that never looks for another: "
                "restart it if it is not driven.",
            ),
        )
    return FoundDevice("board", "linorobot2", LINOROBOT2.title, baud, details, problems)


def _is_ping(message: bytes) -> bool:
    parsed = parse_header(message)
    if parsed is None or parsed[0].session & ~KEYLESS:
        return False
    return any(part.kind == GET_INFO for part in submessages(message, parsed[1]))


def recognise_talking(data: bytes, baud: int) -> FoundDevice | None:
    """Find feedback of a hoverboard, or a linorobot2, which both talk unasked."""
    if baud in LINOROBOT2_BAUDS and (found := recognise_linorobot2(data, baud)):
        return found
    if baud != HOVERBOARD.baud:
        return None
    frames, _ = FrameReader(hoverboard.FRAME, _ignore).feed(data)
    if len(frames) < ENOUGH_UNASKED:
        return None
    told = hoverboard.parse_feedback(frames[-1].data)
    details = (f"battery at {told.centivolts * 1e-2:.1f} V",)
    return FoundDevice("board", "hoverboard", HOVERBOARD.title, HOVERBOARD.baud, details)


def _ignore(_name: str, _number: int) -> None:
    """Count nothing: what is not a frame is some other device's."""


BOARD_QUESTIONS = (
    *(
        BoardQuestion(baud, (), partial(recognise_linorobot2, baud=baud), wait_s=PING_S)
        for baud in LINOROBOT2_BAUDS
    ),
    BoardQuestion(UGV.baud, (b'\n{"T":130}\n',), recognise_ugv),
    BoardQuestion(CREATE.baud, (bytes((START,)), ASK_STREAM), recognise_create, PAUSE_STREAM + END),
)
