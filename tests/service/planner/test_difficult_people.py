"""People who make it hard on purpose: nobody is driven into, it says why it waits, and goes on.

The flatland judges: a robot that would drive into somebody stands, and the touch is counted; those
who walk up to a robot that stands are not.
"""

import math
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from support.flatland import Flatland, empty_room, two_rooms, with_block

from trolley import codes
from trolley.geometry import Pose2D
from trolley.gridmap import FREE, OCCUPIED, GridMap
from trolley.messages import GoalStatus

from .conftest import Stage

STEP_S = 0.1
BODY_M = 0.2
START = Pose2D(1.0, 3.0, 0.0)
DOOR = (4.0, 3.0)
OTHER_ROOM = Pose2D(6.5, 3.0, 0.0)
TRUE_REASONS = {"", codes.BLOCKED, codes.WAITING, codes.OSCILLATION}

Places = list[tuple[float, float]]
People = Callable[[float, Pose2D], Places]


def nobody(_time_s: float, _robot: Pose2D) -> Places:
    return []


def among(room: GridMap, people: Places) -> GridMap:
    """The room with people, 0.4 m wide, standing in it."""
    cells = room.cells.copy()
    rows, cols = np.indices(cells.shape)
    x, y = (cols + 0.5) * room.resolution, (rows + 0.5) * room.resolution
    for at in people:
        cells[np.hypot(x - at[0], y - at[1]) < BODY_M] = OCCUPIED
    return GridMap(room.name, room.resolution, room.origin, cells)


class Play:
    """A robot on its way to a goal, and what happens around it."""

    def __init__(self, folder: Path, room: GridMap, goal: Pose2D, start: Pose2D) -> None:
        self.room = room
        self.world = Flatland(room, start)
        self.stage = Stage(folder, self.world)
        self.stage.send(goal)

    def live(self, seconds: float, people: People, room: GridMap | None = None) -> list[GoalStatus]:
        """Let time pass among people, until the goal is over; return what was said meanwhile."""
        first = len(self.stage.goals)
        for step in range(round(seconds / STEP_S)):
            if self.state in ("arrived", "failed"):
                break
            at = people(step * STEP_S, self.world.pose)
            self.world.set_truth(among(room or self.room, at))
            self.stage.lockstep.run(STEP_S)
        self.world.set_truth(self.room)
        return self.stage.goals[first:]

    def goes_on(self) -> bool:
        """Whether the robot reaches its goal, and has driven into nobody."""
        self.live(60.0, nobody)
        return self.state == "arrived" and self.world.touches == 0

    @property
    def state(self) -> str:
        return self.stage.goals[-1].state


@pytest.fixture
def play(tmp_path: Path) -> Iterator[Callable[..., Play]]:
    """Begin a play in a room with a goal."""
    made: list[Play] = []

    def begin(room: GridMap, goal: Pose2D, start: Pose2D = START) -> Play:
        made.append(Play(tmp_path, room, goal, start))
        return made[-1]

    yield begin
    for one in made:
        one.stage.lockstep.close()


def says_the_truth(said: list[GoalStatus]) -> bool:
    """Whether each status of a robot that waits says why, in a sentence, and knows a reason."""
    waits = [one for one in said if one.state == "recovering"]
    return all(one.reason in TRUE_REASONS and one.message.endswith(".") for one in waits)


def says_what_blocks(said: list[GoalStatus]) -> bool:
    """Whether it said besides that something is in its way."""
    return says_the_truth(said) and codes.BLOCKED in {one.reason for one in said}


def walk(way: Places, speed: float, time_s: float) -> tuple[float, float]:
    """Where somebody is on a way."""
    places = np.array(way)
    along = np.append(0.0, np.hypot(*np.diff(places, axis=0).T).cumsum())
    x, y = (float(np.interp(speed * time_s, along, places[:, k])) for k in (0, 1))
    return x, y


def into_door(time_s: float) -> tuple[float, float]:
    """Where somebody is who walks into the door from the other side, and stirs there."""
    x, y = walk([(6.0, 3.0), DOOR], 0.8, max(time_s - 1.0, 0.0))
    return x + 0.05 * math.sin(1.3 * time_s), y + 0.05 * math.sin(0.7 * time_s)


