"""Tracking people, and standing before they are in the way."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from support.flatland import BEAMS, Flatland, empty_room, with_block

from trolley.geometry import Pose2D
from trolley.gridmap import GridMap, distance_transform
from trolley_planner.people.moving_obstacles import MovingObstacles
from trolley_planner.people.tracker import (
    TRACKING,
    PeopleTracker,
    TrackedPerson,
    person_discs,
)

STEP_S = 0.05


pytestmark = pytest.mark.drives


def mover(x: float, y: float, vx: float, vy: float) -> list[TrackedPerson]:
    """One thing of 0.2 m."""
    points: NDArray[np.float64] = np.array([[x, y - 0.1], [x, y], [x, y + 0.1]])
    return [TrackedPerson(points, np.array([x, y]), np.array([vx, vy]))]


class Watched:
    """Keeps what a drive takes for moving."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.people: list[TrackedPerson] = []
        look = PeopleTracker.update

        def keep(
            watch: PeopleTracker,
            stamp_ns: int,
            beams: NDArray[np.float64],
            wall_distance_m: NDArray[np.float32],
            edge_m: float,
        ) -> list[TrackedPerson]:
            found = look(watch, stamp_ns, beams, wall_distance_m, edge_m)
            self.people += found
            return found

        monkeypatch.setattr(PeopleTracker, "update", keep)


def test_what_stands_does_not_move_when_it_comes_into_sight(
    ride, monkeypatch: pytest.MonkeyPatch
) -> None:
    watched = Watched(monkeypatch)
    room = with_block(empty_room(), 3.0, 1.5, 0.2, 1.6)
    world = Flatland(room, Pose2D(1.0, 2.0, 0.0))
    # Hidden behind the block at first.
    world.set_truth(with_block(with_block(room, 4.5, 1.8, 0.3, 0.3), 2.0, 4.0, 0.2, 0.2))
    drive = ride(world)
    drive.send(Pose2D(6.0, 2.0, 0.0))
    assert drive.until_over().state == "arrived"
    assert not watched.people


def with_person(room: GridMap, x: float, y: float) -> GridMap:
    return with_block(room, x - 0.15, y - 0.15, 0.3, 0.3)


def test_who_comes_is_not_taken_for_somebody_else_who_stands_there() -> None:
    """Who was not there before comes from nowhere known, and not from a bystander's place."""
    room = empty_room()
    world = Flatland(room, Pose2D(4.0, 3.0, 0.0))
    watch = PeopleTracker()
    wall_distance_m = distance_transform(room.occupied_mask(), room.resolution)
    found: list[TrackedPerson] = []
    for step, y in enumerate([None, 4.1, 3.98]):
        bystander = with_person(room, 4.6, 3.0)
        world.set_truth(bystander if y is None else with_person(bystander, 4.6, y))
        angles = 0.7 + np.arange(BEAMS) * (2.0 * math.pi / BEAMS)
        ranges = world.ranges().astype(np.float64)
        x, cos, sin = np.full(BEAMS, 4.05), np.cos(angles), np.sin(angles)
        beams = np.stack([x, np.full(BEAMS, 3.0), cos, sin, ranges, ranges], axis=1)
        found = watch.update(step * 100_000_000, beams, wall_distance_m, room.resolution)
    assert [float(mover.velocity[1]) < -0.5 for mover in found] == [True]


def test_two_who_pass_each_other_keep_their_own_ways() -> None:
    room = empty_room()
    world = Flatland(room, Pose2D(4.0, 3.0, 0.0))
    watch = PeopleTracker()
    wall_distance_m = distance_transform(room.occupied_mask(), room.resolution)
    seen: list[list[float]] = []
    for step in range(16):
        # One comes down at 1.2 m/s, the other goes up at 0.9 m/s, half a metre farther away.
        down, up = 4.0 - 0.12 * step, 2.2 + 0.09 * step
        world.set_truth(with_person(with_person(room, 5.0, down), 5.5, up))
        angles = 0.7 + np.arange(BEAMS) * (2.0 * math.pi / BEAMS)
        ranges = world.ranges().astype(np.float64)
        x, cos, sin = np.full(BEAMS, 4.05), np.cos(angles), np.sin(angles)
        beams = np.stack([x, np.full(BEAMS, 3.0), cos, sin, ranges, ranges], axis=1)
        found = watch.update(step * 100_000_000, beams, wall_distance_m, room.resolution)
        for mover in found:
            is_first = float(mover.points[:, 0].min()) < 5.2
            seen.append([is_first, float(mover.velocity[1])])
    first = [speed for is_first, speed in seen if is_first]
    second = [speed for is_first, speed in seen if not is_first]
    assert len(first) > 8
    assert len(second) > 4
    assert max(first) < -0.3
    assert min(second) > 0.2


