"""Overlays: rules against a slow reference, sources and markup of any text."""

import html.parser
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trolley.messages import OverlayRule
from trolley_viz.overlays.figures import plot_svg, ticks, value_range
from trolley_viz.overlays.history import History
from trolley_viz.overlays.markup import TAGS, safe_markup
from trolley_viz.overlays.rules import matches
from trolley_viz.overlays.source import BadSource, parse_source

DEGREES = st.integers(-720, 720)
NUMBERS = st.floats(-1e9, 1e9)


@given(
    low=DEGREES,
    width=st.integers(0, 359),
    turns_back=st.integers(0, 2),
    bearing=st.integers(-179, 180),
)
def test_a_bearing_lies_between_two_others_if_a_turn_from_one_to_the_other_meets_it(
    low: int, width: int, turns_back: int, bearing: int
) -> None:
    """The slow way: turn counter-clockwise from the first bound, degree by degree."""
    met = any((low + step - bearing) % 360 == 0 for step in range(width + 1))
    high = low + width - 360 * turns_back
    rule = OverlayRule(bearing_min=math.radians(low), bearing_max=math.radians(high))
    assert matches(rule, None, math.radians(bearing)) == met


@given(low=DEGREES, more=st.integers(0, 720), bearing=st.integers(-179, 180))
def test_every_bearing_lies_within_a_full_turn(low: int, more: int, bearing: int) -> None:
    rule = OverlayRule(bearing_min=math.radians(low), bearing_max=math.radians(low + 361 + more))
    assert matches(rule, None, math.radians(bearing))


@given(
    distance=st.floats(0, 20),
    low=st.none() | st.floats(0, 20),
    high=st.none() | st.floats(0, 20),
)
def test_missing_bounds_are_open(distance: float, low: float | None, high: float | None) -> None:
    inside = (-math.inf if low is None else low) <= distance <= (math.inf if high is None else high)
    assert matches(OverlayRule(distance_min=low, distance_max=high), distance, None) == inside


@given(st.text(max_size=60) | st.from_regex(r"(odom|scan|tf|goal)[:/][a-z.\[\]0-9:/]{0,20}"))
def test_any_text_is_a_source_or_told_why_not(text: str) -> None:
    try:
        source = parse_source(text)
    except BadSource as problem:
        said = str(problem)
    else:
        said = str(source)
    assert said


class Tags(html.parser.HTMLParser):
    """What a browser would make of a text."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.found: list[tuple[str, list[tuple[str, str | None]]]] = []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found.append((tag, attrs))


PIECES = st.sampled_from(
    (
        *("<b>", "</b>", "<span style='", "color:", "red", "'>", "<script>", "<!--", "-->", "&lt;"),
        *("<img src=x onerror=", "<svg><style>", "</style>", "javascript:", "<font color=", "url("),
        *('"', ">", "\0"),
    )
)


@given(st.lists(PIECES | st.text(max_size=5), max_size=12))
def test_of_any_markup_only_the_harmless_is_left(pieces: list[str]) -> None:
    for tag, attributes in Tags(safe_markup("".join(pieces))).found:
        assert tag in TAGS
        assert {name for name, _ in attributes} <= {"style", "color"}
        assert not any(
            "(" in (value or "") and "rgb" not in (value or "") for _, value in attributes
        )


@given(st.lists(NUMBERS, min_size=1, max_size=50), st.none() | NUMBERS, st.none() | NUMBERS)
def test_any_values_can_be_plotted(
    values: list[float], low: float | None, high: float | None
) -> None:
    history = History()
    for i, value in enumerate(values):
        history.add(i * 10**8, i, value)
    lines = history.lines(len(values) * 10**8, 60.0, 200)
    bottom, top = value_range(lines, low, high)
    assert top > bottom
    assert len(ticks(bottom, top)) <= 5
    assert "nan" not in plot_svg(lines, 60.0, low, high)


@given(st.integers(0, 2**32 - 1), st.integers(500, 1500), st.integers(20, 200))
def test_thinning_keeps_what_stands_out(seed: int, number: int, columns: int) -> None:
    values = np.random.default_rng(seed).standard_cauchy(number).tolist()
    history = History()
    for i, value in enumerate(values):
        history.add(i * 10**7, i, value)
    ((times, kept),) = history.lines(len(values) * 10**7, 60.0, columns)
    assert np.all(np.diff(times) > 0)
    assert len(kept) <= 2 * columns + 2
    assert kept.min() == min(values)
    assert kept.max() == max(values)
    assert kept[-1] == pytest.approx(values[-1])
