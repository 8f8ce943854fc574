"""What goes wrong while a map is made: nothing is lost, nothing is bent, and it is said."""

import errno
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from msgspec.structs import replace
from support.flatland import Flatland

from trolley import codes, requests, topics
from trolley.codes import Refused
from trolley.geometry import Pose2D, Twist2D
from trolley.gridmap import GridMap, MapError
from trolley.gridmap.wire import map_message
from trolley.messages import PoseEstimate, SavedPose, Stop, Tour, Zone, Zones
from trolley.messages.request_params import Capture, MapNamed, Named, PauseMap, SaveMap
from trolley.runtime import state
from trolley.runtime.lockstep import _LockstepHost
from trolley.runtime.service import Service, every
from trolley.scan_matching.sweep import read_sweep
from trolley.scanning import ScanInput
from trolley_mapper import checkpoint, mapping
from trolley_mapper.edit.map_versions import MapVersions
from trolley_mapper.handover import Handover, MapSaver
from trolley_mapper.service import MapperService
from trolley_mapper.slam.anchors import Anchors
from trolley_mapper.slam.keyframe import Keyframe
from trolley_mapper.slam.keyframe_store import KeyframeStore
from trolley_mapper.slam.mapper import Mapper
from trolley_mapper.slam.pose_graph import ODOMETRY, Edge, between
from trolley_mapper.slam.serialization import State, pack
from trolley_mapper.wire import odom_transform
from trolley_tour.stored import checks

from .conftest import Stage

MakeStage = Callable[..., Stage]
KEPT_S = 6.0


Work = Callable[[], Any]
HeldUp = list[tuple[Work, Callable[[Any], None]]]


@contextmanager
def held_up(
    monkeypatch: pytest.MonkeyPatch, is_held: Callable[[Work], bool] = lambda _: True
) -> Iterator[HeldUp]:
    """Hold up work in the background that is begun meanwhile; `finish` does it."""
    held: HeldUp = []

    def work(_: _LockstepHost, fn: Work, done: Callable[[Any], None]) -> None:
        held.append((fn, done)) if is_held(fn) else done(fn())

    with monkeypatch.context() as computer:
        computer.setattr(_LockstepHost, "work", work)
        yield held


def finish(held: HeldUp) -> None:
    for fn, done in held:
        done(fn())


