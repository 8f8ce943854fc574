"""Bounds of what is kept in memory."""

import pytest

from trolley import codes
from trolley.codes import Refused
from trolley.messages import Marker
from trolley_tour.drawings import DrawingStore

CUBE = Marker(kind="cube")


def put(drawings: DrawingStore[Marker], marker_id: str, text: str = "", lifetime_s: float = 0.0):
    marker = Marker(kind="text", text=text)
    drawings.put(("ns", marker_id), marker, 0, lifetime_s)


def test_number_is_bounded_but_what_is_there_can_be_replaced():
    drawings: DrawingStore[Marker] = DrawingStore(max_number=2)
    put(drawings, "a")
    put(drawings, "b")
    with pytest.raises(Refused) as caught:
        put(drawings, "c")
    assert caught.value.code == codes.TOO_LARGE
    put(drawings, "a", "new")
    drawings.delete(("ns", "b"))
    put(drawings, "c")
    assert len(drawings) == 2


def test_bytes_are_bounded():
    drawings: DrawingStore[Marker] = DrawingStore(max_number=100, max_bytes=2000)
    put(drawings, "a", "x" * 1000)
    with pytest.raises(Refused):
        put(drawings, "b", "x" * 1000)
    put(drawings, "a", "x" * 1200)
    drawings.delete(("**",))
    put(drawings, "b", "x" * 1200)


def test_what_ended_makes_room():
    drawings: DrawingStore[Marker] = DrawingStore(max_number=1)
    put(drawings, "a", lifetime_s=1.0)
    drawings.put(("ns", "b"), CUBE, int(1.1e9))
    assert list(drawings.items(int(1.1e9))) == [("ns", "b")]


def test_delete_of_nothing_is_refused_unless_it_is_a_wildcard():
    drawings: DrawingStore[Marker] = DrawingStore(max_number=1)
    drawings.delete(("ns", "**"))
    for chunks in (("ns", "a"), ()):
        with pytest.raises(Refused):
            drawings.delete(chunks)
