"""Collecting the replies to a get, whose callbacks come on any thread, and reading them."""

from collections.abc import Callable
from typing import Any, TypeVar

from trolley import codes
from trolley.codes import Refused
from trolley.messages import ErrorReply
from trolley.requests import Request
from trolley.runtime import codec
from trolley.runtime.bus import Reply
from trolley.runtime.inbox import Inbox

R = TypeVar("R")


class Replies:
    """Hands replies to `on_finished` once, on the service's thread: all are in, or time is up."""

    def __init__(self, inbox: Inbox, on_finished: Callable[[list[Reply], bool], None]) -> None:
        self._inbox = inbox
        self._on_finished: Callable[[list[Reply], bool], None] | None = on_finished
        self._replies: list[Reply] = []

    def add(self, reply: Reply) -> None:
        """Add a reply (any thread)."""
        self._replies.append(reply)

    def complete(self) -> None:
        """Note that the last reply is in (any thread)."""
        self._inbox.push(lambda _: self.finish(timed_out=False), own=True)

    def finish(self, *, timed_out: bool) -> None:
        """Hand over what is in (the service's thread); later calls do nothing."""
        on_finished, self._on_finished = self._on_finished, None
        if on_finished is not None:
            on_finished(list(self._replies), timed_out)


def outcome(request: Request[Any, R], replies: list[Reply], timed_out: bool) -> R | Refused:
    """What a request came to: the decoded reply, or a `Refused`."""
    if not replies:
        code = codes.TIMEOUT if timed_out else codes.NOT_READY
        why = (
            "did not answer in time"
            if timed_out
            else "is not running, or this connection is not allowed to ask it"
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
                codes.TIMEOUT,
                f"{request.name}: {request.owner} did not answer in time.",
                service=request.owner,
            )
        return Refused(codes.INTERNAL, f"{request.name}: the reply is not understood: {problem}")
    return Refused(error.code, error.message, **error.details)
