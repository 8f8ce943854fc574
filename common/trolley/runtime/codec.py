"""Messages to bytes and back: msgpack or JSON, with everything that arrives validated.

Broken input of any kind (truncated, wrong type, out of range, nested too deeply) ends in
`BadPayload`.
"""

import functools
import json
import math
from typing import Any, Literal, TypeVar, cast
from urllib.parse import unquote

import msgspec

T = TypeVar("T")
Format = Literal["json", "msgpack"]

MIME: dict[Format, str] = {"json": "application/json", "msgpack": "application/msgpack"}

_MSGPACK_ENCODER = msgspec.msgpack.Encoder()
_JSON_ENCODER = msgspec.json.Encoder()
_BLANK = b" \t\r\n"
_POSE_FIELDS = ("x", "y", "yaw")


class BadPayload(ValueError):
    """Bytes that are not a valid message of the expected type; the text says what and where."""


def encode(message: Any, fmt: Format) -> bytes:
    """Encode a message."""
    return _JSON_ENCODER.encode(message) if fmt == "json" else _MSGPACK_ENCODER.encode(message)


def encode_parameters(params: msgspec.Struct) -> bytes:
    """Encode the parameters of a request as msgpack, without those that are as if left out.

    An older receiver refuses a field that it does not know, also where nothing is asked by it.
    """
    given: dict[str, Any] = {}
    for field in msgspec.structs.fields(params):
        value = getattr(params, field.name)
        is_made = field.default_factory is not msgspec.NODEFAULT
        if value != (field.default_factory() if is_made else field.default):
            given[field.encode_name] = value
    return _MSGPACK_ENCODER.encode(given)


@functools.cache
def _msgpack_decoder(kind: type[T]) -> msgspec.msgpack.Decoder[T]:
    """Return the decoder of a kind of message, of which there are as many as streams."""
    return msgspec.msgpack.Decoder(kind)


def detect_format(payload: bytes, encoding: str) -> Format:
    """Tell the format by the encoding without schema suffix, else by the first non-blank byte."""
    if encoding == MIME["msgpack"]:
        return "msgpack"
    mime = encoding.partition(";")[0].strip()
    for fmt, name in MIME.items():
        if mime == name:
            return fmt
    return "json" if payload.lstrip(_BLANK)[:1] == b"{" else "msgpack"


def decode(kind: type[T], payload: bytes, encoding: str = "") -> T:
    """Decode and validate a stream message; unknown fields are ignored.

    Raises:
        BadPayload: The bytes are not a valid `kind`.
    """
    try:
        if detect_format(payload, encoding) == "json":
            return msgspec.json.decode(payload, type=kind)
        return _msgpack_decoder(kind).decode(payload)
    except msgspec.MsgspecError as error:
        raise BadPayload(str(error)) from error
    except UnicodeDecodeError as error:
        raise BadPayload("it is not UTF-8 text") from error
    except RecursionError as error:
        raise BadPayload("it is nested too deeply") from error


def decode_strict(kind: type[T], payload: bytes, encoding: str = "") -> T:
    """Decode the parameters of a request; unknown fields are refused by name, nothing is `{}`.

    Raises:
        BadPayload: The bytes are not a valid `kind`, or hold a field that it does not have.
    """
    if not payload.strip(_BLANK):
        payload, encoding = b"{}", MIME["json"]
    try:
        raw = decode(cast("type[Any]", Any), payload, encoding)
    except BadPayload:
        decode(kind, payload, encoding)  # names the field
        raise
    _refuse_wrong(raw, kind)
    return decode(kind, payload, encoding)


def decode_parameters(kind: type[T], parameters: dict[str, str]) -> T:
    """Decode selector parameters (strings, numbers, booleans); `x`, `y`, `yaw` stand for `pose`.

    Raises:
        BadPayload: They are not a valid `kind`, or hold a parameter that it does not have.
    """
    fields = {field.name for field in msgspec.structs.fields(cast("type[msgspec.Struct]", kind))}
    values: dict[str, Any] = dict(parameters)
    if "pose" in fields and any(name in values for name in _POSE_FIELDS):
        values["pose"] = {name: values.pop(name) for name in _POSE_FIELDS if name in values}
    _refuse_wrong(values, kind)
    try:
        return msgspec.convert(values, type=kind, strict=False)
    except (msgspec.ValidationError, RecursionError) as error:
        raise BadPayload(str(error)) from error


def parse_parameters(text: str) -> dict[str, str]:
    """Split a selector's parameters at `;` or `&`, percent-decoded, without Zenoh's own (`_…`)."""
    found: dict[str, str] = {}
    for item in text.replace("&", ";").split(";"):
        name, _, value = item.partition("=")
        if name and not name.startswith("_"):
            found[unquote(name)] = unquote(value)
    return found


def format_asked(parameters: dict[str, str], default: Format) -> Format:
    """The format that a selector asks for by `format=`, else the default."""
    asked = parameters.get("format")
    return asked if asked == "json" or asked == "msgpack" else default


def to_plain(message: Any) -> Any:
    """A message as plain JSON values, as `--json` prints it."""
    return json.loads(_JSON_ENCODER.encode(message))


def _refuse_wrong(raw: Any, kind: Any) -> None:
    """Raise BadPayload at the first field that `kind` does not have or that is NaN, at any depth.

    Of NaN msgspec says that it is too small wherever a number has a lower bound.
    """
    problem = _problem(raw, msgspec.inspect.type_info(kind), "")
    if problem is not None:
        raise BadPayload(problem)


def _problem(raw: Any, shape: msgspec.inspect.Type, path: str) -> str | None:
    if isinstance(shape, msgspec.inspect.UnionType):
        shapes = [
            one
            for one in shape.types
            if isinstance(
                one,
                msgspec.inspect.StructType | msgspec.inspect.ListType | msgspec.inspect.FloatType,
            )
        ]
        return _problem(raw, shapes[0], path) if len(shapes) == 1 else None
    if isinstance(shape, msgspec.inspect.FloatType) and isinstance(raw, float) and math.isnan(raw):
        return f"`{path}`: it must be a finite number"
    if isinstance(shape, msgspec.inspect.ListType) and isinstance(raw, list):
        items = cast("list[Any]", raw)
        problems = (_problem(item, shape.item_type, f"{path}[{i}]") for i, item in enumerate(items))
        return next((problem for problem in problems if problem), None)
    if isinstance(shape, msgspec.inspect.StructType) and isinstance(raw, dict):
        known = {field.encode_name: field.type for field in shape.fields}
        for name, value in cast("dict[Any, Any]", raw).items():
            here = f"{path}.{name}".lstrip(".")
            if name not in known:
                return f"unknown field `{here}`"
            if problem := _problem(value, known[name], here):
                return problem
    return None
