"""A good driver among people: goes on where they will be gone, gives way, waits, goes round."""

import math
from collections.abc import Callable
from typing import Literal

import numpy as np
import pytest
from support.flatland import Flatland, empty_room, two_rooms, with_block

from trolley.config import PlannerConfig
from trolley.geometry import Pose2D
from trolley.gridmap import GridMap

STEP_S = 0.05
CONTROLLERS = ["mppi", "pursuit"]
Place = Callable[[float], tuple[float, float]]


pytestmark = pytest.mark.drives


class Meeting:
    """A robot that drives along y = 3 from x = 1 to x = 6.5, and one person."""

    def __init__(
        self, ride, controller: Literal["mppi", "pursuit"], room: GridMap | None = None
    ) -> None:
        self._room = self._shown = room or empty_room()
        self.world = Flatland(self._room, Pose2D(1.0, 3.0, 0.0))
        self.drive = ride(self.world, PlannerConfig(controller=controller))
        self.drive.send(Pose2D(6.5, 3.0, 0.0))
        self.drive.step(40)
        self.poses: list[Pose2D] = []
        self.speeds: list[float] = []
        self.nearest = math.inf

    def walk(self, seconds: float, place: Place | None) -> None:
        """Let somebody be where `place` says, at times from 0, until the goal is over."""
        for step in range(round(seconds / STEP_S)):
            if not self.drive.navigator.board.is_active:
                break
            truth = self._room
            if place is not None:
                x, y = place(step * STEP_S)
                truth = with_block(truth, x - 0.15, y - 0.15, 0.3, 0.3)
                self.nearest = min(
                    self.nearest, math.hypot(self.world.pose.x - x, self.world.pose.y - y)
                )
            if not np.array_equal(truth.cells, self._shown.cells):
                self.world.set_truth(truth)
                self._shown = truth
            self.drive.step()
            self.poses.append(self.world.pose)
            self.speeds.append(self.world.twist.vx)

    def arrives(self, seconds: float = 60.0) -> bool:
        return self.drive.until_over(seconds).state == "arrived" and self.world.touches == 0


@pytest.mark.parametrize("controller", CONTROLLERS)
def test_goes_on_behind_who_walks_out_of_the_way(
    ride, controller: Literal["mppi", "pursuit"]
) -> None:
    meeting = Meeting(ride, controller)
    start = meeting.world.pose.x
    meeting.walk(3.0, lambda t: (start + 1.2, 2.9 + 0.8 * t))
    assert min(meeting.speeds) > 0.3
    meeting.walk(0.1, None)
    assert meeting.arrives()


@pytest.mark.parametrize("controller", CONTROLLERS)
def test_does_not_stop_for_who_crosses_far_ahead(
    ride, controller: Literal["mppi", "pursuit"]
) -> None:
    meeting = Meeting(ride, controller)
    start = meeting.world.pose.x
    meeting.walk(3.0, lambda t: (start + 2.2, 1.6 + 1.0 * t))
    assert min(meeting.speeds) > 0.2
    meeting.walk(0.1, None)
    assert meeting.arrives()


def test_gives_way_to_who_comes_towards_it(ride) -> None:
    meeting = Meeting(ride, "mppi")
    meeting.walk(6.0, lambda t: (6.3 - 0.8 * t, 3.0))
    # Side by side, with nobody touched: the person never left the line.
    assert meeting.nearest > 0.27
    assert max(abs(pose.y - 3.0) for pose in meeting.poses) > 0.27
    meeting.walk(0.1, None)
    assert meeting.arrives()


@pytest.mark.parametrize("controller", CONTROLLERS)
def test_goes_round_who_stops_in_the_way(ride, controller: Literal["mppi", "pursuit"]) -> None:
    meeting = Meeting(ride, controller)
    meeting.walk(25.0, lambda t: (4.0, max(3.0, 4.5 - 0.8 * t)))
    assert meeting.arrives(1.0)


def test_waits_for_who_stands_in_a_door_and_goes_on(ride) -> None:
    meeting = Meeting(ride, "mppi", two_rooms(0.7))
    meeting.walk(20.0, lambda t: (min(5.5 - 0.7 * t, 9.0) if t < 2.15 else 4.0, 3.0))
    assert meeting.world.pose.x < 4.0
    meeting.walk(0.1, None)
    assert meeting.arrives()
