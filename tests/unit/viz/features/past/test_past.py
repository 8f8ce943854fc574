"""The past in the viewer: what is recorded, who looks at it, and how one returns to now."""

import datetime
import os
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np
import pytest
from support.pages import PageOf, page_of

from trolley import codes, requests, topics
from trolley.geometry import Pose2D
from trolley.messages import GoalStatus, PastTrip, StopResult, TourStatus
from trolley.messages.request_params import AskHistory, Nothing
from trolley.runtime.service import Service, answers
from trolley_viz.features.past.drawing import HIDDEN
from trolley_viz.features.past.keeper import FIRST_SAVE_NS
from trolley_viz.features.past.record import POSE, SCAN
from trolley_viz.features.past.recorder import AFTER_TRIP_NS, KEPT_NS
from trolley_viz.features.past.trip_file import decode
from trolley_viz.features.past.trip_store import FOLDER, MAX_BYTES, MAX_TRIPS
from trolley_viz.joystick.joystick import Grip
from trolley_viz.server.messages import Resume, Said, Stop
from trolley_viz.server.visitors import Visitor
from trolley_viz.server.web_server import close_scene
from trolley_viz.service import VizService

if TYPE_CHECKING:
    from ...conftest import Stage

FAILED = StopResult(
    stop=1,
    name="kitchen",
    state="failed",
    code=codes.BLOCKED,
    message="Stop 2 (kitchen): something is in the way and does not move; the trip was given up.",
    started_at="2026-11-21T10:00:05Z",
    seconds=5.0,
)
TRIP = TourStatus(stamp_ns=0, name="round", trip="t1", state="driving", stop=0)


class PretendTour(Service):
    """Says what trip is under way, and which there were."""

    name = "tour"

    def __init__(self) -> None:
        self.past: list[PastTrip] = []

    def say(self, **rest: Any) -> None:
        self.publish(topics.TOUR, msgspec.structs.replace(TRIP, **rest))

    @answers(requests.TOUR_HISTORY)
    def history(self, params: AskHistory) -> list[PastTrip]:
        return self.past

    @answers(requests.TOUR_RESUME)
    def go_on(self, params: Nothing) -> TourStatus:
        return TRIP


@pytest.fixture
def tour(stage: "Stage") -> PretendTour:
    return stage.runtime.add(PretendTour())


def drive(stage: "Stage", seconds: float, speed: float = 0.2) -> None:
    """Drive along x."""
    for _ in range(round(seconds / 0.1)):
        stage.robot.driven_m += 0.1 * speed
        stage.runtime.run(0.1)


def restart(stage: "Stage") -> None:
    """Kill the viewer, and start it again."""
    stage.runtime.kill("viz")
    stage.viz._web.close()
    close_scene(stage.viz._scene)
    stage.browsers.clear()
    stage.viz = stage.runtime.add(VizService(stage.config))


def open_past(stage: "Stage", client_id: int = 0) -> PageOf:
    page = page_of(stage, client_id)
    page.press("Past")
    stage.runtime.run(0.5)
    return page


def look_back(stage: "Stage", seconds: float, client_id: int = 0) -> None:
    """Drag the slider to so long ago."""
    page = page_of(stage, client_id)
    page.type("Time of day", page.value("Time of day") - seconds)
    stage.runtime.run(0.5)


def ghost(stage: "Stage", client_id: int = 0) -> Any:
    return stage.drawn(client_id).past.ghost


def record(stage: "Stage", robot: str = "trolley") -> Any:
    return stage.viz.past.lately(robot)


# What is recorded.
def test_the_robot_is_recorded_while_nobody_looks(stage: "Stage") -> None:
    drive(stage, 10.0)
    assert stage.streams() == set()
    poses = record(stage).poses.rows
    assert 17 <= len(poses) <= 21
    assert poses["x"][-1] - poses["x"][0] == pytest.approx(1.9, abs=0.2)
    assert 7 <= len(record(stage).scans.rows) <= 10
    assert record(stage).sentences