def test_who_walks_up_to_the_robot_wherever_it_goes_is_not_driven_into(play) -> None:
    scene = play(empty_room(), Pose2D(6.5, 4.5, 0.0))
    at = np.array([6.0, 2.0])

    def chaser(_time_s: float, robot: Pose2D) -> Places:
        towards = np.array([robot.x, robot.y]) - at
        far = float(np.hypot(*towards))
        # Up to a hand's breadth before the robot.
        if far > BODY_M + 0.19 + 0.1:
            at[:] = at + 0.7 * STEP_S * towards / far
        return [(float(at[0]), float(at[1]))]

    said = scene.live(10.0, chaser)
    assert scene.state != "failed"
    assert says_the_truth(said)
    assert scene.goes_on()


def test_it_waits_for_who_stands_in_the_only_door_and_says_so(play) -> None:
    scene = play(two_rooms(0.8), OTHER_ROOM)
    said = scene.live(20.0, lambda _time_s, _robot: [DOOR])
    assert scene.world.pose.x < DOOR[0]
    assert says_what_blocks(said)
    assert scene.goes_on()


def test_who_stands_in_the_only_door_is_waited_for_at_a_distance(play) -> None:
    scene = play(two_rooms(0.8), OTHER_ROOM)
    away_m: list[float] = []

    def person(_time_s: float, robot: Pose2D) -> Places:
        away_m.append(math.dist((robot.x, robot.y), DOOR))
        return [DOOR]

    said = scene.live(15.0, person)
    assert min(away_m) > 0.9  # on the way beside them
    assert 1.2 < away_m[-1] < 1.7  # and not where it set off
    assert said[-1].state == "recovering"
    assert "waits for it to go" in said[-1].message
    assert scene.goes_on()


def test_who_walked_into_the_only_door_and_stays_is_not_come_closer_to(play) -> None:
    """It came up to their legs, and turned there to look around."""
    scene = play(two_rooms(0.8), OTHER_ROOM)
    away_m: list[float] = []

    def person(time_s: float, robot: Pose2D) -> Places:
        at = into_door(time_s)
        away_m.append(math.dist((robot.x, robot.y), at))
        return [at]

    said = scene.live(70.0, person)
    assert min(away_m) > 0.9  # on the way beside them
    assert (said[-1].state, said[-1].reason) == ("failed", codes.BLOCKED)
    assert scene.world.touches == 0
    assert away_m[-1] > 1.1


def test_who_comes_out_of_the_only_door_as_its_patience_ends_makes_no_goal_fail(play) -> None:
    """They came past it yet when it gave up, and the door was free."""
    scene = play(two_rooms(0.8), OTHER_ROOM)

    def person(time_s: float, _robot: Pose2D) -> Places:
        out = [(3.2, 2.6), (2.6, 1.5), (1.0, 1.0)]
        return [walk([into_door(min(time_s, 61.0)), *out], 0.4, max(time_s - 61.0, 0.0))]

    said = scene.live(64.0, person)
    assert said[-1].state == "recovering"
    scene.live(10.0, lambda time_s, robot: person(64.0 + time_s, robot))
    assert scene.goes_on()


@pytest.mark.parametrize(("before_m", "apart_from_s"), [(3.0, 0.0), (0.7, 8.5)])
def test_who_comes_out_of_the_only_door_finds_the_robot_beside_their_way(
    play, before_m, apart_from_s
) -> None:
    """It waited in front of them, and they walked into it."""
    start = Pose2D(DOOR[0] - before_m, DOOR[1], 0.0)
    scene = play(two_rooms(0.9), OTHER_ROOM, start)
    away_m: list[float] = []

    def person(time_s: float, robot: Pose2D) -> Places:
        at = walk([DOOR, (1.0, 3.0), (1.0, 5.0)], 0.8, max(time_s - 9.0, 0.0))
        if time_s >= apart_from_s:
            away_m.append(math.dist((robot.x, robot.y), at))
        return [at]

    said = scene.live(14.0, person)
    assert min(away_m) > BODY_M + 0.25
    assert says_what_blocks(said)
    assert "waits for it to go" in {one.message.partition("; the robot ")[2][:-1] for one in said}
    assert scene.goes_on()


