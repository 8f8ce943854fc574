"""What a runtime's transport offers: put, delete, subscribe, serve, get (Zenoh, or memory)."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Protocol

import msgspec

from trolley.topics import Qos


class Sample(msgspec.Struct, frozen=True):
    """Something that arrived: a put, or a delete without payload."""

    key: str
    payload: bytes
    encoding: str
    is_delete: bool = False


@dataclasses.dataclass(frozen=True, slots=True)
class Reply:
    """One answer to a get; `is_error` marks an `ErrorReply`."""

    key: str
    payload: bytes
    encoding: str
    is_error: bool = False


class Query(Protocol):
    """A get that waits for answers until `finish` is called or the last reference to it goes."""

    @property
    def key(self) -> str:
        """The key expression asked for."""
        ...

    @property
    def parameters(self) -> str:
        """The selector's parameters, raw."""
        ...

    @property
    def payload(self) -> bytes:
        """The payload, empty if none."""
        ...

    @property
    def encoding(self) -> str:
        """The payload's encoding."""
        ...

    def reply(self, key: str, payload: bytes, encoding: str) -> None:
        """Send one answer."""
        ...

    def refuse(self, payload: bytes, encoding: str) -> None:
        """Send an error reply."""
        ...

    def finish(self) -> None:
        """Say that no more answers follow."""
        ...


class Closer(Protocol):
    """Something declared on the bus that can be taken back."""

    def close(self) -> None:
        """Take it back."""
        ...


class Newest(Protocol):
    """The newest message of a key, without those before it."""

    def take(self) -> bytes | None:
        """Return what was put since the last call, None if nothing was; b"" for a deletion."""
        ...

    def close(self) -> None:
        """Stop listening."""
        ...


class Bus(Protocol):
    """A transport. Callbacks may come on any thread and must only store and wake."""

    def put(self, key: str, payload: bytes, encoding: str, qos: Qos) -> None:
        """Publish."""
        ...

    def is_heard(self, key: str, encoding: str) -> bool:
        """Whether anybody may hear a sensor stream that is put to this key."""
        ...

    def delete(self, key: str) -> None:
        """Publish a deletion."""
        ...

    def subscribe(self, key_expr: str, callback: Callable[[Sample], None]) -> Closer:
        """Call back for each put and delete that matches."""
        ...

    def newest(self, key: str) -> Newest:
        """Keep the newest of what anybody puts to a key, one's own puts too."""
        ...

    def serve(self, key_expr: str, callback: Callable[[Query], None]) -> Closer:
        """Call back for each get that matches."""
        ...

    def get(
        self,
        selector: str,
        payload: bytes,
        encoding: str,
        timeout_s: float,
        on_reply: Callable[[Reply], None],
        on_done: Callable[[], None],
    ) -> None:
        """Ask everybody who serves the key; `on_done` comes once, after the last reply."""
        ...


def has_wildcard(key: str) -> bool:
    """Whether a key expression names more than one key."""
    return "*" in key


def matches(key_expr: str, other: str) -> bool:
    """Whether two key expressions have a key in common.

    `*` stands for one chunk, `**` for any number, neither for a chunk that begins with `@`; `$*`
    for any characters inside a chunk.
    """
    if key_expr == other:
        return True
    return _meet(key_expr.split("/"), other.split("/"), "**", _chunks_meet, _is_plain)


def _meet(
    one: Sequence[str],
    other: Sequence[str],
    star: str,
    items_meet: Callable[[str, str], bool],
    may_be_any: Callable[[str], bool],
) -> bool:
    """Whether two sequences, in which `star` is any number of items, can be the same.

    Dynamic programming over all pairs of prefixes, since a stranger's key may hold many stars.
    """
    row = [True]
    for item in other:
        row.append(row[-1] and item == star)
    for mine in one:
        below = [row[0] and mine == star]
        for j, item in enumerate(other):
            if mine == star:
                can = row[j + 1] or (below[j] and may_be_any(item))
            elif item == star:
                can = below[j] or (row[j + 1] and may_be_any(mine))
            else:
                can = row[j] and items_meet(mine, item)
            below.append(can or (item == star and mine == star and (below[j] or row[j])))
        row = below
    return row[-1]


def _is_plain(chunk: str) -> bool:
    return not chunk.startswith("@")


def _chunks_meet(one: str, other: str) -> bool:
    if one == other:
        return True
    if one.startswith("@") or other.startswith("@"):
        return False
    if one == "*" or other == "*":
        return True
    if "$*" not in one and "$*" not in other:
        return False
    return _meet(_characters(one), _characters(other), "$*", str.__eq__, bool)


def _characters(chunk: str) -> list[str]:
    """The characters of a chunk, `$*` as one."""
    return [c for i, part in enumerate(chunk.split("$*")) for c in (["$*"] * (i > 0) + list(part))]
