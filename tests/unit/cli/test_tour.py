"""`trolley tour start`: what it prints while a trip goes, and at its end."""

import contextlib
from collections.abc import Iterator
from types import SimpleNamespace

import pytest
from click.testing import CliRunner
from msgspec import structs

from trolley.cli import tour
from trolley.messages import Stop, StopResult, Tour, Tours, TourStatus

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


def test_who_interrupts_the_command_reads_that_the_tour_goes_on(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def follow(_: str | None) -> Iterator[TourStatus]:
        yield STARTED
        raise KeyboardInterrupt

    robot = SimpleNamespace(ask=lambda request, params: STARTED, follow_tour=follow)
    monkeypatch.setattr(tour, "one_robot", lambda: contextlib.nullcontext(robot))
    result = CliRunner().invoke(tour.tour_command, ["start", "round"])
    assert result.exit_code != 0
    assert "The tour goes on; `trolley tour stop` ends it." in result.output.splitlines()


def test_a_trip_so_long_that_its_first_results_are_left_out_is_told_to_its_end(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    ends = [
        StopResult(stop=0, name=f"n{i}", state="skipped" if i == 0 else "reached") for i in range(5)
    ]
    told = [
        structs.replace(STARTED, results=ends[max(0, n - 2) : n], missed=1, reached=n - 1)
        for n in range(1, 6)
    ]
    robot = SimpleNamespace(
        ask=lambda request, params: STARTED,
        follow_tour=lambda trip: iter((STARTED, *told, structs.replace(told[-1], state="done"))),
    )
    monkeypatch.setattr(tour, "one_robot", lambda: contextlib.nullcontext(robot))
    result = CliRunner().invoke(tour.tour_command, ["start", "round"])
    lines = result.output.splitlines()
    shown = [line for line in lines if line.startswith("n")]
    assert shown == ["n0: skipped after 0 s", *(f"n{i}: reached after 0 s" for i in range(1, 5))]
    assert result.exit_code == 1, "one stop was skipped, however long ago"


def test_tours_are_listed_with_their_map(monkeypatch: pytest.MonkeyPatch) -> None:
    stops = [Stop(name="sofa")]
    stored = [Tour(name="day", stops=stops), Tour(name="night", stops=stops, map="cellar")]
    robot = SimpleNamespace(latest=lambda topic: Tours(stamp_ns=1, tours=stored))
    monkeypatch.setattr(tour, "one_robot", lambda: contextlib.nullcontext(robot))
    listed = CliRunner().invoke(tour.tour_command, ["list"]).output.splitlines()
    assert [line.split()[:3] for line in listed[1:]] == [
        ["day", "-", "1"],
        ["night", "cellar", "1"],
    ]
    shown = CliRunner().invoke(tour.tour_command, ["show", "night"])
    assert shown.output.startswith("night on cellar, laps: 1")


def test_a_tour_is_shown_by_its_name_as_macos_writes_accents(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    stored = Tour(name="soir\u00e9e", stops=[Stop(name="sofa")])
    robot = SimpleNamespace(latest=lambda topic: Tours(stamp_ns=1, tours=[stored]))
    monkeypatch.setattr(tour, "one_robot", lambda: contextlib.nullcontext(robot))
    result = CliRunner().invoke(tour.tour_command, ["show", "soire\u0301e"])
    assert result.output.startswith("soir\u00e9e, laps: 1")
