"""What accepting proposed changes does to a map."""

from collections.abc import Sequence

from trolley.messages.changing import MapChange
from trolley.messages.editing import DrawWall, EraseStroke, MapOp


def ops_of(changes: Sequence[MapChange]) -> list[MapOp]:
    """Return the operations of `map/edit` that put changes on the map.

    What is gone is erased first: where a thing was moved by less than its size, it stands partly
    where it stood.
    """
    erased: list[MapOp] = [
        EraseStroke(points=list(stroke), width=change.width)
        for change in changes
        if change.kind == "gone"
        for stroke in change.strokes
    ]
    drawn: list[MapOp] = [
        DrawWall(points=list(stroke), width=change.width)
        for change in changes
        if change.kind == "appeared"
        for stroke in change.strokes
    ]
    return erased + drawn
