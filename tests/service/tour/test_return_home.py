"""A low battery ends the drive with the way home."""

import datetime
from typing import TYPE_CHECKING, Any

import pytest

from trolley import codes, requests, topics
from trolley.geometry import Pose2D
from trolley.messages import (
    BaseState,
    Battery,
    ChangedSetting,
    ConfigChanges,
    SavedPose,
    ScheduleEntry,
    Stop,
    Tour,
)
from trolley.messages.request_params import AskOffer, SendGoal

if TYPE_CHECKING:
    from collections.abc import Callable

    from .conftest import Home, Plan

HOME_POSE = Pose2D(0.5, 0.5, 0.0)


def live(home: "Home", seconds: int, fraction: float | None, **state: Any) -> None:
    """Let time pass while the base says this charge, once a second."""
    charging = state.pop("charging", None)
    for _ in range(seconds):
        battery = None if fraction is None else Battery(fraction=fraction, charging=charging)
        stamp_ns = home.base.robot_ns
        message = BaseState(stamp_ns=stamp_ns, battery=battery, **({"mode": "ok"} | state))  # pyrefly: ignore[bad-argument-type]
        home.base.publish(topics.BASE, message)
        home.lockstep.run(1.0)


def save_home(home: "Home") -> None:
    pose = SavedPose(name="home", map="apartment", pose=HOME_POSE)
    home.lockstep.ask(requests.POSES_PUT, pose)


@pytest.fixture
def housed(home: "Home") -> "Home":
    """A home with a place called home."""
    save_home(home)
    return home


def targets(home: "Home") -> list[Pose2D | None]:
    """Where the planner was sent, each goal once."""
    return [goal.pose for goal in {goal.id: goal for goal in home.planner.sent}.values()]


def test_a_trip_goes_home_after_the_present_drive_and_waits_there(
    housed: "Home", plan: "type[Plan]"
) -> None:
    housed.planner.script = [plan(seconds=15.0)]
    first = housed.start("corridor", "kitchen")
    live(housed, 13, 0.18)
    assert (housed.status.trip, len(targets(housed))) == (first.trip, 1)
    live(housed, 4, 0.18)
    assert (housed.status.state, housed.status.reason) == ("driving", codes.LOW_BATTERY)
    assert housed.status.message == "Battery at 18 %: driving home."
    assert targets(housed)[-1] == HOME_POSE
    live(housed, 8, 0.18)
    assert (housed.status.state, housed.status.reason) == ("paused", codes.LOW_BATTERY)
    assert housed.status.trip == first.trip
    assert housed.results() == [(0, "reached", "")]
    past = housed.lockstep.ask(requests.TOUR_HISTORY, requests.TOUR_HISTORY.params())
    assert [trip.message for trip in past] == ["Home, because the battery was low."]
    live(housed, 60, 1.0)
    assert len(targets(housed)) == 2  # nothing sets off by itself
    housed.lockstep.ask(requests.TOUR_RESUME)
    live(housed, 8, 1.0)
    assert housed.status.state == "done"
    assert housed.results() == [(0, "reached", ""), (1, "reached", "")]


def test_a_nearly_empty_battery_ends_the_drive_at_once(housed: "Home", plan: "type[Plan]") -> None:
    housed.planner.script = [plan(seconds=100.0)]
    housed.start("corridor", "kitchen")
    live(housed, 12, 0.09)
    assert targets(housed)[-1] == HOME_POSE


def test_a_moment_of_low_voltage_and_a_charging_battery_mean_nothing(
    housed: "Home", plan: "type[Plan]"
) -> None:
    housed.planner.script = [plan(seconds=100.0)]
    housed.start("corridor", "kitchen")
    for _ in range(5):
        live(housed, 6, 0.05)
        live(housed, 1, 0.5)
    live(housed, 30, 0.05, charging=True)
    assert len(targets(housed)) == 1


def test_it_is_low_until_it_is_well_above_the_limit(housed: "Home") -> None:
    live(housed, 12, 0.19)
    assert housed.status.reason == codes.LOW_BATTERY
    live(housed, 12, 0.25)
    assert housed.status.message == "Battery at 25 %: charge the robot."
    live(housed, 2, 0.31)
    assert (housed.status.state, housed.status.message) == ("idle", "")


def test_an_idle_robot_says_so_and_stays_where_it_is(housed: "Home") -> None:
    health = housed.lockstep.record(topics.HEALTH, "tour")
    live(housed, 120, 0.05)
    assert housed.planner.sent == []
    assert housed.status.message == "Battery at 5 %: charge the robot."
    assert health[-1].message == "Battery at 5 %: charge the robot."


