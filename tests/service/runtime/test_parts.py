"""A service that consists of parts: their methods are bound, and they see the service's wire."""

from pathlib import Path
from typing import ClassVar

import msgspec
import pytest

from trolley import requests, topics
from trolley.messages import Pose2D, SavedPose
from trolley.messages.request_params import Named, Nothing
from trolley.runtime.lockstep import Lockstep
from trolley.runtime.service import Service, answers, every, on


class Content(msgspec.Struct):
    number: int = 0


class Lister:
    """A part that answers a request."""

    def __init__(self, service: Service) -> None:
        self._service = service
        self.heard: list[str] = []

    @answers(requests.MAP_LIST)
    def list_maps(self, _: Nothing) -> list[str]:
        return [self._service.robot, *self.heard]

    @on(topics.SAVED_POSE)
    def hear(self, _: SavedPose, name: str) -> None:
        self.heard.append(name)


class Ticker:
    """A part with a period."""

    num_ticks = 0

    @every(1.0, clock="local")
    def tick(self) -> None:
        self.num_ticks += 1


class Whole(Service):
    name: ClassVar[str] = "whole"

    def __init__(self) -> None:
        self.lister, self.ticker = Lister(self), Ticker()
        self.parts = (self.lister, self.ticker)
        self.saved: list[OSError | None] = []

    @answers(requests.POSES_DELETE)
    def delete(self, params: Named) -> SavedPose:
        self.save("file.toml", Content(number=3), self.saved.append)
        return SavedPose(name=params.name, pose=Pose2D(0.0, 0.0, 0.0))


@pytest.fixture
def bus(tmp_path: Path):
    with Lockstep(state=tmp_path) as lockstep:
        yield lockstep


def test_requests_messages_and_periods_of_parts_are_bound(bus: Lockstep) -> None:
    whole = bus.add(Whole())
    bus.publish(topics.SAVED_POSE, SavedPose(pose=Pose2D(0.0, 0.0, 0.0)), "desk")
    bus.run(3.0)
    assert bus.ask(requests.MAP_LIST) == ["trolley", "desk"]
    assert whole.ticker.num_ticks == 4  # at once, then each second


def test_a_state_file_is_written_and_the_outcome_said(bus: Lockstep) -> None:
    whole = bus.add(Whole())
    bus.ask(requests.POSES_DELETE, Named(name="x"))
    assert whole.saved == [None]
    assert whole.state.read("file.toml", Content) == Content(number=3)


def test_a_state_file_that_cannot_be_written_is_counted(bus: Lockstep) -> None:
    whole = bus.add(Whole())
    whole.state.path.parent.mkdir(parents=True, exist_ok=True)
    whole.state.path.write_text("a file where the folder should be")
    whole.save("file.toml", Content())
    bus.run(0.1)
    assert bus.counters("whole") == {"state/not_saved": 1}