def test_a_robot_that_stands_is_scanned_seldom(stage: "Stage") -> None:
    stage.runtime.run(61.0)
    assert len(record(stage).scans.rows) in (6, 7)


def test_the_scan_lies_where_it_was_seen(stage: "Stage") -> None:
    drive(stage, 5.0)
    then = record(stage).at(stage.viz.monotonic_ns - 10**9)
    assert then.scan.shape == (2, 2)  # the other two beams have no echo
    laser_x = then.scan[0, 0] - 1.0
    assert laser_x == pytest.approx(then.pose.x + 0.1, abs=0.25)
    assert then.scan[1].tolist() == pytest.approx([laser_x, -2.0], abs=0.02)


def test_ten_minutes_are_kept(stage: "Stage") -> None:
    stage.runtime.run(KEPT_NS * 1e-9 + 60.0)
    kept = record(stage)
    assert kept.last_ns - kept.first_ns == pytest.approx(KEPT_NS, abs=2e9)
    assert len(kept.poses.rows) <= 1200


def test_what_happens_while_the_robot_is_away_and_when_it_begins_anew(stage: "Stage") -> None:
    drive(stage, 5.0)
    stage.runtime.kill("base")
    stage.runtime.run(8.0)
    gone_ns = stage.viz.monotonic_ns
    stage.robot = stage.runtime.add(type(stage.robot)())
    stage.robot.epoch = 10**15  # its clock has jumped
    drive(stage, 5.0)
    then = record(stage).at(gone_ns - 10**9)
    assert then.pose is None
    assert then.words.headline.startswith("No contact")
    now = record(stage).at(stage.viz.monotonic_ns)
    assert now.pose is not None
    assert now.scan is not None
    assert (np.diff(record(stage).poses.rows["at_ns"]) > 0).all()


def test_another_robot_is_recorded_while_it_is_followed(stage: "Stage") -> None:
    stage.browse()
    stage.runtime.add(type(stage.robot)(), robot="kart")
    stage.runtime.run(3.0)
    assert record(stage, "kart").first_ns is None
    stage.session.follow("kart")
    stage.runtime.run(3.0)
    first_ns = record(stage, "kart").first_ns
    assert first_ns is not None
    stage.session.follow("trolley")
    stage.runtime.run(3.0)
    assert record(stage, "kart").first_ns is None
    stage.session.follow("kart")
    stage.runtime.run(1.0)
    assert record(stage, "kart").first_ns == first_ns


# Looking back.
def test_the_past_opens_and_closes(stage: "Stage") -> None:
    browser = stage.browse()
    page = page_of(stage)
    assert not page.is_shown("Time of day")
    open_past(stage)
    assert page.is_shown("Time of day")
    assert "Recorded since" in page.text()
    assert not stage.session.past.is_past
    stage.runtime.run(1.0)
    page.press("Close the past")
    stage.runtime.run(0.5)
    assert not page.is_shown("Time of day")
    assert not browser.state.sentence.headline.startswith("At ")


def test_who_looks_back_sees_where_the_robot_was_and_that_it_is_the_past(stage: "Stage") -> None:
    browser = stage.browse()
    drive(stage, 30.0)
    was_x = 1.5 + stage.robot.driven_m - 2.0
    now = browser.state.sentence
    open_past(stage)
    look_back(stage, 10.0)
    assert ghost(stage).position[0] == pytest.approx(was_x, abs=0.35)
    state = browser.state
    assert state.sentence.headline.startswith("At ")
    assert "10 s ago: " in state.sentence.headline or "11 s ago: " in state.sentence.headline
    assert state.sentence.headline.endswith(now.headline)
    assert state.sentence.tone == "idle"
    assert state.lines[0].headline == f"Now: {now.headline}"
    assert not any(stage.drawn().is_visible("trolley", layer) for layer in HIDDEN)
    assert stage.drawn().is_visible("trolley", "map")
    page_of(stage).press("Now")
    stage.runtime.run(0.5)
    assert ghost(stage) is None
    assert stage.drawn().is_visible("trolley", "robot")
    assert browser.state.sentence == now


