"""The form of state files: readable TOML that says which schema it has.

A file of today's schema is read; one of an older schema is upgraded step by step. A file that is
empty, of another kind, or written by a newer Trolley is `Unreadable`: a program that took it for an
empty list would overwrite it with one.
"""

import stat
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, ClassVar, NamedTuple, Protocol, TypeVar, cast

import msgspec
import tomli_w
from msgspec import Struct

from trolley.files import BROKEN, NEWER, keep_aside, read_file, write_atomically

S = TypeVar("S", bound=Struct)

_SCHEMA = "schema"
_FIRST = 1
"""Also of the files that do not say theirs: what Trolley wrote before they did."""


class Unreadable(ValueError):
    """A state file cannot be used; the text says why."""


class Newer(Unreadable):
    """A state file was written by a newer Trolley."""


class Changed(Protocol):
    """What the struct of a state file has once its form was changed for the first time.

    Whoever changes what a file may hold, if only by a field, counts `SCHEMA` up and writes a step,
    since an older Trolley would lose what it does not know.
    """

    SCHEMA: ClassVar[int]
    """Schema of the files that are written; a struct without it is of schema 1."""

    @classmethod
    def bring_forward(cls, plain: dict[str, Any], schema: int) -> dict[str, Any]:
        """Return the content of a file of `schema` as that of the next schema."""
        ...


def schema_of(kind: type[Struct]) -> int:
    """The schema in which files of this kind are written."""
    return getattr(kind, "SCHEMA", _FIRST)


class Read(NamedTuple):
    """What a state file held."""

    value: Any
    schema: int
    """Schema of the file, before it was brought forward."""


def parse(content: bytes, kind: type[S]) -> S:
    """The content of a state file.

    Raises:
        Unreadable: It is broken, empty or of something else; `Newer`: of a newer Trolley.
    """
    return cast("S", parse_any_schema(content, kind).value)


def parse_any_schema(content: bytes, kind: type[Struct]) -> Read:
    """The content of a state file, and which schema it was in.

    Raises:
        Unreadable: As `parse` does.
    """
    try:
        plain: dict[str, Any] = tomllib.loads(content.decode("utf-8-sig"))
    except (ValueError, RecursionError) as error:
        raise Unreadable(str(error) or type(error).__name__) from error
    schema = _take_schema(plain, kind)
    for step in range(schema, schema_of(kind)):
        plain = cast("Changed", kind).bring_forward(plain, step)
    foreign = sorted(plain.keys() - set(kind.__struct_fields__))
    if foreign:
        raise Unreadable(f"it holds {', '.join(map(repr, foreign[:3]))}, which is not of this file")
    if not plain:
        raise Unreadable("it is empty")
    try:
        return Read(msgspec.convert(plain, type=kind), schema)
    except (ValueError, msgspec.ValidationError, RecursionError) as error:
        raise Unreadable(str(error)) from error


class _Said(Struct):
    schema: Annotated[int, msgspec.Meta(ge=1)] = _FIRST


def parse_encoded(content: bytes, kind: type[S], decode: Callable[..., Any]) -> S:
    """The content of a state file in JSON or msgpack, as `parse_encoded_any_schema`."""
    return cast("S", parse_encoded_any_schema(content, kind, decode).value)


def parse_encoded_any_schema(
    content: bytes, kind: type[Struct], decode: Callable[..., Any]
) -> Read:
    """The content of a state file in JSON or msgpack, and which schema it was in.

    Its struct has a field `schema`, which a file of the first schema may lack.

    Args:
        content: of the file.
        kind: what it should hold; the default of its field `schema` is the one that is known.
        decode: `msgspec.json.decode` or `msgspec.msgpack.decode`.

    Raises:
        Unreadable: As `parse` does.
    """
    fields = {field.name: field for field in msgspec.structs.fields(kind)}
    try:
        schema, known = decode(content, type=_Said).schema, fields[_SCHEMA].default
        _refuse_newer(schema, known)
        value = decode(content, type=kind)
        return Read(msgspec.structs.replace(value, **{_SCHEMA: known}), schema)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        raise Unreadable(str(error) if content else "it is empty") from error


def reason_of(why: Exception) -> str:
    """Why a state file cannot be used, for a sentence: of an `OSError` without file and number."""
    return str((isinstance(why, OSError) and why.strerror) or why)


def keep_unreadable(path: Path, why: Exception) -> Path:
    """Rename a state file that cannot be read; its name says so, or that it is a newer Trolley's.

    Raises:
        OSError: It cannot be renamed.
    """
    return keep_aside(path, NEWER if isinstance(why, Newer) else BROKEN)


def read_encoded(path: Path, kind: type[S], decode: Callable[..., Any]) -> S:
    """Read a state file in JSON or msgpack; of one of an older schema keep the original beside it.

    Raises:
        FileNotFoundError: There is none.
        OSError: It cannot be read, or its original not be kept.
        Unreadable: As `parse` does.
    """
    content = read_file(path)
    found = parse_encoded_any_schema(content, kind, decode)
    if found.schema < found.value.schema:
        keep_original(path, content, found.schema)
    return cast("S", found.value)


def keep_original(path: Path, content: bytes, schema: int) -> Path:
    """Keep a file of an older schema beside the one that will take its place.

    Raises:
        OSError: It cannot be written.
    """
    original = path.with_name(f"{path.name}.schema-{schema}")
    write_atomically(original, content, stat.S_IMODE(path.stat().st_mode))
    return original


def render(value: Struct) -> bytes:
    """A state file with this content; fields that are None are left out.

    A struct's `NOTE` stands at the top, as a comment for people who open the file.
    """
    plain = _without_none(msgspec.to_builtins(value))
    note: str = getattr(type(value), "NOTE", "")
    return (note + tomli_w.dumps({_SCHEMA: schema_of(type(value)), **plain})).encode()


def _take_schema(plain: dict[str, Any], kind: type[Struct]) -> int:
    schema = plain.pop(_SCHEMA, _FIRST)
    if type(schema) is not int or schema < 1:
        raise Unreadable(f"its schema {schema!r:.20} is not one that Trolley has used")
    _refuse_newer(schema, schema_of(kind))
    return schema


def _refuse_newer(schema: int, known: int) -> None:
    if schema > known:
        raise Newer(f"it was written by a newer Trolley (schema {schema}; this one knows {known})")


def _without_none(item: Any) -> Any:
    """TOML has no null: drop such entries at any depth."""
    if isinstance(item, dict):
        entries = cast("dict[str, Any]", item)
        return {name: _without_none(value) for name, value in entries.items() if value is not None}
    if isinstance(item, list | tuple):  # pyrefly: ignore[implicit-any-type-argument]
        return [_without_none(value) for value in cast("list[Any]", item)]
    return item