def test_a_direct_goal_is_driven_then_the_robot_goes_home(housed: "Home") -> None:
    live(housed, 12, 0.15)
    housed.lockstep.ask(requests.GOAL_SEND, SendGoal(id="abc", pose=Pose2D(2.0, 1.0, 0.0)))
    live(housed, 20, 0.15)
    assert targets(housed) == [Pose2D(2.0, 1.0, 0.0)]
    live(housed, 20, 0.15)
    assert targets(housed)[-1] == HOME_POSE
    live(housed, 10, 0.15)
    assert (housed.status.state, housed.status.reason) == ("done", codes.LOW_BATTERY)
    live(housed, 120, 0.15)
    assert len(targets(housed)) == 2  # once


@pytest.mark.parametrize("what", ["stop", "teleop", "cancel", "pause"])
def test_who_takes_the_robot_keeps_it(housed: "Home", what: str, plan: "type[Plan]") -> None:
    housed.planner.script = [plan(seconds=100.0)]
    housed.start("corridor", "kitchen")
    live(housed, 12, 0.15)
    match what:
        case "stop":
            live(housed, 3, 0.04, mode="stopped", reason=codes.BUTTON)
        case "teleop":
            live(housed, 3, 0.04, source="teleop")
        case "cancel":
            housed.lockstep.ask(requests.TOUR_STOP)
        case "pause":
            housed.lockstep.ask(requests.TOUR_PAUSE)
    live(housed, 60, 0.04)
    assert len(targets(housed)) == 1


def test_a_stop_on_the_way_home_holds_there(housed: "Home", plan: "type[Plan]") -> None:
    housed.planner.script = [plan(seconds=100.0), plan(seconds=100.0)]
    housed.start("corridor", "kitchen")
    live(housed, 13, 0.09)
    live(housed, 2, 0.09, mode="stopped", reason=codes.BUTTON)
    live(housed, 60, 0.09)
    assert housed.status.state == "paused"
    assert len(targets(housed)) == 2


def test_who_ends_the_way_home_ends_the_tour(housed: "Home", plan: "type[Plan]") -> None:
    housed.planner.script = [plan(seconds=100.0), plan(seconds=100.0)]
    first = housed.start("corridor", "kitchen")
    live(housed, 13, 0.09)
    housed.lockstep.ask(requests.TOUR_STOP)
    live(housed, 60, 0.09)
    assert (housed.status.state, housed.status.trip) == ("stopped", first.trip)
    assert len(targets(housed)) == 2


def test_another_tour_takes_the_place_of_both(housed: "Home", plan: "type[Plan]") -> None:
    housed.planner.script = [plan(seconds=100.0), plan(seconds=100.0)]
    housed.start("corridor", "kitchen")
    live(housed, 13, 0.15)
    live(housed, 13, 0.09)
    housed.start("entrance")
    live(housed, 6, 0.5)
    assert housed.status.state == "done"
    past = housed.lockstep.ask(requests.TOUR_HISTORY, requests.TOUR_HISTORY.params())
    assert sorted(trip.state for trip in past) == ["done", "stopped", "stopped"]


def test_without_a_home_the_trip_goes_on_and_it_is_said(home: "Home") -> None:
    health = home.lockstep.record(topics.HEALTH, "tour")
    home.start("corridor", "kitchen")
    live(home, 20, 0.08)
    assert home.status.state == "done"
    assert "no place “home”" in health[-1].message


def test_a_home_on_another_map_is_named(home: "Home") -> None:
    health = home.lockstep.record(topics.HEALTH, "tour")
    upstairs = SavedPose(name="home", map="upstairs", pose=HOME_POSE)
    home.lockstep.ask(requests.POSES_PUT, upstairs)
    home.start("corridor")
    live(home, 20, 0.08)
    assert "'home' is on the map upstairs, the robot is on apartment" in health[-1].message


def test_at_home_already_it_stays(housed: "Home") -> None:
    housed.localizer.estimate = housed.localizer.estimate.__class__(
        stamp_ns=0,
        map="apartment",
        pose=HOME_POSE,
        covariance=housed.localizer.estimate.covariance,
        state="localized",
        match=0.9,
        spread=0.0,
    )
    housed.lockstep.ask(requests.GOAL_SEND, SendGoal(id="abc", pose=HOME_POSE))
    live(housed, 60, 0.15)
    assert len(targets(housed)) == 1


