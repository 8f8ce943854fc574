"""Furniture that was moved is proposed, accepted on the map, and then known: in lock-step."""

import runpy
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bench.harness.drives import make_config
from bench.harness.paths import WORLDS
from bench.harness.wandering import APARTMENT, START, Wanderer, write_world
from msgspec.structs import replace

from trolley import requests, topics
from trolley.codes import EXISTS, UNKNOWN_NAME, Refused
from trolley.geometry import Twist2D
from trolley.gridmap import save_map
from trolley.map_editing.proposals import ops_of
from trolley.messages import EditMap, MapChange, MapChanges, OccupancyGrid, VelocityCommand
from trolley.messages.request_params import Named, WhichChange
from trolley.names import free_name
from trolley.runtime.lockstep import Lockstep
from trolley_base.service import BaseService
from trolley_localizer.service import LocalizerService
from trolley_mapper.service import MapperService
from trolley_tour.service import TourService

# Where these are, x0, x1, y0, y1 [m]: what went, and where the sofa stands now.
TELEVISION = (1.0, 2.3, -0.95, -0.6)
SOFA_NOW = (-0.95, -0.1, -0.35, 1.3)
SOFA_LEFT, SOFA_CAME = (-0.95, -0.1, 1.3, 2.0), (-0.95, -0.1, -0.35, 0.35)
BAG = (4.25, 1.2)
PERMITTED = "[localizer]\npropose_changes = true\nchange_after_s = 60.0\n"
# Round and round in the living room, on a circle of 0.6 m: [m/s, rad/s].
CIRCLE = Twist2D(0.15, 0.0, -0.5)


class Room:
    """The demo's robot in the living room, where furniture was moved."""

    def __init__(self, folder: Path, permission: str) -> None:
        world = write_world(folder)
        maps: dict[str, Any] = runpy.run_path(str(WORLDS / "make_maps.py"))
        plan = maps["APARTMENT"]
        furniture = {**plan.furniture, "sofa": [SOFA_NOW], "television": []}
        save_map(maps["draw"](plan._replace(furniture=furniture)), folder / "moved.yaml")
        text = world.read_text().replace(str(APARTMENT), str(folder / "moved.yaml"))
        world.write_text(text)
        rest = f'[base.simulated]\nworld = "{world}"\nseed = 5\n{permission}'
        config = make_config(APARTMENT, START, rest)
        self.lockstep = Lockstep(config.robot.name, 5)
        self.changes: list[MapChanges] = self.lockstep.record(topics.CHANGES)
        self.maps: list[OccupancyGrid] = self.lockstep.record(topics.MAP)
        self.poses = self.lockstep.record(topics.POSE)
        for service in (BaseService, LocalizerService, MapperService, TourService):
            self.lockstep.add(service(config))

    def drive(self, seconds: float) -> None:
        """Go round."""
        for _ in range(round(seconds * 10)):
            now_ns = self.lockstep.now_ns
            command = VelocityCommand(stamp_ns=now_ns, twist=CIRCLE, valid_for=0.5)
            self.lockstep.publish(topics.COMMAND, command, "teleop")
            self.lockstep.run(0.1)

    @property
    def proposed(self) -> dict[str, MapChange]:
        """What is proposed, by id."""
        return {one.id: one for one in self.changes[-1].changes}


@pytest.fixture
def moved_room(tmp_path: Path) -> Iterator[Room]:
    room = Room(tmp_path, PERMITTED)
    yield room
    room.lockstep.close()


def is_in(change: MapChange, box: tuple[float, float, float, float]) -> bool:
    """Whether the cells of a change lie in a box, give or take a cell, and reach half along it."""
    ends = np.array(change.strokes).reshape(-1, 2)
    low, high = ends.min(axis=0), ends.max(axis=0)
    x0, x1, y0, y1 = box
    is_inside = bool(np.all(low >= np.array([x0, y0]) - 0.06)) and bool(
        np.all(high <= np.array([x1, y1]) + 0.06)
    )
    return is_inside and float((high - low).max()) >= 0.5 * max(x1 - x0, y1 - y0)


@pytest.mark.slow
def test_moved_furniture_is_proposed_and_decided_on(moved_room: Room) -> None:
    room, ask = moved_room, moved_room.lockstep.ask
    assert room.proposed == {}
    room.drive(90.0)
    assert room.poses[-1].state == "localized"
    gone = [one for one in room.proposed.values() if one.kind == "gone"]
    came = [one for one in room.proposed.values() if one.kind == "appeared"]
    assert len(gone) == 2
    assert sum(is_in(one, TELEVISION) for one in gone) == 1
    assert sum(is_in(one, SOFA_LEFT) for one in gone) == 1
    assert sum(is_in(one, SOFA_CAME) for one in came) == 1
    # Through the door the bag in the corridor can be seen.
    (bag,) = (one for one in came if not is_in(one, SOFA_CAME))
    assert all(np.hypot(x - BAG[0], y - BAG[1]) < 0.3 for stroke in bag.strokes for x, y in stroke)

    assert ask(requests.CHANGES_DISMISS, WhichChange(id=bag.id)).id == bag.id
    assert bag.id not in room.proposed
    with pytest.raises(Refused) as refused:
        ask(requests.CHANGES_DISMISS, WhichChange(id=bag.id))
    assert refused.value.code == UNKNOWN_NAME

    # The map that robot.toml names is left alone: the changed one gets a name of its own.
    edit = EditMap(name="apartment", ops=ops_of(list(room.proposed.values())))
    with pytest.raises(Refused) as refused:
        ask(requests.MAP_EDIT, edit)
    assert refused.value.code == EXISTS
    name = free_name("apartment", ask(requests.MAP_LIST))
    ask(requests.MAP_EDIT, replace(edit, as_name=name))
    room.drive(30.0)
    assert room.maps[-1].name == room.changes[-1].map == name
    assert room.poses[-1].state == "localized"
    assert room.poses[-1].match > 0.9
    assert room.proposed == {}


def test_without_permission_nothing_is_watched(tmp_path: Path) -> None:
    room = Room(tmp_path, "")
    room.drive(15.0)
    assert [one.changes for one in room.changes] == [[]]
    room.lockstep.nodes["localizer"].close()
    assert not list(room.lockstep.state.rglob("changes/*"))
    room.lockstep.close()


@pytest.mark.slow
@pytest.mark.parametrize("mirror_is_known", [True, False])
def test_people_and_mirrors_are_not_proposed(tmp_path: Path, mirror_is_known: bool) -> None:
    robot = Wanderer(write_world(tmp_path, people=True), 2, more=PERMITTED)
    changes = robot.lockstep.record(topics.CHANGES)
    if not mirror_is_known:
        robot.lockstep.ask(requests.ZONES_DELETE, Named(name="hall mirror"))
    robot.run(200.0)
    robot.close()
    proposed = [one for message in changes for one in message.changes]
    assert {one.kind for one in proposed} == {"appeared"}
    for x, y in (point for one in proposed for point in one.points):
        assert min(np.hypot(x - BAG[0], y - BAG[1]), np.hypot(x - 5.0, y + 1.35)) < 0.4
