"""What msgspec says, in words for people."""

import re
from typing import Any

import msgspec
import pytest

from trolley import requests
from trolley.invalid import in_plain_words
from trolley.messages.request_params import MapNamed, WhichPhoto


def problem_of(kind: type[Any], value: object) -> str:
    with pytest.raises(msgspec.ValidationError) as refused:
        msgspec.convert(value, kind)
    return in_plain_words(str(refused.value))


def test_a_name_that_cannot_be_is_described_not_shown_as_an_expression() -> None:
    assert problem_of(MapNamed, {"name": "../x"}).startswith("`name`: a map's name has 1 to 64 of")
    assert "trolley tour history --stops" in problem_of(WhichPhoto, {"name": "nothing"})


class Numbers(msgspec.Struct, forbid_unknown_fields=True):
    many: list[int] = []
    share: float | None = None


@pytest.mark.parametrize(
    ("value", "words"),
    [
        ({"many": "x"}, "`many`: a list is needed, not text"),
        ({"many": [1, "x"]}, "`many[1]`: a whole number is needed, not text"),
        ({"share": []}, "`share`: a number or nothing is needed, not a list"),
        ([], "an object is needed, not a list"),
        ({"few": 1}, "Object contains unknown field `few`"),
    ],
)
def test_kinds_have_names_that_people_know(value: object, words: str) -> None:
    assert problem_of(Numbers, value) == words


def test_no_request_shows_an_expression_for_a_name() -> None:
    for request in requests.REQUESTS:
        for field in msgspec.structs.fields(request.params):
            try:
                msgspec.convert({field.name: "\n\n"}, request.params)
            except msgspec.ValidationError as error:
                words = in_plain_words(str(error))
                assert re.search(r"matching regex|must match", words) is None, (request, words)