@pytest.fixture
def often(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the map be kept every five seconds, so that no test waits for long."""
    monkeypatch.setattr(checkpoint, "PERIOD_NS", 5_000_000_000)


@pytest.mark.usefixtures("often")
def test_a_mapper_that_is_killed_goes_on_with_its_map(stage: Stage) -> None:
    true_T_map = stage.map(seconds=4.0)
    stage.bus.run(KEPT_S)
    scans = stage.status.scans
    stage.bus.kill("mapper")
    stage.bus.run(1.0)
    stage.begin("mapper")
    stage.drive(3.0, 0.2)
    assert stage.status.state == "mapping"
    assert stage.status.scans >= scans
    assert (stage.pose.state, stage.pose.map) == ("mapping", "home")
    assert stage.error_m(true_T_map) < 0.08
    stage.ask(requests.MAP_SAVE, SaveMap())
    stage.bus.run(2.0)
    assert stage.pose.state == "localized"
    assert stage.error_m(stage.straightened(true_T_map)) < 0.08


def killed_after_a_drive(stage: Stage, meanwhile: Callable[[], object]) -> Pose2D:
    """Let a mapper be killed that was last kept when its map began; returns true_T_map."""
    true_T_map = stage.map(seconds=8.0)
    assert stage.world.map_T_base.distance_to(true_T_map) > 0.8
    stage.bus.kill("mapper")
    meanwhile()
    stage.begin("mapper")
    stage.bus.run(5.0)
    return true_T_map


def test_a_mapper_that_is_killed_follows_the_wheels_from_when_its_map_was_kept(
    stage: Stage,
) -> None:
    true_T_map = killed_after_a_drive(stage, lambda: stage.drive(1.0, 0.2))
    assert (stage.pose.state, stage.status.loose) == ("mapping", 0)
    assert stage.status.message == (
        "Continuing the map home. What was mapped in the half minute before may be missing."
    )
    assert stage.error_m(true_T_map) < 0.08
    scans = stage.status.scans
    stage.drive(2.0, 0.2)
    assert stage.status.scans > scans
    assert stage.error_m(true_T_map) < 0.08


def test_a_mapper_that_is_killed_knows_that_the_robot_was_carried_meanwhile(stage: Stage) -> None:
    def carry() -> None:
        stage.world.pose = Pose2D(6.0, 2.0, 1.0)

    killed_after_a_drive(stage, carry)
    assert (stage.pose.state, stage.status.loose) == ("lost", 1)


def test_the_wheels_of_another_run_of_base_say_nothing_to_a_mapper_that_was_killed(
    stage: Stage,
) -> None:
    killed_after_a_drive(stage, stage.base.restart)
    assert (stage.pose.state, stage.status.loose) == ("lost", 1)


def map_with_bed(stage: Stage) -> None:
    """Begin a map and save where the robot stands."""
    stage.map(seconds=3.0)
    stage.bus.run(1.5)
    stage.ask(requests.POSE_CAPTURE, Capture(name="bed"))


def test_a_mapper_that_is_killed_just_after_its_map_began_goes_on_with_it(
    make_stage: MakeStage,
) -> None:
    stage = make_stage("localizer", "mapper", "tour")
    poses = stage.bus.record(topics.POSES)
    map_with_bed(stage)
    stage.bus.kill("mapper")
    stage.begin("mapper")
    stage.drive(2.0, 0.1)
    assert (stage.status.state, stage.status.name) == ("mapping", "home")
    stage.ask(requests.MAP_CANCEL)
    stage.bus.run(0.5)
    assert poses[-1].poses == []


@pytest.mark.usefixtures("often")
def test_places_go_with_a_map_that_was_begun_before_tour_ran_and_whose_robot_stood_still(
    make_stage: MakeStage,
) -> None:
    stage = make_stage("localizer", "mapper")
    stage.map(seconds=3.0)
    stage.bus.run(KEPT_S)
    stage.begin("tour")
    stage.bus.run(1.5)
    poses = stage.bus.record(topics.POSES)
    stage.ask(requests.POSE_CAPTURE, Capture(name="bed"))
    stage.bus.run(KEPT_S)
    stage.bus.kill("mapper")
    stage.begin("mapper")
    stage.bus.run(2.0)
    stage.ask(requests.MAP_CANCEL)
    stage.bus.run(0.5)
    assert poses[-1].poses == []


OLD = SavedPose(name="sofa", map="home", pose=Pose2D.identity(), saved_at="2026-10-01T08:00:00Z")
"""Of a map called home that is not there now."""


@pytest.mark.usefixtures("often")
def test_places_saved_before_the_mapper_was_killed_go_when_the_map_is_discarded(
    make_stage: MakeStage,
) -> None:
    stage = make_stage("localizer", "mapper", "tour")
    poses = stage.bus.record(topics.POSES)
    stage.ask(requests.POSES_PUT, OLD)
    map_with_bed(stage)
    stage.drive(KEPT_S, 0.1)
    stage.bus.run(1.5)
    stage.ask(requests.POSE_CAPTURE, Capture(name="desk"))
    stage.bus.kill("mapper")
    stage.begin("mapper")
    stage.drive(2.0, 0.1)
    stage.ask(requests.MAP_CANCEL)
    stage.bus.run(0.5)
    assert poses[-1].poses == [OLD]


@pytest.mark.usefixtures("often")
def test_an_unfinished_map_is_discarded_with_its_places_while_it_is_loaded(
    make_stage: MakeStage, monkeypatch: pytest.MonkeyPatch
) -> None:
    stage = make_stage("localizer", "mapper", "tour")
    poses = stage.bus.record(topics.POSES)
    stage.ask(requests.POSES_PUT, OLD)
    map_with_bed(stage)
    stage.drive(KEPT_S, 0.1)
    stage.bus.kill("mapper")
    with held_up(monkeypatch, lambda fn: getattr(fn, "func", None) is mapping._load):
        stage.begin("mapper")
        stage.bus.run(0.5)
        stage.ask(requests.MAP_CANCEL)
    stage.bus.run(0.5)
    assert poses[-1].poses == [OLD]


@pytest.mark.usefixtures("often")
def test_an_extended_map_keeps_its_places_where_it_is_discarded_while_it_is_loaded(
    make_stage: MakeStage, monkeypatch: pytest.MonkeyPatch
) -> None:
    stage = make_stage("localizer", "mapper", "tour")
    poses = stage.bus.record(topics.POSES)
    stage.map(seconds=3.0)
    stage.ask(requests.MAP_SAVE, SaveMap())
    stage.bus.run(3.0)
    stage.ask(requests.MAP_EXTEND, MapNamed(name="home"))
    stage.drive(2.0, 0.1)
    stage.ask(requests.POSES_PUT, SavedPose(name="bed", map="home", pose=Pose2D.identity()))
    stage.drive(KEPT_S, 0.1)
    stage.bus.kill("mapper")
    with held_up(monkeypatch, lambda fn: getattr(fn, "func", None) is mapping._load):
        stage.begin("mapper")
        stage.bus.run(0.5)
        assert stage.status.extends == "home"
        status = stage.ask(requests.MAP_CANCEL)
    stage.bus.run(0.5)
    assert status.message == "What was added to the map home was discarded."
    assert [one.name for one in poses[-1].poses] == ["bed"]


def test_places_of_a_discarded_map_that_cannot_be_deleted_are_told_of(
    make_stage: MakeStage, monkeypatch: pytest.MonkeyPatch
) -> None:
    stage = make_stage("localizer", "mapper", "tour")
    map_with_bed(stage)
    stage.bus.run(0.5)
    with monkeypatch.context() as patched:
        patched.setattr(state, "write_atomically", no_room)
        stage.ask(requests.MAP_CANCEL)
        stage.bus.run(0.5)
    assert stage.status.message == (
        "The map home was discarded. Places on it were not deleted (bed): poses.toml could not be "
        "saved: No space left on device."
    )


def test_places_of_a_discarded_map_are_told_of_where_tour_is_not_running(
    make_stage: MakeStage,
) -> None:
    stage = make_stage("localizer", "mapper", "tour")
    map_with_bed(stage)
    stage.bus.run(0.5)
    stage.bus.kill("tour")
    stage.ask(requests.MAP_CANCEL)
    stage.bus.run(0.5)
    assert stage.status.message == (
        "The map home was discarded. Places on it were not deleted (bed): the tour service does "
        "not answer."
    )


@pytest.mark.usefixtures("often")
def test_a_place_that_was_moved_while_no_mapper_ran_stays_there(make_stage: MakeStage) -> None:
    stage = make_stage("localizer", "mapper", "tour")
    poses = stage.bus.record(topics.POSES)
    with_places(stage, 1)
    stage.drive(KEPT_S, 0.1)
    stage.bus.kill("mapper")
    (place,) = poses[-1].poses
    moved = replace(place, pose=Pose2D(0.3, 0.2, 0.0), saved_at="2026-02-03T10:00:00Z")
    stage.ask(requests.POSES_PUT, moved)
    stage.begin("mapper")
    stage.drive(2.0, 0.1)
    assert stage.status.state == "mapping"
    assert poses[-1].poses == [moved]


@pytest.mark.usefixtures("often")
def test_a_mapper_that_is_killed_as_it_hands_over_does_not_go_on_with_a_saved_map(
    stage: Stage,
) -> None:
    stage.map(seconds=2.0)
    stage.bus.run(KEPT_S)
    stage.bus.kill("localizer")
    stage.ask(requests.MAP_SAVE, SaveMap())
    stage.bus.run(2.0)
    assert stage.status.state == "saving"
    stage.bus.kill("mapper")
    stage.begin("localizer")
    stage.begin("mapper")
    stage.bus.run(2.0)
    assert (stage.status.state, stage.status.name) == ("idle", None)
    assert stage.ask(requests.MAP_LIST) == ["home"]


def extend_home(stage: Stage) -> None:
    """Save a map, and drive on with it in the making."""
    stage.map(seconds=2.0)
    stage.ask(requests.MAP_SAVE, SaveMap())
    stage.bus.run(2.0)
    stage.ask(requests.MAP_EXTEND, MapNamed(name="home"))
    stage.drive(2.0, 0.1)


def draw_stairs(stage: Stage, name: str = "stairs") -> None:
    """Put a no-go area."""
    stairs = Zone(name=name, kind="keepout", points=[(0.0, 0.0), (1.0, 0.0), (1.0, 1.0)])
    stage.ask(requests.ZONES_PUT, stairs)


def save_after_a_restart(stage: Stage) -> None:
    """Begin localizer and mapper again, and save the map that was in the making."""
    stage.begin("localizer")
    stage.begin("mapper")
    stage.bus.run(2.0)
    stage.ask(requests.MAP_SAVE, SaveMap())
    stage.bus.run(2.0)


@pytest.mark.usefixtures("often")
def test_zones_of_an_extended_map_outlive_a_mapper_that_is_killed_as_it_hands_over(
    stage: Stage,
) -> None:
    zones = stage.bus.record(topics.ZONES)
    extend_home(stage)
    draw_stairs(stage)
    stage.bus.run(KEPT_S)
    stage.bus.kill("localizer")
    stage.ask(requests.MAP_SAVE, SaveMap())
    stage.bus.run(2.0)
    stage.bus.kill("mapper")
    save_after_a_restart(stage)
    assert stage.status.state == "idle"
    assert [zone.name for zone in zones[-1].zones] == ["stairs"]


def test_zones_that_wait_for_the_localizer_outlive_a_mapper_however_late_they_were_drawn(
    stage: Stage,
) -> None:
    zones = stage.bus.record(topics.ZONES)
    extend_home(stage)
    draw_stairs(stage)
    stage.bus.kill("localizer")
    stage.ask(requests.MAP_SAVE, SaveMap())
    stage.bus.run(2.0)
    stage.bus.nodes.pop("mapper").close()
    save_after_a_restart(stage)
    assert stage.status.state == "idle"
    assert [zone.name for zone in zones[-1].zones] == ["stairs"]


def test_zones_of_an_extended_map_do_not_wait_for_its_places(
    make_stage: MakeStage, monkeypatch: pytest.MonkeyPatch
) -> None:
    stage = make_stage("localizer", "mapper", "tour")
    zones = stage.bus.record(topics.ZONES)
    extend_home(stage)
    stage.ask(requests.POSES_PUT, SavedPose(name="sofa", map="home", pose=Pose2D.identity()))
    draw_stairs(stage)
    monkeypatch.setattr(Mapper, "moved", lambda *_: Pose2D(0.5, 0.0, 0.0))  # as by a loop
    stage.bus.kill("tour")
    stage.ask(requests.MAP_SAVE, SaveMap())
    stage.bus.run(2.0)
    assert (stage.status.state, stage.pose.state) == ("saving", "localized")
    assert [zone.name for zone in zones[-1].zones] == ["stairs"]


def test_wheels_that_slip_are_told_of(stage: Stage) -> None:
    stage.map(seconds=3.0)
    num_said = len(stage.said)
    for _ in range(25):
        stage.world.odom_T_base = stage.world.odom_T_base @ Pose2D(0.03, 0.0, 0.0)
        stage.bus.run(0.1)
    told = {one.message for one in stage.said[num_said:]}
    assert "The wheels slip: they turn farther than the robot moves." in told
    stage.bus.run(3.0)
    assert stage.status.message == ""


def test_a_mapper_that_is_stopped_keeps_its_map_at_once(stage: Stage) -> None:
    stage.map(seconds=2.0)
    stage.bus.nodes.pop("mapper").close()
    assert (stage.bus.state / "trolley" / checkpoint.FILE).exists()


def test_the_localizer_takes_over_from_a_mapper_that_is_gone(stage: Stage) -> None:
    true_T_map = stage.map(seconds=4.0)
    stage.ask(requests.MAP_SAVE, SaveMap())
    stage.bus.run(2.0)
    stage.map("other", seconds=2.0)
    stage.bus.kill("mapper")
    stage.bus.run(5.0)
    assert (stage.pose.state, stage.pose.map) == ("localized", "home")
    assert stage.maps[-1].name == "home"
    assert stage.error_m(stage.straightened(true_T_map)) < 0.08


def test_a_localizer_that_begins_while_a_map_is_made_does_not_disturb(stage: Stage) -> None:
    stage.map(seconds=3.0)
    stage.ask(requests.MAP_SAVE, SaveMap())
    stage.bus.run(2.0)
    stage.map("other", seconds=2.0)
    stage.bus.kill("localizer")
    stage.drive(2.0, 0.1)
    num_poses, num_maps = len(stage.poses), len(stage.maps)
    stage.begin("localizer")
    stage.drive(4.0, 0.1)
    assert {one.map for one in stage.poses[num_poses:]} == {"other"}
    assert {one.name for one in stage.maps[num_maps:]} <= {"other"}
    stage.ask(requests.MAP_SAVE, SaveMap())
    stage.bus.run(2.0)
    assert (stage.pose.state, stage.pose.map) == ("localized", "other")


def test_without_a_localizer_the_map_is_saved_all_the_same(make_stage: MakeStage) -> None:
    stage = make_stage("mapper")
    stage.map(seconds=2.0)
    stage.ask(requests.MAP_SAVE, SaveMap())
    stage.bus.run(15.0)
    assert stage.status.state == "idle"
    assert "the localizer is not running" in stage.status.message
    assert (stage.bus.state / "maps" / "home.yaml").exists()


def test_a_full_disk_refuses_to_save_and_mapping_goes_on(
    stage: Stage, monkeypatch: pytest.MonkeyPatch
) -> None:
    stage.map(seconds=2.0)

    def fail(*_: Any, **__: Any) -> None:
        raise MapError(Path("home.pgm"), "it cannot be written (No space left on device)", "")

    with monkeypatch.context() as patched:
        patched.setattr(MapVersions, "save", fail)
        refused = stage.refusal(requests.MAP_SAVE, SaveMap())
    assert refused.code == codes.NOT_SAVED
    assert "No space left" in refused.message
    assert stage.status.state == "mapping"
    scans = stage.status.scans
    stage.drive(3.0, 0.25)
    assert stage.status.scans > scans
    assert stage.ask(requests.MAP_SAVE, SaveMap()).state == "saving"
    stage.bus.run(2.0)
    assert stage.pose.state == "localized"


def no_room(*_: Any, **__: Any) -> None:
    """What a full disk does."""
    raise OSError(errno.ENOSPC, "No space left on device")


@pytest.mark.usefixtures("often")
def test_a_disk_that_is_full_while_mapping_is_said(
    stage: Stage, monkeypatch: pytest.MonkeyPatch
) -> None:
    health = stage.bus.record(topics.HEALTH, "mapper")
    stage.map(seconds=2.0)
    with monkeypatch.context() as patched:
        patched.setattr(checkpoint, "write_atomically", no_room)
        stage.bus.run(KEPT_S)
    assert health[-1].state == "degraded"
    assert "No space left" in stage.status.message
    assert stage.status.state == "mapping"
    stage.drive(1.0)
    stage.bus.run(KEPT_S)
    assert health[-1].state == "ok"


@pytest.mark.usefixtures("often")
def test_a_backup_that_fails_as_the_map_is_canceled_is_no_trouble(
    stage: Stage, monkeypatch: pytest.MonkeyPatch
) -> None:
    health = stage.bus.record(topics.HEALTH, "mapper")
    stage.map(seconds=2.0)
    with monkeypatch.context() as patched:
        patched.setattr(checkpoint, "write_atomically", no_room)
        with held_up(
            monkeypatch, lambda work: getattr(work, "func", None) is checkpoint._write
        ) as slow:
            stage.drive(KEPT_S, 0.1)
            stage.ask(requests.MAP_CANCEL)
        finish(slow[-1:])
    stage.bus.run(KEPT_S)
    assert slow
    assert health[-1].state == "ok"


def with_places(stage: Stage, num: int) -> Pose2D:
    """Map a draft with places where the robot is then; returns where that is, true_T_place."""
    stage.map("draft", seconds=3.0)
    stage.bus.run(1.5)
    for number in range(num):
        stage.ask(requests.POSE_CAPTURE, Capture(name=f"place {number}"))
    stage.bus.run(0.5)
    return stage.world.map_T_base


def test_places_go_along_to_a_saved_map_however_many_once_tour_is_there(
    make_stage: MakeStage,
) -> None:
    stage = make_stage("localizer", "mapper", "tour")
    true_T_map = stage.world.map_T_base
    true_T_place = with_places(stage, 300)  # of more than 256 the rest was refused
    stage.bus.kill("tour")
    stage.ask(requests.MAP_SAVE, SaveMap(name="home"))
    stage.bus.run(3.0)
    assert {one.state for one in stage.poses[-10:]} == {"localized"}
    poses = stage.bus.record(topics.POSES)
    stage.begin("tour")
    stage.bus.run(3.0)
    assert stage.status.message == "The map home is saved and in use."
    assert len(poses) < 20
    assert {place.map for place in poses[-1].poses} == {"home"}
    true_T_home = stage.straightened(true_T_map)
    for place in poses[-1].poses:
        assert (true_T_home @ place.pose).distance_to(true_T_place) < 0.05


def test_a_place_that_is_refused_does_not_keep_the_others_from_going_along(
    make_stage: MakeStage, monkeypatch: pytest.MonkeyPatch
) -> None:
    stage = make_stage("localizer", "mapper", "tour")
    poses = stage.bus.record(topics.POSES)
    with_places(stage, 3)
    checked_pose = checks.checked_pose

    def refuse_one(pose: SavedPose, *args: Any) -> SavedPose:
        if pose.name == "place 0":
            raise Refused(codes.NOT_SAVED, "Its note is too long.")
        return checked_pose(pose, *args)

    monkeypatch.setattr(checks, "checked_pose", refuse_one)
    stage.ask(requests.MAP_SAVE, SaveMap(name="home"))
    stage.bus.run(20.0)
    assert stage.status.state == "idle"
    assert stage.status.message.endswith("not moved along with the map: Its note is too long.")
    assert [place.map for place in poses[-1].poses] == ["draft", "home", "home"]


def test_a_place_that_is_deleted_or_moved_as_its_map_is_handed_over_does_not_come_back(
    make_stage: MakeStage,
) -> None:
    stage = make_stage("localizer", "mapper", "tour")
    poses = stage.bus.record(topics.POSES)
    with_places(stage, 3)
    stage.bus.kill("tour")
    stage.ask(requests.MAP_SAVE, SaveMap(name="home"))
    stage.bus.run(3.0)
    stage.begin("tour")
    moved = SavedPose(name="place 1", map="home", pose=Pose2D(5.0, 5.0, 0.0))
    stage.ask(requests.POSES_PUT, moved)
    stage.ask(requests.POSES_DELETE, Named(name="place 2"))
    assert [place.map for place in poses[-1].poses] == ["draft", "home"]
    stage.bus.run(3.0)
    assert stage.status.state == "idle"
    assert [(place.name, place.map) for place in poses[-1].poses] == [
        ("place 0", "home"),
        ("place 1", "home"),
    ]
    assert poses[-1].poses[1].pose == moved.pose


def test_places_that_could_not_go_along_to_a_saved_map_are_told_of(
    make_stage: MakeStage,
) -> None:
    stage = make_stage("localizer", "mapper", "tour")
    with_places(stage, 1)
    stage.bus.kill("tour")
    stage.ask(requests.MAP_SAVE, SaveMap(name="home"))
    stage.bus.run(30.0)
    assert stage.status.state == "idle"
    why = "the tour service does not answer."
    assert stage.status.message.endswith(f"Places were not moved along with the map: {why}")


def test_zones_of_an_extended_map_wait_for_a_localizer_that_is_not_running(
    stage: Stage, monkeypatch: pytest.MonkeyPatch
) -> None:
    stage.map(seconds=3.0)
    stage.ask(requests.MAP_SAVE, SaveMap())
    stage.bus.run(2.0)
    stage.ask(requests.MAP_EXTEND, MapNamed(name="home"))
    stage.drive(2.0, 0.2)
    draw_stairs(stage)
    stage.bus.kill("localizer")
    stage.ask(requests.MAP_SAVE, SaveMap())
    stage.bus.run(20.0)
    assert "its zones wait for the localizer, which is not running." in stage.status.message
    zones = stage.bus.record(topics.ZONES)
    hand_over, may_discard = MapSaver._hand_zones_over, list[bool]()

    def look(saver: MapSaver, *args: Any) -> None:
        may_discard.append(saver._mapping.status().may_discard)
        hand_over(saver, *args)

    monkeypatch.setattr(MapSaver, "_hand_zones_over", look)
    stage.begin("localizer")
    stage.bus.run(10.0)
    assert (stage.status.state, stage.pose.state) == ("idle", "localized")
    assert [zone.name for zone in zones[-1].zones] == ["stairs"]
    assert not any(may_discard)  # once it takes them, a cancel is refused


@pytest.mark.parametrize("is_tour_there", [True, False])
def test_zones_that_wait_for_a_localizer_can_be_given_up(
    make_stage: MakeStage, is_tour_there: bool
) -> None:
    stage = make_stage("localizer", "mapper", "tour")
    extend_home(stage)
    stage.ask(requests.POSES_PUT, SavedPose(name="sofa", map="home", pose=Pose2D.identity()))
    draw_stairs(stage)
    stage.bus.kill("localizer")
    if not is_tour_there:
        stage.bus.kill("tour")
    stage.ask(requests.MAP_SAVE, SaveMap())
    stage.bus.run(2.0)
    assert not stage.status.may_discard
    assert stage.refusal(requests.MAP_CANCEL).code == codes.NOT_READY  # one may be starting
    stage.bus.run(20.0)
    assert stage.status.may_discard
    assert "discard" in stage.refusal(requests.MAP_NEW, MapNamed(name="other")).message
    stage.ask(requests.MAP_CANCEL)
    stage.bus.run(30.0)
    assert stage.status.state == "idle"
    given_up = "The map home is saved; changes to these zones were discarded: stairs."
    assert stage.status.message.startswith(given_up)
    assert not (stage.bus.state / "trolley" / checkpoint.FILE).exists()
    stage.map("other", seconds=2.0)
    assert (stage.status.state, stage.status.name) == ("mapping", "other")


def test_a_zone_that_the_localizer_has_is_not_said_to_be_given_up(
    stage: Stage, monkeypatch: pytest.MonkeyPatch
) -> None:
    zones = stage.bus.record(topics.ZONES)
    extend_home(stage)
    draw_stairs(stage, "stairs down")
    draw_stairs(stage, "stairs up")
    stored = MapSaver._zone_stored

    def die(saver: MapSaver, *args: Any) -> None:
        stage.bus.kill("localizer")
        monkeypatch.undo()
        stored(saver, *args)

    monkeypatch.setattr(MapSaver, "_zone_stored", die)
    stage.ask(requests.MAP_SAVE, SaveMap())
    stage.bus.run(30.0)
    stage.ask(requests.MAP_CANCEL)
    assert "changes to these zones were discarded: stairs up." in stage.status.message
    stage.begin("localizer")
    stage.bus.run(5.0)
    assert [zone.name for zone in zones[-1].zones] == ["stairs down"]


def test_zones_wait_for_a_localizer_that_dies_as_it_takes_the_map_over(
    stage: Stage, monkeypatch: pytest.MonkeyPatch
) -> None:
    zones = stage.bus.record(topics.ZONES)
    extend_home(stage)
    draw_stairs(stage)
    taken_over = Handover._taken_over

    def die(handover: Handover) -> None:
        stage.bus.kill("localizer")
        monkeypatch.undo()
        taken_over(handover)

    monkeypatch.setattr(Handover, "_taken_over", die)
    stage.ask(requests.MAP_SAVE, SaveMap())
    stage.bus.run(15.0)
    stage.begin("localizer")
    stage.bus.run(10.0)
    assert stage.status.state == "idle"
    assert [zone.name for zone in zones[-1].zones] == ["stairs"]


@pytest.mark.parametrize("comes_back", [True, False])
def test_a_tour_goes_along_to_a_saved_map_once_tour_is_there_or_is_told_of(
    make_stage: MakeStage, comes_back: bool
) -> None:
    stage = make_stage("localizer", "mapper", "tour")
    tours = stage.bus.record(topics.TOURS)
    stage.map(name="draft", seconds=2.0)
    stops = [Stop(pose=Pose2D.identity())]
    stage.ask(requests.TOURS_PUT, Tour(name="round", stops=stops, map="draft"))
    stage.bus.kill("tour")
    stage.ask(requests.MAP_SAVE, SaveMap(name="home"))
    stage.bus.run(3.0)
    if comes_back:
        stage.begin("tour")
    stage.bus.run(30.0)
    assert stage.status.state == "idle"
    (tour,) = tours[-1].tours
    assert tour.map == ("home" if comes_back else "draft")
    why = "the tour service does not answer."
    told = f"Tours were not moved along with the map: {why}"
    assert stage.status.message.endswith("in use." if comes_back else told)


@pytest.mark.parametrize("comes_back", [True, False])
def test_what_lies_on_a_map_is_not_left_behind_where_tour_was_not_heard_since_the_mapper_began(
    make_stage: MakeStage, comes_back: bool
) -> None:
    stage = make_stage("localizer", "mapper", "tour")
    poses, tours = stage.bus.record(topics.POSES), stage.bus.record(topics.TOURS)
    with_places(stage, 1)
    stops = [Stop(pose=Pose2D.identity())]
    stage.ask(requests.TOURS_PUT, Tour(name="round", stops=stops, map="draft"))
    stage.bus.kill("tour")
    stage.bus.nodes.pop("mapper").close()
    stage.begin("mapper")
    stage.bus.run(2.0)
    stage.ask(requests.MAP_SAVE, SaveMap(name="home"))
    stage.bus.run(3.0)
    if comes_back:
        stage.begin("tour")
    stage.bus.run(30.0)
    assert stage.status.state == "idle"
    found = poses[-1].poses[0].map, tours[-1].tours[0].map
    assert found == (("home", "home") if comes_back else ("draft", "draft"))
    for what in ("Places", "Tours"):
        told = f"{what} were not moved along with the map: the tour service does not answer."
        assert (told in stage.status.message) is not comes_back


def test_a_tour_that_is_deleted_or_changed_as_its_map_is_handed_over_does_not_come_back(
    make_stage: MakeStage,
) -> None:
    stage = make_stage("localizer", "mapper", "tour")
    tours = stage.bus.record(topics.TOURS)
    stage.map(name="draft", seconds=2.0)
    names, stops = ("one", "two", "three"), [Stop(pose=Pose2D.identity())]
    for name in names:
        stage.ask(requests.TOURS_PUT, Tour(name=name, stops=stops, map="draft"))
    stage.bus.kill("tour")
    stage.ask(requests.MAP_SAVE, SaveMap(name="home"))
    stage.bus.run(3.0)
    stage.begin("tour")
    changed = Tour(name="two", stops=[Stop(pose=Pose2D(5.0, 5.0, 0.0))], map="home")
    stage.ask(requests.TOURS_PUT, changed)
    stage.ask(requests.TOURS_DELETE, Named(name="three"))
    stage.bus.run(5.0)
    assert stage.status.state == "idle"
    found = {tour.name: tour for tour in tours[-1].tours}
    assert set(found) == {"one", "two"}
    assert found["one"].map == "home"
    assert found["two"].stops == changed.stops


def test_a_name_that_is_taken_is_refused(stage: Stage) -> None:
    stage.map(seconds=2.0)
    stage.ask(requests.MAP_SAVE, SaveMap())
    stage.bus.run(2.0)
    assert stage.refusal(requests.MAP_NEW, MapNamed(name="home")).code == codes.EXISTS
    stage.map("other", seconds=2.0)
    assert stage.refusal(requests.MAP_SAVE, SaveMap(name="home")).code == codes.EXISTS
    assert stage.status.state == "mapping"


def test_a_new_map_waits_for_a_lidar_that_starts_late(stage: Stage) -> None:
    stage.base.silent = {"scan"}
    assert stage.ask(requests.MAP_NEW, MapNamed(name="home")).state == "starting"
    stage.bus.run(3.0)
    assert "lidar is silent" in stage.status.message
    stage.base.silent = set()
    stage.drive(1.0)
    assert (stage.status.state, stage.status.message) == ("mapping", "")
    assert stage.status.scans > 0


def test_what_a_map_cannot_be_continued_without_is_named(stage: Stage) -> None:
    stage.base.silent = {"scan"}
    refused = stage.refusal(requests.MAP_EXTEND, MapNamed(name="home"))
    assert refused.code == codes.NOT_READY
    assert "scan" in refused.message
    assert "odom" not in refused.message.replace("tf/odom", "")


def test_a_silent_lidar_is_said_and_the_map_goes_on_afterwards(stage: Stage) -> None:
    true_T_map = stage.map(seconds=4.0)
    stage.base.silent = {"scan"}
    stage.drive(5.0, 0.1)
    assert stage.status.message == "The lidar is silent; the map does not grow."
    stage.base.silent = set()
    stage.drive(3.0, 0.1)
    assert stage.status.message == ""
    assert stage.pose.state == "mapping"
    assert stage.error_m(true_T_map) < 0.08


def test_a_new_run_of_base_does_not_tear_the_map(stage: Stage) -> None:
    true_T_map = stage.map(seconds=4.0)
    corrections = stage.bus.record(topics.TF, "odom")
    stage.base.restart()
    stage.drive(3.0, 0.2, 0.2)
    assert stage.pose.state == "mapping"
    assert stage.error_m(true_T_map) < 0.05
    at = true_T_map @ corrections[-1].pose @ stage.world.odom_T_base
    assert at.distance_to(stage.world.map_T_base) < 0.05


def test_a_map_grows_on_though_robot_time_begins_earlier(stage: Stage) -> None:
    true_T_map = stage.map(seconds=4.0)
    scans, seconds = stage.status.scans, stage.status.seconds
    stage.base.restart(later_s=-5)
    stage.drive(3.0, 0.2, 0.2)
    stage.bus.run(1.0)
    assert stage.status.scans > scans
    assert stage.status.seconds > seconds
    assert stage.pose.state == "mapping"
    assert stage.error_m(true_T_map) < 0.05


def test_a_map_handed_over_just_after_a_new_run_of_base_gets_the_pose_of_before(
    stage: Stage,
) -> None:
    stage.map(seconds=3.0)
    stage.drive(4.0, 0.3)
    stage.base.silent = {"scan"}
    stage.base.restart()
    stage.bus.run(0.3)
    mapper = stage.bus.nodes["mapper"].service
    assert isinstance(mapper, MapperService)
    session = mapper._mapping.session
    assert session is not None
    assert session.estimate is not None
    assert mapper._mapping.pose_now() == session.estimate.pose


def test_a_broken_working_file_is_kept_aside_and_said(stage: Stage) -> None:
    stage.map(seconds=2.0)
    stage.bus.nodes.pop("mapper").close()
    file = stage.bus.state / "trolley" / checkpoint.FILE
    file.write_bytes(file.read_bytes()[:-100])
    stage.begin("mapper")
    stage.bus.run(0.5)
    assert stage.status.state == "idle"
    assert "kept as mapping.bin.broken" in stage.status.message
    assert list(file.parent.glob("mapping.bin.broken-*"))
    assert stage.ask(requests.MAP_NEW, MapNamed(name="again")).state == "starting"


def unfinished_map(world: Flatland, off_m: float) -> bytes:
    """A map of laps round one place as a mapper keeps it; the later laps lie beside the others."""
    store, begin = KeyframeStore(), world.map_T_base.inverse()
    for number in range(64):
        world.drive(Twist2D(0.4, 0.0, 0.8), 1.0)
        scan = world.scan(number + 1)
        entered = ScanInput(
            number + 1, world.ranges(), scan.angle_min, scan.angle_increment, scan.range_min,
            scan.range_max, world.base_T_laser, world.odom_T_base, world.odom_T_base,
        )  # fmt: skip
        keyframe = Keyframe.of(number, number + 1, read_sweep(entered, 10.0))
        pose = (begin @ world.map_T_base).as_array()
        pose[0] += off_m if number >= 32 else 0.0
        before = store.poses[-1] if number else pose
        edge = Edge(number - 1, number, between(before, pose), np.eye(3), ODOMETRY)
        store.add(keyframe, pose, [edge] if number else [])
    at = Pose2D.from_array(store.poses[-1])
    core = pack(State(store, Anchors(), None, at, len(store), 0))
    return msgspec.msgpack.encode(checkpoint.Checkpoint(name="home", core=core))


@pytest.mark.parametrize(("off_m", "is_doubted"), [(0.0, False), (0.5, True)])
def test_a_map_that_contradicts_itself_is_saved_and_said_to_be_doubtful(
    make_stage: MakeStage, off_m: float, is_doubted: bool
) -> None:
    stage = make_stage("localizer", "tour")
    folder = stage.bus.state / "trolley"
    folder.mkdir(parents=True, exist_ok=True)
    (folder / checkpoint.FILE).write_bytes(unfinished_map(stage.world, off_m))
    stage.begin("mapper")
    stage.bus.run(2.0)
    assert stage.status.scans > 60
    stage.ask(requests.MAP_SAVE, SaveMap())
    stage.bus.run(3.0)
    assert stage.status.state == "idle"
    assert "in use" in stage.status.message
    assert stage.ask(requests.MAP_LIST) == ["home"]
    assert ("contradict each other" in stage.status.message) == is_doubted


class OnLand(Service):
    """A localizer that knows where it is on a coarse map."""

    name = "localizer"

    def __init__(self, num_cells: int, x: float) -> None:
        cells = np.zeros((num_cells, num_cells), np.int8)
        self.grid = GridMap("land", 10.0, Pose2D(x, 0.0, 0.0), cells)

    @every(0.2)
    def say(self) -> None:
        now_ns, here = self.stamp_ns, self.grid.origin
        self.publish(topics.MAP, map_message(now_ns, self.grid))
        self.publish(topics.ZONES, Zones(stamp_ns=now_ns, map="land", zones=[]))
        self.publish(topics.TF, odom_transform(now_ns, here), "odom")
        known = PoseEstimate(
            stamp_ns=now_ns,
            map="land",
            pose=here,
            covariance=None,
            state="localized",
            match=1.0,
            spread=0.0,
        )
        self.publish(topics.POSE, known)


@pytest.mark.parametrize(
    ("num_cells", "x", "sentence"),
    [
        (100, 0.0, "1000 x 1000 m, too large to be drawn in cells of 0.05 m"),
        (5, 5e5, "more than 20 km from where its coordinates are 0"),
    ],
)
def test_a_map_too_large_or_too_far_away_is_not_extended(
    make_stage: MakeStage, num_cells: int, x: float, sentence: str
) -> None:
    stage = make_stage("mapper")
    stage.bus.add(OnLand(num_cells, x))
    stage.bus.run(0.5)
    refused = stage.refusal(requests.MAP_EXTEND, MapNamed(name="land"))
    assert refused.code == codes.BAD_REQUEST
    assert sentence in refused.message
    assert stage.status.state == "idle"


@pytest.mark.usefixtures("often")
def test_no_map_begins_before_it_is_known_whether_one_is_unfinished(
    stage: Stage, monkeypatch: pytest.MonkeyPatch
) -> None:
    stage.map(seconds=2.0)
    stage.bus.run(KEPT_S)
    stage.bus.kill("mapper")
    with held_up(monkeypatch) as slow_disk:
        stage.begin("mapper")
    stage.bus.run(0.1)
    assert stage.refusal(requests.MAP_NEW, MapNamed(name="other")).code == codes.NOT_READY
    finish(slow_disk)
    stage.bus.run(1.0)
    assert (stage.status.state, stage.status.name) == ("mapping", "home")


def test_a_map_that_is_long_in_writing_stays_the_mappers(
    stage: Stage, monkeypatch: pytest.MonkeyPatch
) -> None:
    stage.map(seconds=2.0)
    with held_up(monkeypatch) as slow_disk:
        assert stage.ask(requests.MAP_SAVE, SaveMap()).state == "saving"
        num_poses = len(stage.poses)
        stage.bus.run(6.0)
    assert {one.state for one in stage.poses[num_poses:]} == {"mapping"}
    assert stage.refusal(requests.POSE_FIND).code == codes.MAPPING
    finish(slow_disk)
    stage.bus.run(2.0)
    assert (stage.pose.state, stage.pose.map) == ("localized", "home")


@pytest.mark.usefixtures("often")
def test_a_pause_while_an_unfinished_map_is_loaded_holds(
    stage: Stage, monkeypatch: pytest.MonkeyPatch
) -> None:
    stage.map(seconds=2.0)
    stage.bus.run(KEPT_S)
    stage.bus.kill("mapper")
    with held_up(monkeypatch, lambda fn: getattr(fn, "func", None) is mapping._load) as slow:
        stage.begin("mapper")
        stage.bus.run(0.5)
        assert stage.ask(requests.MAP_PAUSE, PauseMap()).state == "starting"
    assert len(slow) == 1
    finish(slow)
    stage.bus.run(1.0)
    assert (stage.status.state, stage.status.name) == ("paused", "home")