def test_the_past_is_told_in_the_time_zone_of_the_page(stage: "Stage") -> None:
    browser = stage.browse()
    drive(stage, 30.0)
    stage.say(browser, Said(time_zone="Asia/Kolkata"))
    open_past(stage)
    look_back(stage, 10.0)
    at = stage.session.past.wall_time(stage.session.past.at_ns)
    assert at.utcoffset() == datetime.timedelta(hours=5, minutes=30)
    assert browser.state.sentence.headline.startswith(f"At {at:%H:%M:}")
    assert "10 s ago: " in browser.state.sentence.headline


def test_what_was_before_the_computer_slept_is_told_with_the_time_at_which_it_was(
    stage: "Stage", tour: PretendTour
) -> None:
    tour.say()
    drive(stage, 10.0)
    recorder = stage.viz.past._recorders["trolley"]
    assert recorder.trip is not None
    both = (recorder.record, recorder.trip.record)
    stage.browse()
    wall_time = stage.session.past.wall_time
    before = [wall_time(one.poses.rows["at_ns"][0]) for one in both]
    stage.runtime.slept_ns += 300_000_000_000
    drive(stage, 10.0)
    assert [wall_time(one.poses.rows["at_ns"][0]) for one in both] == before
    assert wall_time(recorder.record.last_ns) - before[0] > datetime.timedelta(seconds=315)


def test_a_page_that_looks_back_shows_the_same_moment_after_the_computer_slept(
    stage: "Stage",
) -> None:
    browser = stage.browse()
    drive(stage, 60.0)
    open_past(stage)
    look_back(stage, 20.0)
    past = stage.session.past
    at = past.wall_time(past.at_ns)
    stage.runtime.slept_ns += 300_000_000_000
    stage.runtime.run(0.5)
    assert past.wall_time(past.at_ns) == at
    assert "5 min ago: " in browser.state.sentence.headline


def test_what_plays_does_not_play_on_while_the_computer_sleeps(stage: "Stage") -> None:
    stage.browse()
    drive(stage, 60.0)
    open_past(stage)
    look_back(stage, 50.0)
    page_of(stage).press("Play")
    past = stage.session.past
    at = past.wall_time(past.at_ns)
    stage.runtime.slept_ns += 300_000_000_000
    stage.runtime.run(1.0)
    assert past.is_past
    assert past.wall_time(past.at_ns) - at < datetime.timedelta(seconds=2)


def test_what_is_known_of_a_robot_that_was_followed_before_the_computer_slept_keeps_its_time(
    stage: "Stage",
) -> None:
    stage.browse()
    stage.runtime.add(type(stage.robot)(), robot="kart")
    stage.session.follow("kart")
    stage.runtime.run(5.0)
    first_ns = record(stage, "kart").first_ns
    assert first_ns is not None
    wall_time = stage.session.past.wall_time
    began = wall_time(first_ns)
    stage.session.follow("trolley")
    stage.runtime.run(3.0)
    stage.runtime.slept_ns += 300_000_000_000
    stage.session.follow("kart")
    stage.runtime.run(1.0)
    again_ns = record(stage, "kart").first_ns
    assert again_ns is not None
    assert wall_time(again_ns) == began


def test_each_page_looks_at_a_time_of_its_own(stage: "Stage") -> None:
    drive(stage, 20.0)
    for number in range(4):
        stage.browse(number)
    for number in range(1, 4):
        open_past(stage, number)
        look_back(stage, 4.0 * number, number)
    seen = [ghost(stage, number).position[0] for number in range(1, 4)]
    assert seen == sorted(seen, reverse=True)
    assert ghost(stage, 0) is None
    assert stage.drawn(0).is_visible("trolley", "robot")


