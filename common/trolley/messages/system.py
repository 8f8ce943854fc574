"""Messages about the services themselves, and the error reply."""

from typing import Any, Literal

from msgspec import Struct

from trolley.geometry import Finite
from trolley.messages.types import Count, NonNegative, StampNs


class Health(Struct, frozen=True, kw_only=True):
    """How a service is, at 1 Hz on the local clock. `cpu` is the share of one core, `rss` bytes.

    `run` is that of the process, as in its token `alive/<service>/<run>`: of two processes of one
    name the later ends only if the earlier one answers for its token here.

    `counters` only grow; `figures` are what the service measures of itself now: of `base` which
    share of its beams the lidar sees by (`lidar/seen`), and on each side (`lidar/seen/rear_left`).
    """

    stamp_ns: StampNs
    state: Literal["starting", "ok", "degraded", "failed"]
    message: str = ""
    counters: dict[str, Count] = {}
    cpu: NonNegative = 0.0
    rss: Count = 0
    run: str = ""
    figures: dict[str, Finite] = {}


class Alive(Struct, frozen=True, kw_only=True):
    """The liveliness token `alive/<service>/<run>`: no payload, only a place in the table."""


class ErrorReply(Struct, frozen=True, kw_only=True):
    """A refusal: a stable code, one sentence for a person, and details for a program."""

    code: str
    message: str
    details: dict[str, Any] = {}
