"""Maps that are changed while the robot is on them: what comes of them, zones, places and pose."""

import math
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from trolley import codes, requests, topics
from trolley.codes import Refused
from trolley.geometry import Pose2D
from trolley.gridmap import GridMap, load_map, save_map
from trolley.messages import (
    Crop,
    DrawWall,
    EditMap,
    EraseStroke,
    MapEdited,
    MapOp,
    Merge,
    SavedPose,
    SavedPoses,
    Stop,
    TakeBack,
    Tour,
    Tours,
    Turn,
    Zone,
    Zones,
)
from trolley.messages.request_params import LoadMap, MapNamed, StartTour
from trolley_localizer.map_server import MapServer
from trolley_mapper.edit import editor, map_switch, map_versions
from trolley_tour.stored import places, tours

from .conftest import START, Planner, Stage, flat

RUG = Zone(name="rug", kind="keepout", points=[(4.0, 1.0), (5.0, 1.0), (5.0, 2.0)])
SOFA = SavedPose(name="sofa", map="flat", pose=Pose2D(1.5, 2.0, 0.5))


class Home(Stage):
    """A robot that is on the map `flat`, with a zone, a place and a tour."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        (folder / "maps").mkdir()
        self.put_map("flat")
        super().__init__(folder, "localizer", "mapper", "tour")
        self.zones = self.bus.record(topics.ZONES)
        self.places = self.bus.record(topics.POSES)
        self.tours = self.bus.record(topics.TOURS)
        self.ask(requests.MAP_LOAD, LoadMap(name="flat", pose=START))
        self.bus.run(1.0)
        self.ask(requests.ZONES_PUT, RUG)
        self.ask(requests.POSES_PUT, SOFA)
        stops = [Stop(name="sofa"), Stop(pose=Pose2D(2.0, 2.0, 0.0))]
        self.ask(requests.TOURS_PUT, Tour(name="round", stops=stops))

    def put_map(self, name: str) -> None:
        grid = flat()
        named = GridMap(name, grid.resolution, grid.origin, grid.cells)
        save_map(named, self.folder / f"maps/{name}.yaml")

    def files(self) -> dict[Path, bytes]:
        """All maps as they are on disk."""
        found = (self.folder / "maps").rglob("*")
        return {file: file.read_bytes() for file in found if file.is_file()}

    def edit(self, *ops: MapOp, name: str = "flat", as_name: str | None = None) -> MapEdited:
        params = EditMap(name=name, ops=list(ops), as_name=as_name)
        reply = self.ask(requests.MAP_EDIT, params)
        self.bus.run(1.0)
        return reply

    def restart_mapper(self) -> None:
        self.bus.kill("mapper")
        self.begin("mapper")
        self.bus.run(3.0)

    @property
    def zone_names(self) -> list[str]:
        return [zone.name for zone in self.newest(self.zones).zones]

    @staticmethod
    def newest(said: list[Any]) -> Any:
        return said[-1]


@pytest.fixture
def home(tmp_path: Path) -> Home:
    return Home(tmp_path)


def test_a_speck_is_erased_a_wall_drawn_and_both_undone(home: Home) -> None:
    file = home.folder / "maps/flat.yaml"
    before = load_map(file).cells
    speck = EraseStroke(points=[(1.9, 0.75)], width=0.3)
    reply = home.edit(speck, DrawWall(points=[(2.5, 3.0), (2.5, 3.5)], width=0.1))
    assert (reply.state, reply.version) == ("saved", 2)
    assert reply.message == "Erased, drew a wall: flat is stored as version 2."
    after = load_map(file)
    assert after.values_at(np.array([[1.9, 0.75], [2.5, 3.2]])).tolist() == [0, 100]
    assert (before != after.cells).sum() < 100
    assert bytes(home.maps[-1].cells) == after.cells.tobytes()
    assert home.poses[-1].state == "localized"
    assert home.edit(TakeBack()).version == 3
    np.testing.assert_array_equal(load_map(file).cells, before)


def test_zones_places_tours_and_the_robot_turn_with_their_map(home: Home) -> None:
    turn = Turn(angle=math.radians(30.0), about=(1.0, 1.0))
    new_T_old = Pose2D(1.0, 1.0, turn.angle) @ Pose2D(-1.0, -1.0, 0.0)
    for wanted in (new_T_old, Pose2D.identity()):
        home.edit(turn if wanted is new_T_old else TakeBack())
        zones: Zones = home.zones[-1]
        points = wanted.transform_points(np.array(RUG.points))
        np.testing.assert_allclose(zones.zones[0].points, points, atol=1e-9)
        places: SavedPoses = home.places[-1]
        assert places.poses[0].pose.distance_to(wanted @ SOFA.pose) < 1e-9
        tours: Tours = home.tours[-1]
        stops = tours.tours[0].stops
        assert stops[0].name == "sofa"
        assert stops[1].pose is not None
        assert stops[1].pose.distance_to(wanted @ Pose2D(2.0, 2.0, 0.0)) < 1e-9
        home.bus.run(2.0)
        estimate = home.poses[-1]
        assert estimate.state == "localized"
        assert estimate.pose is not None
        assert estimate.pose.distance_to(wanted @ START) < 0.1


def test_tours_of_another_map_stay_as_they_are(home: Home) -> None:
    """One that tells no map, as none did before, turns with any."""
    stops = [Stop(pose=Pose2D(2.0, 2.0, 0.0))]
    cellar = Tour(name="cellar", map="cellar", stops=stops)
    home.ask(requests.TOURS_PUT, cellar)

    def stored() -> dict[str, Tour]:
        return {tour.name: tour for tour in home.tours[-1].tours}

    home.edit(Turn(angle=0.5, about=(1.0, 1.0)))
    assert stored()["round"].map == "flat"
    home.edit(Crop(corners=((-1.0, -1.0), (9.0, 9.0))), as_name="small")
    assert stored()["round"].map == "small"
    home.edit(TakeBack(), name="small")
    assert stored()["round"].map == "flat"
    assert stored()["cellar"] == cellar


def test_a_goal_that_was_sent_while_its_map_was_turned_is_canceled(home: Home) -> None:
    planner = home.bus.add(Planner())
    home.edit(EraseStroke(points=[(2.0, 2.0)], width=0.1))
    assert planner.num_canceled == 0  # it holds on the map as it lies
    home.edit(Turn(angle=0.5, about=(1.0, 1.0)))
    assert planner.num_canceled == 1


def test_a_map_does_not_turn_under_a_trip(home: Home) -> None:
    turn = EditMap(name="flat", ops=[Turn(angle=0.5, about=(1.0, 1.0))])
    home.ask(requests.TOUR_START, StartTour(name="round"))
    for change in (requests.TOUR_PAUSE, requests.TOUR_RESUME, requests.TOUR_STOP):
        assert home.refusal(requests.MAP_EDIT, turn).code == codes.BUSY
        home.bus.run(0.5)
        home.ask(change)
    assert home.ask(requests.MAP_EDIT, turn).state == "saved"


def test_under_another_name_the_old_map_stays_and_the_robot_goes_over(home: Home) -> None:
    home.edit(Crop(corners=((-1.0, -1.0), (4.5, 6.0))), as_name="small")
    assert home.poses[-1].map == "small"
    assert home.poses[-1].state == "localized"
    assert home.zone_names == ["rug"]
    assert home.places[-1].poses[0].map == "small"
    home.edit(TakeBack(), name="small")
    assert home.poses[-1].map == "flat"
    assert home.places[-1].poses[0].map == "flat"
    assert (home.folder / "maps/small.yaml").exists()


def test_two_halves_are_merged_with_their_zones(home: Home) -> None:
    home.edit(Crop(corners=((3.0, -1.0), (9.0, 6.0))), as_name="right")
    home.edit(TakeBack(), name="right")
    home.edit(Crop(corners=((-1.0, -1.0), (5.0, 6.0))))
    whole, half = flat().occupied_mask().sum(), home.maps[-1]
    # The two rooms are of one size: turned by half a circle the one fits onto the other.
    unplaced = EditMap(name="flat", ops=[Merge(name="right")])
    assert home.refusal(requests.MAP_EDIT, unplaced).code == codes.AMBIGUOUS
    reply = home.edit(Merge(name="right", pose=Pose2D.identity()))
    assert reply.placed == Pose2D.identity()
    assert reply.walls
    assert home.maps[-1].width > half.width
    count = int((np.frombuffer(home.maps[-1].cells, np.int8) == 100).sum())
    assert 0.9 * whole < count < 1.3 * whole
    assert home.zone_names == ["rug", "rug 2"]
    home.edit(TakeBack())
    assert home.zone_names == ["rug"]


REFUSED = [
    (EditMap(name="attic", ops=[Turn(angle=1.0)]), codes.UNKNOWN_NAME),
    (EditMap(name="flat", ops=[Merge(name="attic")]), codes.UNKNOWN_NAME),
    (EditMap(name="flat", ops=[TakeBack()]), codes.BAD_REQUEST),
    (EditMap(name="flat", ops=[Turn(angle=1.0), TakeBack()]), codes.BAD_REQUEST),
    (EditMap(name="flat", ops=[Crop(corners=((90.0, 9.0), (91.0, 8.0)))]), codes.OUTSIDE_MAP),
    (EditMap(name="flat", ops=[DrawWall(points=[(1.0, 1.0)])], as_name="flat2"), codes.EXISTS),
    (EditMap(name="flat2", ops=[Turn(angle=1.0)]), codes.WRONG_MAP),
    (
        EditMap(name="flat", ops=[Merge(name="flat2", pose=Pose2D(1e5, 1e5, 0.0))]),
        codes.TOO_LARGE,
    ),
]


def test_what_cannot_be_is_refused_and_changes_nothing(home: Home) -> None:
    home.put_map("flat2")
    before = home.files()
    for params, code in REFUSED:
        assert home.refusal(requests.MAP_EDIT, params).code == code, params
        assert home.files() == before


def test_no_map_is_turned_to_where_no_message_can_hold_it(home: Home) -> None:
    far = EditMap(name="flat", ops=[Turn(angle=math.pi, about=(9e5, 0.0))])
    assert home.refusal(requests.MAP_EDIT, far).code == codes.OUTSIDE_MAP
    home.bus.run(1.0)
    assert home.poses[-1].state == "localized"


def test_a_preview_stores_nothing_and_logs_no_edit(
    home: Home, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO")
    before = home.files()
    params = EditMap(name="flat", ops=[Turn(angle=0.2)], preview=True)
    reply = home.ask(requests.MAP_EDIT, params)
    assert (reply.state, reply.version) == ("preview", None)
    assert home.files() == before
    assert "Map edited" not in caplog.text
    home.edit(Turn(angle=0.2))
    assert "Map edited" in caplog.text


def test_another_robot_on_the_map_is_not_led_astray(home: Home) -> None:
    (home.folder / "hall").mkdir()
    (home.folder / "hall/last_pose.toml").write_text('map = "flat"\n')
    refused = home.refusal(requests.MAP_EDIT, EditMap(name="flat", ops=[Turn(angle=1.0)]))
    assert refused.code == codes.EXISTS
    assert "hall would be lost" in refused.message
    home.edit(DrawWall(points=[(1.0, 1.0)]))  # which moves nothing


def test_what_did_not_follow_before_a_cut_follows_at_the_next_start(
    home: Home, monkeypatch: pytest.MonkeyPatch
) -> None:
    params = EditMap(name="flat", ops=[Turn(angle=0.5)])
    with monkeypatch.context() as patch:
        patch.setattr(editor.MapSwitch, "begin", lambda *_: None)
        assert home.ask(requests.MAP_EDIT, params).state == "working"
    assert home.zones[-1].zones == [RUG]
    home.restart_mapper()
    wanted = Pose2D(0.0, 0.0, 0.5).transform_points(np.array(RUG.points))
    np.testing.assert_allclose(home.zones[-1].zones[0].points, wanted, atol=1e-9)
    assert not list(home.folder.rglob(map_switch.PLAN_FILE))


def test_an_edit_after_which_the_robot_stands_in_a_wall_is_not_repeated_later(home: Home) -> None:
    reply = home.edit(DrawWall(points=[(START.x, START.y)], width=0.8), as_name="walled")
    assert "walled is stored as version 1. The robot stands in an obstacle" in reply.message
    assert home.poses[-1].map == "walled"
    assert not list(home.folder.rglob(map_switch.PLAN_FILE))
    home.ask(requests.MAP_LOAD, LoadMap(name="flat", pose=START))
    home.restart_mapper()
    assert home.poses[-1].map == "flat"


def test_a_switch_that_failed_does_not_take_the_robot_off_a_map_loaded_since(
    home: Home, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(editor.MapSwitch, "begin", lambda *_: None)
        home.ask(requests.MAP_EDIT, EditMap(name="flat", ops=[Turn(angle=0.5)]))
    home.bus.kill("mapper")
    home.put_map("attic")
    home.ask(requests.MAP_LOAD, LoadMap(name="attic", pose=START))
    home.begin("mapper")
    home.bus.run(3.0)
    assert home.poses[-1].map == "attic"
    home.ask(requests.MAP_LOAD, LoadMap(name="flat", pose=START))
    home.restart_mapper()
    wanted = Pose2D(0.0, 0.0, 0.5).transform_points(np.array(RUG.points))
    np.testing.assert_allclose(home.zones[-1].zones[0].points, wanted, atol=1e-9)
    assert not list(home.folder.rglob(map_switch.PLAN_FILE))


def test_a_map_that_is_long_in_loading_gets_its_zones_all_the_same(
    home: Home, monkeypatch: pytest.MonkeyPatch
) -> None:
    read, late = MapServer._read_map, []
    monkeypatch.setattr(MapServer, "_read_map", lambda *args: late.append(args))
    params = EditMap(name="flat", ops=[Turn(angle=0.5)], id="a1")
    assert home.ask(requests.MAP_EDIT, params).state == "working"
    home.bus.run(3.0)
    assert home.ask(requests.MAP_EDIT, params).state == "working"
    busy = home.refusal(requests.MAP_EDIT, EditMap(name="flat", ops=[TakeBack()]))
    assert busy.code == codes.BUSY
    assert home.refusal(requests.MAP_NEW, MapNamed(name="attic")).code == codes.NOT_READY
    assert home.zones[-1].zones == [RUG]
    read(*late[0])
    home.bus.run(1.0)
    reply = home.ask(requests.MAP_EDIT, params)
    assert (reply.state, reply.message) == ("saved", "Turned: flat is stored as version 2.")
    wanted = Pose2D(0.0, 0.0, 0.5).transform_points(np.array(RUG.points))
    np.testing.assert_allclose(home.zones[-1].zones[0].points, wanted, atol=1e-9)
    assert not list(home.folder.rglob(map_switch.PLAN_FILE))


def test_no_edit_begins_while_a_map_is_about_to(home: Home) -> None:
    home.base.silent = {"scan"}
    asks, answers = home.bus.nodes["tour"].service, []
    asks.request(requests.MAP_EXTEND, MapNamed(name="flat"), answers.append)
    home.bus.run(0.5)
    assert not answers
    turn = EditMap(name="flat", ops=[Turn(angle=0.5)])
    assert home.refusal(requests.MAP_EDIT, turn).code == codes.MAPPING


def test_places_that_are_not_known_are_not_left_behind(home: Home) -> None:
    before = home.files()
    home.bus.kill("tour")
    params = EditMap(name="flat", ops=[Turn(angle=0.5)])
    refused = home.refusal(requests.MAP_EDIT, params)
    assert refused.code == codes.NOT_READY
    assert "saved places" in refused.message
    assert home.files() == before
    home.edit(DrawWall(points=[(1.0, 1.0)]))  # which moves nothing
    home.begin("tour")
    home.bus.run(1.0)
    home.edit(Turn(angle=0.5))
    moved = {place.name: place.pose for place in home.newest(home.places).poses}
    wanted = Pose2D(0.0, 0.0, 0.5) @ SOFA.pose
    assert moved["sofa"].distance_to(wanted) < 1e-6


def test_one_that_asks_again_hears_of_the_same_change(home: Home) -> None:
    params = EditMap(name="flat", ops=[Turn(angle=0.5)], id="a1")
    assert home.ask(requests.MAP_EDIT, params) == home.ask(requests.MAP_EDIT, params)
    other = EditMap(name="flat", ops=[Turn(angle=0.6)], id="a1")
    assert home.refusal(requests.MAP_EDIT, other).code == codes.BAD_REQUEST


@contextmanager
def no_map_can_be_read(monkeypatch: pytest.MonkeyPatch) -> Generator[None]:
    def refuse(*_: Any) -> None:
        raise Refused(codes.BAD_REQUEST, "The map cannot be read.")

    with monkeypatch.context() as patch:
        patch.setattr(MapServer, "_read_map", refuse)
        yield


def test_zones_and_places_stay_where_they_are_while_the_edited_map_cannot_be_loaded(
    home: Home, monkeypatch: pytest.MonkeyPatch
) -> None:
    with no_map_can_be_read(monkeypatch):
        reply = home.edit(Turn(angle=0.5), as_name="turned")
    assert "The map cannot be read. The robot stays on the map of before" in reply.message
    assert home.poses[-1].map == "flat"
    assert home.newest(home.zones).zones == [RUG]
    assert home.newest(home.places).poses == [SOFA]
    home.restart_mapper()
    assert home.newest(home.zones).map == "turned"
    wanted = Pose2D(0.0, 0.0, 0.5).transform_points(np.array(RUG.points))
    np.testing.assert_allclose(home.newest(home.zones).zones[0].points, wanted, atol=1e-9)
    assert home.newest(home.places).poses[0].map == "turned"
    assert not list(home.folder.rglob(map_switch.PLAN_FILE))


@pytest.mark.parametrize("is_restarted", [False, True])
def test_an_edit_whose_map_cannot_be_loaded_can_be_undone(
    home: Home, monkeypatch: pytest.MonkeyPatch, is_restarted: bool
) -> None:
    with no_map_can_be_read(monkeypatch):
        assert "Or undo the edit." in home.edit(Turn(angle=0.5)).message
        if is_restarted:
            home.restart_mapper()
    where = home.pose.pose
    assert where is not None
    assert home.edit(TakeBack()).version == 3
    assert home.newest(home.zones).zones == [RUG]
    assert home.newest(home.places).poses == [SOFA]
    assert not list(home.folder.rglob(map_switch.PLAN_FILE))
    assert home.pose.state == "localized"
    assert home.pose.pose is not None
    assert home.pose.pose.distance_to(where) < 0.05
    assert home.maps[-1].cells == flat().cells.tobytes()


@pytest.mark.parametrize("is_restarted", [False, True])
def test_a_map_of_its_own_that_cannot_be_loaded_holds_up_no_other_edit(
    home: Home, monkeypatch: pytest.MonkeyPatch, is_restarted: bool
) -> None:
    with no_map_can_be_read(monkeypatch):
        home.edit(Turn(angle=0.5), as_name="turned")
        if is_restarted:
            home.restart_mapper()
    home.ask(requests.ZONES_PUT, replace(RUG, name="mat"))
    home.edit(TakeBack(), name="turned")
    home.edit(Turn(angle=0.2))
    assert home.maps[-1].name == "flat"
    wanted = Pose2D(0.0, 0.0, 0.2).transform_points(np.array(RUG.points))
    for zone in home.newest(home.zones).zones:
        np.testing.assert_allclose(zone.points, wanted, atol=1e-9)
    home.restart_mapper()
    assert home.maps[-1].name == "flat"
    assert home.newest(home.places).poses[0].map == "flat"
    assert not list(home.folder.rglob(map_switch.PLAN_FILE))


def test_nobody_is_told_to_undo_an_edit_while_the_localizer_does_not_answer(
    home: Home, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(MapServer, "_read_map", lambda *_: None)
    params = EditMap(name="flat", ops=[Turn(angle=0.5)], id="a1")
    home.ask(requests.MAP_EDIT, params)
    home.bus.run(map_switch.LOAD_NS * 1e-9 + 3.0)
    message = home.ask(requests.MAP_EDIT, params).message
    assert "The localizer has not loaded flat. The robot stays" in message
    assert "undo" not in message


def test_an_edit_that_has_not_reached_zones_and_places_is_not_forgotten_for_the_next(
    home: Home, monkeypatch: pytest.MonkeyPatch
) -> None:
    home.put_map("attic")
    with monkeypatch.context() as patch:
        patch.setattr(editor.MapSwitch, "begin", lambda switch, _: switch._done("Cut."))
        home.edit(Turn(angle=0.5))
    home.ask(requests.MAP_LOAD, LoadMap(name="attic", pose=START))
    home.bus.run(1.0)
    before = home.files()
    for name in ("attic", "flat"):
        wall = EditMap(name=name, ops=[DrawWall(points=[(1.0, 1.0)])])
        refused = home.refusal(requests.MAP_EDIT, wall)
        assert refused.code == codes.BUSY
        assert "load flat and restart the mapper" in refused.message
        assert home.files() == before
    home.ask(requests.MAP_LOAD, LoadMap(name="flat", pose=START))
    home.restart_mapper()
    new_T_old = Pose2D(0.0, 0.0, 0.5)
    wanted = new_T_old.transform_points(np.array(RUG.points))
    np.testing.assert_allclose(home.newest(home.zones).zones[0].points, wanted, atol=1e-9)
    assert home.newest(home.places).poses[0].pose.distance_to(new_T_old @ SOFA.pose) < 1e-6
    assert home.edit(DrawWall(points=[(1.0, 1.0)])).version == 3


def test_what_was_refused_after_the_switch_is_not_tried_again_at_each_start(
    home: Home, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: Any) -> None:
        raise Refused(codes.TOO_LARGE, "There is no room for it.")

    with monkeypatch.context() as patch:
        patch.setattr(tours.Tours, "_put", refuse)
        reply = home.edit(Turn(angle=0.5))
    assert "There is no room for it." in reply.message
    home.ask(requests.POSES_PUT, SOFA)
    home.restart_mapper()
    assert home.newest(home.places).poses == [SOFA]
    assert not list(home.folder.rglob(map_switch.PLAN_FILE))


def test_only_what_could_not_be_saved_is_tried_again_at_the_next_start(
    home: Home, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: Any) -> None:
        raise Refused(codes.NOT_SAVED, "The disk is full.")

    with monkeypatch.context() as patch:
        patch.setattr(places.Places, "put", refuse)
        reply = home.edit(Turn(angle=0.5))
    assert "The disk is full." in reply.message
    assert home.newest(home.places).poses == [SOFA]
    home.ask(requests.ZONES_PUT, RUG)
    home.restart_mapper()
    assert home.newest(home.zones).zones == [RUG]
    wanted = Pose2D(0.0, 0.0, 0.5) @ SOFA.pose
    assert home.newest(home.places).poses[0].pose.distance_to(wanted) < 1e-6
    assert not list(home.folder.rglob(map_switch.PLAN_FILE))


def test_an_edit_that_could_not_be_stored_leaves_no_plan(
    home: Home, monkeypatch: pytest.MonkeyPatch
) -> None:
    home.edit(DrawWall(points=[(2.5, 3.0), (2.5, 3.5)], width=0.1))
    write = map_versions.write_atomically

    def fail(path: Path, *content: Any) -> None:
        if path.suffix == ".pgm" and path.parent.name == "maps":
            raise OSError(28, "No space left on device")
        write(path, *content)

    with monkeypatch.context() as patch:
        patch.setattr(map_versions, "write_atomically", fail)
        refused = home.refusal(requests.MAP_EDIT, EditMap(name="flat", ops=[Turn(angle=0.5)]))
    assert refused.code == codes.NOT_SAVED
    assert not list(home.folder.rglob(map_switch.PLAN_FILE))


def test_the_map_in_use_is_edited_though_the_lidar_is_off(home: Home) -> None:
    home.put_map("attic")
    home.base.silent = {"scan"}
    home.ask(requests.MAP_LOAD, LoadMap(name="attic", pose=START))
    home.bus.run(1.0)
    before = len(home.maps)
    home.ask(requests.MAP_EDIT, EditMap(name="attic", ops=[Turn(angle=0.5)]))
    home.bus.run(3.0)
    assert len(home.maps) > before
    assert home.maps[-1].name == "attic"
