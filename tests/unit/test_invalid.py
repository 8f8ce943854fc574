"""What msgspec says, in words for people."""

import math
import re
from typing import Annotated, Any, Literal

import msgspec
import pytest

from trolley import requests
from trolley.geometry import Finite
from trolley.invalid import in_plain_words
from trolley.messages.request_params import MapNamed, WhichPhoto
from trolley.messages.types import NonNegative, StampNs
from trolley.runtime import codec


def problem_of(kind: type[Any], value: object) -> str:
    with pytest.raises(msgspec.ValidationError) as refused:
        msgspec.convert(value, kind)
    return in_plain_words(str(refused.value), kind)


def test_a_name_that_cannot_be_is_described_not_shown_as_an_expression() -> None:
    assert problem_of(MapNamed, {"name": "../x"}).startswith("`name`: a map's name has 1 to 64 of")
    assert "trolley tour history --stops" in problem_of(WhichPhoto, {"name": "nothing"})


class Cup(msgspec.Struct, tag=True):
    size: Literal["s", "m", "l"]


class Pot(msgspec.Struct, tag=True):
    pass


class Numbers(msgspec.Struct, forbid_unknown_fields=True):
    many: list[int] = []
    share: Annotated[float, msgspec.Meta(ge=0.0)] | None = None
    percent: Annotated[float, msgspec.Meta(ge=0.0, lt=100.0)] = 0.0
    pair: tuple[int, int] = (0, 0)
    word: Annotated[str, msgspec.Meta(min_length=1, max_length=3)] = "a"
    few: Annotated[list[int], msgspec.Meta(max_length=2)] = []
    kind: Literal["tea", "coffee"] = "tea"
    cups: list[Cup] | None = None
    pots: dict[str, Cup] = {}
    drinks: list[Cup | Pot] = []
    letter: Literal["a", "b", "c", "d", "e", "f", "g", "h", "i"] = "a"
    place: Finite = 0.0
    width: NonNegative = 0.0
    stamp_ns: StampNs = 0
    notes: Any = None


@pytest.mark.parametrize(
    ("value", "words"),
    [
        ({"many": "x"}, "`many`: a list is needed, not text"),
        ({"many": [1, "x"]}, "`many[1]`: a whole number is needed, not text"),
        ({"share": []}, "`share`: a number or nothing is needed, not a list"),
        ([], "an object is needed, not a list"),
        ({"percent": -1}, "`percent`: it must be at least 0.0"),
        ({"percent": 100}, "`percent`: it must be less than 100.0"),
        ({"pair": [1]}, "`pair`: it must have 2 entries"),
        ({"word": ""}, "`word`: it must have at least 1 character"),
        ({"word": "long"}, "`word`: it must have at most 3 characters"),
        ({"few": [1, 2, 3]}, "`few`: it must have at most 2 entries"),
        ({"kind": "milk"}, "`kind`: it may be `coffee` or `tea`, not 'milk'"),
        ({"cups": [{"size": "xl"}]}, "`cups[0].size`: it may be `l`, `m` or `s`, not 'xl'"),
        ({"pots": {"x": {"size": "xl"}}}, "`pots[...].size`: it may be `l`, `m` or `s`, not 'xl'"),
        ({"drinks": [{"type": "beer"}]}, "`drinks[0].type`: it may be `Cup` or `Pot`, not 'beer'"),
        ({"letter": "z"}, "`letter`: 'z' is not among the values that it may have"),
        ({"word": None}, "`word`: text is needed, not nothing"),
        ({"place": -math.inf}, "`place`: it must be at least -1e12"),
        ({"place": math.inf}, "`place`: it must be at most 1e12"),
        ({"width": 1e15}, "`width`: it must be at most 1e12"),
        ({"stamp_ns": 1 << 63}, "`stamp_ns`: it must be at most 9223372036854775807"),
        ({"fewer": 1}, "unknown field `fewer`"),
    ],
)
def test_kinds_have_names_that_people_know(value: object, words: str) -> None:
    assert problem_of(Numbers, value) == words


@pytest.mark.parametrize(
    ("payload", "words"),
    [
        (b'{"notes": ' + b"[" * 50_000, "it is nested too deeply"),
        (b'{"word": "\xff"}', "it is not UTF-8 text"),
        (b'{"word": "\\ud800"}', "it is cut short, or not valid JSON or msgpack"),
        (b'{"place": 1e999}', "`place`: the number is too large"),
        (b'{"many": [1, ' + b"1" * 5000 + b"]}", "`many[1]`: the number is too large"),
        (msgspec.msgpack.encode({"percent": math.nan}), "`percent`: it must be a finite number"),
        (msgspec.msgpack.encode({"share": math.nan}), "`share`: it must be a finite number"),
        (msgspec.msgpack.encode({"word": math.nan}), "`word`: text is needed, not a number"),
        (msgspec.msgpack.encode({"word": None}), "`word`: text is needed, not nothing"),
    ],
)
def test_what_cannot_be_decoded_is_said_without_a_programmer_s_words(
    payload: bytes, words: str
) -> None:
    with pytest.raises(codec.BadPayload) as refused:
        codec.decode_strict(Numbers, payload)
    assert in_plain_words(str(refused.value), Numbers) == words


def test_no_request_shows_an_expression_for_a_name() -> None:
    for request in requests.REQUESTS:
        for field in msgspec.structs.fields(request.params):
            try:
                msgspec.convert({field.name: "\n\n"}, request.params)
            except msgspec.ValidationError as error:
                words = in_plain_words(str(error), request.params)
                assert re.search(r"matching regex|must match", words) is None, (request, words)
