"""The localizer on the wire, in lock-step: messages in, messages and counters out."""

import json
import math
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from trolley import codes, requests, topics
from trolley.codes import Refused
from trolley.config import RobotConfig
from trolley.geometry import Pose2D, Twist2D, integrate_twist
from trolley.geometry.pose import LARGEST
from trolley.gridmap import GridMap, save_map
from trolley.messages import (
    ChangedSetting,
    Clock,
    ConfigChanges,
    Odometry,
    PoseEstimate,
    SavedPose,
    SavedPoses,
    Scan,
    Transform,
    Zone,
    floats_to_bytes,
)
from trolley.messages.request_params import LoadMap, Named, SetPose
from trolley.runtime.lockstep import Lockstep
from trolley_localizer.core import Localizer
from trolley_localizer.service import LocalizerService

from .conftest import BASE_T_LASER, at, make_scan

STEP_NS = 50_000_000
START = (5.5, 3.0, 0.4)


pytestmark = pytest.mark.drives


class Robot:
    """A base that drives as told, with a lidar, on a lock-step bus."""

    def __init__(self, folder: Path, grid: GridMap, **config: Any) -> None:
        self.grid = grid
        self.folder = folder
        self.config = msgspec.convert(
            {
                "robot": {"name": "trolley", "footprint": {"radius_m": 0.17}},
                "map": {"file": str(folder / f"{grid.name}.yaml")},
                **config,
            },
            RobotConfig,
        )
        self.pose = at(grid, *START)
        self.odom = Pose2D.identity()
        self.epoch_ns = 0
        self.sends_odometry = True
        self.begin()

    def begin(self) -> None:
        """Start the localizer's process on the state that lies there."""
        self.bus = Lockstep(state=self.folder / "state")
        self.poses = self.bus.record(topics.POSE)
        self.maps = self.bus.record(topics.MAP)
        self.zones = self.bus.record(topics.ZONES)
        self.transforms = self.bus.record(topics.TF, "odom")
        self.beams = self.bus.record(topics.BEAMS)
        self.particles = self.bus.record(topics.PARTICLES)
        self.bus.add(LocalizerService(self.config))
        laser = Transform(stamp_ns=0, parent="base_link", child="laser", pose=BASE_T_LASER)
        self.bus.publish(topics.TF, laser, "laser")

    def drive(self, seconds: float, vx: float = 0.0, wz: float = 0.0) -> None:
        """Send odometry at 20 Hz and scans at 10 Hz while time passes."""
        twist = Twist2D(vx, 0.0, wz)
        for step in range(round(seconds * 20)):
            self.bus.run(STEP_NS * 1e-9)
            self.pose = integrate_twist(self.pose, twist, STEP_NS * 1e-9)
            self.odom = integrate_twist(self.odom, twist, STEP_NS * 1e-9)
            now_ns = self.bus.now_ns
            self.bus.publish(topics.CLOCK, Clock(stamp_ns=now_ns, rate=1.0, epoch=self.epoch_ns))
            if self.sends_odometry:
                odometry = Odometry(stamp_ns=now_ns, pose=self.odom, twist=twist)
                self.bus.publish(topics.ODOM, odometry)
            if step % 2:
                self.bus.publish(topics.SCAN, self.scan(now_ns))

    def scan(self, stamp_ns: int) -> Scan:
        taken = make_scan(self.grid, self.pose, self.odom)
        return Scan(
            stamp_ns=stamp_ns,
            frame="laser",
            angle_min=taken.angle_min,
            angle_increment=taken.angle_increment,
            time_increment=0.0,
            range_min=taken.range_min,
            range_max=taken.range_max,
            ranges=floats_to_bytes(taken.ranges),
        )

    @property
    def last(self) -> PoseEstimate:
        return self.poses[-1]

    def error_m(self) -> float:
        assert self.last.pose is not None
        return self.last.pose.distance_to(self.pose)


MakeRobot = Callable[..., Robot]


@pytest.fixture
def make_robot(tmp_path: Path, flat: GridMap) -> Iterator[MakeRobot]:
    robots: list[Robot] = []

    def make(**config: Any) -> Robot:
        save_map(flat, tmp_path / "flat.yaml")
        robots.append(Robot(tmp_path, flat, **config))
        return robots[-1]

    yield make
    for robot in robots:
        robot.bus.close()


