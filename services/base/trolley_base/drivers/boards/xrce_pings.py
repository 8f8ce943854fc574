"""Answers a board's pings, and its question for the time, on the thread that reads its port.

A micro-ROS board waits for 0.1 s or less, and then lets its motors be as they are; base's own
thread may come round later than that on a busy computer. Many a sketch waits 10 ms for the time
(`rmw_uros_sync_session(10)`), and then blinks until it is restarted.
"""

from trolley_base.drivers.boards import xrce_messages as xrce
from trolley_base.drivers.boards.xrce_frames import FrameDecoder, encode
from trolley_base.drivers.boards.xrce_messages import Header, Submessage


class PingResponder:
    """Looks for both in what arrives; its two switches are set by the dialogue's thread.

    Attributes:
        has_session: the board has a session here, which it is told, and may ask for the time.
        is_silent: pings are not answered, so that the board gives up a session with another agent.
    """

    def __init__(self) -> None:
        self.has_session = False
        self.is_silent = False
        self._decoder = FrameDecoder(_ignore)

    def respond(self, data: bytes, now_ns: int) -> bytes:
        """Take bytes; return what is to be answered now [robot time]."""
        answers: list[bytes] = []
        for frame in self._decoder.feed(data):
            parsed = xrce.parse_header(frame.message)
            if parsed is None:
                continue
            header, at = parsed
            for part in xrce.submessages(frame.message, at):
                answer = self._answer(part, now_ns)
                if answer:
                    # In the session in which it was asked.
                    whole = Header(header.session, xrce.NO_STREAM, 0, header.key).encode() + answer
                    answers.append(encode(whole, frame.source))
        return b"" if self.is_silent else b"".join(answers)

    def _answer(self, part: Submessage, now_ns: int) -> bytes:
        """Return the answer to a part of a message, b"" to all but pings and times."""
        if part.kind == xrce.GET_INFO and len(part.payload) >= 4:
            return xrce.info(part.payload[:4], has_session=self.has_session)
        if part.kind == xrce.TIMESTAMP and len(part.payload) >= 8 and self.has_session:
            return xrce.timestamp_reply(part.payload, now_ns)
        return b""


def _ignore(_name: str, _number: int) -> None:
    """Count nothing: the dialogue counts the same bytes."""
