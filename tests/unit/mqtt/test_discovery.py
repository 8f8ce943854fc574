"""Slugs of names."""

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from trolley_mqtt.discovery import Device, entities, slug


@given(st.text(min_size=1, max_size=64))
def test_a_slug_is_what_home_assistant_allows(name: str) -> None:
    assert re.fullmatch(r"[a-z0-9_]{8,60}", slug(name))


@pytest.mark.parametrize(("one", "other"), [("Küche", "Kuche"), ("a b", "a-b"), ("居間", "書斎")])
def test_slugs_keep_names_apart(one: str, other: str) -> None:
    assert slug(one) != slug(other)
    assert slug(one) == slug(one)


@pytest.mark.parametrize(
    ("entity", "state", "shown"),
    [
        ("sensor/place", {"place": "hall", "position": "localized"}, "hall"),
        ("sensor/place", {"place": None, "position": "unsure"}, "elsewhere"),
        ("sensor/place", {"place": None, "position": "lost"}, "None"),
        ("sensor/room", {"room": None, "position": "localized"}, "none"),
        ("sensor/room", {"room": None, "position": None}, "None"),
        ("binary_sensor/problem", {"problem": False, "activity": "ready"}, "OFF"),
        ("binary_sensor/problem", {"problem": False, "activity": "away"}, "None"),
        ("binary_sensor/problem", {"problem": True, "activity": "away"}, "ON"),
    ],
)
def test_what_nobody_knows_is_shown_as_unknown(entity: str, state: dict, shown: str) -> None:
    jinja2 = pytest.importorskip("jinja2")
    device = Device("robby", "Robby", "1", "trolley/robby", "homeassistant")
    component, name = entity.split("/")
    message = entities(device, has_battery=True, has_charging=True)[device.topic(component, name)]
    # Home Assistant takes "None" for unknown.
    assert jinja2.Template(message["value_template"]).render(value_json=state) == shown