def start_at(pose: Pose2D) -> dict[str, Any]:
    return {"pose": {"x": pose.x, "y": pose.y, "yaw": pose.yaw}}


def test_map_and_zones_are_published_at_the_start(make_robot: MakeRobot, flat: GridMap) -> None:
    robot = make_robot()
    assert [m.name for m in robot.maps] == ["flat"]
    assert robot.maps[0].cells == flat.cells.tobytes()
    assert (robot.maps[0].width, robot.maps[0].height) == (flat.cols, flat.rows)
    assert robot.zones[-1].map == "flat"
    assert robot.zones[-1].zones == []


def test_settings_that_are_changed_count_from_the_next_scan_on(
    make_robot: MakeRobot, flat: GridMap
) -> None:
    robot = make_robot(start=start_at(at(flat, *START)))
    robot.drive(2.0, 0.3)
    assert robot.last.state == "localized"
    change = ChangedSetting(section="localizer", key="max_spread_m", value=0.001)
    robot.bus.publish(topics.CONFIG, ConfigChanges(stamp_ns=0, changes=[change]))
    robot.drive(2.0, 0.3)
    assert robot.last.state == "unsure"
    assert robot.error_m() < 0.05, "the estimate itself goes on"
    robot.bus.publish(topics.CONFIG, ConfigChanges(stamp_ns=0, changes=[]))
    robot.drive(2.0, 0.3)
    assert robot.last.state == "localized"


def test_each_scan_gives_a_pose_and_before_it_the_transform(
    make_robot: MakeRobot, flat: GridMap
) -> None:
    robot = make_robot(start=start_at(at(flat, *START) @ Pose2D(0.2, 0.1, 0.1)))
    robot.drive(3.0, 0.3, 0.3)
    assert len(robot.poses) == 30
    assert robot.last.state == "localized"
    assert robot.last.map == "flat"
    assert robot.error_m() < 0.05
    assert robot.transforms[-1].stamp_ns == robot.last.stamp_ns
    joined = robot.transforms[-1].pose @ robot.odom
    assert robot.last.pose is not None
    assert joined.distance_to(robot.last.pose) < 1e-6
    assert len(robot.beams) == 30
    assert 14 <= len(robot.particles) <= 15
    assert len(robot.beams[-1].classes) == 360
    assert robot.bus.counters("localizer") == {}


def test_standing_it_repeats_an_unchanged_transform_once_a_second(
    make_robot: MakeRobot, flat: GridMap
) -> None:
    robot = make_robot(start=start_at(at(flat, *START)))
    robot.drive(4.0)
    assert robot.last.state == "localized"
    poses, transforms = len(robot.poses), len(robot.transforms)
    robot.drive(5.0)
    assert len(robot.poses) - poses == 50
    assert 4 <= len(robot.transforms) - transforms <= 6
    assert robot.last.pose is not None
    held = robot.transforms[-1].pose @ robot.odom
    assert held.distance_to(robot.last.pose) < 1e-9


@pytest.mark.parametrize("push", [(0.4, 0.0), (0.0, 0.8)])
def test_a_push_that_the_wheels_feel_is_in_the_next_pose(
    make_robot: MakeRobot, flat: GridMap, push: tuple[float, float]
) -> None:
    robot = make_robot(start=start_at(at(flat, *START)))
    robot.drive(5.0)
    poses, transforms = len(robot.poses), len(robot.transforms)
    robot.drive(0.1, *push)
    assert len(robot.poses) == poses + 1
    assert len(robot.transforms) == transforms + 1
    assert robot.transforms[-1].stamp_ns == robot.last.stamp_ns
    assert robot.error_m() < 0.02


def test_without_a_start_it_searches_and_keeps_tf_back_until_it_knows(
    make_robot: MakeRobot,
) -> None:
    robot = make_robot()
    robot.drive(0.1)
    assert robot.last.state == "searching"
    assert robot.last.pose is None
    assert robot.transforms == []
    robot.drive(2.0, 0.2, 0.2)
    assert robot.last.state == "localized"
    assert robot.error_m() < 0.05


