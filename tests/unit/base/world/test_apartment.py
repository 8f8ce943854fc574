"""The worlds that ship with Trolley are what they are said to be."""

import importlib.util
import tomllib
from itertools import pairwise
from pathlib import Path
from types import ModuleType

import msgspec
import numpy as np
import pytest

from trolley.geometry import Pose2D, Twist2D, pose_from_quaternion
from trolley.messages import Zone
from trolley.names import name_problem
from trolley_base.world import RobotBody, Simulation
from trolley_base.world.world_file import World, load_world

FOOTPRINT = np.array([[0.15, -0.12], [0.15, 0.12], [-0.15, 0.12], [-0.15, -0.12]])
CORRIDOR = pose_from_quaternion(5.315, 1.366, [0, 0, -0.49845, 0.86692])
ENTRANCE = pose_from_quaternion(5.775, -1.246, [0, 0, -0.95949, 0.28175])
KITCHEN = pose_from_quaternion(2.149, -2.706, [0, 0, -0.99147, 0.13033])
NAMES = ["apartment", "office", "room"]


@pytest.fixture
def apartment(worlds: Path) -> World:
    return load_world(worlds / "apartment.toml")


@pytest.fixture
def maps(worlds: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location("make_maps", worlds / "make_maps.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def stand(world: World, pose: Pose2D | None = None, seed: int = 1) -> Simulation:
    robot = RobotBody(FOOTPRINT, Pose2D(0.05, 0.0, 0.0))
    return Simulation(world.spec, world.grid, robot, seed, pose)


def test_the_article_s_places_have_room_around(apartment: World) -> None:
    for pose in (None, CORRIDOR, ENTRANCE, KITCHEN):
        assert stand(apartment, pose).truth().clearance >= 0.35


def test_the_bag_is_in_the_way_and_can_be_passed(apartment: World) -> None:
    bag, bucket = apartment.spec.box[0], apartment.spec.circle[0]
    points = np.array([[bag.x, bag.y], [bucket.x, bucket.y]])
    assert (apartment.grid.values_at(points) == 0).all(), "neither is on the map"
    upwards = bag.y + np.arange(0.2, 2.0, 0.01)
    above = apartment.grid.values_at(np.stack([np.full_like(upwards, bag.x), upwards], axis=1))
    assert upwards[np.argmax(above == 100)] - upwards[0] >= 0.75


def test_the_mirror_shows_the_hall_and_the_robot_in_the_kitchen(apartment: World) -> None:
    before = Pose2D(4.4, -1.8, np.pi)
    simulation = stand(apartment, before)
    for _ in range(10):
        simulation.step(Twist2D.zero())
    scan = simulation.take_scans()[0]
    bearings = scan.angle_min + np.arange(len(scan.ranges)) * scan.angle_increment
    seen = np.isfinite(scan.ranges) & (scan.ranges > 0.0)
    ends = np.stack([scan.ranges * np.cos(bearings), scan.ranges * np.sin(bearings)], axis=1)
    points = (before @ Pose2D(0.05, 0.0, 0.0)).transform_points(ends[seen])
    # Its own front is 0.79 m before the mirror, so it appears 0.79 m behind it.
    phantom = np.hypot(points[:, 0] - (3.46 - 0.79), points[:, 1] + 1.8) < 0.2
    assert phantom.sum() >= 5
    assert ((points[:, 0] < 0.5) & (points[:, 1] > -2.5)).sum() >= 5, "the hall's far wall"


def test_the_wall_behind_the_mirror_is_on_the_map(apartment: World) -> None:
    along = np.linspace(-2.2, -1.2, 21)
    behind = np.stack([np.full_like(along, 3.4), along], axis=1)
    assert (apartment.grid.values_at(behind) == 100).all()


@pytest.mark.parametrize("name", ["apartment", "office"])
def test_the_zones_name_all_mirrors_and_panes(worlds: Path, name: str) -> None:
    text = (worlds / f"{name}.zones.toml").read_text()
    zones = msgspec.convert(tomllib.loads(text)["zones"], list[Zone])
    assert [name_problem(zone.name) for zone in zones] == [None] * len(zones)
    spec = load_world(worlds / f"{name}.toml").spec
    things = [("mirror", mirror) for mirror in spec.mirror]
    things += [("glass", pane) for pane in spec.glass]
    assert [(zone.kind, zone.name, zone.points) for zone in zones] == [
        (kind, thing.name, thing.points) for kind, thing in things
    ]


@pytest.mark.parametrize("name", NAMES)
def test_the_map_is_the_floor_plan(worlds: Path, maps: ModuleType, name: str) -> None:
    plan = next(plan for plan in maps.PLANS if plan.name == name)
    drawn, kept = maps.draw(plan), load_world(worlds / f"{name}.toml").grid
    np.testing.assert_array_equal(kept.cells, drawn.cells)
    assert (kept.origin, kept.resolution) == (drawn.origin, drawn.resolution)


@pytest.mark.parametrize("name", NAMES)
def test_nobody_walks_through_walls(worlds: Path, name: str) -> None:
    world = load_world(worlds / f"{name}.toml")
    for person in world.spec.person:
        path = [*person.path, person.path[0]] if person.loop else person.path
        for start, end in pairwise(path):
            points = np.linspace(start, end, 200)
            assert (world.grid.values_at(points) == 0).all()


@pytest.mark.parametrize("seed", range(20))
def test_nobody_stands_on_the_robot_at_the_start(worlds: Path, seed: int) -> None:
    for name in NAMES:
        simulation = stand(load_world(worlds / f"{name}.toml"), seed=seed)
        for _ in range(3):
            simulation.step(Twist2D.zero())
        assert simulation.truth().bumps == 0
        assert simulation.truth().clearance > 0.1
