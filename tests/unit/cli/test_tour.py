"""`trolley tour start`: what it prints while a trip goes, and at its end."""

import contextlib
from types import SimpleNamespace

import pytest
from click.testing import CliRunner

from trolley.cli import tour
from trolley.messages import StopResult, TourStatus

STARTED = TourStatus(stamp_ns=1, name="round", trip="t1", state="driving", stop=0)
DONE = TourStatus(
    stamp_ns=2,
    name="round",
    trip="t1",
    state="done",
    results=[StopResult(stop=0, name="sofa", state="reached", seconds=4.0)],
)


def test_how_a_trip_ended_is_printed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    robot = SimpleNamespace(
        ask=lambda request, params: STARTED, follow_tour=lambda trip: iter((STARTED, DONE))
    )
    monkeypatch.setattr(tour, "one_robot", lambda: contextlib.nullcontext(robot))
    result = CliRunner().invoke(tour.tour_command, ["start", "round"])
    assert result.output.splitlines() == [
        "round: driving, stop 1",
        "sofa: reached after 4 s",
        "round: done",
    ]
    assert result.exit_code == 0
