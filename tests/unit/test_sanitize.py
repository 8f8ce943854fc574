"""Nothing that moves a terminal leaves as it came."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from trolley import codes
from trolley.codes import Refused
from trolley.sanitize import MOST_REPEATED, escape, fit, sanitize

HOSTILE = (
    "\x1b[2J\x1b]0;owned\x07",
    "\x9b2J\x9d0;owned\x9c",
    "a\u202egnp.exe",
    "\u2066x\u2069\u200f",
    "\x00\x08\x7f",
    "\U000e0041",
    "\ud800",
    "line\rover",
)


@pytest.mark.parametrize("text", HOSTILE)
def test_what_is_not_printable_is_shown_as_what_it_is(text: str):
    for clean in (escape(text), sanitize(text), fit(text, "utf-8"), fit(text, "ascii")):
        assert clean.isprintable()
    assert "\\" in escape(text)


@given(st.text(), st.sampled_from(["utf-8", "latin-1", "ascii", None]))
def test_any_text_fits_any_terminal(text: str, encoding: str | None):
    fitting = fit(text, encoding)
    fitting.encode(encoding or "utf-8")
    assert fitting.replace("\n", "").replace("\t", "").isprintable()
    assert fitting.count("\n") == text.count("\n")


@given(st.text())
def test_a_line_stays_one_line_of_a_length(text: str):
    assert len(sanitize(text, 20)) <= 20
    assert sanitize(text, 20).isprintable()
    assert escape(text).isprintable()


def test_plain_text_stays_as_it_is():
    for text in ("Küche 書斎", "", "a b"):
        assert escape(text) == sanitize(text) == fit(text, "utf-8") == text
    assert fit("Küche", "ascii") == "K?che"
    assert fit("Küche", "latin-1") == "Küche"


def test_the_sentence_of_a_refusal_keeps_its_beginning_and_its_end():
    whole = Refused(codes.UNKNOWN_NAME, f"There is no {'x' * 900}.")
    assert whole.message.endswith("xx.")
    assert "…" not in whole.message
    cut = Refused(codes.UNKNOWN_NAME, f"There is no {'x' * 1_000_000} on this map.")
    assert len(cut.message) == MOST_REPEATED
    assert cut.message.startswith("There is no xx")
    assert cut.message.endswith("xx on this map.")
