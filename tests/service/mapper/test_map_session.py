"""A map from a drive: begun, driven, saved, taken over, extended, given up."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from msgspec.structs import replace

from trolley import codes, requests, topics
from trolley.geometry import Pose2D
from trolley.gridmap import load_map
from trolley.gridmap.wire import grid_of
from trolley.messages import OccupancyGrid, SavedPose, Stop, Tour, Zone
from trolley.messages.request_params import (
    Capture,
    JoinPart,
    LoadMap,
    MapNamed,
    Named,
    Nothing,
    PauseMap,
    SaveMap,
    SendGoal,
    SetPose,
    UndoMap,
    Yield,
)
from trolley.runtime import codec
from trolley.state_file import parse
from trolley.zones import ZoneFile
from trolley_planner.service import PlannerService

from .conftest import START, Planner, Stage

MakeStage = Callable[..., Stage]


def answers_to(stage: Stage, topic: topics.Topic) -> list:
    """What everybody says is the latest value."""
    replies = stage.bus.get(topic.key("trolley") + "?format=msgpack")
    return [codec.decode(topic.message, one.payload, one.encoding) for one in replies]


def test_a_new_robot_has_a_map_after_one_drive(make_stage: MakeStage) -> None:
    stage = make_stage("localizer", "mapper", "tour")
    true_T_map = stage.map()
    assert stage.status.state == "mapping"
    assert stage.status.name == "home"
    assert stage.status.scans > 3
    assert {(one.state, one.map) for one in stage.poses} == {("mapping", "home")}
    assert stage.error_m(true_T_map) < 0.05
    stage.bus.run(0.5)
    place = stage.ask(requests.POSE_CAPTURE, Capture(name="sofa"))
    assert place.map == "home"

    assert stage.ask(requests.MAP_SAVE, SaveMap()).state == "saving"
    stage.drive(3.0, 0.2, 0.2)
    assert stage.status.state == "idle"
    assert "in use" in stage.status.message
    assert (stage.pose.state, stage.pose.map) == ("localized", "home")
    # Its walls run along the axes, and all that lies on it was turned along.
    true_T_home = stage.straightened(true_T_map)
    assert abs(true_T_home.yaw) < math.radians(0.5)
    assert stage.error_m(true_T_home) < 0.05
    grid = load_map(stage.bus.state / "maps" / "home.yaml")
    assert (grid.cells == 100).sum() > 100
    assert stage.ask(requests.MAP_LIST) == ["home"]
    assert not (stage.bus.state / "trolley" / "mapping.bin").exists()
    (kept,) = answers_to(stage, topics.POSES)[0].poses
    assert kept.map == "home"
    assert (true_T_home @ kept.pose).distance_to(true_T_map @ place.pose) < 0.03
    # The robot knows where it is after a restart, too.
    stage.bus.kill("localizer")
    stage.begin("localizer")
    stage.bus.run(1.0)
    assert (stage.pose.state, stage.pose.map) == ("localized", "home")


def test_a_map_of_what_is_seen_from_one_place_has_walls_to_go_by(stage: Stage) -> None:
    true_T_map = stage.world.map_T_base
    planner = stage.bus.add(Planner())
    stage.ask(requests.MAP_NEW, MapNamed(name="home"))
    stage.bus.run(3.0)
    assert stage.status.scans == 1
    stage.ask(requests.MAP_SAVE, SaveMap())
    stage.bus.run(3.0)
    assert (load_map(stage.bus.state / "maps" / "home.yaml").cells == 100).sum() > 100
    assert (stage.pose.state, stage.pose.map) == ("localized", "home")
    assert stage.straightened(true_T_map).yaw != true_T_map.yaw
    assert planner.num_canceled == 1  # its goal was one of the map as it lay before
    assert stage.error_m(stage.straightened(true_T_map)) < 0.05


def test_while_a_map_is_made_the_localizer_owns_nothing(stage: Stage) -> None:
    stage.map(seconds=2.0)
    for topic in (topics.MAP, topics.POSE, topics.ZONES):
        assert len(answers_to(stage, topic)) == 1
    assert stage.refusal(requests.POSE_SET, SetPose(pose=Pose2D.identity())).code == codes.MAPPING
    assert stage.refusal(requests.POSE_FIND).code == codes.MAPPING
    assert stage.refusal(requests.MAP_LOAD, LoadMap(name="home")).code == codes.MAPPING
    assert stage.refusal(requests.MAP_NEW, MapNamed(name="other")).code == codes.MAPPING


def test_the_map_is_seen_to_grow_once_a_second_at_most(stage: Stage) -> None:
    stage.map(seconds=6.0)
    drawn = [one for one in stage.maps if one.name == "home"]
    assert 3 <= len(drawn) <= 8
    cells = [one.width * one.height for one in drawn]
    assert cells[-1] >= cells[0]


def test_a_map_is_extended_and_the_old_one_is_kept(stage: Stage) -> None:
    true_T_map = stage.map(seconds=4.0)
    stage.ask(requests.MAP_SAVE, SaveMap())
    stage.bus.run(2.0)
    zone = Zone(name="stairs", kind="keepout", points=[(0.0, 0.0), (1.0, 0.0), (1.0, 1.0)])
    stage.ask(requests.ZONES_PUT, zone)
    first = load_map(stage.bus.state / "maps" / "home.yaml")
    true_T_map = stage.straightened(true_T_map)
    assert stage.refusal(requests.MAP_EXTEND, MapNamed(name="flat")).code == codes.WRONG_MAP

    stage.ask(requests.MAP_EXTEND, MapNamed(name="home"))
    stage.drive(5.0, 0.35, -0.1)
    assert stage.status.extends == "home"
    assert stage.pose.state == "mapping"
    assert stage.error_m(true_T_map) < 0.08
    assert [one.name for one in answers_to(stage, topics.ZONES)[0].zones] == ["stairs"]
    stage.ask(requests.MAP_SAVE, SaveMap())
    stage.bus.run(2.0)
    assert stage.pose.state == "localized"
    assert stage.error_m(true_T_map) < 0.08
    assert [one.name for one in answers_to(stage, topics.ZONES)[0].zones] == ["stairs"]
    second = load_map(stage.bus.state / "maps" / "home.yaml")
    assert (second.cells >= 0).sum() > (first.cells >= 0).sum()
    folder = stage.bus.state / "maps" / "versions" / "home"
    assert (load_map(folder / "0001.yaml").cells == first.cells).all()
    kept = parse((folder / "0001.zones.toml").read_bytes(), ZoneFile)
    assert [one.name for one in kept.zones] == ["stairs"]
    assert stage.ask(requests.MAP_LIST) == ["home"]


def test_places_that_were_saved_on_a_map_go_when_it_is_discarded(make_stage: MakeStage) -> None:
    stage = make_stage("localizer", "mapper", "tour")
    # Of a map of that name that is not there now.
    for name in ("sofa", "desk"):
        old = SavedPose(
            name=name, map="home", pose=Pose2D.identity(), saved_at="2026-10-01T08:00:00Z"
        )
        stage.ask(requests.POSES_PUT, old)
    stage.map(seconds=3.0)
    stage.bus.run(1.5)
    for name in ("bed", "desk"):
        stage.ask(requests.POSE_CAPTURE, Capture(name=name, replace=True))
    stage.bus.run(0.5)
    stage.ask(requests.MAP_CANCEL)
    stage.bus.run(0.5)
    assert [one.name for one in answers_to(stage, topics.POSES)[0].poses] == ["sofa"]


def test_nothing_goes_to_a_first_map_that_was_discarded(make_stage: MakeStage) -> None:
    stage = make_stage("localizer", "mapper", "tour")
    planner = stage.bus.add(PlannerService(stage.config))
    stage.map(seconds=3.0)
    stage.ask(requests.MAP_CANCEL)
    stage.bus.run(1.0)
    assert (stage.pose.map, stage.pose.message) == (None, "there is no map")
    here = SavedPose(name="sofa", pose=Pose2D.identity())
    assert stage.refusal(requests.POSES_PUT, here).code == codes.NOT_READY
    goal = SendGoal(pose=Pose2D(0.3, 0.0, 0.0))
    assert stage.refusal(requests.GOAL_SEND, goal).details["missing"] == ["map"]
    stage.map(seconds=3.0)
    assert (stage.pose.state, stage.pose.map) == ("mapping", "home")
    assert planner.navigator.inputs.map is not None


def test_goals_are_taken_again_after_a_mapper_that_was_silent_for_a_while(
    make_stage: MakeStage,
) -> None:
    stage = make_stage("localizer", "mapper")
    stage.bus.add(PlannerService(stage.config))
    stage.map(seconds=3.0)
    stage.bus.run(2.0)
    num_maps = len(stage.maps)
    stage.ask(requests.LOCALIZER_YIELD, Yield(on=False))  # as if it had not been renewed in time
    stage.bus.run(3.0)
    assert None in [pose.map for pose in stage.poses]
    assert (stage.pose.map, len(stage.maps)) == ("home", num_maps)
    assert stage.pose.pose is not None
    goal = SendGoal(pose=stage.pose.pose @ Pose2D(0.3, 0.0, 0.0))
    assert stage.ask(requests.GOAL_SEND, goal).state == "driving"


def test_an_extended_map_is_saved_under_another_name_with_its_zones_places_and_tours(
    make_stage: MakeStage,
) -> None:
    stage = make_stage("localizer", "mapper", "tour")
    stage.map(seconds=3.0)
    stage.ask(requests.MAP_SAVE, SaveMap())
    stage.bus.run(2.0)
    zone = Zone(name="stairs", kind="keepout", points=[(0.0, 0.0), (1.0, 0.0), (1.0, 1.0)])
    stage.ask(requests.ZONES_PUT, zone)
    stage.ask(requests.POSES_PUT, SavedPose(name="sofa", map="home", pose=Pose2D.identity()))
    own = Stop(pose=Pose2D(0.5, 0.0, 0.0))
    stage.ask(requests.TOURS_PUT, Tour(name="round", stops=[own]))
    stage.ask(requests.TOURS_PUT, Tour(name="upstairs", stops=[own], map="attic"))
    stage.ask(requests.MAP_EXTEND, MapNamed(name="home"))
    stage.drive(2.0, 0.2)
    stage.ask(requests.MAP_SAVE, SaveMap(name="home2"))
    stage.bus.run(2.0)
    assert (stage.pose.state, stage.pose.map) == ("localized", "home2")
    assert [one.name for one in answers_to(stage, topics.ZONES)[0].zones] == ["stairs"]
    assert [one.map for one in answers_to(stage, topics.POSES)[0].poses] == ["home2"]
    tours = {one.name: one for one in answers_to(stage, topics.TOURS)[0].tours}
    assert {name: one.map for name, one in tours.items()} == {"round": "home2", "upstairs": "attic"}
    assert tours["round"].stops == [own]
    assert stage.ask(requests.MAP_LIST) == ["home", "home2"]


def test_who_extends_the_original_file_hears_at_once_that_it_needs_another_name(
    stage: Stage,
) -> None:
    stage.map(seconds=3.0)
    stage.ask(requests.MAP_SAVE, SaveMap())
    stage.bus.run(2.0)
    original = stage.bus.state / "maps" / "home.yaml"
    stage.config = replace(stage.config, map=replace(stage.config.map, file=str(original)))
    for name in ("localizer", "mapper"):
        stage.bus.kill(name)
        stage.begin(name)
    stage.bus.run(2.0)
    why = (
        "The map home is your original file, which is never overwritten: save the extended map "
        "under another name (`trolley map save NAME`)."
    )
    assert stage.ask(requests.MAP_EXTEND, MapNamed(name="home")).message == why
    stage.drive(2.0, 0.1)
    assert stage.status.message.endswith(why)
    refused = stage.refusal(requests.MAP_SAVE)
    assert (refused.code, refused.message) == (codes.EXISTS, why)
    stage.ask(requests.MAP_SAVE, SaveMap(name="home2"))
    stage.bus.run(2.0)
    assert (stage.pose.state, stage.pose.map) == ("localized", "home2")


STAIRS = Zone(name="stairs", kind="keepout", points=[(0.0, 0.0), (1.0, 0.0), (1.0, 1.0)])
MIRROR = Zone(name="mirror", kind="mirror", points=[(2.0, 0.0), (2.0, 1.0)])


def zones_of(stage: Stage) -> dict[str, Zone]:
    (zones,) = answers_to(stage, topics.ZONES)
    assert zones.map == stage.pose.map
    return {one.name: one for one in zones.zones}


def test_zones_drawn_while_a_map_is_made_are_saved_and_turned_with_it(stage: Stage) -> None:
    true_T_map = stage.map()
    assert stage.ask(requests.ZONES_PUT, STAIRS) == STAIRS
    stage.ask(requests.ZONES_PUT, MIRROR)
    assert zones_of(stage) == {"stairs": STAIRS, "mirror": MIRROR}
    bow = Zone(name="bow", kind="keepout", points=[(0.0, 0.0), (1.0, 1.0), (1.0, 0.0), (0.0, 1.0)])
    assert stage.refusal(requests.ZONES_PUT, bow).code == codes.BAD_REQUEST
    assert stage.ask(requests.ZONES_DELETE, Named(name="mirror")) == MIRROR
    assert stage.refusal(requests.ZONES_DELETE, Named(name="mirror")).code == codes.UNKNOWN_NAME
    stage.ask(requests.MAP_SAVE, SaveMap(name="flat"))
    stage.bus.run(3.0)
    assert (stage.pose.state, stage.pose.map) == ("localized", "flat")
    (kept,) = zones_of(stage).values()
    true_T_flat = stage.straightened(true_T_map, "flat")
    assert abs(true_T_flat.yaw - true_T_map.yaw) > 0.1
    there = true_T_flat.transform_points(np.array(kept.points))
    assert np.abs(there - true_T_map.transform_points(np.array(STAIRS.points))).max() < 0.03


def test_what_is_seen_through_a_mirror_goes_from_the_map_as_soon_as_that_is_drawn(
    stage: Stage,
) -> None:
    stage.map()
    grid = grid_of(stage.maps[-1])
    here = stage.pose.pose
    assert here is not None
    ahead = here.transform_points(np.array([[0.6, -0.5], [0.6, 0.5]]))
    x, y = np.meshgrid(np.arange(0.9, 1.3, 0.05), np.arange(-0.3, 0.31, 0.05))
    beyond = here.transform_points(np.column_stack([x.ravel(), y.ravel()]))
    before = np.count_nonzero(grid.values_at(beyond) >= 0)
    points = [(float(a), float(b)) for a, b in ahead]
    stage.ask(requests.ZONES_PUT, Zone(name="new", kind="mirror", points=points))
    stage.bus.run(1.5)
    assert np.count_nonzero(grid_of(stage.maps[-1]).values_at(beyond) >= 0) < 0.5 * before
    stage.ask(requests.ZONES_DELETE, Named(name="new"))
    stage.bus.run(1.5)
    assert np.count_nonzero(grid_of(stage.maps[-1]).values_at(beyond) >= 0) >= before


def test_zones_drawn_before_anything_is_mapped_are_refused(stage: Stage) -> None:
    stage.base.silent.add("scan")
    stage.ask(requests.MAP_NEW, MapNamed(name="home"))
    stage.bus.run(2.0)
    assert stage.refusal(requests.MAP_ZONES_PUT, STAIRS).code == codes.NOT_READY
    stage.ask(requests.MAP_CANCEL)
    assert stage.refusal(requests.MAP_ZONES_PUT, STAIRS).code == codes.NOT_MAPPING


@pytest.mark.parametrize("is_saved", [True, False])
def test_zones_drawn_while_a_map_is_extended_are_its_own_once_it_is_saved(
    stage: Stage, is_saved: bool
) -> None:
    stage.map(seconds=3.0)
    stage.ask(requests.MAP_SAVE, SaveMap())
    stage.bus.run(2.0)
    stage.ask(requests.ZONES_PUT, STAIRS)
    stage.ask(requests.MAP_EXTEND, MapNamed(name="home"))
    stage.drive(2.0, 0.2)
    stage.ask(requests.ZONES_PUT, MIRROR)
    stage.ask(requests.ZONES_DELETE, Named(name="stairs"))
    assert zones_of(stage) == {"mirror": MIRROR}
    stage.ask(requests.MAP_SAVE, SaveMap()) if is_saved else stage.ask(requests.MAP_CANCEL)
    stage.bus.run(2.0)
    assert stage.status.state == "idle"
    assert list(zones_of(stage)) == (["mirror"] if is_saved else ["stairs"])


def test_a_canceled_map_leaves_the_one_of_before(stage: Stage) -> None:
    true_T_map = stage.map(seconds=4.0)
    stage.ask(requests.MAP_SAVE, SaveMap())
    stage.bus.run(2.0)
    stage.map("other", seconds=3.0)
    stage.ask(requests.MAP_CANCEL)
    stage.drive(1.0, 0.1)
    assert stage.status.state == "idle"
    assert (stage.pose.state, stage.pose.map) == ("localized", "home")
    assert stage.error_m(stage.straightened(true_T_map)) < 0.08
    grid: OccupancyGrid = stage.maps[-1]
    assert grid.name == "home"
    assert stage.ask(requests.MAP_LIST) == ["home"]
    assert stage.refusal(requests.MAP_CANCEL).code == codes.NOT_MAPPING


def test_a_paused_map_does_not_grow_and_the_pose_is_followed(stage: Stage) -> None:
    true_T_map = stage.map(seconds=3.0)
    assert stage.ask(requests.MAP_PAUSE, PauseMap()).state == "paused"
    scans, seconds = stage.status.scans, stage.status.seconds
    stage.drive(2.0, 0.3)
    assert (stage.status.scans, stage.status.seconds) == (scans, seconds)
    assert stage.error_m(true_T_map) < 0.08
    assert stage.ask(requests.MAP_PAUSE, PauseMap(on=False)).state == "mapping"
    stage.drive(2.0, 0.3)
    assert stage.status.scans > scans


def test_what_was_mapped_last_can_be_forgotten(stage: Stage) -> None:
    stage.map(seconds=4.0)
    scans = stage.status.scans
    stage.drive(5.0, 0.25)
    assert stage.status.scans > scans
    assert stage.ask(requests.MAP_UNDO, UndoMap(seconds=5.0)).scans <= scans + 1
    assert stage.ask(requests.MAP_UNDO, UndoMap(seconds=60.0)).state == "mapping"
    stage.drive(1.0, 0.25)
    assert stage.ask(requests.MAP_SAVE, SaveMap()).state == "saving"


@pytest.mark.parametrize("request_", [requests.MAP_SAVE, requests.MAP_PAUSE, requests.MAP_UNDO])
def test_without_a_map_in_the_making_there_is_nothing_to_do(
    stage: Stage, request_: requests.Request
) -> None:
    assert stage.refusal(request_, Nothing()).code == codes.NOT_MAPPING


def test_some_time_after_a_map_the_mapper_gives_its_memory_back(make_stage: MakeStage) -> None:
    stage = make_stage("mapper")
    mapper = stage.bus.nodes["mapper"].service
    stage.ask(requests.MAP_NEW, MapNamed(name="home"))
    stage.base.silent.add("scan")
    stage.bus.run(40.0)
    assert not mapper.is_spent
    stage.ask(requests.MAP_CANCEL)
    stage.bus.run(20.0)
    assert not mapper.is_spent
    stage.bus.run(20.0)
    assert mapper.is_spent


def carried_away(stage: Stage) -> Pose2D:
    """Map a bit, and carry the robot away until a part hangs loose; returns true_T_map."""
    true_T_map = stage.map(seconds=4.0)
    stage.world.pose = Pose2D(5.6, 4.4, 2.0)
    for _ in range(100):
        if stage.pose.state == "lost":
            stage.bus.run(1.0)  # until the status tells of it
            assert stage.status.loose
            return true_T_map
        stage.bus.run(0.1)
    raise AssertionError("no part hangs loose")


def test_a_map_saved_while_the_robot_is_lost_is_searched_for_where_it_is(stage: Stage) -> None:
    carried_away(stage)  # to where the map shows nothing
    num_poses = len(stage.poses)
    stage.ask(requests.MAP_SAVE, SaveMap())
    stage.bus.run(4.0)
    assert stage.status.state == "idle"
    assert {one.state for one in stage.poses[num_poses:]} == {"lost", "searching"}


def test_a_person_joins_the_part_that_hangs_loose(stage: Stage) -> None:
    assert stage.refusal(requests.MAP_JOIN, JoinPart(pose=START)).code == codes.NOT_MAPPING
    true_T_map = carried_away(stage)
    scans = stage.status.scans
    assert "say where the robot is" in stage.status.message
    far = Pose2D(1e4, 0.0, 0.0)
    assert stage.refusal(requests.MAP_JOIN, JoinPart(pose=far)).code == codes.OUTSIDE_MAP
    here = true_T_map.inverse() @ stage.world.map_T_base
    stage.ask(requests.MAP_JOIN, JoinPart(pose=here @ Pose2D(0.2, 0.1, 0.1)))
    stage.bus.run(1.5)
    assert (stage.status.loose, stage.pose.state) == (0, "mapping")
    assert stage.status.scans > scans
    assert stage.error_m(true_T_map) < 0.5
    assert stage.refusal(requests.MAP_JOIN, JoinPart(pose=here)).code == codes.NOT_LOOSE


def test_a_person_removes_what_hangs_loose(stage: Stage) -> None:
    stage.map(seconds=2.0)
    assert stage.refusal(requests.MAP_DROP).code == codes.NOT_LOOSE
    stage.ask(requests.MAP_CANCEL)
    carried_away(stage)
    scans, loose = stage.status.scans, stage.status.loose
    status = stage.ask(requests.MAP_DROP)
    assert (status.scans, status.loose) == (scans, 0)
    what = "1 scan that hung loose has" if loose == 1 else f"{loose} scans that hung loose have"
    assert what in status.message
