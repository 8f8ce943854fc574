"""Messages about what has appeared or disappeared since a map was made."""

from typing import Annotated, Literal

from msgspec import Meta, Struct

from trolley.messages.types import NonNegative, Point, Positive, Share, StampNs

ChangeKind = Literal["appeared", "gone"]
Stroke = tuple[Point, Point]


class MapChange(Struct, frozen=True, kw_only=True):
    """A difference from the map: something that has `appeared`, or that is `gone`.

    `points` [[x, y]] is its convex outline in `map` [m], for display. `strokes`, `width` [m] wide,
    cover it exactly if drawn or erased on the map. It was first seen `seconds` of observed time
    ago; `score` is how certain it is.
    """

    id: str
    kind: ChangeKind
    points: Annotated[list[Point], Meta(min_length=1)]
    strokes: Annotated[list[Stroke], Meta(max_length=1000)]
    width: Positive
    seconds: NonNegative
    score: Share
    message: str = ""


class MapChanges(Struct, frozen=True, kw_only=True):
    """What the localizer proposes to change on `map`. Owned by `localizer`, on change.

    Always empty unless `[localizer] propose_changes` allows it.
    """

    stamp_ns: StampNs
    map: str
    changes: list[MapChange]
