"""What may name a place, a tour, a zone or a marker."""

import unicodedata

import pytest

from trolley.names import name_problem


@pytest.mark.parametrize(
    "name",
    [
        "kitchen", "Küche", "Ku\u0308che", "living room", "台所", "кухня", "مطبخ", "रसोई", "a",
        "x" * 64, "u\u0308" * 64, "A_b-c.d", "7", "a..b", "١٢",
    ],
)  # fmt: skip
def test_names_of_any_script_are_allowed(name: str):
    assert name_problem(name) is None


@pytest.mark.parametrize(
    "name",
    [
        "", "x" * 65, ".", "..", ".hidden", " a", "a ", "a  b", "a\tb", "a\nb", "a/b", "a\\b", "*",
        "a*", "a?b", "a#b", "a$b", "a\x00", "\x1b[31m", "a:b", "a@b", "🙂", "a\u00a0b", "a\u200bb",
        "<b>", "a'b", 'a"b', "a;b", "a=b", "a%20b", "\ud800",
    ],
)  # fmt: skip
def test_what_is_no_name_is_refused_with_a_sentence(name: str):
    problem = name_problem(name)
    assert problem
    assert "\n" not in problem
    assert "\x1b" not in problem


def test_the_length_counts_after_nfc():
    assert len("u\u0308" * 64) == 128
    assert len(unicodedata.normalize("NFC", "u\u0308" * 64)) == 64
    assert name_problem("u\u0308" * 65) is not None
