"""What overlays look like: text, menus, gauges, plots, and what they say when there is nothing."""

import math
import re
from typing import Any

import pytest

from trolley.geometry.relation import Relation
from trolley.messages import Overlay, OverlayRule
from trolley_viz.overlays.cards import Card, CardContext, card_of, item_of
from trolley_viz.overlays.figures import gauge_svg, number, ticks, value_range
from trolley_viz.overlays.history import History
from trolley_viz.overlays.markup import safe_markup
from trolley_viz.overlays.readings import Reading
from trolley_viz.overlays.source import parse_source

S = 10**9
NOW = CardContext(100 * S)
ARTICLE = [
    OverlayRule(bearing_min=math.pi / 10, bearing_max=-math.pi / 10, text="OtherWayRound"),
    OverlayRule(distance_min=10.0, text="FarAway"),
    OverlayRule(distance_min=1.0, distance_max=10.0, text="CloseBy"),
    OverlayRule(distance_max=1.0, text="Target"),
]
ITEMS = ["FarAway", "CloseBy", "Target", "OtherWayRound"]

ATTACKS = [
    "<script>alert(1)</script>",
    "<img src=x onerror=alert(1)>",
    "<svg/onload=alert(1)>",
    "<a href='javascript:alert(1)'>x</a>",
    "<iframe src=//evil.example></iframe>",
    "<b onmouseover=alert(1)>x</b>",
    "<span style='color:expression(alert(1))'>x</span>",
    "<span style='background:url(//evil.example/x)'>x</span>",
    "<span style='color:red;position:fixed;top:0'>x</span>",
    "<font color='red\" onclick=alert(1)'>x</font>",
    "<style>@import '//evil.example'</style>",
    "<math><mi//xlink:href='data:x,<script>alert(1)</script>'>",
    "<!--><img src=x onerror=alert(1)>-->",
    "<noscript><p title='</noscript><img src=x onerror=alert(1)>'>",
    "</div></div><button data-index=0 class=ov-csv>",
    "<form action=//evil.example><input name=q>",
    "<object data=//evil.example></object>",
    "<base href=//evil.example>",
    "<link rel=stylesheet href=//evil.example>",
    "&lt;script&gt;alert(1)&lt;/script&gt;",
    "<scr<script>ipt>alert(1)</scr</script>ipt>",
]
ACTIVE = re.compile(
    r"<(?!/?(b|strong|i|em|u|small|br|span|font|div|button|svg|text|path|line)\b)|"
    r"<[^>]* on\w+|<[^>]*(href|src|url\(|expression|position)",
    re.IGNORECASE,
)


def reading(
    text: str = "odom:twist.vx", value: float | str | None = None, **known: float
) -> Reading:
    found = Reading(parse_source(text), value=value, arrived_ns=NOW.now_ns)
    if known:
        bearing, distance = known.get("bearing", 0.0), known["distance"]
        found.relation = Relation(
            parent="base_link",
            child="map",
            distance=distance,
            bearing=bearing,
            translation=(0.0, 0.0, 0.0),
            yaw=0.0,
            rotation=(0.0, 0.0, 0.0, 1.0),
            age=0.0,
            links=[],
            stale=[],
        )
    return found


def made(overlay: Overlay, of: Reading | None = None, chosen: int | None = None) -> Card:
    return card_of(overlay, of, chosen, NOW)


@pytest.mark.parametrize("attack", ATTACKS)
@pytest.mark.parametrize("kind", ["text", "menu", "gauge", "plot"])
def test_markup_of_strangers_does_nothing(attack: str, kind: Any) -> None:
    overlay = Overlay(kind=kind, title=attack, text=attack, items=[attack], unit=attack, source="x")
    card = made(overlay, reading(value=attack))
    assert not ACTIVE.search(re.sub(r'<button type="button"|aria-label="[^"]*"', "<div", card.body))
    assert not ACTIVE.search(re.sub(r'<button type="button"', "<div", card.head))
    assert "alert" not in card.style