def test_it_plays_and_ends_with_now(stage: "Stage") -> None:
    drive(stage, 30.0)
    stage.browse()
    page = open_past(stage)
    look_back(stage, 20.0)
    before = page.value("Time of day")
    page.press("Play")
    stage.runtime.run(3.0)
    assert page.value("Time of day") - before == pytest.approx(3.0, abs=1.1)
    page.press("Stop playing")
    stage.runtime.run(3.0)
    assert page.value("Time of day") - before == pytest.approx(3.0, abs=1.1)
    page.press("Play 8 times as fast")
    stage.runtime.run(4.0)
    assert not stage.session.past.is_past
    assert stage.session.past.is_open


def test_play_begins_with_the_earliest_moment(stage: "Stage") -> None:
    stage.browse()
    drive(stage, 10.0)
    page = open_past(stage)
    page.press("Play")
    stage.runtime.run(0.5)
    assert stage.session.past.at_ns < record(stage).first_ns + 10**9


def test_an_empty_record_leads_nowhere(stage: "Stage") -> None:
    stage.browse()
    stage.session.follow("nobody")
    stage.runtime.run(0.1)
    page = open_past(stage)
    stage.viz.past._recorders["nobody"].record.first_ns = None
    page.press("Play")
    page.press("Play 8 times as fast")
    assert not stage.session.past.is_past
    assert stage.session.past.speed == 0.0


def test_what_was_on_another_map_is_told_and_not_drawn(stage: "Stage") -> None:
    browser = stage.browse()
    drive(stage, 10.0)
    kept = record(stage)
    kept.maps[kept.maps.index("room")] = "house"
    open_past(stage)
    look_back(stage, 5.0)
    assert ghost(stage) is None
    assert "on the map “house”, which is not shown" in browser.state.sentence.headline
    assert not stage.drawn().is_visible("trolley", "robot")


def test_a_clock_that_is_set_moves_no_moment(
    stage: "Stage", monkeypatch: pytest.MonkeyPatch
) -> None:
    browser = stage.browse()
    drive(stage, 20.0)
    page = open_past(stage)
    look_back(stage, 10.0)
    was_x = ghost(stage).position[0]
    monkeypatch.setattr(VizService, "unix_ns", property(lambda one: one.monotonic_ns + 10**18))
    stage.runtime.run(0.5)
    assert ghost(stage).position[0] == was_x
    assert " s ago: " in browser.state.sentence.headline
    page.type("Time of day", page.value("Time of day") + 5.0)
    stage.runtime.run(0.5)
    assert ghost(stage).position[0] == pytest.approx(was_x + 1.0, abs=0.25)


def test_what_went_wrong_is_listed_and_leads_there(stage: "Stage") -> None:
    browser = stage.browse()
    stage.runtime.run(5.0)
    stage.robot.mode = "stopped"
    drive(stage, 3.0)
    stage.robot.mode = "ok"
    drive(stage, 10.0)
    page = open_past(stage)
    marks = [one.look.marks for one in stage.page().controls.all.values() if one.look.marks]
    assert "bad" in {tone for _, tone in marks[0]}
    page.press_lead("Press “Drive on”")
    stage.runtime.run(0.5)
    assert "Press “Drive on”" in browser.state.sentence.headline
    assert not browser.state.is_stopped  # that is what is, not what was


@pytest.mark.slow
def test_who_looked_away_for_long_goes_on_with_what_is_still_there(stage: "Stage") -> None:
    stage.browse()
    stage.runtime.run(20.0)
    page = open_past(stage)
    look_back(stage, 4.0)
    page.press("Play")
    stage.runtime.run(0.5)
    page.press("Stop playing")
    stage.runtime.run(KEPT_NS * 1e-9 + 30.0)
    page.press("Play")
    stage.runtime.run(6.0)
    assert stage.session.past.is_past
    assert stage.session.past.at_ns >= record(stage).first_ns - 10**9
    assert ghost(stage) is not None