def test_a_set_pose_is_a_hypothesis(make_robot: MakeRobot) -> None:
    robot = make_robot()
    robot.drive(2.0)
    reply = robot.bus.ask(requests.POSE_SET, SetPose(pose=robot.pose @ Pose2D(0.2, 0.0, 0.1)))
    assert reply.state == "unsure"
    robot.drive(1.0)
    assert robot.last.state == "localized"
    assert robot.error_m() < 0.05


@pytest.mark.parametrize(
    ("x", "y", "code"), [(-3.0, 1.0, codes.OUTSIDE_MAP), (0.05, 3.0, codes.IN_OBSTACLE)]
)
def test_a_pose_where_the_robot_cannot_be_is_refused(
    make_robot: MakeRobot, flat: GridMap, x: float, y: float, code: str
) -> None:
    robot = make_robot()
    with pytest.raises(Refused) as refused:
        robot.bus.ask(requests.POSE_SET, SetPose(pose=at(flat, x, y, 0.0)))
    assert refused.value.code == code


@pytest.mark.parametrize("covariance", [[0.0] * 9, [-1e9] * 9, [LARGEST] * 9])
def test_any_covariance_of_nine_numbers_is_survived(
    make_robot: MakeRobot, covariance: list[float]
) -> None:
    robot = make_robot()
    robot.drive(0.2)
    robot.bus.ask(requests.POSE_SET, SetPose(pose=robot.pose, covariance=covariance))
    robot.drive(1.0)
    assert robot.last.covariance is not None
    assert all(math.isfinite(value) for value in robot.last.covariance)
    assert robot.last.state == "localized"


def test_find_searches_the_whole_map(make_robot: MakeRobot, flat: GridMap) -> None:
    robot = make_robot(start=start_at(at(flat, *START)))
    robot.drive(1.0)
    robot.pose = at(flat, 1.6, 4.8, 2.5)
    assert robot.bus.ask(requests.POSE_FIND).state == "searching"
    robot.drive(1.5)
    assert robot.last.state == "localized"
    assert robot.error_m() < 0.05


def test_it_comes_back_at_the_last_pose(make_robot: MakeRobot, flat: GridMap) -> None:
    robot = make_robot(start=start_at(at(flat, *START)))
    robot.drive(4.0, 0.2)
    robot.bus.close()
    robot.odom, robot.epoch_ns = Pose2D.identity(), 1
    robot.begin()
    robot.drive(0.1)
    assert robot.last.state == "unsure"
    assert robot.error_m() < 0.05
    robot.drive(0.5)
    assert robot.last.state == "localized"


def test_a_kill_loses_two_seconds_at_most(make_robot: MakeRobot, flat: GridMap) -> None:
    robot = make_robot(start=start_at(at(flat, *START)))
    robot.drive(5.0, 0.1)
    robot.bus.kill("localizer")
    saved = (robot.folder / "state" / "trolley" / "last_pose.toml").read_text()
    assert 'map = "flat"' in saved
    robot.begin()
    robot.drive(0.5)
    assert robot.last.state == "localized"


def test_after_a_kill_it_goes_on_where_the_odometry_has_led(
    make_robot: MakeRobot, flat: GridMap
) -> None:
    robot = make_robot(start=start_at(at(flat, *START)))
    robot.drive(4.1, 0.1, 0.4)
    robot.bus.kill("localizer")
    # While it is away the robot drives on.
    for _ in range(20):
        robot.pose = integrate_twist(robot.pose, Twist2D(0.3, 0.0, 0.8), 0.1)
        robot.odom = integrate_twist(robot.odom, Twist2D(0.3, 0.0, 0.8), 0.1)
    robot.begin()
    robot.drive(0.1)
    assert robot.error_m() < 0.03
    robot.drive(0.4)
    assert robot.last.state == "localized"
    assert robot.error_m() < 0.03


def test_what_was_before_is_not_gone_on_from_once_a_pose_was_set(
    make_robot: MakeRobot, flat: GridMap
) -> None:
    robot = make_robot(start=start_at(at(flat, *START)))
    robot.drive(4.0, 0.1)
    robot.bus.kill("localizer")
    robot.begin()
    robot.pose = at(flat, 1.6, 4.8, 2.5)
    robot.bus.ask(requests.POSE_SET, SetPose(pose=robot.pose))
    robot.drive(0.6)
    assert robot.last.state == "localized"
    assert robot.error_m() < 0.05


