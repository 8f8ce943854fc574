"""What a slow page is sent: less, but in the end the same picture."""

from typing import Any

import msgspec
import numpy as np
import pytest
import zstandard
from hypothesis import given
from hypothesis import strategies as st

from trolley_viz.server.sending import Room
from trolley_viz.server.thinning import LARGE_BYTES, OtherFormat, Thinner, packed, unpacked

NODES = ("/a", "/a/b", "/a/b/c", "/d")
Scene = dict[str, dict[str, Any]]


def batch(*messages: dict[str, Any]) -> bytes:
    """As viser sends messages: arrays stand behind, aligned, and are referred to by number."""
    arrays: list[bytes] = []

    def refer(value: Any) -> Any:
        if isinstance(value, np.ndarray):
            arrays.append(value.tobytes())
            return {"__binary_index": len(arrays) - 1, "dtype": str(value.dtype)}
        if isinstance(value, dict):
            return {key: refer(one) for key, one in value.items()}
        return value

    told = [refer(message) for message in messages]
    inner = msgspec.msgpack.encode(
        {
            "messages": told,
            "timestampSec": 1.5,
            "binaryBufferLengths": [len(array) for array in arrays],
        }
    )
    head = zstandard.ZstdCompressor().compress(inner)
    data = len(inner).to_bytes(8, "little") + len(head).to_bytes(8, "little") + head
    for array in arrays:
        data += bytes(-len(data) % 8) + array
    return data


def apply(scene: Scene, data: bytes) -> None:
    """Do to a scene what the page does."""
    for part in unpacked(data)[1]:
        message, name = part.message, part.message["name"]
        match message["type"]:
            case "RemoveSceneNodeMessage":
                for one in [one for one in scene if one == name or one.startswith(f"{name}/")]:
                    del scene[one]
            case "SceneNodeUpdateMessage":
                if name in scene:
                    for key in message["updates"]:
                        scene[name][key] = part.arrays or message["updates"][key]
            case "SetPositionMessage":
                if name in scene:
                    scene[name]["position"] = message["position"]
            case _:
                scene[name] = {"made": part.arrays or message["props"]}


def made(name: str, value: int) -> dict[str, Any]:
    return {"type": "PointCloudMessage", "name": name, "props": {"value": value}}


def moved(name: str, value: int) -> dict[str, Any]:
    return {"type": "SetPositionMessage", "name": name, "position": [value, 0, 0]}


def updated(name: str, key: str, value: int, size: int) -> dict[str, Any]:
    points = np.full(size, value, np.float32)
    return {"type": "SceneNodeUpdateMessage", "name": name, "updates": {key: points}}


def removed(name: str) -> dict[str, Any]:
    return {"type": "RemoveSceneNodeMessage", "name": name}


NAMES, VALUES = st.sampled_from(NODES), st.integers(0, 100)
MESSAGES = st.one_of(
    st.builds(made, NAMES, VALUES),
    st.builds(moved, NAMES, VALUES),
    st.builds(
        updated, NAMES, st.sampled_from(["points", "colors"]), VALUES, st.sampled_from([3, 600])
    ),
    st.builds(removed, NAMES),
)


@given(st.lists(st.tuples(st.lists(MESSAGES, max_size=5), st.sampled_from(["", "small", "large"]))))
def test_in_the_end_the_picture_is_the_same(
    steps: list[tuple[list[dict[str, Any]], str]],
) -> None:
    all_of_it: Scene = {}
    thinned: Scene = {}
    thinner = Thinner()
    for messages, sent in steps:
        data = batch(*messages)
        apply(all_of_it, data)
        thinner.take(data)
        if sent == "small" or sent == "large":
            small = thinner.small()
            if small is not None:
                apply(thinned, small)
        if sent == "large":
            large = thinner.large()
            if large is not None:
                apply(thinned, large)
    while not thinner.is_empty:
        for data in (thinner.small(), thinner.large()):
            if data is not None:
                apply(thinned, data)
    assert thinned == all_of_it


def test_only_the_newest_of_what_is_large_waits_and_what_is_small_goes_first() -> None:
    thinner = Thinner()
    thinner.take(batch(made("/scan", 0), made("/robot", 0)))
    thinner.small()
    for i in range(50):
        thinner.take(batch(updated("/scan", "points", i, 1000), moved("/robot", i)))
    small = thinner.small()
    assert small is not None
    assert [part.message["type"] for part in unpacked(small)[1]] == ["SetPositionMessage"]
    assert len(small) < LARGE_BYTES
    assert thinner.large_size > 4000
    large = thinner.large()
    assert large is not None
    (part,) = unpacked(large)[1]
    assert np.frombuffer(part.arrays[0], np.float32).tolist() == [49.0] * 1000
    assert thinner.is_empty


def test_large_ones_take_turns() -> None:
    thinner = Thinner()
    seen = []
    for i in range(6):
        thinner.take(
            batch(updated("/scan", "points", i, 1000), updated("/particles", "points", i, 1000))
        )
        large = thinner.large()
        assert large is not None
        seen.append(unpacked(large)[1][0].message["name"])
    assert set(seen[:2]) == {"/scan", "/particles"}
    assert seen[::2] == seen[:1] * 3


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\0" * 40,
        b"\xff" * 100,
        batch(made("/a", 0))[:-3],
        batch(updated("/a", "points", 1, 9))[:-1],
    ],
)
def test_what_is_not_as_viser_sends_it_is_said_to_be_so(data: bytes) -> None:
    with pytest.raises(OtherFormat):
        unpacked(data)


def test_a_batch_is_packed_as_it_was() -> None:
    data = batch(updated("/a", "points", 3, 7), made("/b", 1), updated("/c", "colors", 4, 11))
    timestamp, parts = unpacked(data)
    again = unpacked(packed(parts, timestamp))
    assert again == (timestamp, parts)


@pytest.mark.parametrize(
    ("waiting", "rate", "size", "small", "takes"),
    [
        (0, 0.0, 10, 0, False),
        (3000, 50_000.0, 4000, 0, True),
        (3000, 50_000.0, 5000, 0, False),
        (3000, 0.0, 900, 4000, True),
        (3000, 0.0, 1100, 4000, False),
    ],
)
def test_there_is_room_for_what_arrives_soon(
    waiting: int, rate: float, size: int, small: int, *, takes: bool
) -> None:
    assert Room(waiting, rate).takes(size, small) == takes