# Back to now.
def test_stop_drive_on_and_the_joystick_work_and_return_to_now(stage: "Stage") -> None:
    browser = stage.browse()
    drive(stage, 10.0)
    open_past(stage)
    look_back(stage, 5.0)
    stage.say(browser, Said(stop=Stop(id=1, robots=["trolley"])))
    stage.runtime.run(0.5)
    assert stage.robot.mode == "stopped"
    assert browser.state.is_stopped
    assert not stage.session.past.is_past

    look_back(stage, 5.0)
    stage.say(browser, Said(resume=Resume(id=2, at_ms=stage.now_ms, robot="trolley")))
    stage.runtime.run(0.5)
    assert stage.robot.mode == "ok"
    assert not stage.session.past.is_past

    look_back(stage, 5.0)
    grip = Grip(x=0.0, y=0.0, held=False, speed=0.2, sent_ms=1.0)
    stage.say(browser, Said(grip=grip))
    assert stage.session.past.is_past
    stage.say(browser, Said(grip=msgspec.structs.replace(grip, held=True, sent_ms=2.0)))
    assert not stage.session.past.is_past


def test_what_moves_the_robot_returns_to_now(stage: "Stage") -> None:
    stage.browse()
    drive(stage, 10.0)
    page = open_past(stage)
    look_back(stage, 5.0)
    page.press("kitchen")
    assert not stage.session.past.is_past
    stage.runtime.run(0.5)
    assert [one.name for one in stage.robot.goals] == ["kitchen"]
    look_back(stage, 5.0)
    page.press("Set pose …")
    stage.runtime.run(0.5)
    assert not stage.session.past.is_past


def test_who_follows_another_robot_sees_it_as_it_is(stage: "Stage") -> None:
    stage.browse()
    stage.runtime.add(type(stage.robot)(), robot="kart")
    drive(stage, 10.0)
    open_past(stage)
    look_back(stage, 5.0)
    stage.session.follow("kart")
    stage.runtime.run(1.0)
    assert not stage.session.past.is_open
    assert ghost(stage) is None


def test_who_only_looks_may_look_back(stage: "Stage") -> None:
    stage.browse(0, Visitor("guest", "viewer"))
    drive(stage, 10.0)
    open_past(stage)
    look_back(stage, 5.0)
    assert ghost(stage) is not None


# Trips.
def take_trip(stage: "Stage", tour: PretendTour) -> None:
    """Drive a trip whose second stop fails after 10 s, and wait until it is written."""
    for _ in range(5):
        tour.say()
        drive(stage, 2.0)
    tour.say(seconds=10.0, results=[FAILED])
    drive(stage, 10.0)
    tour.say(state="failed", seconds=20.0, results=[FAILED])
    stage.runtime.run(AFTER_TRIP_NS * 1e-9 + 2.0)
    past = PastTrip(
        trip="t1",
        name="round",
        state="failed",
        started_at="2026-11-21T10:00:00Z",
        results=[FAILED],
    )
    tour.past = [past]


def test_a_failed_stop_leads_to_its_moment(stage: "Stage", tour: PretendTour) -> None:
    browser = stage.browse()
    stage.runtime.run(1.0)
    take_trip(stage, tour)
    page = page_of(stage).within("Tours")
    page.press("Past trips")
    stage.runtime.run(2.0)
    page.press_lead("Show the moment")
    stage.runtime.run(0.5)
    assert browser.state.sentence.headline.endswith(f" ago: {FAILED.message}")
    assert ghost(stage).position[0] == pytest.approx(1.5 + 10 * 0.2, abs=0.4)
    page.press_lead("Look at it")
    stage.runtime.run(0.5)
    assert ghost(stage).position[0] == pytest.approx(1.5, abs=0.4)
    assert "The trip “round”" in page_of(stage).text()
    page_of(stage).press("Now")
    stage.runtime.run(0.5)
    assert ghost(stage) is None


