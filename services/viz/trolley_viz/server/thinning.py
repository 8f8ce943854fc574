"""Thinning what viser sends to a page whose connection is slow.

viser sends all pages the same: positions of the robot, which are small and should be new, and scans
and particles, which are large. On a connection that is slower than that, of each node of the scene
the newest state only is sent: small ones first, and of the large ones one at a time.
"""

import copy
from dataclasses import dataclass, field
from typing import Any, cast

import msgspec
import zstandard

UPDATE, REMOVAL = "SceneNodeUpdateMessage", "RemoveSceneNodeMessage"
MOVES = ("SetPositionMessage", "SetOrientationMessage", "SetSceneNodeVisibilityMessage")
"""What replaces what was said before of the same node."""
LARGE_BYTES = 1500
"""More than goes in one packet."""
ALIGNMENT = 8
MAX_REST_BYTES = 1 << 20
"""What must not be left out (new nodes, say) waits in viser when there is more of it."""


@dataclass
class Part:
    """One message of viser's, with the arrays that it refers to."""

    message: dict[str, Any]
    arrays: list[bytes]

    @property
    def size(self) -> int:
        """About how large it is [B]."""
        return 150 + sum(map(len, self.arrays))


Changes = dict[tuple[str, ...], Part]
"""The newest of each kind of change of one node, by what of it is changed."""


class OtherFormat(Exception):
    """This is not as viser's pinned version sends it."""


@dataclass
class Thinner:
    """The messages that wait for one slow page; what a newer one replaces is dropped."""

    rest: list[Part] = field(default_factory=list[Part])
    """What is sent in order, all of it."""
    moves: dict[tuple[str, str], Part] = field(default_factory=dict[tuple[str, str], Part])
    """By kind and node: the newest."""
    updates: dict[str, Changes] = field(default_factory=dict[str, Changes])
    """By node and by what of it is changed: the newest."""
    timestamp: float = 0.0
    """When the newest was sent, by viser's clock [s]."""

    @property
    def is_empty(self) -> bool:
        """Whether nothing waits."""
        return not (self.rest or self.moves or self.updates)

    @property
    def is_full(self) -> bool:
        """Whether more waits than is good that may not be left out."""
        return sum(part.size for part in self.rest) > MAX_REST_BYTES

    def take(self, data: bytes) -> None:
        """Take in what viser sent: the newest replaces what was said of the same node.

        Raises:
            OtherFormat: It is not as viser's pinned version sends it.
        """
        self.timestamp, parts = unpacked(data)
        for part in parts:
            message = part.message
            kind, node = message["type"], message.get("name")
            if kind == UPDATE and isinstance(node, str):
                changed = tuple(sorted(message["updates"]))
                self.updates.setdefault(node, {})[changed] = part
            elif kind in MOVES and isinstance(node, str):
                self.moves[kind, node] = part
            else:
                if isinstance(node, str) and ("props" in message or kind == REMOVAL):
                    self._forget(node, below=kind == REMOVAL)
                self.rest.append(part)

    def small(self) -> bytes | None:
        """Return what has to be sent before all else, None for nothing."""
        nodes = [node for node, parts in self.updates.items() if _size(parts) <= LARGE_BYTES]
        parts = [*self.rest, *self.moves.values()]
        for node in nodes:
            parts += self.updates.pop(node).values()
        self.rest, self.moves = [], {}
        return packed(parts, self.timestamp) if parts else None

    def large(self) -> bytes | None:
        """Return the large update that has waited longest, None for none."""
        if not self.updates:
            return None
        node = next(iter(self.updates))
        return packed([*self.updates.pop(node).values()], self.timestamp)

    @property
    def large_size(self) -> int:
        """About how large that is [B]."""
        return _size(next(iter(self.updates.values()))) if self.updates else 0

    def _forget(self, node: str, *, below: bool) -> None:
        """Leave out what was said of a node, and of those below: they stay if it is made anew."""

        def goes(one: str) -> bool:
            return one == node or (below and one.startswith(f"{node}/"))

        self.updates = {one: parts for one, parts in self.updates.items() if not goes(one)}
        self.moves = {key: part for key, part in self.moves.items() if not goes(key[1])}


def unpacked(data: bytes) -> tuple[float, list[Part]]:
    """Take apart what viser sends at once: when, by its clock [s], and what.

    Raises:
        OtherFormat: It is not as viser's pinned version sends it.
    """
    try:
        size, length = (int.from_bytes(data[i : i + 8], "little") for i in (0, 8))
        inner = zstandard.ZstdDecompressor().decompress(
            data[16 : 16 + length], max_output_size=size
        )
        batch = msgspec.msgpack.decode(inner)
        arrays: list[bytes] = []
        at = 16 + length
        for num_bytes in batch["binaryBufferLengths"]:
            at += -at % ALIGNMENT
            arrays.append(data[at : at + num_bytes])
            at += num_bytes
        if at > len(data):
            raise OtherFormat("an array is cut off")
        return float(batch["timestampSec"]), [
            _part(message, arrays) for message in batch["messages"]
        ]
    except (
        zstandard.ZstdError,
        msgspec.MsgspecError,
        LookupError,
        TypeError,
        OverflowError,
    ) as problem:
        raise OtherFormat(str(problem)) from problem


def packed(parts: list[Part], timestamp: float) -> bytes:
    """Put messages together as viser sends them."""
    messages: list[Any] = []
    arrays: list[bytes] = []
    for part in parts:
        message = copy.deepcopy(part.message)
        for place in _places(message):
            place["__binary_index"] += len(arrays)
        messages.append(message)
        arrays += part.arrays
    inner = msgspec.msgpack.encode(
        {
            "messages": messages,
            "timestampSec": timestamp,
            "binaryBufferLengths": [len(array) for array in arrays],
        }
    )
    head = zstandard.ZstdCompressor(level=1).compress(inner)
    data = bytearray(len(inner).to_bytes(8, "little") + len(head).to_bytes(8, "little") + head)
    for array in arrays:
        data += bytes(-len(data) % ALIGNMENT)
        data += array
    return bytes(data)


def _part(message: dict[str, Any], arrays: list[bytes]) -> Part:
    """A message with its own arrays, numbered from 0."""
    own: list[bytes] = []
    for place in _places(message):
        own.append(arrays[int(place["__binary_index"])])
        place["__binary_index"] = len(own) - 1
    return Part(message, own)


def _places(value: Any) -> list[dict[str, Any]]:
    """All places in a message where an array is meant."""
    if isinstance(value, dict):
        inside = cast("dict[str, Any]", value)
        if "__binary_index" in inside:
            return [inside]
        return [place for one in inside.values() for place in _places(one)]
    if isinstance(value, list):
        return [place for one in cast("list[Any]", value) for place in _places(one)]
    return []


def _size(parts: Changes) -> int:
    return sum(part.size for part in parts.values())