def test_the_article_s_green_number_stays_green() -> None:
    text = 'Counter = <span style="color: green;">5.</span>'
    assert safe_markup(text) == 'Counter = <span style="color:green">5.</span>'
    assert safe_markup("<font color=#0f0>a</font><br>3 < 5") == (
        '<font color="#0f0">a</font><br>3 &lt; 5'
    )


def test_an_odd_place_is_the_top_left_and_sizes_are_bounded() -> None:
    card = made(Overlay(kind="text", text="x", place="under the bed", size=1e6))
    assert card.place == "top-left"
    assert "font-size:48px" in card.style
    assert made(Overlay(kind="text", text="x", place="right")).place == "right"


def test_text_shows_values_between_its_words() -> None:
    known = reading("tf:base_link/map:distance", 2.5, distance=2.5, bearing=-math.pi / 2)
    overlay = Overlay(kind="text", text="{distance} at <b>{bearing}</b>, {value}", unit="m")
    assert "2.50 m at <b>-90.0°</b>, 2.50 m" in made(overlay, known).body
    assert "driving" in made(Overlay(kind="text"), reading("goal:state", "driving")).body


@pytest.mark.parametrize(
    ("distance", "bearing", "item"),
    [
        (12.0, 0.1, "FarAway"),
        (5.0, -0.1, "CloseBy"),
        (0.5, 0.0, "Target"),
        (0.5, 0.4, "OtherWayRound"),
        (0.5, -0.4, "OtherWayRound"),  # the article took every turn to the right for ahead
        (12.0, math.pi, "OtherWayRound"),
    ],
)
def test_the_article_s_rules_mark_the_item(distance: float, bearing: float, item: str) -> None:
    menu = Overlay(kind="menu", items=ITEMS, rules=ARTICLE)
    known = reading("tf:base_link/map:distance", distance, distance=distance, bearing=bearing)
    assert item_of(menu, known) == ITEMS.index(item)
    assert f'aria-pressed="true">{item}<' in made(menu, known).body


def test_without_the_frames_no_rule_with_bounds_matches() -> None:
    menu = Overlay(kind="menu", items=ITEMS, rules=ARTICLE)
    assert item_of(menu, reading("tf:base_link/map:distance")) is None


def test_a_menu_marks_the_word_or_number_of_its_source_or_what_was_clicked() -> None:
    states = Overlay(kind="menu", items=["idle", "driving"], source="goal:state")
    assert item_of(states, reading("goal:state", "driving")) == 1
    assert item_of(states, reading("tour:stop", 0.0)) == 0
    menu = Overlay(kind="menu", items=["a", "b"])
    assert made(menu).body.count('aria-pressed="true"') == 0
    assert 'aria-pressed="true">b' in made(menu, chosen=1).body
    assert 'aria-pressed="true">a' in made(Overlay(kind="menu", items=["a", "b"], index=0)).body


def test_a_long_menu_is_cut_and_says_so() -> None:
    card = made(Overlay(kind="menu", items=[f"item {i}" for i in range(1000)]))
    assert card.body.count("data-index") == 40
    assert "960 more are not shown" in card.body


def test_a_rule_colours_a_plot_and_gives_its_words() -> None:
    red = OverlayRule(distance_max=1.0, text="<b>Near</b>", color=(1.0, 0.0, 0.0, 1.0))
    plot = Overlay(kind="plot", source="tf:base_link/map:distance", rules=[red])
    near = reading("tf:base_link/map:distance", 0.5, distance=0.5)
    near.history.add(NOW.now_ns, 1, 0.5)
    card = made(plot, near)
    assert "color:rgba(255,0,0,1)" in card.style
    assert "<b>Near</b>" in card.body
    far = reading("tf:base_link/map:distance", 5.0, distance=5.0)
    assert "color:rgba(255,255,255,1)" in made(plot, far).style


def test_bearings_are_shown_in_degrees_where_the_unit_says_so() -> None:
    known = reading("tf:base_link/map:bearing", -math.pi / 2, distance=1.0)
    gauge = Overlay(kind="gauge", unit="°", min=-180.0, max=180.0)
    assert ">-90.0°<" in made(gauge, known).body
    assert ">-1.57<" in made(Overlay(kind="gauge", min=-3.2, max=3.2), known).body
    # Another field's unit is the program's own word.
    assert ">90.0°<" in made(gauge, reading("odom:pose.yaw", 90.0)).body


