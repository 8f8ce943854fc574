"""The suspected mirrors that somebody has dismissed."""

from msgspec import Struct

from trolley.messages.types import Point


class Dismissed(Struct, frozen=True, kw_only=True):
    """A suspected mirror that somebody has dismissed."""

    map: str
    points: list[Point]
