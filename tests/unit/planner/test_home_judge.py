"""The judge of homes and people: what it finds possible, and whom it blames for a contact."""

import math
from dataclasses import replace
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from bench.planner.all_poses import Reach, Speeds, Target
from bench.planner.among_people import CROWDS, corridor, crowded, movers, recorded
from bench.planner.crowds import Crowd, Manner, Paths, Polite, Recorded, Route, Seen, read_tracks
from bench.planner.known_people import Future, KnownPeople
from bench.planner.mazes import draw_maze, furnish
from bench.planner.no_path import FURNITURE_PER_M2, HOME_M, ROOM_M, boxes_of, home
from bench.planner.people_judge import PEOPLE_S, PERSONAL_M, PeopleJudge
from bench.planner.situations import HOBBY, REAR, STATIC, Body, between, room

from trolley.config import PlannerConfig
from trolley.geometry import Pose2D, Twist2D
from trolley.gridmap import GridMap
from trolley_base.world import RobotBody, Simulation
from trolley_base.world.simulation import STEP_NS
from trolley_base.world.spec import PoseConfig, WorldSpec
from trolley_planner.costmap.costmap import Costmap
from trolley_planner.costmap.footprint import Footprint
from trolley_planner.people.moving_obstacles import ROBOT_DT_S

SPEEDS = Speeds(0.5, 1.5)
ROOM = room((0.0, 0.0), (4.0, 2.0))
HERE = Pose2D(0.0, 0.0, 0.0)


def seconds(start: Pose2D, goal: Pose2D, boxes=ROOM, body: Body = HOBBY, margin=0.005) -> float:
    return Reach(body.array, boxes, margin).seconds(start, Target(goal, 0.0, 0.0), SPEEDS)


