"""Collecting the replies to a get, whose callbacks come on any thread."""

from collections.abc import Callable
from typing import Any

from trolley import codes
from trolley.codes import Refused
from trolley.messages import ErrorReply
from trolley.requests import Request
from trolley.runtime import codec
from trolley.runtime.bus import Reply
from trolley.runtime.inbox import Inbox


class Gathering:
    """Hands the replies to `finish` once, on the service's thread: all are in, or time is up."""

    def __init__(self, inbox: Inbox, finish: Callable[[list[Reply], bool], None]) -> None:
        self._inbox = inbox
        self._finish: Callable[[list[Reply], bool], None] | None = finish
        self._replies: list[Reply] = []

    def add(self, reply: Reply) -> None:
        """Take a reply (any thread)."""
        self._replies.append(reply)

    def done(self) -> None:
        """The last reply is in (any thread)."""
        self._inbox.push(lambda _: self.end(timed_out=False), own=True)

    def end(self, *, timed_out: bool) -> None:
        """Hand over what is in (the service's thread); later calls do nothing."""
        finish, self._finish = self._finish, None
        if finish is not None:
            finish(list(self._replies), timed_out)


def outcome(request: Request[Any, Any], replies: list[Reply], timed_out: bool) -> object:
    """What a request came to: the decoded reply, or a `Refused`."""
    if not replies:
        code = codes.TIMEOUT if timed_out else codes.NOT_READY
        why = (
            "did not answer in time"
            if timed_out
            else "is not running, or this connection may not ask it"
        )
        return Refused(code, f"{request.name}: {request.owner} {why}.", service=request.owner)
    reply = replies[0]
    try:
        if not reply.is_error:
            return codec.decode(request.reply, reply.payload, reply.encoding)
        error = codec.decode(ErrorReply, reply.payload, reply.encoding)
    except codec.BadPayload as problem:
        if reply.is_error:  # Zenoh's own error, which it sends at the deadline
            return Refused(
                codes.TIMEOUT, f"{request.name}: {request.owner} did not answer in time."
            )
        return Refused(codes.INTERNAL, f"{request.name}: the reply is not understood: {problem}")
    return Refused(error.code, error.message, **error.details)
