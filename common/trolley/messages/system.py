"""Messages about the services themselves, and the error reply."""

from typing import Any, Literal

from msgspec import Struct

from trolley.geometry import Finite
from trolley.messages.types import Count, NonNegative, StampNs


class Health(Struct, frozen=True, kw_only=True):
    """The health of a service, at 1 Hz by the local clock.

    `cpu` is its share of one core, `rss` its memory in bytes, `up` how long it has been
    running [s], null if it does not tell.

    `run` identifies the process, as in its token `alive/<service>/<run>`: of two processes of one
    name, the later one exits only if the earlier one answers here for its token.

    `counters` only grow. `figures` are what the service measures about itself now: for `base`, the
    share of its beams with which the lidar sees something, in all (`lidar/seen`) and on each side
    (`lidar/seen/rear_left`).
    """

    stamp_ns: StampNs
    state: Literal["starting", "ok", "degraded", "failed"]
    message: str = ""
    counters: dict[str, Count] = {}
    cpu: NonNegative = 0.0
    rss: Count = 0
    up: NonNegative | None = None
    run: str = ""
    figures: dict[str, Finite] = {}


class Alive(Struct, frozen=True, kw_only=True):
    """The liveliness token `alive/<service>/<run>`: no payload, only a place in the table."""


class ErrorReply(Struct, frozen=True, kw_only=True):
    """A refusal: a stable code, one sentence for a person, and details for a program."""

    code: str
    message: str
    details: dict[str, Any] = {}