def test_a_restart_on_the_way_home_goes_on(housed: "Home", plan: "type[Plan]") -> None:
    housed.planner.script = [plan(seconds=100.0), plan(seconds=20.0)]
    first = housed.start("corridor", "kitchen")
    live(housed, 13, 0.09)
    assert targets(housed)[-1] == HOME_POSE
    housed.restart_tour()
    live(housed, 25, 0.09)
    assert (housed.status.state, housed.status.trip) == ("paused", first.trip)
    housed.restart_tour()
    live(housed, 12, 0.9)
    assert (housed.status.state, housed.status.trip) == ("paused", first.trip)
    housed.lockstep.ask(requests.TOUR_RESUME)
    live(housed, 12, 0.9)
    assert housed.status.state == "done"


def test_zero_switches_it_off(make_home: "Callable[..., Home]") -> None:
    home = make_home(low_battery=0.0)
    home.save_places()
    save_home(home)
    home.start("corridor", "kitchen")
    live(home, 20, 0.0)
    assert home.status.state == "done"
    assert HOME_POSE not in targets(home)


def test_a_base_without_a_battery_changes_nothing(housed: "Home") -> None:
    housed.start("corridor", "kitchen")
    live(housed, 20, None)
    assert housed.status.state == "done"


def test_a_home_that_cannot_be_reached_is_told_with_the_tour_that_waits(
    housed: "Home", plan: "type[Plan]"
) -> None:
    blocked = plan(state="failed", reason=codes.BLOCKED, message="The way is blocked.")
    housed.planner.script = [plan(seconds=12.0), *[blocked] * 30]
    first = housed.start(Stop(name="corridor"), "kitchen")
    live(housed, 1200, 0.15)
    assert (housed.status.trip, housed.status.state) == (first.trip, "paused")
    assert "blocked" in housed.status.message


def test_a_scheduled_tour_waits_for_a_charged_battery(
    housed: "Home", monkeypatch: pytest.MonkeyPatch
) -> None:
    due = datetime.datetime(2026, 11, 2, 12, 0, 5, tzinfo=datetime.UTC)
    schedule = [ScheduleEntry(at=f"{due.astimezone():%H:%M}")]
    tour = Tour(name="dawn", stops=[Stop(name="kitchen")], schedule=schedule)
    housed.lockstep.ask(requests.TOURS_PUT, tour)
    live(housed, 12, 0.1)
    for now in ((due - datetime.timedelta(seconds=30)).isoformat(), due.isoformat()):
        monkeypatch.setattr(type(housed.tour), "utc_now", lambda _, now=now: now)
        live(housed, 3, 0.1)
    assert housed.planner.sent == []
    assert housed.lockstep.counters("tour")["schedule/skipped"] == 1


def test_a_robot_with_a_low_battery_does_not_offer_itself(home: "Home") -> None:
    live(home, 12, 0.9)
    offer = home.lockstep.ask(requests.TOUR_OFFER, AskOffer(pose=HOME_POSE))
    assert (offer.free, offer.reason) == (True, "")
    live(home, 12, 0.1)
    offer = home.lockstep.ask(requests.TOUR_OFFER, AskOffer(pose=HOME_POSE))
    assert (offer.free, offer.reason) == (False, codes.LOW_BATTERY)


def low_battery(home: "Home", value: float) -> None:
    """Let another charge count as low, as base says it when somebody has set it."""
    change = ChangedSetting(section="tour", key="low_battery", value=value)
    home.lockstep.publish(topics.CONFIG, ConfigChanges(stamp_ns=0, changes=[change]))


def test_what_counts_as_low_can_be_changed_on_the_way(housed: "Home", plan: "type[Plan]") -> None:
    housed.planner.script = [plan(seconds=30.0)]
    housed.start("corridor")
    live(housed, 12, 0.4)
    low_battery(housed, 0.5)
    live(housed, 60, 0.4)
    assert targets(housed)[-1] == HOME_POSE


def test_a_robot_that_stands_is_not_set_off_by_a_change_of_what_is_low(
    housed: "Home", plan: "type[Plan]"
) -> None:
    housed.planner.script = [plan(seconds=3.0)]
    housed.start("corridor")
    live(housed, 12, 0.4)
    assert housed.status.state == "done"
    low_battery(housed, 0.9)
    live(housed, 90, 0.4)
    assert HOME_POSE not in targets(housed)


def test_a_lower_limit_takes_back_that_the_battery_is_low(
    housed: "Home", plan: "type[Plan]"
) -> None:
    housed.planner.script = [plan(seconds=30.0)]
    housed.start("corridor")
    live(housed, 12, 0.18)
    low_battery(housed, 0.1)
    live(housed, 60, 0.18)
    assert housed.status.state == "done"
    assert HOME_POSE not in targets(housed)
