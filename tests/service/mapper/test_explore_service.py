"""Exploring in lock-step: mapper and planner find two rooms by themselves, and stand when told."""

from collections.abc import Iterator
from pathlib import Path

import msgspec
import numpy as np
import pytest
from support.flatland import Flatland, HalfBlind, Masked, empty_room, with_block

from trolley import codes, requests, topics
from trolley.codes import Refused
from trolley.config import RobotConfig
from trolley.geometry import Pose2D, Twist2D
from trolley.gridmap import GridMap, distance_transform
from trolley.gridmap.wire import grid_of
from trolley.messages import BaseState, MappingStatus, VelocityCommand
from trolley.messages.request_params import ExploreMap, MapNamed, PauseMap, SendGoal
from trolley.runtime.lockstep import Lockstep
from trolley.runtime.service import every, on
from trolley_mapper import checkpoint
from trolley_mapper.map_session import MapSession
from trolley_mapper.service import MapperService
from trolley_planner.service import PlannerService

from .conftest import Base

START = Pose2D(0.8, 0.8, 0.4)
SILENT_NS = 300_000_000


def small_rooms() -> GridMap:
    """Two rooms of 2.5 m, one with a cupboard, and a door between them."""
    walled = with_block(empty_room(5.0, 2.6), 2.45, 0.0, 0.1, 1.3)
    walled = with_block(walled, 2.45, 2.2, 0.1, 0.4)
    return with_block(walled, 4.2, 0.1, 0.7, 0.4)


class DrivenBase(Base):
    """A base that the planner drives."""

    commanded_ns = -SILENT_NS

    @on(topics.COMMAND, "planner")
    def obey(self, command: VelocityCommand, *_: str) -> None:
        self.twist, self.commanded_ns = command.twist, self.monotonic_ns

    @every(0.1, clock="local")
    def stop_without_commands(self) -> None:
        if self.monotonic_ns - self.commanded_ns > SILENT_NS:
            self.twist = Twist2D.zero()

    def say(self, mode: str, source: str | None = None) -> None:
        """Publish a state of the base."""
        state = {"stamp_ns": self.stamp(), "mode": mode, "source": source}
        self.publish(topics.BASE, msgspec.convert(state, BaseState))


class Stage:
    """Base, mapper and planner on a bus."""

    def __init__(
        self, folder: Path, kind: type[Flatland] = Flatland, start: Pose2D = START
    ) -> None:
        self.start, self.world = start, kind(small_rooms(), start)
        self.config = msgspec.convert(
            {"robot": {"name": "trolley", "footprint": {"length_m": 0.3, "width_m": 0.24}}},
            RobotConfig,
        )
        self.bus = Lockstep(seed=1, state=folder)
        self.said = self.bus.record(topics.MAPPING)
        self.maps = self.bus.record(topics.MAP)
        self.goals = self.bus.record(topics.GOAL)
        self.base = self.bus.add(DrivenBase(self.world))
        self.bus.add(PlannerService(self.config))
        self.bus.add(MapperService(self.config))
        self.base.say("ok", None)
        self.bus.run(0.5)

    @property
    def status(self) -> MappingStatus:
        return self.said[-1]

    def explore(self) -> None:
        """Begin, and wait until the first goal is driven to."""
        self.bus.ask(requests.MAP_NEW, MapNamed(name="home", explore=True))
        assert self.bus.run_until(lambda: self.is_driving, 10.0)

    @property
    def is_driving(self) -> bool:
        return bool(self.goals) and self.goals[-1].state == "driving"

    def share_found(self) -> float:
        """Share of the floor that the newest map knows as such."""
        grid = grid_of(self.maps[-1])
        inner = distance_transform(self.world.grid.occupied_mask(), 0.05) > 0.1
        points = self.world.grid.cell_to_world(np.argwhere(inner))
        true_T_map = self.world.grid.origin @ self.start
        known = grid.values_at(true_T_map.inverse().transform_points(points))
        return float(np.count_nonzero(known == 0)) / len(known)


def session_of(stage: Stage) -> MapSession:
    """The map in the making."""
    mapper = stage.bus.nodes["mapper"].service
    assert isinstance(mapper, MapperService)
    session = mapper._mapping.session
    assert session is not None
    return session


