"""A good driver among people: goes on where they will be gone, gives way, waits, goes round."""

import math
from collections.abc import Callable
from typing import Literal

import msgspec
import numpy as np
import pytest
from support.flatland import RANGE_MAX, Flatland, empty_room, two_rooms, with_block

from trolley.config import PlannerConfig
from trolley.geometry import Pose2D
from trolley.gridmap import FREE, GridMap, cast_rays
from trolley.messages import Scan
from trolley.messages.types import floats_to_bytes

STEP_S = 0.05
START = Pose2D(1.0, 3.0, 0.0)
CONTROLLERS = ["mppi", "pursuit"]
Place = Callable[[float], tuple[float, float]]


pytestmark = pytest.mark.drives


class HalfView(Flatland):
    """Its lidar sees the 180 degrees ahead."""

    def scan(self, stamp_ns: int) -> Scan:
        laser, first = self.pose @ self.base_T_laser, -0.5 * math.pi - self.base_T_laser.yaw
        angles = laser.yaw + first + np.radians(np.arange(181))
        edge = self.grid.resolution
        ranges = cast_rays(self._occupied, edge, (laser.x, laser.y), angles, RANGE_MAX)
        return Scan(
            stamp_ns=stamp_ns,
            frame="laser",
            angle_min=first,
            angle_increment=math.pi / 180.0,
            time_increment=0.0,
            range_min=0.05,
            range_max=RANGE_MAX,
            ranges=floats_to_bytes(ranges),
        )


class Meeting:
    """A robot that drives along y = 3 from x = 1, and one person."""

    def __init__(
        self,
        ride,
        controller: Literal["mppi", "pursuit"],
        room: GridMap | None = None,
        goal_x: float = 6.5,
        world: type[Flatland] = Flatland,
        start: Pose2D = START,
        settle_steps: int = 40,
    ) -> None:
        self._room = self._shown = room or empty_room()
        self.world = world(self._room, start)
        self.drive = ride(self.world, PlannerConfig(controller=controller))
        self.drive.send(Pose2D(goal_x, 3.0, 0.0))
        self.drive.step(settle_steps)
        self.poses: list[Pose2D] = []
        self.speeds: list[float] = []
        self.nearest = math.inf

    def walk(self, seconds: float, place: Place | None) -> None:
        """Let somebody be where `place` says, at times from 0, until the goal is over."""
        for step in range(round(seconds / STEP_S)):
            if not self.drive.navigator.current.board.is_active:
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
    # A path that swings back behind the person may have pursuit turn on the spot for a moment.
    slowest = min(meeting.speeds) if controller == "mppi" else np.mean(meeting.speeds)
    assert slowest > 0.2
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


def test_a_robot_that_obeys_late_meets_people_where_they_will_be_then(ride) -> None:
    def met_at(delay_s: float) -> float:
        meeting = Meeting(ride, "mppi")
        inputs = meeting.drive.navigator.inputs
        inputs.robot = msgspec.structs.replace(inputs.robot, delay=delay_s)
        meeting.walk(1.5, lambda t: (6.3 - 0.8 * t, 3.0))
        context = meeting.drive.navigator.costmap_manager.require_context()
        x, _, vx = context.local_costmap.walkers_now()[0, :3]
        assert vx == pytest.approx(-0.8, abs=0.15)
        return float(x)

    assert met_at(0.0) - met_at(0.4) == pytest.approx(0.4 * 0.8, abs=0.1)


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


def corridor(width_m: float) -> GridMap:
    """A corridor along y = 3."""
    room, aside_m = empty_room(12.0, 6.0), 2.9 - 0.5 * width_m
    below = with_block(room, 0.1, 0.1, 11.8, aside_m)
    return with_block(below, 0.1, 5.9 - aside_m, 11.8, aside_m)


class Person:
    """Somebody 0.3 m wide who comes along a corridor at 0.8 m/s; polite ones see the robot."""

    def __init__(self, meeting: Meeting, y: float, room_m: float) -> None:
        self._meeting = meeting
        self._least_y, self._most_y = 3.0 - room_m, 3.0 + room_m
        self.x, self.y, self.held_s = 11.0, y, 0.0
        self.is_polite = False

    def __call__(self, time_s: float) -> tuple[float, float]:
        pose = self._meeting.world.pose
        ahead, beside = self.x - pose.x, self.y - pose.y
        if self.is_polite and 0.0 < ahead < 2.0 and abs(beside) < 0.55:
            # They go to the side that is nearer, to their right if it is neither.
            sense = 1.0 if beside > -0.03 else -1.0
            self.y = min(max(self.y + sense * 0.5 * STEP_S, self._least_y), self._most_y)
        touches = abs(ahead) < 0.32 and abs(beside) < 0.28
        if touches and ahead > 0.0:
            self.held_s += STEP_S
        else:
            self.x = max(self.x - 0.8 * STEP_S, 0.5)
        return self.x, self.y


