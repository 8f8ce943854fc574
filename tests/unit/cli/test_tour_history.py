"""`trolley tour history`: what it prints."""

import contextlib
from types import SimpleNamespace

import pytest
from click.testing import CliRunner

from trolley.cli import tour
from trolley.messages import PastTrip, StopResult

TRIPS = [
    PastTrip(
        trip="b",
        name=None,
        state="failed",
        message="The way is blocked.",
        seconds=75.0,
        planned=3,
        reached=1,
        missed=1,
        results=[
            StopResult(stop=0, name="hall", state="reached", seconds=4.0),
            StopResult(stop=1, state="failed", code="blocked", message="Blocked."),
        ],
    ),
    PastTrip(trip="a", name="round", state="stopped", started_at="2026-11-21T10:00:00Z", reached=7),
]


@pytest.fixture
def shown(monkeypatch: pytest.MonkeyPatch):
    """What a call prints."""
    robot = SimpleNamespace(ask=lambda request, params: TRIPS[: params.limit])
    monkeypatch.setattr(tour, "one_robot", lambda: contextlib.nullcontext(robot))

    def show(*arguments: str) -> list[str]:
        result = CliRunner().invoke(tour.tour_command, ["history", *arguments])
        assert result.exit_code == 0, result.output
        return result.output.splitlines()

    return show


def test_a_line_for_each_trip(shown) -> None:
    _, newest, endless = shown()
    assert newest.split()[:2] == ["?", "-"]
    assert "1 of 3" in newest
    assert "The way is blocked." in newest
    assert endless.split() == ["2026-11-21T10:00:00Z", "round", "stopped", "0", "s", "7"]


def test_the_stops_below_their_trip(shown) -> None:
    lines = shown("--stops", "--limit", "1")
    assert [line.strip() for line in lines[1:]] == [
        "hall: reached after 4 s",
        "stop 2: failed after 0 s: Blocked. (blocked)",
    ]