def test_it_waits_beside_the_way_no_longer_than_until_a_detour_is_worth_it(play) -> None:
    """It looked for none there, and then went on as if somebody were coming."""
    room = with_block(two_rooms(0.9), 0.9, 1.2, 6.2, 0.1)
    room.cells[3:20, 74:86] = FREE  # another door, 9 m further
    scene = play(room, OTHER_ROOM)
    said = scene.live(8.0, lambda _time_s, _robot: [DOOR])
    assert [one.state for one in said if one.message][-1:] == ["recovering"]
    assert says_what_blocks(said)
    assert codes.WAITING not in {one.reason for one in said}
    assert scene.state == "driving"
    assert scene.live(60.0, lambda _time_s, _robot: [DOOR])[-1].state == "arrived"


def test_a_silent_lidar_takes_nothing_from_the_patience_beside_the_way(play) -> None:
    scene = play(two_rooms(0.8), OTHER_ROOM)
    scene.live(8.0, lambda _time_s, _robot: [DOOR])
    silent = scene.stage.robot.silent
    silent.add("scan")
    scene.live(12.0, lambda _time_s, _robot: [DOOR])
    silent.clear()
    scene.live(2.0, lambda _time_s, _robot: [DOOR])
    said = scene.live(3.0, lambda _time_s, _robot: [DOOR])
    assert {one.state for one in said} == {"recovering"}
    assert says_what_blocks(said)
    assert scene.goes_on()


@pytest.mark.slow
def test_it_lets_ten_people_come_through_the_door(play) -> None:
    scene = play(two_rooms(0.9), OTHER_ROOM)
    begins = [0.9 * number for number in range(10)]

    def ten(time_s: float, _robot: Pose2D) -> Places:
        found: Places = []
        for number, begin in enumerate(begins):
            end = (0.4 + 0.3 * number, 5.6)
            before = (4.6 + 0.7 * begin, 3.0)
            found.append(walk([before, (3.5, 3.0), end], 0.8, time_s))
        return found

    said = scene.live(22.0, ten)
    assert scene.world.touches == 0
    assert says_the_truth(said)
    assert scene.goes_on()


@pytest.mark.parametrize("every", [1, pytest.param(3, marks=pytest.mark.slow)])
def test_people_who_seem_to_jump_hold_nobody_up_for_good(play, every: int) -> None:
    """Two people, of whom each scan, or every third, shows only one."""
    scene = play(empty_room(), Pose2D(6.5, 3.0, 0.0))

    def jumping(time_s: float, robot: Pose2D) -> Places:
        which = round(time_s / STEP_S) // every % 2
        at = (3.6, 3.4) if which else (3.9, 2.7)
        # Nobody appears inside the robot.
        return [at] if math.dist(at, (robot.x, robot.y)) > 0.45 else []

    said = scene.live(15.0, jumping)
    assert scene.world.touches == 0
    assert says_the_truth(said)
    assert scene.goes_on()


def test_a_door_that_closes_on_the_robot_is_not_pushed(play) -> None:
    room = two_rooms(0.9)
    scene = play(room, OTHER_ROOM)
    for _ in range(200):
        scene.live(STEP_S, nobody)
        if scene.world.pose.x > DOOR[0] - 0.2:
            break
    x, y = scene.world.pose.x, scene.world.pose.y
    # The leaf swings in before it, as late as it can still stop; somebody's foot is behind it.
    shut = with_block(room, x + 0.45, 2.5, 0.1, 1.0)
    shut = with_block(shut, x - 0.35, y - 0.1, 0.1, 0.2)
    said = scene.live(12.0, nobody, shut)
    assert scene.world.touches == 0
    assert scene.world.pose.x < x + 0.2  # where it stops
    assert says_what_blocks(said)
    assert scene.goes_on()