@pytest.fixture
def stage(tmp_path: Path) -> Iterator[Stage]:
    made = Stage(tmp_path / "state")
    yield made
    made.bus.close()


def test_two_rooms_are_found_and_the_robot_comes_back(stage: Stage) -> None:
    stage.explore()
    assert stage.status.exploring == "exploring"
    assert stage.bus.run_until(lambda: stage.status.exploring == "done", 150.0)
    stage.bus.run(1.5)
    assert stage.share_found() > 0.97
    assert stage.world.touches == 0
    assert stage.world.pose.distance_to(START) < 0.25
    assert stage.status.state == "mapping"
    assert stage.status.message.endswith("It is back where it began.")
    assert stage.status.area == pytest.approx(10.5, abs=1.5)


@pytest.mark.parametrize("kind", [HalfBlind, Masked])
def test_who_looks_ahead_only_looks_behind_itself_first_and_finds_them_too(
    tmp_path: Path, kind: type[Flatland]
) -> None:
    start = Pose2D(1.4, 1.3, -2.2)
    stage = Stage(tmp_path / "state", kind, start)
    stage.explore()
    first = stage.goals[-1].pose
    assert first is not None
    assert abs(first.yaw) > 3.1
    assert stage.bus.run_until(lambda: stage.status.exploring == "done", 150.0)
    assert stage.share_found() > 0.97
    assert stage.world.touches == 0
    assert stage.status.message.endswith("It is back where it began.")
    stage.bus.close()


def test_exploring_once_more_ends_where_it_first_began(stage: Stage) -> None:
    stage.explore()
    assert stage.bus.run_until(lambda: stage.status.exploring == "done", 150.0)
    stage.bus.ask(requests.GOAL_SEND, SendGoal(id="mine", pose=Pose2D(0.8, 0.4, 0.0), frame="map"))
    assert stage.bus.run_until(lambda: stage.goals[-1].state == "arrived", 30.0)
    assert stage.world.pose.distance_to(START) > 0.6
    stage.bus.ask(requests.MAP_EXPLORE)
    assert stage.bus.run_until(lambda: stage.status.exploring == "exploring", 5.0)
    assert stage.bus.run_until(lambda: stage.status.exploring == "done", 60.0)
    assert stage.world.pose.distance_to(START) < 0.25