def corridor(door_x: float) -> GridMap:
    """A corridor of 1 m along y = 3 with a wide opening to the left at `door_x`."""
    below = with_block(empty_room(), 0.1, 0.1, 6.0, 2.4)
    before = with_block(below, 0.1, 3.5, door_x - 0.6, 0.3)
    return with_block(before, door_x + 0.5, 3.5, 5.5 - door_x, 0.3)


@pytest.mark.parametrize("speed", [pytest.param(1.0, marks=pytest.mark.slow), 1.4])
def test_who_runs_out_of_a_door_finds_the_robot_standing(
    ride, speed: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    watched = Watched(monkeypatch)
    door_x, late_s = 2.2, 3.3
    room = corridor(door_x)
    world = Flatland(room, Pose2D(1.0, 3.0, 0.0))
    drive = ride(world)
    drive.send(Pose2D(5.5, 3.0, 0.0))
    fastest = 0.0
    # All the time the walls are nearer than the person, who comes when the robot would be there.
    for step in range(round((late_s + 1.5) / STEP_S)):
        y = max(3.0 + speed * (late_s - step * STEP_S), 2.7)
        if y < 5.5:
            world.set_truth(with_person(room, door_x, y))
        drive.step()
        away = door_x - world.pose.x, y - world.pose.y
        if math.hypot(*away) < 0.35:
            along = away[0] * math.cos(world.pose.yaw) + away[1] * math.sin(world.pose.yaw)
            # It may make room for them, but neither drive on into them nor beside them.
            is_leaving = world.twist.vx * along < 0.0
            fastest = max(fastest, 0.0 if is_leaving else abs(world.twist.vx))
    assert watched.people
    assert world.touches == 0
    assert fastest <= 0.02
    world.set_truth(room)
    assert drive.until_over().state == "arrived"


ANGLES = np.arange(360) * (2.0 * math.pi / 360)
NO_WALLS = np.full((200, 200), 9.0, dtype=np.float32)
EDGE_M = 0.05


def beams_to(
    circles: list[tuple[float, float, float]], shown_to: float = 7.0, wall_m: float = 2.0
) -> NDArray[np.float64]:
    """Beams from (5, 5) that meet circles (x, y, radius), or end in a wall all round.

    Those at angles above `shown_to` are left out, as by a lidar that does not look there.
    """
    ways = np.stack([np.cos(ANGLES), np.sin(ANGLES)], axis=1)
    ranges = np.full(len(ANGLES), wall_m)
    for x, y, radius in circles:
        along = ways @ (x - 5.0, y - 5.0)
        beside = (x - 5.0) ** 2 + (y - 5.0) ** 2 - along**2
        meets = (along > 0.0) & (beside < radius**2)
        ranges[meets] = np.minimum(ranges[meets], along[meets] - np.sqrt(radius**2 - beside[meets]))
    here = np.full(len(ANGLES), 5.0)
    return np.column_stack([here, here, ways, ranges, ranges])[shown_to > ANGLES]


def seems_alive(sway_m: float = 0.0, corrected_rad: float = 0.0) -> bool:
    """Whether what stands is taken for somebody, who sways, or while the heading is corrected."""
    moving, noise = MovingObstacles(), np.random.default_rng(3)
    found = False
    for step in range(150):
        yaw = corrected_rad * step / 150
        turn = np.array([(math.cos(yaw), math.sin(yaw)), (-math.sin(yaw), math.cos(yaw))])
        beams = beams_to([(6.2, 5.0 + sway_m * math.sin(0.13 * step), 0.2)])
        beams[:, 2:4] = beams[:, 2:4] @ turn
        beams[:, 4:] += noise.normal(0.0, 0.015, (len(beams), 1))
        moving.update(step * 100_000_000, beams, NO_WALLS, EDGE_M)
        found |= moving.is_somebody_at(6.2, 5.0, Pose2D(5.0, 5.0, yaw))
    return found


def test_who_sways_where_they_stand_is_told_from_a_thing() -> None:
    assert seems_alive(sway_m=0.06)
    assert not seems_alive()
    assert not seems_alive(corrected_rad=0.12)


def legs(y: float) -> list[tuple[float, float, float]]:
    """Of somebody at (6.2, y) who walks along y."""
    swing = 0.15 * math.sin(2.0 * math.pi * y / 1.2)
    return [(6.1, y + swing, 0.06), (6.3, y - swing, 0.06)]


def test_two_legs_are_one_person_who_walks_evenly() -> None:
    watch = PeopleTracker()
    for step in range(25):
        y = 4.2 + 0.08 * step
        movers = watch.update(step * 100_000_000, beams_to(legs(y)), NO_WALLS, EDGE_M)
        if step >= 6:
            assert len(movers) == 1
            x_mps, y_mps = movers[0].velocity
            assert abs(float(x_mps)) < 0.4
            assert 0.4 < float(y_mps) < 1.2
            disc = person_discs(movers)[0]
            assert math.hypot(disc[0] - 6.2, disc[1] - y) < 0.25


def test_who_comes_out_of_sight_walks_on_for_a_while_where_nobody_looks() -> None:
    watch = PeopleTracker()
    shown_to = 0.8
    times: list[float] = []
    for step in range(40):
        y = 5.0 + 0.1 * step
        beams = beams_to([(5.8, y, 0.15)], shown_to)
        movers = watch.update(step * 100_000_000, beams, NO_WALLS, EDGE_M)
        is_hidden = math.atan2(y - 5.2, 0.8) > shown_to
        if is_hidden and movers:
            times.append(0.1 * step)
            disc = person_discs(movers)[0]
            assert math.hypot(disc[0] - 5.8, disc[1] - y) < 0.6
    assert len(movers) == 0
    assert 0.5 < times[-1] - times[0] < TRACKING.hidden_s + 0.15


def test_nobody_is_left_where_the_lidar_sees_nobody() -> None:
    watch = PeopleTracker()
    for step in range(8):
        circles = [(5.8, 4.6 + 0.1 * step, 0.15)]
        assert bool(watch.update(step * 100_000_000, beams_to(circles), NO_WALLS, EDGE_M)) == (
            step > 0
        )
    assert watch.update(800_000_000, beams_to([]), NO_WALLS, EDGE_M) == []


def test_between_two_looks_who_walks_goes_on() -> None:
    watch = PeopleTracker()
    for step in range(6):
        found = watch.update(
            step * 100_000_000, beams_to([(5.8, 4.6 + 0.1 * step, 0.15)]), NO_WALLS, EDGE_M
        )
    (walker,) = found
    (later,) = watch.update(540_000_000, beams_to([(5.8, 5.14, 0.15)]), NO_WALLS, EDGE_M)
    np.testing.assert_allclose(later.points, walker.points + 0.04 * walker.velocity)


@pytest.mark.parametrize("has_legs", [False, True])
@pytest.mark.parametrize("speed", [0.25, 0.45, 0.9])
def test_who_walks_straight_away_is_seen_to_walk(speed: float, has_legs: bool) -> None:
    """No beam was ever where they go: their own body hid it."""
    watch = PeopleTracker()
    found: list[list[TrackedPerson]] = []
    rows, cols = np.indices(NO_WALLS.shape)
    away = np.hypot(EDGE_M * (cols + 0.5) - 5.0, EDGE_M * (rows + 0.5) - 5.0)
    wall_distance_m = np.abs(away - 2.0).astype(np.float32)
    for step in range(30):
        x = 6.0 + 0.1 * speed * step
        if x > 6.8:
            break
        swing = 0.15 * math.sin(2.0 * math.pi * x / 1.2)
        circles = [(x + swing, 5.1, 0.06), (x - swing, 4.9, 0.06)]
        beams = beams_to(circles if has_legs else [(x, 5.0, 0.2)])
        found += [watch.update(step * 100_000_000, beams, wall_distance_m, EDGE_M)]
    late = found[6:]
    assert sum(len(people) == 1 for people in late) >= 0.8 * len(late)
    speeds = [float(people[0].velocity[0]) for people in late if people]
    assert abs(np.mean(speeds) - speed) < 0.35 * speed


@pytest.mark.parametrize("speed", [0.25, 0.45, 0.9])
def test_who_walks_straight_up_is_seen_to_walk(speed: float) -> None:
    """Only beams of a second ago went on where they are now."""
    watch = PeopleTracker()
    for step in range(20):
        x = 6.9 - 0.1 * speed * (step if speed < 0.5 else step - 8)
        people = watch.update(step * 100_000_000, beams_to([(x, 5.0, 0.3)]), NO_WALLS, EDGE_M)
        if step < 14:
            continue
        (person,) = people
        np.testing.assert_allclose(person.velocity, [-speed, 0.0], atol=0.1)


def test_something_a_metre_wide_is_tracked_from_every_side() -> None:
    for bearing in (0.0, 0.4, 0.785, 1.2):
        watch, found = PeopleTracker(), []
        for step in range(6):
            away = 3.0 - 0.1 * step
            x, y = 5.0 + away * math.cos(bearing), 5.0 + away * math.sin(bearing)
            beams = beams_to([(x, y, 0.5)], wall_m=4.0)
            found = watch.update(step * 100_000_000, beams, NO_WALLS, EDGE_M)
        (mover,) = found
        assert math.hypot(*mover.velocity) == pytest.approx(1.0, abs=0.15)
        assert person_discs(found)[0, 4] == pytest.approx(0.5, abs=0.08)


def test_two_people_shoulder_to_shoulder_are_two() -> None:
    watch, found = PeopleTracker(), []
    for step in range(6):
        x = 8.0 - 0.1 * step
        beams = beams_to([(x, 4.75, 0.2), (x, 5.3, 0.2)], wall_m=4.0)
        found = watch.update(step * 100_000_000, beams, NO_WALLS, EDGE_M)
    assert len(found) == 2
    for person in found:
        np.testing.assert_allclose(person.velocity, [-1.0, 0.0], atol=0.15)


def test_who_comes_out_from_behind_somebody_goes_on_as_before() -> None:
    """Two pass each other: the nearer hides the other for a while."""
    watch = PeopleTracker()
    known: dict[object, float] = {}
    for step in range(26):
        there = 0.1 * step
        circles = [(6.2, 6.2 - there, 0.2), (7.0, 3.8 + there, 0.2)]
        beams = beams_to(circles, wall_m=4.0)
        people = watch.update(step * 100_000_000, beams, NO_WALLS, EDGE_M)
        if step < 3:
            continue
        assert len(people) == 2
        for person in people:
            assert abs(abs(person.velocity[1]) - 1.0) < 0.25
        for track in (one for one in watch.tracks() if one.is_moving):
            sense = known.setdefault(track.identity, float(track.velocity[1]))
            assert sense * track.velocity[1] > 0.0
    assert len(known) == 2


@pytest.mark.parametrize("radius", [0.2, 0.3, 0.45])
def test_what_the_edge_of_sight_passes_over_stands(radius: float) -> None:
    watch = PeopleTracker()
    for step in range(40):
        shown_to = 1.0 - 0.025 * step
        beams = beams_to([(6.6, 5.6, radius)], shown_to, wall_m=3.0)
        assert watch.update(step * 100_000_000, beams, NO_WALLS, EDGE_M) == []


def test_who_is_half_hidden_walks_as_before() -> None:
    """A pillar hides first one side of who walks behind it, then the other."""
    watch, num_seen = PeopleTracker(), 0
    for step in range(34):
        y = 3.3 + 0.1 * step
        beams = beams_to([(6.0, 5.0, 0.15), (7.0, y, 0.3)], wall_m=4.0)
        people = watch.update(step * 100_000_000, beams, NO_WALLS, EDGE_M)
        for person in people:
            x, y_mps = person.velocity
            assert math.hypot(x, y_mps - 1.0) < 0.2, y
            assert math.dist(person.place, (7.0, y)) < 0.1, y
        num_seen += len(people)
    assert num_seen >= 28


def test_a_pause_of_the_lidar_leaves_no_velocity_to_measure() -> None:
    watch = PeopleTracker()
    for stamp_ns, y in ((0, 5.0), (100_000_000, 5.05), (800_000_000, 5.1)):
        found = watch.update(stamp_ns, beams_to([(5.8, y, 0.15)]), NO_WALLS, EDGE_M)
        assert all(np.isfinite(one.velocity).all() for one in found)