def test_a_last_pose_on_another_map_is_not_used(make_robot: MakeRobot, flat: GridMap) -> None:
    robot = make_robot(start=start_at(at(flat, *START)))
    file = robot.folder / "state" / "trolley" / "last_pose.toml"
    robot.bus.close()
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text('map = "elsewhere"\n[pose]\nx = 2.0\ny = 2.0\nyaw = 0.0\n')
    robot.begin()
    robot.drive(0.1)
    assert robot.last.pose is not None
    assert robot.error_m() < 0.1


def test_a_start_pose_may_be_the_name_of_a_saved_pose(make_robot: MakeRobot) -> None:
    robot = make_robot(start={"pose": "dock"})
    saved = SavedPose(name="dock", map="flat", pose=robot.pose)
    robot.bus.publish(topics.POSES, SavedPoses(stamp_ns=0, poses=[saved]))
    robot.drive(0.1)
    assert robot.last.state == "unsure"
    assert robot.error_m() < 0.05


def test_zones_are_stored_published_and_deleted(make_robot: MakeRobot) -> None:
    robot = make_robot()
    body = json.dumps({"name": "hall", "kind": "mirror", "points": [[6.0, 1.0], [6.0, 2.0]]})
    key = topics.ZONE.key("trolley", "hall")
    robot.bus.put(key, body.encode(), "application/json")
    assert [zone.name for zone in robot.zones[-1].zones] == ["hall"]
    assert json.loads(robot.bus.get(key)[0].payload)["kind"] == "mirror"
    stairs = Zone(name="stairs", kind="keepout", points=[(1.0, 1.0), (2.0, 1.0), (2.0, 2.0)])
    assert robot.bus.ask(requests.ZONES_PUT, stairs) == stairs
    robot.bus.close()
    robot.begin()
    assert [zone.name for zone in robot.zones[-1].zones] == ["hall", "stairs"]
    robot.bus.delete(key)
    assert robot.bus.ask(requests.ZONES_DELETE, Named(name="stairs")) == stairs
    assert robot.zones[-1].zones == []