def test_a_trip_is_found_after_the_viewer_was_restarted(
    stage: "Stage", tour: PretendTour, tmp_path: Path
) -> None:
    take_trip(stage, tour)
    (file,) = files(tmp_path)
    kept, _ = decode(file.read_bytes())
    restart(stage)
    browser = stage.browse()
    stage.runtime.run(2.0)
    page = page_of(stage).within("Tours")
    page.press("Past trips")
    stage.runtime.run(2.0)
    page.press_lead("Show the moment")
    stage.runtime.run(0.5)
    assert browser.state.sentence.headline.endswith(f" ago: {FAILED.message}")
    assert kept.failures[0].stop == 1


def test_a_failure_that_was_not_noted_is_found_by_its_times(
    stage: "Stage", tour: PretendTour
) -> None:
    stage.runtime.run(1.0)
    take_trip(stage, tour)
    stage.browse()
    recorded = stage.viz.past._recorders["trolley"].trip
    assert recorded is not None
    recorded.record.failures.clear()
    stage.session.past.show_trip(tour.past[0], FAILED)
    stage.runtime.run(0.5)
    assert ghost(stage).position[0] == pytest.approx(1.5 + 10 * 0.2, abs=0.5)


def files(folder: Path) -> list[Path]:
    return sorted(folder.rglob(f"{FOLDER}/**/*.trip*"))


def test_a_trip_under_way_is_written_now_and_then_and_goes_on_after_a_restart(
    stage: "Stage", tour: PretendTour, tmp_path: Path
) -> None:
    tour.say()
    drive(stage, FIRST_SAVE_NS * 1e-9 + 2.0)
    (file,) = files(tmp_path)
    first, _ = decode(file.read_bytes())
    restart(stage)
    tour.say()
    drive(stage, 5.0)
    tour.say(state="done")
    stage.runtime.run(AFTER_TRIP_NS * 1e-9 + 2.0)
    whole, _ = decode(file.read_bytes())
    assert len(whole.poses.rows) > len(first.poses.rows)
    assert whole.first_ns is not None
    assert first.first_ns is not None
    assert whole.last_ns - whole.first_ns > 65e9


@pytest.mark.parametrize(
    ("content", "mark"),
    [
        (b"", "broken"),
        (b"nothing of ours", "broken"),
        (msgspec.msgpack.encode({"schema": 1, "songs": []}), "broken"),
        (msgspec.msgpack.encode({"schema": 99}), "newer"),
    ],
)
def test_a_file_that_cannot_be_read_is_kept_and_told(
    stage: "Stage", tour: PretendTour, tmp_path: Path, content: bytes, mark: str
) -> None:
    take_trip(stage, tour)
    (file,) = files(tmp_path)
    file.write_bytes(content)
    restart(stage)
    browser = stage.browse()
    stage.session.past.show_trip(tour.past[0])
    stage.runtime.run(0.5)
    assert not stage.session.past.is_past
    (title, text) = browser.notices[-1]
    (aside,) = files(tmp_path)
    assert title == "The trip cannot be shown"
    assert aside.name in text
    assert f".{mark}-" in aside.name
    assert aside.read_bytes() == content
    assert not stage.viz.past.has_trip("trolley", "t1")


@pytest.mark.parametrize("cut", range(5, 100, 12))
def test_no_damaged_file_breaks_the_viewer(
    stage: "Stage", tour: PretendTour, tmp_path: Path, cut: int
) -> None:
    take_trip(stage, tour)
    (file,) = files(tmp_path)
    content = bytearray(file.read_bytes())
    at = len(content) * cut // 100
    content[at : at + 3] = b"\xff\x00\xc1"
    file.write_bytes(bytes(content))
    restart(stage)
    stage.browse()
    stage.session.past.show_trip(tour.past[0])
    stage.runtime.run(1.0)
    assert len(files(tmp_path)) == 1


