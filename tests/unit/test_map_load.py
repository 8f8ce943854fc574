"""`Robot.load_map` where the map is long in loading."""

from typing import Any

import pytest

from trolley import Refused, Robot, client, codes, topics
from trolley.connection import Connection
from trolley.geometry import Pose2D
from trolley.messages import OccupancyGrid, Zones


class SlowRobot(Robot):
    """Answers in time that it is not done, and is some questions later."""

    def __init__(self, code: str) -> None:
        self._talk_over(Connection(["tcp/127.0.0.1:1"]), "slow")
        self.code = code
        self.asked = 0

    def ask(self, *_: Any, **__: Any) -> Any:
        raise Refused(self.code)

    def latest(self, topic: Any, *_: str) -> Any:
        self.asked += 1
        stamp_ns = 1 if self.asked < 4 else 2
        if topic is topics.ZONES:
            return Zones(stamp_ns=stamp_ns, map="attic", zones=[])
        return OccupancyGrid(
            stamp_ns=2,
            name="attic",
            frame="map",
            resolution=0.05,
            width=1,
            height=1,
            origin=Pose2D.identity(),
            cells=memoryview(b"\0"),
        )


def test_a_map_that_takes_longer_than_an_answer_is_waited_for(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(client, "ASK_AGAIN_S", 0.001)
    slow = SlowRobot(codes.TIMEOUT)
    assert slow.load_map("attic").name == "attic"
    assert slow.asked >= 4
    slow = SlowRobot(codes.TIMEOUT)
    monkeypatch.setattr(client, "LOAD_TIMEOUT_S", 0.0)
    with pytest.raises(Refused, match="not in use yet"):
        slow.load_map("attic")


def test_one_that_cannot_be_used_is_said_at_once() -> None:
    robot = SlowRobot(codes.IN_OBSTACLE)
    with pytest.raises(Refused) as refused:
        robot.load_map("attic")
    assert refused.value.code == codes.IN_OBSTACLE
    assert robot.asked == 1