def test_zones_that_no_write_has_saved_do_not_hold(
    make_robot: MakeRobot, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot = make_robot()
    line = [(0.0, 0.0), (1.0, 0.0)]
    kept, one, two = (Zone(name=name, kind="mirror", points=line) for name in ("a", "b", "c"))
    assert robot.bus.ask(requests.ZONES_PUT, kept) == kept
    service = robot.bus.nodes["localizer"].service
    jobs: list[tuple[Callable[[], object], Callable[[Any], None]]] = []
    monkeypatch.setattr(service, "work", lambda fn, then: jobs.append((fn, then)))
    for zone in (one, two):
        key = topics.ZONE.key("trolley", zone.name)
        robot.bus.put(key, json.dumps(msgspec.to_builtins(zone)).encode(), "application/json")
        robot.bus.run(0.1)

    def fail(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(service.state, "write", fail)
    assert len(jobs) == 2
    for fn, then in jobs:
        then(fn())
    robot.bus.run(0.1)
    monkeypatch.undo()
    three = Zone(name="d", kind="mirror", points=line)
    assert robot.bus.ask(requests.ZONES_PUT, three) == three
    assert [zone.name for zone in robot.zones[-1].zones] == ["a", "d"]


def test_a_zone_that_is_still_being_written_does_not_hold(
    make_robot: MakeRobot, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot = make_robot()
    service = robot.bus.nodes["localizer"].service
    jobs: list[tuple[Callable[[], object], Callable[[Any], None]]] = []
    monkeypatch.setattr(service, "work", lambda fn, then: jobs.append((fn, then)))

    def put(name: str) -> None:
        body = json.dumps({"name": name, "kind": "mirror", "points": [[6.0, 1.0], [6.0, 2.0]]})
        robot.bus.put(topics.ZONE.key("trolley", name), body.encode(), "application/json")
        robot.bus.run(0.1)

    put("a")
    (write, tell) = jobs[0]
    outcome = write()
    put("b")  # while the outcome of the first is on its way
    tell(outcome)
    robot.bus.run(0.1)
    assert [zone.name for zone in robot.zones[-1].zones] == ["a"]
    assert len(robot.bus.get(topics.ZONE.key("trolley", "*"))) == 1


@pytest.mark.parametrize("is_full_again", [False, True])
def test_a_zone_is_refused_only_if_it_is_not_saved_with_the_next_one(
    make_robot: MakeRobot, monkeypatch: pytest.MonkeyPatch, is_full_again: bool
) -> None:
    robot = make_robot()
    service = robot.bus.nodes["localizer"].service
    jobs: list[tuple[Callable[[], object], Callable[[Any], None]]] = []
    answers: list[Zone | Refused] = []
    one, two = (Zone(name=name, kind="mirror", points=[(6.0, 1.0), (6.0, 2.0)]) for name in "ab")

    def fail(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    def put(zone: Zone) -> None:
        service.request(requests.ZONES_PUT, zone, answers.append)
        robot.bus.run(0.1)

    with monkeypatch.context() as held:
        held.setattr(service, "work", lambda fn, then: jobs.append((fn, then)))
        put(one)
        with monkeypatch.context() as disk:
            disk.setattr("trolley.runtime.state.write_atomically", fail)
            failed = jobs[0][0]()
            put(two)  # while the outcome of the first is on its way
            second = jobs[1][0]() if is_full_again else None
        jobs[0][1](failed)
        jobs[1][1](second if is_full_again else jobs[1][0]())
    robot.bus.run(0.1)
    if is_full_again:
        assert [one.code for one in answers if isinstance(one, Refused)] == ["not_saved"] * 2
        assert robot.zones[-1].zones == []
    else:
        assert answers == [one, two]
        assert robot.zones[-1].zones == [one, two]


def test_a_refused_zone_changes_nothing_and_is_counted(make_robot: MakeRobot) -> None:
    robot = make_robot()
    body = json.dumps({"name": "other", "kind": "mirror", "points": [[6.0, 1.0], [6.0, 2.0]]})
    robot.bus.put(topics.ZONE.key("trolley", "hall"), body.encode(), "application/json")
    assert robot.zones[-1].zones == []
    assert robot.bus.counters("localizer") == {"zones/bad_request": 1}


def test_zones_that_come_with_a_map_are_taken_over_once(make_robot: MakeRobot) -> None:
    robot = make_robot()
    robot.bus.close()
    seeds = robot.folder / "flat.zones.toml"
    seeds.write_text('[[zones]]\nname = "m"\nkind = "mirror"\npoints = [[6.0, 1.0], [6.0, 2.0]]\n')
    robot.begin()
    assert [zone.name for zone in robot.zones[-1].zones] == ["m"]
    robot.bus.ask(requests.ZONES_DELETE, Named(name="m"))
    robot.bus.close()
    robot.begin()
    assert robot.zones[-1].zones == []


def test_maps_are_listed_and_changed_with_the_pose_kept(
    make_robot: MakeRobot, flat: GridMap
) -> None:
    robot = make_robot(start=start_at(at(flat, *START)))
    robot.drive(1.0)
    cells = flat.cells.copy()
    cells[110:112, 20:60] = 100
    (robot.folder / "state" / "maps").mkdir(parents=True, exist_ok=True)
    save_map(
        GridMap("newer", flat.resolution, flat.origin, cells),
        robot.folder / "state" / "maps" / "newer.yaml",
    )
    assert robot.bus.ask(requests.MAP_LIST) == ["flat", "newer"]
    assert robot.bus.ask(requests.MAP_LOAD, LoadMap(name="newer")).width == flat.cols
    assert robot.maps[-1].name == "newer"
    robot.drive(0.1)
    assert robot.last.map == "newer"
    assert robot.error_m() < 0.05
    robot.bus.close()
    robot.begin()
    assert robot.maps[-1].name == "newer"


@pytest.mark.parametrize("by", ["map", "pose"])
def test_a_search_that_nobody_needs_any_more_is_given_up(
    make_robot: MakeRobot, flat: GridMap, monkeypatch: pytest.MonkeyPatch, by: str
) -> None:
    robot = make_robot()
    folder = robot.folder / "state" / "maps"
    folder.mkdir(parents=True, exist_ok=True)
    save_map(GridMap("newer", flat.resolution, flat.origin, flat.cells), folder / "newer.yaml")
    jobs: list[tuple[Callable[[], object], Callable[[Any], None]]] = []
    finished: list[object] = []
    monkeypatch.setattr(
        LocalizerService, "work", lambda _, fn, then=lambda _: None: jobs.append((fn, then))
    )
    monkeypatch.setattr(Localizer, "finish", lambda _, job: finished.append(job))
    robot.drive(0.2)
    assert len(jobs) == 1
    if by == "map":
        with suppress(Refused):  # it is read behind the search, and not answered in time
            robot.bus.ask(requests.MAP_LOAD, LoadMap(name="newer"))
    else:
        robot.bus.ask(requests.POSE_SET, SetPose(pose=robot.pose))
    while jobs:
        fn, then = jobs.pop(0)
        then(fn())
    assert finished == []
    assert robot.maps[-1].name == ("newer" if by == "map" else "flat")


@pytest.mark.parametrize("is_slow", [False, True], ids=["read at once", "read later"])
def test_a_map_that_is_asked_for_before_the_first_one_is_open_stays(
    make_robot: MakeRobot, flat: GridMap, monkeypatch: pytest.MonkeyPatch, is_slow: bool
) -> None:
    robot = make_robot()
    robot.bus.close()
    folder = robot.folder / "state" / "maps"
    folder.mkdir(parents=True, exist_ok=True)
    save_map(GridMap("newer", flat.resolution, flat.origin, flat.cells), folder / "newer.yaml")
    later: list[Callable[[], None]] = []
    with monkeypatch.context() as patch:
        # It is not known yet whether the mapper is making a map.
        patch.setattr(
            LocalizerService, "get", lambda _, topic, then: later.append(lambda: then({}))
        )
        if is_slow:
            patch.setattr(
                LocalizerService,
                "work",
                lambda _, fn, then=lambda _: None: later.append(lambda: then(fn())),
            )
        robot.begin()
        with suppress(Refused):  # a slow one does not answer in time
            robot.bus.ask(requests.MAP_LOAD, LoadMap(name="newer", pose=at(flat, *START)))
        for one in later:
            one()
    robot.drive(1.0)
    assert [grid.name for grid in robot.maps] == ["newer"]
    assert (robot.last.map, robot.last.state) == ("newer", "localized")
    assert robot.error_m() < 0.05


@pytest.mark.parametrize(("settings", "instead"), [({}, ["flat"]), ({"map": {}}, [])])
def test_a_map_of_the_last_run_that_is_gone_is_named_until_another_is_loaded(
    make_robot: MakeRobot, flat: GridMap, settings: dict[str, Any], instead: list[str]
) -> None:
    robot = make_robot(**settings)
    folder = robot.folder / "state" / "maps"
    folder.mkdir(parents=True, exist_ok=True)
    for name in ("newer", "other"):
        save_map(GridMap(name, flat.resolution, flat.origin, flat.cells), folder / f"{name}.yaml")
    robot.bus.ask(requests.MAP_LOAD, LoadMap(name="newer"))
    robot.bus.close()
    (folder / "newer.yaml").unlink()
    robot.begin()
    health = robot.bus.record(topics.HEALTH, "localizer")
    robot.drive(1.1)
    assert [grid.name for grid in robot.maps] == instead
    assert health[-1].state == "degraded"
    assert "'newer' of the last run is gone" in health[-1].message
    robot.bus.ask(requests.MAP_LOAD, LoadMap(name="other"))
    robot.drive(1.1)
    assert health[-1].state == "ok"


def test_whatever_map_can_be_loaded_is_listed(make_robot: MakeRobot, flat: GridMap) -> None:
    robot = make_robot()
    folder = robot.folder / "state" / "maps"
    folder.mkdir(parents=True, exist_ok=True)
    save_map(
        GridMap("flat.zones", flat.resolution, flat.origin, flat.cells), folder / "flat.zones.yaml"
    )
    robot.bus.ask(requests.MAP_LOAD, LoadMap(name="flat.zones"))
    zone = Zone(name="rug", kind="keepout", points=[(4.0, 1.0), (5.0, 1.0), (5.0, 2.0)])
    robot.bus.ask(requests.ZONES_PUT, zone)
    assert robot.bus.ask(requests.MAP_LIST) == ["flat", "flat.zones"]
    robot.bus.ask(requests.MAP_LOAD, LoadMap(name="flat"))
    assert robot.zones[-1].zones == []


def test_mirrors_that_are_told_with_a_map_are_suspected_until_they_are_drawn(
    make_robot: MakeRobot, flat: GridMap
) -> None:
    robot = make_robot(start=start_at(at(flat, *START)))
    suspects = robot.bus.record(topics.SUSPECTS)
    robot.drive(1.0)
    mirror, other = [(1.0, 0.0), (2.0, 0.0)], [(3.0, 1.0), (3.0, 2.0)]
    robot.bus.ask(requests.MAP_LOAD, LoadMap(name="flat", mirrors=[mirror, other]))
    robot.drive(0.5)
    assert [line.points for line in suspects[-1].lines] == [mirror, other]
    drawn = Zone(name="wardrobe", kind="mirror", points=[(0.8, 0.1), (2.1, 0.1)])
    robot.bus.ask(requests.ZONES_PUT, drawn)
    robot.drive(0.5)
    assert [line.points for line in suspects[-1].lines] == [other]


@pytest.mark.parametrize(
    ("params", "code"),
    [
        (LoadMap(name="none"), codes.UNKNOWN_NAME),
        (LoadMap(name="flat", pose=Pose2D(90.0, 0.0, 0.0)), codes.OUTSIDE_MAP),
    ],
)
def test_a_map_that_cannot_be_used_changes_nothing(
    make_robot: MakeRobot, params: LoadMap, code: str
) -> None:
    robot = make_robot()
    with pytest.raises(Refused) as refused:
        robot.bus.ask(requests.MAP_LOAD, params)
    assert refused.value.code == code
    assert len(robot.maps) == 1


def test_a_map_whose_name_is_misspelt_is_told_with_what_may_be_meant(make_robot: MakeRobot) -> None:
    with pytest.raises(Refused, match="Did you mean flat"):
        make_robot().bus.ask(requests.MAP_LOAD, LoadMap(name="flatt"))


def test_without_a_map_it_says_so_and_refuses(make_robot: MakeRobot) -> None:
    robot = make_robot(map={})
    health = robot.bus.record(topics.HEALTH, "localizer")
    robot.drive(1.1)
    assert health[-1].state == "degraded"
    assert "no map" in health[-1].message
    with pytest.raises(Refused) as refused:
        robot.bus.ask(requests.POSE_FIND)
    assert refused.value.code == codes.NOT_READY
    assert robot.bus.counters("localizer")["scan/no_map"] > 0


def test_a_broken_map_is_reported_and_survived(make_robot: MakeRobot) -> None:
    robot = make_robot()
    robot.bus.close()
    (robot.folder / "flat.yaml").write_text("image: nowhere.pgm\n")
    robot.begin()
    health = robot.bus.record(topics.HEALTH, "localizer")
    robot.drive(1.1)
    assert health[-1].state == "failed"
    assert "flat.yaml" in health[-1].message


def test_scans_without_odometry_are_counted(make_robot: MakeRobot) -> None:
    robot = make_robot()
    robot.sends_odometry = False
    robot.drive(1.0)
    assert robot.poses == []
    assert robot.bus.counters("localizer")["scan/no_odometry"] >= 8


def test_what_a_stranger_sends_as_scan_does_no_harm(make_robot: MakeRobot, flat: GridMap) -> None:
    robot = make_robot(start=start_at(at(flat, *START)))
    robot.drive(1.0)
    good = robot.scan(robot.bus.now_ns + 1)
    for ranges in (np.full(3, np.nan), np.empty(0), np.full(2000, -1.0)):
        robot.bus.run(0.05)
        odd = msgspec.structs.replace(
            good, stamp_ns=robot.bus.now_ns, ranges=floats_to_bytes(ranges)
        )
        robot.bus.publish(topics.SCAN, odd)
    robot.bus.publish(topics.SCAN, good)
    robot.drive(1.0)
    assert robot.last.state == "localized"
    assert robot.bus.counters("localizer")["scan/old_stamp"] >= 1
    for pose in robot.poses:
        assert pose.covariance is None or np.isfinite(pose.covariance).all()


def test_a_restart_of_base_keeps_the_pose(make_robot: MakeRobot, flat: GridMap) -> None:
    robot = make_robot(start=start_at(at(flat, *START)))
    robot.drive(2.0, 0.2, 0.3)
    robot.odom = Pose2D.identity()
    now_ns = robot.bus.now_ns
    robot.bus.publish(topics.CLOCK, Clock(stamp_ns=now_ns, rate=1.0, epoch=now_ns))
    before = len(robot.poses)
    for _ in range(10):
        robot.bus.run(0.1)
        stamp_ns = robot.bus.now_ns
        robot.bus.publish(topics.CLOCK, Clock(stamp_ns=stamp_ns, rate=1.0, epoch=now_ns))
        robot.bus.publish(
            topics.ODOM, Odometry(stamp_ns=stamp_ns, pose=robot.odom, twist=Twist2D.zero())
        )
        robot.bus.publish(topics.SCAN, robot.scan(stamp_ns))
    assert len(robot.poses) == before + 10
    assert {pose.state for pose in robot.poses[before:]} == {"localized"}
    assert robot.error_m() < 0.05


def test_a_restart_of_base_while_a_map_is_read_does_not_move_the_pose_that_was_given(
    make_robot: MakeRobot, flat: GridMap, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot = make_robot(start=start_at(at(flat, *START)))
    robot.odom = Pose2D(2.0, 1.0, 2.5)
    robot.drive(1.0)
    reading: list[Callable[[], None]] = []
    with monkeypatch.context() as patch:
        patch.setattr(
            LocalizerService, "work", lambda _, fn, then: reading.append(lambda: then(fn()))
        )
        with pytest.raises(Refused):  # it takes longer than an answer may
            robot.bus.ask(requests.MAP_LOAD, LoadMap(name="flat", pose=robot.pose))
    robot.odom, robot.epoch_ns = Pose2D.identity(), robot.bus.now_ns
    robot.drive(0.05)
    num_poses, (read,) = len(robot.poses), reading
    read()
    robot.drive(0.2)
    first = robot.poses[num_poses]
    assert first.pose is not None
    assert first.pose.distance_to(robot.pose) < 0.05


def test_a_stop_just_after_a_restart_of_base_does_not_mix_up_two_odometries(
    make_robot: MakeRobot, flat: GridMap
) -> None:
    robot = make_robot(start=start_at(at(flat, *START)))
    robot.drive(4.0, 0.2, 0.3)
    # Base begins anew, and its lidar takes seconds to spin up.
    robot.odom, robot.epoch_ns = Pose2D.identity(), 1
    clock = Clock(stamp_ns=robot.bus.now_ns, rate=1.0, epoch=robot.epoch_ns)
    robot.bus.publish(topics.CLOCK, clock)
    robot.bus.run(0.5)
    robot.bus.close()
    robot.begin()
    robot.drive(0.1)
    assert robot.error_m() < 0.05
    robot.drive(0.5)
    assert robot.last.state == "localized"
    assert robot.error_m() < 0.05


def test_a_place_named_as_start_counts_where_the_last_pose_is_of_another_map(
    make_robot: MakeRobot,
) -> None:
    robot = make_robot(start={"pose": "dock"})
    robot.bus.close()
    file = robot.folder / "state" / "trolley" / "last_pose.toml"
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text('map = "elsewhere"\n[pose]\nx = 2.0\ny = 2.0\nyaw = 0.0\n')
    robot.begin()
    saved = SavedPose(name="dock", map=robot.grid.name, pose=robot.pose)
    robot.bus.publish(topics.POSES, SavedPoses(stamp_ns=0, poses=[saved]))
    robot.drive(0.1)
    assert robot.last.pose is not None
    assert robot.error_m() < 0.1


def test_a_last_pose_that_could_not_be_written_is_written_once_there_is_room(
    make_robot: MakeRobot, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot = make_robot()
    robot.bus.ask(requests.POSE_SET, SetPose(pose=robot.pose))

    def fail(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as full:
        full.setattr("trolley.runtime.state.write_atomically", fail)
        robot.drive(2.0)
    assert robot.last.state == "localized"
    robot.drive(30.0)
    assert (robot.folder / "state" / "trolley" / "last_pose.toml").exists()
