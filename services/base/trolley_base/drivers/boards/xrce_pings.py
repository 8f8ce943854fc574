"""Answers a board's pings at once, on the thread that reads its port.

A micro-ROS board waits for 0.1 s or less, and then lets its motors be as they are; base's own
thread may come round later than that on a busy computer.
"""

from trolley_base.drivers.boards import xrce_messages as xrce
from trolley_base.drivers.boards.xrce_frames import FrameDecoder, encode
from trolley_base.drivers.boards.xrce_messages import Header


class PingResponder:
    """Looks for pings in what arrives; its two switches are set by the dialogue's thread.

    Attributes:
        has_session: the board has a session here, which it is told.
        is_silent: pings are not answered, so that the board gives up a session with another agent.
    """

    def __init__(self) -> None:
        self.has_session = False
        self.is_silent = False
        self._decoder = FrameDecoder(_ignore)

    def respond(self, data: bytes) -> bytes:
        """Take bytes; return what is to be answered now."""
        answers: list[bytes] = []
        for frame in self._decoder.feed(data):
            parsed = xrce.parse_header(frame.message)
            if parsed is None:
                continue
            header, at = parsed
            for part in xrce.submessages(frame.message, at):
                if part.kind == xrce.GET_INFO and len(part.payload) >= 4:
                    answers.append(encode(self._answer(header, part.payload), frame.source))
        return b"" if self.is_silent else b"".join(answers)

    def _answer(self, header: Header, asked: bytes) -> bytes:
        """Answer in the session in which it was asked."""
        answer = xrce.info(asked[:4], has_session=self.has_session)
        return Header(header.session, xrce.NO_STREAM, 0, header.key).encode() + answer


def _ignore(_name: str, _number: int) -> None:
    """Count nothing: the dialogue counts the same bytes."""