@pytest.mark.parametrize("value", [-1e308, -5.0, 0.0, 0.5, 5.0, 1e308, None])
def test_a_gauge_stays_in_its_dial(value: float | None) -> None:
    svg = gauge_svg(value, 0.0, 1.0, "x", "")
    assert "nan" not in svg
    assert svg.count("<path") == (1 if value is None else 2)


def test_silence_is_told_with_its_age() -> None:
    old = reading(value=0.4)
    old.arrived_ns = NOW.now_ns - 5 * S
    card = made(Overlay(kind="gauge"), old)
    assert "No data for 5 s." in card.body
    assert "data-trouble" in card.body
    assert "No data yet." in made(Overlay(kind="gauge"), Reading(old.source)).body
    still = reading("robot:max_speed", 0.6)
    still.arrived_ns = 0
    assert "No data" not in made(Overlay(kind="gauge"), still).body
    assert (
        "No data for 100 s."
        in card_of(Overlay(kind="gauge"), still, None, CardContext(NOW.now_ns, is_away=True)).body
    )
    of_goal = reading("goal:distance_remaining", 0.6)
    of_goal.arrived_ns = 0
    assert "No data" not in made(Overlay(kind="gauge"), of_goal).body
    silent = CardContext(NOW.now_ns, silent=frozenset({"planner"}))
    assert "No data for 100 s." in card_of(Overlay(kind="gauge"), of_goal, None, silent).body


def test_a_field_that_does_not_exist_is_told_without_a_picture() -> None:
    card = made(Overlay(kind="plot"), Reading(None, "odom has no field “twist.vz”."))
    assert "no field “twist.vz”" in card.body
    assert "<svg" not in card.body


def test_the_line_of_a_dead_topic_ends() -> None:
    history = History()
    for i in range(100):
        history.add(i * S // 10, i, float(i))
    ((times, values),) = history.lines(20 * S, 60.0, 200)
    assert times[-1] == pytest.approx(-10.1)
    assert values[-1] == 99.0
    history.add(19 * S, 1, 5.0)  # it comes back: another line, with a gap between
    assert [len(v) for _, v in history.lines(20 * S, 60.0, 200)] == [100, 1]
    assert history.lines(200 * S, 60.0, 200) == []


def test_an_unknown_value_breaks_the_line() -> None:
    history = History()
    for i, value in enumerate([1.0, 2.0, None, None, 3.0, 4.0]):
        history.add(i * S, i, value)
    assert [v.tolist() for _, v in history.lines(6 * S, 60.0, 200)] == [[1.0, 2.0], [3.0, 4.0]]


def test_history_is_bounded_and_exported_whole() -> None:
    history = History()
    for i in range(7000):
        history.add(i * S // 100, i, 0.5 * i)
    assert len(history) == 6000
    assert history.csv().splitlines()[:2] == ["stamp_ns,value", "1000,500.0"]
    history.add(1000 * S, 7, None)  # the others are over ten minutes old
    assert history.csv() == "stamp_ns,value\n7,\n"


def test_a_value_that_stays_the_same_lies_in_a_readable_range() -> None:
    history = History()
    for i in range(20):
        history.add(i * S, i, 0.0)
    low, high = value_range(history.lines(20 * S, 60.0, 200))
    assert (low, high) == pytest.approx((-0.05, 0.05))
    assert value_range([]) == pytest.approx((-0.05, 1.05))
    assert value_range([], 2.0) == (2.0, 3.0)


def test_numbers_are_short_and_ticks_differ() -> None:
    assert [number(v) for v in (0.0, -0.001, 1.239, 12.34, 123.4, 1e6, 1e-5)] == [
        "0.00", "0.00", "1.24", "12.3", "123", "1e+06", "1e-05",
    ]  # fmt: skip
    written = [text for _, text in ticks(0.5801, 0.5839)]
    assert len(set(written)) == len(written) > 2
