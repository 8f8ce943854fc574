"""A message given as JSON on the command line, checked as its receiver would."""

import json
from collections.abc import Mapping
from typing import Any, TypeVar, cast

import click
import msgspec
import numpy as np

from trolley.invalid import in_plain_words
from trolley.messages.arrays import ARRAY_FIELDS
from trolley.runtime import codec
from trolley.suggestions import did_you_mean

T = TypeVar("T")


def read_json(text: str, kind: type[T], name: str, preset: Mapping[str, Any] | None = None) -> T:
    """A message of a kind; arrays may be lists of numbers, null in them is no echo.

    Args:
        text: one JSON object.
        kind: a struct of `trolley.messages`.
        name: what it is for, as errors call it.
        preset: values of fields that are not given.

    Raises:
        click.BadParameter: it is not one, saying where and why.
    """
    try:
        given: Any = json.loads(text, parse_constant=_refuse_constant)
    except (ValueError, RecursionError) as problem:
        raise click.BadParameter(
            f'{text!r} is not JSON ({problem}); write it like \'{{"name": "kitchen"}}\''
        ) from problem
    if not isinstance(given, dict):
        raise click.BadParameter(f"{name} takes a JSON object in {{}}, not {text}")
    values = cast("dict[str, Any]", given)
    known = [field.name for field in msgspec.structs.fields(cast("type[msgspec.Struct]", kind))]
    for field in values:
        if field not in known:
            hint = did_you_mean(field, known) if known else "It takes nothing."
            raise click.BadParameter(f"{name} has no field {field!r}. {hint}")
    complete = {**{key: value for key, value in (preset or {}).items() if key in known}, **values}
    try:
        payload = json.dumps(_with_arrays(complete, kind)).encode()
        return codec.decode_strict(kind, payload, codec.MIME["json"])
    except (ValueError, OverflowError) as problem:  # also what the decoder raises
        raise click.BadParameter(f"{name}: {in_plain_words(str(problem), kind)}") from problem


def _refuse_constant(word: str) -> None:
    raise ValueError(f"{word} is not a number there")


def _with_arrays(values: dict[str, Any], kind: type) -> dict[str, Any]:
    """The values with lists of numbers as the bytes that the wire has for them."""
    filled = dict(values)
    for (owner, field), layout in ARRAY_FIELDS.items():
        if owner is kind and isinstance(values.get(field), list):
            try:
                numbers = np.array(values[field], dtype=np.float64)
            except (TypeError, ValueError) as problem:
                raise ValueError(f"`{field}` must be a list of numbers") from problem
            if layout.dtype == "<f4":
                numbers = np.where(np.isnan(numbers), np.inf, numbers)
            filled[field] = msgspec.to_builtins(numbers.astype(layout.dtype).tobytes())
    return filled