def test_a_mapper_that_comes_back_explores_until_it_is_where_exploring_first_began(
    stage: Stage, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(checkpoint, "PERIOD_NS", 2_000_000_000)
    stage.explore()
    assert stage.bus.run_until(lambda: stage.world.pose.distance_to(START) > 0.6, 60.0)
    stage.bus.run(3.0)
    assert stage.world.pose.distance_to(START) > 0.6
    stage.bus.kill("mapper")
    stage.bus.add(MapperService(stage.config))
    stage.bus.run(2.0)
    stage.bus.ask(requests.MAP_EXPLORE)
    assert stage.bus.run_until(lambda: stage.status.exploring == "done", 150.0)
    assert stage.world.pose.distance_to(START) < 0.25


def test_it_stands_after_a_hand_on_the_robot_until_it_is_told(stage: Stage) -> None:
    stage.explore()
    stage.base.say("ok", "teleop")
    stage.bus.run(1.0)
    assert (stage.status.exploring, stage.goals[-1].state) == ("paused", "canceled")
    assert "somebody else is driving" in stage.status.message
    stage.base.say("ok", None)
    stood = stage.world.pose
    stage.bus.run(5.0)
    assert stage.world.pose == stood
    stage.bus.ask(requests.MAP_EXPLORE)
    stage.bus.run(3.0)
    assert stage.status.exploring == "exploring"
    assert stage.world.pose != stood


def test_a_stop_from_before_that_is_heard_late_does_not_hold_it(stage: Stage) -> None:
    late = BaseState(stamp_ns=stage.base.stamp(), mode="stopped")
    stage.explore()
    stage.bus.publish(topics.BASE, late)
    stage.bus.run(1.0)
    assert stage.status.exploring == "exploring"
    stage.base.say("stopped")
    stage.bus.run(1.0)
    assert stage.status.exploring == "paused"


@pytest.mark.parametrize("how", ["off", "pause", "cancel", "save", "stop", "goal"])
def test_whatever_else_is_wanted_ends_its_driving(stage: Stage, how: str) -> None:
    stage.explore()
    match how:
        case "off":
            stage.bus.ask(requests.MAP_EXPLORE, ExploreMap(on=False))
        case "pause":
            stage.bus.ask(requests.MAP_PAUSE, PauseMap())
        case "cancel":
            stage.bus.ask(requests.MAP_CANCEL)
        case "save":
            stage.bus.run(2.0)
            stage.bus.ask(requests.MAP_SAVE)
        case "stop":
            stage.base.say("stopped", None)
        case _:
            stage.bus.ask(requests.GOAL_SEND, SendGoal(id="mine", pose=Pose2D(0.1, 0.1, 0.0)))
    stage.bus.run(2.0)
    assert stage.status.exploring in ("paused", "off")
    last = {one.id: one.state for one in stage.goals if one.id is not None}
    mine = last.pop("mine", "arrived")
    assert set(last.values()) == {"canceled"}
    assert mine in ("driving", "arrived")


def test_a_mapper_that_comes_back_drives_nowhere(stage: Stage) -> None:
    stage.explore()
    stage.bus.kill("mapper")
    stage.bus.add(MapperService(stage.config))
    stage.bus.run(2.0)
    assert stage.goals[-1].state == "canceled"
    assert stage.status.exploring == "off"


def test_a_mapper_that_comes_back_says_that_exploring_waits(
    stage: Stage, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(checkpoint, "PERIOD_NS", 2_000_000_000)
    stage.explore()
    stage.bus.run(4.0)
    assert stage.status.exploring == "exploring"
    stage.bus.kill("mapper")
    stage.bus.add(MapperService(stage.config))
    stage.bus.run(1.0)
    assert stage.status.state == "mapping"
    assert "`trolley map explore` continues it" in stage.status.message


def test_a_mirror_that_was_seen_is_known_to_a_mapper_that_comes_back_and_to_who_explores_again(
    stage: Stage, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(checkpoint, "PERIOD_NS", 2_000_000_000)
    zones = stage.bus.record(topics.ZONES)
    suspects = stage.bus.record(topics.SUSPECTS)
    stage.explore()
    explorer = session_of(stage).explorer
    assert explorer is not None
    explorer._mirror = Pose2D(3.9, 0.6, 0.0)  # as if it had seen itself
    stage.bus.run(6.0)
    (mirror,) = zones[-1].zones
    stage.bus.kill("mapper")
    stage.bus.add(MapperService(stage.config))
    stage.bus.run(3.0)
    assert zones[-1].zones == [mirror]
    assert [line.points for line in suspects[-1].lines] == [mirror.points]
    stage.bus.ask(requests.MAP_EXPLORE, ExploreMap())
    assert stage.bus.run_until(lambda: session_of(stage).explorer is not None, 5.0)
    session = session_of(stage)
    assert session.zones_shown == [mirror]
    assert [line.points for line in session.suspects] == [mirror.points]


def test_where_the_robot_stood_is_tried_again_by_who_explores_again(stage: Stage) -> None:
    zones = stage.bus.record(topics.ZONES)
    stage.explore()
    session = session_of(stage)
    explorer = session.explorer
    assert explorer is not None
    assert session.core is not None
    for _ in range(2):  # before somebody in a door
        session.barriers.add(Pose2D(1.0, 0.6, 0.0), Pose2D(3.0, 0.6, 0.0), 0.2, session.core.grid())
    explorer._mirror = Pose2D(3.9, 0.6, 0.0)  # as if it had seen itself
    stage.bus.run(2.0)
    assert len(zones[-1].zones) == 2
    (mirror,) = session.suspects
    explorer.state = "done"
    stage.bus.ask(requests.MAP_EXPLORE, ExploreMap())
    assert stage.bus.run_until(lambda: session.explorer is not explorer, 5.0)
    assert [zone.points for zone in zones[-1].zones] == [mirror.points]
    assert [zone.points for zone in session.zones_shown] == [mirror.points]


def test_exploring_needs_a_map_in_the_making(stage: Stage) -> None:
    with pytest.raises(Refused) as refused:
        stage.bus.ask(requests.MAP_EXPLORE)
    assert refused.value.code == codes.NOT_MAPPING
