"""Slugs of names."""

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from trolley_mqtt.discovery import slug


@given(st.text(min_size=1, max_size=64))
def test_a_slug_is_what_home_assistant_allows(name: str) -> None:
    assert re.fullmatch(r"[a-z0-9_]{8,60}", slug(name))


@pytest.mark.parametrize(("one", "other"), [("Küche", "Kuche"), ("a b", "a-b"), ("居間", "書斎")])
def test_slugs_keep_names_apart(one: str, other: str) -> None:
    assert slug(one) != slug(other)
    assert slug(one) == slug(one)
