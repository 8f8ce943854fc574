"""What a runtime's transport offers: put, delete, subscribe, serve, get (Zenoh, or memory)."""

import dataclasses
from collections.abc import Callable
from typing import Protocol

from trolley.topics import Qos


@dataclasses.dataclass(frozen=True, slots=True)
class Sample:
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


class Bus(Protocol):
    """A transport. Callbacks may come on any thread and must only store and wake."""

    def put(self, key: str, payload: bytes, encoding: str, qos: Qos) -> None:
        """Publish."""
        ...

    def delete(self, key: str) -> None:
        """Publish a deletion."""
        ...

    def subscribe(self, key_expr: str, callback: Callable[[Sample], None]) -> Closer:
        """Call back for each put and delete that matches."""
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

    `*` stands for one chunk, `**` for any number, neither for a chunk that begins with `@`.
    """
    return _meet(tuple(key_expr.split("/")), tuple(other.split("/")))


def _meet(one: tuple[str, ...], other: tuple[str, ...]) -> bool:
    if not one or not other:
        return all(chunk == "**" for chunk in one + other)
    if other[0] == "**":
        one, other = other, one
    if one[0] == "**":
        return _meet(one[1:], other) or (not other[0].startswith("@") and _meet(one, other[1:]))
    return _chunks_meet(one[0], other[0]) and _meet(one[1:], other[1:])


def _chunks_meet(one: str, other: str) -> bool:
    if one == other:
        return True
    if one.startswith("@") or other.startswith("@"):
        return False
    if one == "*" or other == "*":
        return True
    if "$*" in other:
        one, other = other, one
    return "$*" in one and _match_inside(one.split("$*"), other)


def _match_inside(pieces: list[str], chunk: str) -> bool:
    """Match `a$*b`: pieces in order, the first at the start of the chunk, the last at its end."""
    if not chunk.startswith(pieces[0]):
        return False
    at = len(pieces[0])
    for piece in pieces[1:-1]:
        found = chunk.find(piece, at)
        if found < 0:
            return False
        at = found + len(piece)
    return chunk.endswith(pieces[-1]) and len(chunk) - len(pieces[-1]) >= at
