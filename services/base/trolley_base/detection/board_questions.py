"""Questions to boards that are told by one answer at their own speed, and harm nobody else.

They are asked before the lidars of 115200 baud: none of them holds an A5, with which all that those
lidars are told begins.

- Waveshare's JSON boards: an empty line ends what other questions have left in the buffer.
"""

from collections.abc import Callable
from dataclasses import dataclass

from trolley_base.detection.results import FoundDevice
from trolley_base.drivers.boards import BOARDS
from trolley_base.drivers.boards.waveshare_ugv import REPORT, SPEED_KEYS, numbers_of, parse_line

UGV = BOARDS["waveshare_ugv"]


@dataclass(frozen=True, slots=True)
class BoardQuestion:
    """How a board is told.

    Attributes:
        baud: at which speed it is asked [bits/s].
        ask: the question.
        recognise: finds the answer in what has arrived; None while it is not there.
        leave: what is sent once it has answered, so that it is as it was before; b"" for nothing.
    """

    baud: int
    ask: bytes
    recognise: Callable[[bytes], FoundDevice | None]
    leave: bytes = b""


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


QUESTIONS = (BoardQuestion(UGV.baud, b'\n{"T":130}\n', recognise_ugv),)