class Meeting:
    """A robot of 0.35 x 0.30 m at the origin of an empty world, and one person."""

    def __init__(self, way: Route, *, legs: bool = False) -> None:
        grid = GridMap("floor", 0.5, Pose2D(-10.0, -10.0, 0.0), np.zeros((40, 40), dtype=np.int8))
        spec = WorldSpec(map="floor.yaml", start=PoseConfig(x=0.0, y=0.0, yaw=0.0))
        self.world = Simulation(spec, grid, RobotBody(HOBBY.array, HERE), 1)
        self.judge = PeopleJudge(Crowd(Paths((way,)), 0.2, legs=legs), self.world, HOBBY.array)

    def run(self, duration_s: float, command: Twist2D) -> None:
        for step in range(round(duration_s / PEOPLE_S) + 1):
            for _ in range(round(PEOPLE_S * 1e9) // STEP_NS):
                self.world.step(command)
            self.judge.update(step * PEOPLE_S)


@pytest.mark.slow
@pytest.mark.drives
def test_ideal_of_a_straight_drive_is_its_length_at_full_speed() -> None:
    assert seconds(Pose2D(0.5, 1.0, 0.0), Pose2D(2.5, 1.0, 0.0)) == pytest.approx(4.0, abs=0.1)


def test_ideal_of_a_turn_is_its_angle_at_the_full_rate() -> None:
    found = seconds(Pose2D(1.0, 1.0, 0.0), Pose2D(1.0, 1.0, math.pi))
    assert found == pytest.approx(math.pi / 1.5, abs=0.05)


def test_backing_out_is_as_quick_as_driving_in() -> None:
    there, back = Pose2D(0.5, 1.0, 0.0), Pose2D(2.5, 1.0, 0.0)
    assert seconds(back, there) == pytest.approx(seconds(there, back), abs=0.01)


@pytest.mark.parametrize(("width", "margin", "fits"), [
    (0.35, 0.005, True), (0.35, 0.03, False), (0.40, 0.03, True),
])  # fmt: skip
def test_exhaustive_search_passes_a_door_only_if_the_margin_leaves_room(
    width: float, margin: float, fits: bool
) -> None:
    low, high = 0.5 * (1.0 - width), 0.5 * (1.0 + width)
    boxes = (
        *room((0.0, 0.0), (1.7, 1.0)),
        between((0.8, 0.0), (0.9, low)),
        between((0.8, high), (0.9, 1.0)),
    )
    there, back = Pose2D(0.4, 0.5, 0.0), Pose2D(1.3, 0.5, 0.0)
    assert math.isfinite(seconds(there, back, boxes, margin=margin)) is fits


def test_robot_that_cannot_turn_in_a_niche_turns_outside() -> None:
    niche = next(row for row in STATIC if row.name.startswith("dead end 0.40")).scene(0)
    end = niche.goals[0]
    turned = seconds(end, Pose2D(end.x, end.y, math.pi), niche.boxes)
    assert turned > 2.0 * (1.2 - 0.35) / 0.5


def test_body_with_its_axle_at_the_rear_reaches_farther_ahead() -> None:
    (front, _), (back, _) = REAR.corners[0], REAR.corners[1]
    assert (front, back) == pytest.approx((0.5, -0.1))


def test_same_seed_is_the_same_scene() -> None:
    first, second = (crowded(4, "dense", legs=True) for _ in range(2))
    assert (first.start, first.goals) == (second.start, second.goals)
    for scene in (first, second):
        assert scene.crowd is not None
    crowds = [scene.crowd() for scene in (first, second) if scene.crowd is not None]
    for _ in range(100):
        for crowd in crowds:
            crowd.step(PEOPLE_S, Seen(HERE, 0.2))
    assert np.array_equal(crowds[0].solids(), crowds[1].solids())


def test_who_walks_into_a_standing_robot_is_not_its_fault() -> None:
    meeting = Meeting(Route.at_speed(((1.5, 0.0), (-1.5, 0.0)), 0.8))
    meeting.run(4.0, Twist2D.zero())
    (hit,) = meeting.judge.hits  # once, though they walk through it
    assert not hit.is_moving
    assert not hit.is_by_robot
    assert hit.their_mps == pytest.approx(0.8, abs=0.05)
    assert meeting.judge.closest_m == 0.0


def test_robot_that_drives_into_somebody_has_closed_in() -> None:
    meeting = Meeting(Route.at_speed(((1.0, 0.0), (1.1, 0.0)), 0.1, starts_s=100.0))
    meeting.run(4.0, Twist2D(0.4, 0.0, 0.0))
    (hit,) = meeting.judge.hits
    assert hit.is_moving
    assert hit.is_by_robot


def test_robot_that_backs_away_too_slowly_moves_but_has_not_closed_in() -> None:
    meeting = Meeting(Route.at_speed(((1.5, 0.0), (-3.0, 0.0)), 0.8))
    meeting.run(4.0, Twist2D(-0.2, 0.0, 0.0))
    hit = meeting.judge.hits[0]
    assert hit.is_moving
    assert hit.closing_mps == pytest.approx(-0.2, abs=0.02)


def test_who_passes_at_half_a_metre_is_neither_hit_nor_near() -> None:
    meeting = Meeting(Route.at_speed(((2.0, 1.0), (-2.0, 1.0)), 0.8))
    meeting.run(5.0, Twist2D.zero())
    assert meeting.judge.hits == []
    # Between the body, 0.2 m, and the side of the robot, 0.15 m.
    assert meeting.judge.closest_m == pytest.approx(1.0 - 0.2 - 0.15, abs=0.01)
    assert meeting.judge.closest_m > PERSONAL_M
    assert meeting.judge.near_s == 0.0


def test_share_of_time_beside_somebody_is_counted() -> None:
    meeting = Meeting(Route.at_speed(((0.0, 0.6), (0.1, 0.6)), 0.1, starts_s=2.0))
    meeting.run(2.0, Twist2D.zero())
    assert meeting.judge.near_s == pytest.approx(meeting.judge.seconds)


def test_lidar_meets_who_stands_there() -> None:
    meeting = Meeting(Route.at_speed(((1.0, 0.0), (1.1, 0.0)), 0.1, starts_s=100.0))
    meeting.run(0.5, Twist2D.zero())
    ranges = np.concatenate([scan.ranges for scan in meeting.world.take_scans()])
    seen = ranges[np.isfinite(ranges) & (ranges > 0.0)]
    assert np.quantile(seen, 0.05) == pytest.approx(0.8, abs=0.03)


def test_legs_are_met_in_place_of_the_body() -> None:
    meeting = Meeting(Route.at_speed(((1.5, 0.0), (-1.5, 0.0)), 0.8), legs=True)
    meeting.run(4.0, Twist2D.zero())
    assert len(meeting.judge.hits) >= 1
    assert all(not hit.is_moving for hit in meeting.judge.hits)


@pytest.mark.parametrize("how", get_args(Manner))
def test_polite_person_does_not_touch_a_robot_that_stands_in_the_way(how: Manner) -> None:
    person = Polite((6.0, 0.0), -1.5, 0.8, (0.5, 0.2), how)
    robot = Seen(Pose2D(3.0, 0.0, 0.0), 0.23)
    nearest = math.inf
    for _ in range(1000):
        person.step(PEOPLE_S, robot)
        nearest = min(nearest, math.dist(person.at[0], (3.0, 0.0)) - 0.2 - robot.radius)
    assert nearest > 0.0
    assert person.at[0, 0] > 3.0  # there is no room, and they wait


@pytest.mark.parametrize("how", get_args(Manner))
def test_polite_person_walks_on_once_the_robot_has_passed(how: Manner) -> None:
    person = Polite((6.0, 0.0), -1.5, 0.8, (0.75, 0.2), how)
    for step in range(1000):
        person.step(PEOPLE_S, Seen(Pose2D(0.5 + 0.01 * step, 0.4, 0.0), 0.23))
    assert person.at[0, 0] < -1.4


@pytest.mark.parametrize("name", CROWDS)
def test_walkers_of_a_crowd_keep_out_of_walls_and_of_each_other(name: str) -> None:
    scene = crowded(1, name, legs=False)
    assert scene.crowd is not None
    crowd = scene.crowd()
    inside = np.array(scene.boxes)
    overlaps = 0
    for _ in range(500):
        crowd.step(PEOPLE_S, Seen(scene.start, 0.23))
        off = np.abs(crowd.at[:, None] - inside[None, :, :2]) - 0.5 * inside[None, :, 2:]
        assert not (off.max(axis=2) < -0.05).any()
        far = np.hypot(*(crowd.at[:, None] - crowd.at[None]).transpose(2, 0, 1))
        overlaps += int((far[np.triu_indices(len(far), 1)] < 0.2).sum())
    assert overlaps < 0.005 * 500 * len(crowd.at)


def test_movers_do_not_begin_on_the_robot() -> None:
    for seed in range(5):
        scene = movers(seed, "hard")
        assert scene.crowd is not None
        crowd = scene.crowd()
        assert 18 <= len(crowd.at) <= 24
        assert np.hypot(*(crowd.at - (scene.start.x, scene.start.y)).T).min() > 2.0


def test_boxes_of_a_home_are_its_occupied_cells() -> None:
    grid = furnish(draw_maze(HOME_M, ROOM_M, 3, 0.7, open_share=0.2), FURNITURE_PER_M2, 3)
    boxes = replace(home(3), boxes=boxes_of(grid)).map()
    assert np.array_equal(boxes.occupied_mask(), grid.occupied_mask())


def test_corridor_is_as_wide_as_it_says() -> None:
    for width in (1.0, 1.2, 1.5, 2.0):
        free = corridor(width).map().free_mask()
        assert free[:, free.shape[1] // 2].sum() * 0.05 == pytest.approx(width)


def test_recording_is_read_by_person_and_time(tmp_path: Path) -> None:
    file = tmp_path / "hotel.txt"
    file.write_text("# t id x y\n10 2 1.0 5.0\n0\t1\t0.0\t0.0\n10,1,0.5,0.0 9 9\n\n0 2 1.0 4.0\n")
    first, second = read_tracks(file, 25.0)
    assert first.tolist() == [[0.0, 0.0, 0.0], [0.4, 0.5, 0.0]]
    assert second.tolist() == [[0.0, 1.0, 4.0], [0.4, 1.0, 5.0]]


def test_who_was_away_in_a_recording_does_not_glide_back(tmp_path: Path) -> None:
    file = tmp_path / "gap.txt"
    file.write_text("0 1 0 0\n1 1 1 0\n9 1 5 0\n10 1 6 0\n")
    people = Recorded(read_tracks(file, 1.0), 0.5)
    assert people.at[0].tolist() == [0.5, 0.0]
    people.step(4.0, Seen(HERE, 0.2))
    assert (np.abs(people.at) > 100.0).any(axis=1).all()


def test_robot_crosses_a_recording_where_nobody_stands(tmp_path: Path) -> None:
    file = tmp_path / "place.txt"
    rows = [f"{t} {who} {0.1 * t * (-1) ** who} {who - 4}" for t in range(100) for who in range(8)]
    file.write_text("\n".join(rows))
    for seed in range(4):
        scene = recorded(seed, file, 1.0, legs=False)
        assert scene.crowd is not None
        at = scene.crowd().at
        assert np.hypot(*(at - (scene.start.x, scene.start.y)).T).min() > 1.2
        assert scene.start.distance_to(scene.goals[0]) > 4.0


@pytest.mark.parametrize("text", ["0 1 2\n", "0 1 x 3\n", "0 1 nan 3\n", "", "0 1 2 3\n"])
def test_broken_recording_is_refused(tmp_path: Path, text: str) -> None:
    file = tmp_path / "broken.txt"
    file.write_text(text)
    with pytest.raises(ValueError, match="broken"):
        read_tracks(file, 1.0)


def told(crowd: Crowd, *, walked_s: float, future: Future | None) -> KnownPeople:
    """What the planner is told, whose map begins at -10, -10 m, and whose lidar is at 0, 0."""
    grid = GridMap("hall", 0.5, Pose2D(-10.0, -10.0, 0.0), np.zeros((40, 40), dtype=np.int8))
    costmap = Costmap(grid, Footprint.from_polygon(HOBBY.corners), PlannerConfig(), False)
    clocks = (lambda: walked_s), (lambda: walked_s)
    people = KnownPeople(crowd, clocks, future, lambda: costmap.grid_T_frame)
    people.update(0, np.array([[10.0, 10.0, 1.0, 0.0, 1.0, 1.0]]), costmap.distance_m, 0.5)
    return people


def test_planner_that_is_told_the_future_is_told_where_people_then_are() -> None:
    crowd = crowded(3, "dense", legs=False).crowd
    assert crowd is not None
    people, far = crowd(), Seen(Pose2D(-1000.0, -1000.0, 0.0), 0.2)
    future = Future(people)
    for _ in range(100):
        people.step(PEOPLE_S, far)
    told_now = told(people, walked_s=2.0, future=future).robots_at(2_000_000_000)
    near = np.hypot(*people.at.T) < 6.0
    assert 0 < near.sum() == len(told_now)
    for _ in range(100):
        people.step(PEOPLE_S, far)
    then = told_now[:, round(2.0 / ROBOT_DT_S), :2]
    assert then - 10.0 == pytest.approx(people.at[near], abs=1e-6)


def test_planner_that_is_told_the_truth_is_told_of_who_is_hidden_and_not_of_who_is_far() -> None:
    ways = [Route.at_speed(((x, 0.0), (x, 1.0)), 0.8) for x in (1.0, 2.0, 7.0)]
    people = Crowd(Paths(ways), 0.2, legs=False)
    people.step(0.5, Seen(HERE, 0.2))
    walkers = told(people, walked_s=0.5, future=None).walkers_at(600_000_000)
    expected = [[11.0, 10.48, 0.0, 0.8], [12.0, 10.48, 0.0, 0.8]]
    assert walkers[:, :4] == pytest.approx(np.array(expected))