@pytest.mark.parametrize(
    ("width_m", "y"),
    [
        pytest.param(1.4, 3.0, marks=pytest.mark.slow),
        pytest.param(1.6, 3.0, marks=pytest.mark.slow),
        (1.6, 2.9),
        pytest.param(2.0, 3.1, marks=pytest.mark.slow),
    ],
)
def test_keeps_to_its_side_when_somebody_comes_who_does_not_see_it(
    ride, width_m: float, y: float
) -> None:
    meeting = Meeting(ride, "mppi", corridor(width_m), 9.0)
    person = Person(meeting, y, 0.0)
    meeting.walk(30.0, person)
    assert meeting.arrives(1.0)
    assert person.held_s == 0.0
    # It shows early which side it takes: well before they meet it is on its way there.
    meets = next(i for i, pose in enumerate(meeting.poses) if pose.x > 10.5 - 0.8 * i * STEP_S)
    early = meeting.poses[meets - round(1.5 / STEP_S)]
    assert abs(early.y - 3.0) > 0.08


@pytest.mark.parametrize("width_m", [1.2, pytest.param(1.6, marks=pytest.mark.slow)])
def test_passes_a_polite_person_without_delay(ride, width_m: float) -> None:
    meeting = Meeting(ride, "mppi", corridor(width_m), 9.0)
    person = Person(meeting, 3.0, 0.5 * width_m - 0.2)
    person.is_polite = True
    meeting.walk(30.0, person)
    assert meeting.arrives(1.0)
    assert person.held_s == 0.0
    # Alone it takes 18 s.
    assert len(meeting.poses) * STEP_S < 1.3 * 18.0


def with_room_behind(grid: GridMap) -> GridMap:
    """A room at the end of a corridor where the robot comes from."""
    cells, edge = grid.cells.copy(), grid.resolution
    cells[round(1.2 / edge) : round(4.8 / edge), 2 : round(2.0 / edge)] = FREE
    return GridMap(grid.name, edge, grid.origin, cells)


# Where they step aside later, it is back in the room by then and lets them pass there.
@pytest.mark.parametrize("aside_m", [5.0, pytest.param(4.5, marks=pytest.mark.slow)])
def test_goes_back_no_farther_once_who_comes_has_stepped_aside(ride, aside_m: float) -> None:
    meeting = Meeting(ride, "mppi", with_room_behind(corridor(0.9)), 10.0)
    at = [11.0, 3.0]

    def walk(_: float) -> tuple[float, float]:
        ahead = at[0] - meeting.world.pose.x
        if ahead < aside_m:
            at[1] = min(at[1] + 0.5 * STEP_S, 3.27)
        if abs(ahead) > 0.4 or at[1] - meeting.world.pose.y > 0.3:
            at[0] = max(at[0] - 0.8 * STEP_S, 0.5)
        return at[0], at[1]

    meeting.walk(60.0, walk)
    assert meeting.arrives(1.0)
    # Alone it takes 18 s, and 30 s if it lets them pass in the room.
    assert len(meeting.poses) * STEP_S < 28.0


@pytest.mark.parametrize(
    ("niche_x", "world"),
    [
        (3.4, Flatland),
        pytest.param(None, Flatland, marks=pytest.mark.slow),
        pytest.param(3.4, HalfView, marks=pytest.mark.slow),
        pytest.param(None, HalfView, marks=pytest.mark.slow),
    ],
)
def test_makes_room_where_two_do_not_fit_side_by_side(
    ride, niche_x: float | None, world: type[Flatland]
) -> None:
    """It waits in a niche, or in the room behind it, until who comes has passed."""
    grid = with_room_behind(corridor(0.7))
    cells, edge = grid.cells, grid.resolution
    if niche_x is not None:
        niche = slice(round(niche_x / edge), round((niche_x + 0.7) / edge))
        cells[round(3.3 / edge) : round(4.0 / edge), niche] = FREE
    meeting = Meeting(ride, "mppi", grid, 10.0, world)
    person = Person(meeting, 3.0, 0.0)
    meeting.walk(60.0, person)
    assert person.held_s == 0.0
    assert meeting.arrives(1.0)


def test_who_stands_at_the_wall_stays_there_until_who_comes_has_passed(ride) -> None:
    """So near to a wall it may need a maneuver to drive on, but not into somebody's way."""
    start = Pose2D(3.0, 2.64, 0.0)
    meeting = Meeting(ride, "mppi", corridor(1.0), 9.0, start=start, settle_steps=0)
    person = Person(meeting, 3.0, 0.0)
    person.x = 6.5
    meeting.walk(5.0, person)
    assert person.held_s == 0.0
    assert person.x < meeting.world.pose.x - 0.3
    assert max(pose.y for pose in meeting.poses) < 2.68
