"""Messages about the services themselves, and the error reply."""

from typing import Any, Literal

from msgspec import Struct

from trolley.messages.types import Count, NonNegative, StampNs


class Health(Struct, frozen=True, kw_only=True):
    """How a service is, at 1 Hz on the local clock. `cpu` is the share of one core, `rss` bytes."""

    stamp_ns: StampNs
    state: Literal["starting", "ok", "degraded", "failed"]
    message: str = ""
    counters: dict[str, Count] = {}
    cpu: NonNegative = 0.0
    rss: Count = 0


class Alive(Struct, frozen=True, kw_only=True):
    """The liveliness token `alive/<service>/<run>`: no payload, only a place in the table."""


class ErrorReply(Struct, frozen=True, kw_only=True):
    """A refusal: a stable code, one sentence for a person, and details for a program."""

    code: str
    message: str
    details: dict[str, Any] = {}