def test_the_newest_trips_are_kept(stage: "Stage", tmp_path: Path) -> None:
    stage.runtime.run(1.0)
    folder = stage.viz.state.path / FOLDER / "trolley"
    folder.mkdir(parents=True)
    for number in range(MAX_TRIPS + 5):
        (folder / f"t{number}.trip").write_bytes(b"x")
    stage.viz.past.store.open()
    assert len(files(tmp_path)) == MAX_TRIPS
    for file in files(tmp_path)[:3]:
        file.write_bytes(b"x" * (MAX_BYTES // 2))
    stage.viz.past.store.open()
    assert sum(file.stat().st_size for file in files(tmp_path)) <= MAX_BYTES


def test_the_newest_trips_are_kept_also_where_the_clock_was_set_back(
    stage: "Stage", tour: PretendTour, tmp_path: Path
) -> None:
    folder = stage.viz.state.path / FOLDER / "trolley"
    folder.mkdir(parents=True)
    next_year_s = time.time() + 3e7
    for number in range(MAX_TRIPS):
        file = folder / f"old{number}.trip"
        file.write_bytes(b"x")
        os.utime(file, (next_year_s + number, next_year_s + number))
    take_trip(stage, tour)
    tour.say(trip="t2")
    drive(stage, 5.0)
    tour.say(trip="t2", state="done")
    drive(stage, 6.0)
    names = {file.name for file in files(tmp_path)}
    assert names == {"t1.trip", "t2.trip", *(f"old{n}.trip" for n in range(2, MAX_TRIPS))}


def test_the_columns_of_the_tables_belong_to_the_schema() -> None:
    """Whoever changes them counts up the schema of `TripFile`."""
    assert POSE.descr == [
        ("at_ns", "<i8"),
        ("robot_ns", "<i8"),
        ("x", "<f4"),
        ("y", "<f4"),
        ("yaw", "<f4"),
        ("state", "|u1"),
        ("map", "<u2"),
    ]
    assert SCAN.descr == [
        ("at_ns", "<i8"),
        ("x", "<f4"),
        ("y", "<f4"),
        ("map", "<u2"),
        ("count", "<u2"),
        ("points_cm", "<i2", (120, 2)),
    ]


def test_a_robot_that_finds_its_place_draws_no_line_there(stage: "Stage") -> None:
    stage.browse()
    drive(stage, 5.0)
    stage.robot.driven_m += 20.0
    drive(stage, 5.0)
    track = record(stage).track(stage.viz.monotonic_ns, 0, "room")
    assert len(track) > 5
    assert np.hypot(*(track[:, 1] - track[:, 0]).T).max() < 1.0
    assert isinstance(record(stage).at(stage.viz.monotonic_ns).pose, Pose2D)


def test_a_trip_is_written_also_where_the_next_begins_at_once(
    stage: "Stage", tour: PretendTour, tmp_path: Path
) -> None:
    tour.say()
    drive(stage, 5.0)
    tour.say(trip="t2")
    drive(stage, 5.0)
    assert [file.name for file in files(tmp_path)] == ["t1.trip"]
    stage.viz.past.stop()
    assert [file.name for file in files(tmp_path)] == ["t1.trip", "t2.trip"]


def test_nothing_goes_wrong_while_the_viewer_starts(stage: "Stage") -> None:
    stage.robot.publish(topics.GOAL, GoalStatus(stamp_ns=0, id=None, state="idle"))
    drive(stage, 6.0)
    assert record(stage).troubles() == []


def test_a_robot_of_any_name_leads_to_no_other_folder(stage: "Stage", tmp_path: Path) -> None:
    drive(stage, 2.0)
    before = sorted(tmp_path.rglob("*"))
    store = stage.viz.past.store
    store.save(("..", "t1"), record(stage).copy())
    store.save(("a/../../b", "t1"), record(stage).copy())
    store.save_now(("trolley", "../t1"), record(stage).copy())
    assert sorted(tmp_path.rglob("*")) == before
