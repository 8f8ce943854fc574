"""What accepting proposed changes does to a map."""

from collections.abc import Sequence

from trolley.messages.editing import MAX_OPS, DrawWall, EraseStroke, MapOp
from trolley.messages.map_changes import MapChange


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


def first_that_fit(changes: Sequence[MapChange]) -> list[MapChange]:
    """Return as many changes, from the first on, as one request can hold."""
    kept: list[MapChange] = []
    left = MAX_OPS
    for change in changes:
        left -= len(change.strokes)
        if left < 0:
            break
        kept.append(change)
    return kept
