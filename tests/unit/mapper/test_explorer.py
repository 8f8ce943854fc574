"""Exploring: a house is found whole, what must not happen does not, and it always ends."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from bench.harness.houses import draw_house, free_poses
from bench.mapper import perfect_robot
from bench.mapper.perfect_robot import CLEARANCE, LIMITS, REACH_M, PerfectRobot, advance
from numpy.typing import NDArray

from trolley import codes
from trolley.codes import Refused
from trolley.geometry import Pose2D
from trolley.geometry.footprint import footprint_from_box
from trolley.geometry.polygon import polygon_contains
from trolley.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap, cast_rays
from trolley.messages import BaseState, GoalState, GoalStatus, Zone
from trolley.messages.request_params import SendGoal
from trolley_mapper.explore import sentences
from trolley_mapper.explore.exploration_goal import Action, Cancel, Limits, Scene, Send, Survey
from trolley_mapper.explore.explorer import PARAMS, Explorer
from trolley_mapper.explore.frontiers import Clearance, Frontier, FrontierReport
from trolley_mapper.explore.traversable_area import lay_out_area
from trolley_mapper.explore.visited_frontiers import SQUEEZED, VisitedFrontiers
from trolley_mapper.kernels.frontiers import BLOCKED

EDGE = 0.05
START = Pose2D(1.0, 1.0, 0.0)
BOX = footprint_from_box(0.5, 0.4)
REAR = np.array([(0.4, -0.15), (0.4, 0.15), (-0.1, 0.15), (-0.1, -0.15)])


pytestmark = pytest.mark.drives


def two_rooms(open_at: float | None = 1.5, width_m: float = 0.8) -> GridMap:
    """Two rooms of 3 x 3 m side by side with a door from y [m] on, if there is one."""
    cells = np.full((80, 140), UNKNOWN, np.int8)
    cells[8:72, 8:132] = OCCUPIED
    cells[10:70, 10:69] = FREE
    cells[10:70, 71:130] = FREE
    if open_at is not None:
        row = round(open_at / EDGE) + 10
        cells[row : row + round(width_m / EDGE), 69:71] = FREE
    return GridMap("rooms", EDGE, Pose2D(-0.5, -0.5, 0.0), cells)


def make_explorer(limits: Limits = LIMITS, *, sees_all_round: bool = True) -> Explorer:
    return Explorer("run", CLEARANCE, limits, sees_all_round)


def next_goal(explorer: Explorer, scene: Scene, now_s: float) -> SendGoal:
    """The goal that is sent now."""
    advance(explorer, scene, now_s)
    (action,) = explorer.take_actions()
    assert isinstance(action, Send)
    return action.goal


def explored(robot: PerfectRobot, limits: Limits = LIMITS) -> Explorer:
    explorer = make_explorer(limits)
    robot.explore(explorer)
    return explorer


def test_both_rooms_are_found_and_the_robot_comes_back() -> None:
    robot = PerfectRobot(two_rooms(), START)
    explorer = explored(robot)
    assert explorer.state == "done"
    assert robot.share_found() > 0.99
    assert robot.pose.distance_to(START) < 0.2
    assert explorer.message == "Explored: 18 m². It is back where it began."


@pytest.mark.parametrize(
    ("open_at", "width_m"),
    [
        pytest.param(1.5, 0.3, id="6 cm wider than the robot"),
        pytest.param(0.0, 0.3, id="the same in a corner"),
    ],
)
def test_a_room_behind_a_narrow_door_is_found(open_at: float, width_m: float) -> None:
    robot = PerfectRobot(two_rooms(open_at, width_m), START)
    explorer = explored(robot)
    assert explorer.message == "Explored: 18 m². It is back where it began."
    assert robot.pose.distance_to(START) < 0.2


def test_a_robot_whose_room_is_known_at_once_squeezes_out_of_it_at_once() -> None:
    robot, explorer = PerfectRobot(two_rooms(0.0, 0.3), Pose2D(1.5, 1.5, 0.0)), make_explorer()
    explorer.begin(None, None)
    for _ in range(2):
        advance(explorer, robot.scene(), robot.now_s)
    (action,) = explorer.take_actions()
    assert isinstance(action, Send)
    assert action.goal.xy_tolerance < 0.1


def test_a_goal_a_step_farther_into_a_door_is_another_place() -> None:
    visited = VisitedFrontiers(SQUEEZED)
    stood, farther = (Frontier(1.4, 0.0, Pose2D(x, 0.0, 0.0), 0.0, 2.0) for x in (1.0, 1.1))
    visited.find_or_add(stood).arrivals += 1
    assert visited.is_given_up(stood)
    assert not visited.is_given_up(farther)


@pytest.mark.parametrize(("size_m", "seed"), [(6.0, 1), (8.0, 2)])
def test_houses_are_found_with_hardly_a_goal_that_is_near_to_anything(
    size_m: float, seed: int
) -> None:
    house = draw_house(size_m, seed)
    start = free_poses(house, 0.35, 1, np.random.default_rng(seed))[0]
    robot = PerfectRobot(house, start)
    assert explored(robot).state == "done"
    assert robot.share_found() > 0.99
    solid = house.cell_to_world(np.argwhere(house.cells != FREE))
    places = [goal.pose.as_array()[:2] for goal in robot.goals[:-1] if goal.pose is not None]
    room_m = np.array([np.hypot(*(solid - place).T).min() for place in places])
    assert room_m.min() >= CLEARANCE.squeezing_m
    assert np.count_nonzero(room_m < CLEARANCE.standing_m - EDGE) <= 2


@pytest.mark.parametrize("width_m", [0.6, 0.7])
def test_goals_in_a_bend_are_poses_in_which_a_robot_about_its_rear_axle_fits(
    width_m: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    outline = np.array([(0.5, -0.21), (0.5, 0.21), (-0.1, 0.21), (-0.1, -0.21)])
    clearance = Clearance(outline, passing_m=0.145, standing_m=0.667, squeezing_m=0.1)
    monkeypatch.setattr(perfect_robot, "CLEARANCE", clearance)
    cells, wide = np.full((80, 100), OCCUPIED, np.int8), round(width_m / EDGE)
    cells[2:-2, 2:42] = cells[10 : 10 + wide, 42:80] = cells[10:-2, 80 - wide : 80] = FREE
    house = GridMap("bend", EDGE, Pose2D.identity(), cells)
    robot = PerfectRobot(house, Pose2D(0.9, 2.0, 0.0))
    explorer = Explorer("run", clearance, LIMITS)
    robot.explore(explorer)
    assert robot.share_found() > 0.98
    poses = [goal.pose for goal in robot.goals if goal.pose is not None]
    edges = [pose.transform_points(clearance.outline_cells(EDGE) * EDGE) for pose in poses]
    assert all((house.values_at(edge) == FREE).all() for edge in edges)


def test_a_lidar_that_looks_ahead_only_is_turned_to_what_is_unknown() -> None:
    robot = PerfectRobot(two_rooms(), START, fov_rad=math.pi)
    explorer = make_explorer(sees_all_round=False)
    robot.explore(explorer)
    assert explorer.state == "done"
    assert robot.share_found() > 0.98
    assert all(goal.yaw_tolerance < 0.5 for goal in robot.goals)


def test_a_lidar_that_looks_ahead_only_is_turned_to_what_is_behind_the_robot_first() -> None:
    robot = PerfectRobot(two_rooms(), START, fov_rad=math.pi)
    explorer = make_explorer(sees_all_round=False)
    explorer.begin(None, None)
    advance(explorer, robot.scene(), robot.now_s)
    (first,) = explorer.take_actions()
    assert isinstance(first, Send)
    assert first.goal.pose is not None
    assert first.goal.pose.distance_to(START) < 1e-6
    assert abs(first.goal.pose.yaw) == pytest.approx(math.pi)
    # Where it cannot turn it explores what it sees.
    explorer.hear_refusal(str(first.goal.id), Refused(codes.IN_OBSTACLE), robot.now_s)
    advance(explorer, robot.scene(), robot.now_s + 5.0)
    (second,) = explorer.take_actions()
    assert isinstance(second, Send)
    assert second.goal.pose is not None
    assert second.goal.pose.distance_to(START) > 0.2
    assert explorer.state == "exploring"


def test_floor_that_is_free_as_far_as_the_map_reaches_goes_on_there() -> None:
    walled = two_rooms().cells[8:72, 8:60].copy()  # but for its right side
    cut = GridMap("cut", EDGE, Pose2D(-0.1, -0.1, 0.0), walled)
    explorer = make_explorer()
    explorer.begin(None, None)
    advance(explorer, Scene(cut, START, False, False, (), START), 0.0)
    assert explorer.state == "exploring"
    (sent,) = explorer.take_actions()
    assert isinstance(sent, Send)
    assert sent.goal.pose is not None
    assert sent.goal.pose.x > 1.5


def test_a_grid_that_lies_askew_changes_nothing() -> None:
    house = two_rooms()
    turn = Pose2D(2.0, -1.0, 0.7)
    askew = GridMap(house.name, EDGE, turn @ house.origin, house.cells)
    robot = PerfectRobot(askew, turn @ START)
    assert explored(robot).state == "done"
    assert robot.share_found() > 0.99


def test_keep_outs_are_kept_out_of() -> None:
    corners = [(3.0, -0.5), (6.0, -0.5), (6.0, 3.5), (3.0, 3.5)]
    zone = Zone(name="office", kind="keepout", points=corners)
    robot = PerfectRobot(two_rooms(), START, (zone,))
    assert explored(robot).state == "done"
    track = np.array([(pose.x, pose.y) for pose in robot.track])
    assert not polygon_contains(np.array(corners), track).any()


def test_who_stands_in_a_keep_out_leaves_it() -> None:
    zone = Zone(name="mat", kind="keepout", points=[(0.5, 0.5), (1.5, 0.5), (1.5, 1.5), (0.5, 1.5)])
    robot = PerfectRobot(two_rooms(), START, (zone,))
    explorer = explored(robot)
    assert explorer.state == "done"
    assert robot.share_found() > 0.9


def test_a_mirror_on_the_map_is_a_wall() -> None:
    door = Zone(name="mirror", kind="mirror", points=[(3.0, 1.3), (3.0, 2.5)])
    robot = PerfectRobot(two_rooms(), START, (door,))
    explored(robot)
    assert max(pose.x for pose in robot.track) < 3.0


def test_of_a_mirror_without_end_only_what_lies_on_the_map_is_drawn() -> None:
    ends = ((9.0, 9.0), (1e12, 1e12))
    first, far = (
        lay_out_area(
            two_rooms(),
            [Zone(name="mirror", kind="mirror", points=[(-9.0, -9.0), end])],
            START,
            CLEARANCE.passing_m,
            (START, LIMITS.radius_m),
        )
        for end in ends
    )
    assert np.array_equal(first.kinds, far.kinds)
    assert first.kinds[first.kinds.shape[0] // 2, first.kinds.shape[0] // 2] == BLOCKED


def test_what_a_glass_door_shows_is_explored_no_farther_than_allowed() -> None:
    cells = np.full((400, 400), FREE, np.int8)  # a lawn without end
    lawn = GridMap("lawn", EDGE, Pose2D(-10.0, -10.0, 0.0), cells)
    robot = PerfectRobot(lawn, Pose2D.identity())
    explorer = explored(robot, Limits(radius_m=4.0, area_m2=500.0))
    assert explorer.state == "done"
    assert max(math.hypot(pose.x, pose.y) for pose in robot.track) < 4.0


def test_enough_floor_ends_it_and_is_told() -> None:
    robot = PerfectRobot(draw_house(10.0, 3), Pose2D(2.0, 2.0, 0.0))
    explorer = explored(robot, Limits(radius_m=30.0, area_m2=20.0))
    assert explorer.state == "done"
    assert ", all that [mapper] explore_area_m2 allows" in explorer.message
    assert robot.pose.distance_to(robot.home) < 0.2


class RobotWithABlindSpot(PerfectRobot):
    """No beam ever says anything of one place."""

    blind = np.s_[35:50, 90:105]

    def look(self) -> None:
        super().look()
        self.cells[self.blind] = UNKNOWN


def test_a_frontier_that_never_goes_away_is_looked_at_twice() -> None:
    robot = RobotWithABlindSpot(two_rooms(), START)
    explorer = explored(robot)
    assert explorer.state == "done"
    assert robot.now_s < 300.0
    assert len(robot.goals) < 16


def beyond_the_door(goal: SendGoal) -> bool:
    return goal.pose is not None and goal.pose.x > 2.9


def test_a_place_that_cannot_be_reached_is_tried_twice_and_told() -> None:
    robot = PerfectRobot(two_rooms(), START, fails=beyond_the_door)
    explorer = explored(robot)
    assert explorer.state == "done"
    assert "2 places could not be reached" in explorer.message  # the door's left and right
    assert 1 <= sum(beyond_the_door(goal) for goal in robot.goals) <= 8
    # Only after all else was found.
    assert beyond_the_door(robot.goals[-2])


def test_a_goal_along_a_long_border_is_kept_while_it_is_driven_to() -> None:
    robot = PerfectRobot(two_rooms(), START, fov_rad=math.pi)
    explorer = make_explorer(sees_all_round=False)
    explorer.begin(None, None)
    for second in (0.0, 1.0, 2.0):  # a half turn; the best places along two borders
        sent = next_goal(explorer, robot.scene(), second)
        explorer.hear_refusal(str(sent.id), Refused(codes.NO_PATH), second)
    sent = next_goal(explorer, robot.scene(), 3.0)
    for second in (5.5, 8.0, 10.5):
        explorer.hear_goal(status("driving", goal=str(sent.id)), second)
        advance(explorer, robot.scene(), second)
        assert explorer.take_actions() == []


def test_where_it_only_cannot_turn_nothing_is_taken_for_a_wall() -> None:
    robot = PerfectRobot(two_rooms(), Pose2D(1.0, 1.0, 1.0), fov_rad=math.pi)
    explorer = make_explorer(sees_all_round=False)
    explorer.begin(None, None)
    half_turn = next_goal(explorer, robot.scene(), 0.0)
    explorer.hear_refusal(str(half_turn.id), Refused(codes.NO_PATH), 0.0)
    now_s = 1.0
    for is_turn in (True, False):  # it stands twice, which makes a barrier elsewhere
        sent = next_goal(explorer, robot.scene(), now_s)
        assert sent.pose is not None
        assert (sent.pose.distance_to(robot.pose) < PARAMS.tried_m) is is_turn
        for _ in range(round(PARAMS.stand_s) + 5):
            now_s += 1.0
            explorer.hear_goal(status("driving", goal=str(sent.id)), now_s)
            advance(explorer, robot.scene(), now_s)
            if Cancel(str(sent.id)) in explorer.take_actions():
                break
        else:
            pytest.fail("it does not give up")
    assert explorer.barriers == []


def test_a_place_that_was_found_in_the_end_is_not_told() -> None:
    failed: list[SendGoal] = []

    def is_first(goal: SendGoal) -> bool:
        if beyond_the_door(goal) and not failed:
            failed.append(goal)
        return goal in failed

    explorer = explored(PerfectRobot(two_rooms(), START, fails=is_first))
    assert failed
    assert explorer.message == "Explored: 18 m². It is back where it began."


def test_a_place_that_is_reached_at_the_second_try_is_not_told() -> None:
    """What it stood before may stay unknown, as the inside of a shelf."""
    spot, failed = Pose2D(4.55, 1.4, 0.0), []

    def is_first(goal: SendGoal) -> bool:
        if goal.pose is not None and goal.pose.distance_to(spot) < 1.0 and not failed:
            failed.append(goal)
        return goal in failed

    robot = RobotWithABlindSpot(two_rooms(), START, fails=is_first)
    robot.blind = np.s_[35:42, 98:105]
    explorer = explored(robot)
    assert failed[0].pose in [goal.pose for goal in robot.goals if goal != failed[0]]
    assert explorer.message == "Explored: 18 m². It is back where it began."


def test_a_robot_that_does_not_get_on_says_so() -> None:
    robot = PerfectRobot(draw_house(10.0, 3), Pose2D(2.0, 2.0, 0.0), fails=lambda _: True)
    explorer = explored(robot)
    assert (explorer.state, explorer.reason) == ("paused", codes.BLOCKED)
    assert "cannot get anywhere" in explorer.message
    assert len(robot.goals) == PARAMS.max_failed


@pytest.mark.parametrize("shape", [(1, 1), (1, 40), (60, 60)])
@pytest.mark.parametrize("value", [UNKNOWN, OCCUPIED])
def test_a_map_that_shows_no_floor_is_waited_for_and_then_told(
    shape: tuple[int, int], value: int
) -> None:
    grid = GridMap("blank", EDGE, Pose2D.identity(), np.full(shape, value, np.int8))
    explorer = make_explorer()
    explorer.begin(None, None)
    for second in range(round(PARAMS.start_s) + 3):
        pose = Pose2D(0.02, 0.02, 0.0)
        advance(explorer, Scene(grid, pose, False, False, (), pose), float(second))
    assert (explorer.state, explorer.reason) == ("paused", codes.IN_OBSTACLE)
    assert "the lidar shows no room" in explorer.message  # there may be some where it cannot look
    assert "drive the robot by hand" in explorer.message
    assert explorer.take_actions() == []


def test_a_robot_in_a_box_says_so() -> None:
    house = two_rooms(None)
    cells = house.cells.copy()
    cells[10:18, 10:70] = OCCUPIED
    cells[18:70, 18:69] = OCCUPIED
    grid = GridMap("box", EDGE, house.origin, cells)
    robot = PerfectRobot(grid, Pose2D(0.2, 1.0, 0.0))
    assert explored(robot).state in ("paused", "done")
    assert robot.now_s < 60.0


def test_a_robot_that_is_boxed_in_where_it_has_driven_to_turns_home() -> None:
    explorer, robot = make_explorer(), PerfectRobot(two_rooms(), START)
    advance(explorer, robot.scene(), 0.0)
    explorer.hear_goal(status("arrived"), 1.0)
    grid, here = robot.scene().grid, Pose2D(1.5, 1.0, 0.0)
    points = grid.cell_to_world(np.argwhere(grid.cells != OCCUPIED))
    away = np.hypot(*(points - here.as_array()[:2]).T)
    row, col = grid.world_to_cell(points[(away > 0.15) & (away < 0.25)]).T
    cells = grid.cells.copy()
    cells[row, col] = OCCUPIED
    shut_in = Scene(replace(grid, cells=cells), here, False, False, (), START)
    for second in range(2, round(PARAMS.start_s) + 5):
        advance(explorer, shut_in, float(second))
    assert explorer.state == "homing"
    goals = [one.goal for one in explorer.take_actions() if isinstance(one, Send)]
    assert goals[-1].pose == START


def test_it_is_driven_at_the_speed_that_was_asked_for_when_it_last_set_off() -> None:
    robot, explorer = PerfectRobot(two_rooms(), START), make_explorer()
    for speed_mps in (0.2, None):
        explorer.begin(None, None, speed_mps)
        advance(explorer, robot.scene(), 0.0)
        (action,) = explorer.take_actions()
        assert isinstance(action, Send)
        assert action.goal.speed == speed_mps
        explorer.pause(codes.PAUSED, "")
        explorer.take_actions()


# What pauses it.


def status(state: GoalState, reason: str = "", goal: str = "map-run-1") -> GoalStatus:
    return GoalStatus(stamp_ns=0, id=goal, state=state, reason=reason)


def base(source: str | None, mode: str = "ok") -> BaseState:
    return BaseState(stamp_ns=0, mode=mode, source=source)  # pyrefly: ignore[bad-argument-type]


INTERRUPTIONS: dict[str, Callable[[Explorer], None]] = {
    codes.STOPPED: lambda one: one.hear_base(base("planner", "stopped")),
    codes.TAKEN_OVER: lambda one: one.hear_base(base("teleop")),
    codes.RESTARTED: lambda one: one.epoch_began(),
    codes.OTHER_GOAL: lambda one: one.hear_goal(status("driving", goal="living-room"), 2.0),
    codes.CANCELED: lambda one: one.hear_goal(status("canceled", codes.CANCELED), 2.0),
    codes.PAUSED: lambda one: one.hear_goal(status("paused", codes.PAUSED), 2.0),
}


@pytest.mark.parametrize("reason", INTERRUPTIONS)
def test_it_stands_until_it_is_told_to_go_on(reason: str) -> None:
    robot, explorer = PerfectRobot(two_rooms(), START), make_explorer()
    explorer.begin("older", None)
    explorer.hear_goal(status("driving", goal="older"), 0.5)  # which ours replaces
    advance(explorer, robot.scene(), 1.0)
    explorer.hear_goal(status("driving"), 1.5)
    explorer.take_actions()
    INTERRUPTIONS[reason](explorer)
    assert (explorer.state, explorer.reason) == ("paused", reason)
    assert all(isinstance(action, Cancel) for action in explorer.take_actions())
    for second in range(2, 100):
        advance(explorer, robot.scene(), float(second))
    assert explorer.take_actions() == []
    explorer.begin("living-room", "teleop")
    explorer.hear_base(base("teleop"))  # the hand that was on it before
    advance(explorer, robot.scene(), 101.0)
    assert [type(action) for action in explorer.take_actions()] == [Send]


def test_a_goal_of_ours_that_was_already_under_way_is_taken_back_when_paused() -> None:
    robot, explorer = PerfectRobot(two_rooms(), START), make_explorer()
    explorer.begin(None, None)
    advance(explorer, robot.scene(), 1.0)
    explorer.pause(codes.PAUSED, "Paused.")
    explorer.take_actions()
    explorer.hear_goal(status("driving"), 1.2)  # it was on its way to the planner
    assert explorer.take_actions() == [Cancel("map-run-1")]


@pytest.mark.parametrize(("lost", "after_s"), [(True, 8), (False, 35)])
def test_a_pose_that_is_doubted_for_long_pauses(lost: bool, after_s: int) -> None:
    robot, explorer = PerfectRobot(two_rooms(), START), make_explorer()
    explorer.begin(None, None)
    advance(explorer, robot.scene(), 0.0)
    scene = Scene(robot.grid, START, lost, not lost, (), START)
    advance(explorer, scene, 1.0)
    assert explorer.is_under_way
    for second in range(1, after_s):
        explorer.hear_goal(status("driving"), float(second))
        advance(explorer, scene, float(second))
    assert explorer.state == "paused"
    assert Cancel("map-run-1") in explorer.take_actions()


def test_a_planner_that_is_not_ready_is_asked_again_for_a_while() -> None:
    robot, explorer = PerfectRobot(two_rooms(), START), make_explorer()
    explorer.begin(None, None)
    sent: list[str | None] = []
    for second in range(round(PARAMS.wait_s) + 20):
        advance(explorer, robot.scene(), float(second))
        for action in explorer.take_actions():
            if isinstance(action, Send):
                sent.append(action.goal.id)
                explorer.hear_refusal("map-run-1", Refused(codes.NOT_READY), float(second))
    assert len(sent) > 5
    assert set(sent) == {"map-run-1"}
    assert (explorer.state, explorer.reason) == ("paused", codes.NOT_READY)


@pytest.mark.parametrize(("opens_after_s", "message"), [(40.0, "is back"), (1e9, "could not")])
def test_home_is_tried_for_a_while_where_something_stands_in_the_way(
    opens_after_s: float, message: str
) -> None:
    shut_s: list[float] = []

    def is_shut(goal: SendGoal) -> bool:
        if goal.pose == START:
            shut_s.append(robot.now_s)
        return goal.pose == START and robot.now_s - shut_s[0] < opens_after_s

    robot = PerfectRobot(two_rooms(), START, fails=is_shut)
    explorer = explored(robot)
    assert explorer.state == "done"
    assert message in explorer.message
    assert shut_s[-1] - shut_s[0] < PARAMS.wait_s + 5.0
    assert len(shut_s) <= PARAMS.wait_s / PARAMS.survey_period_s + 2


def test_a_goal_that_takes_too_long_is_given_up() -> None:
    robot, explorer = PerfectRobot(two_rooms(), START), make_explorer()
    explorer.begin(None, None)
    advance(explorer, robot.scene(), 0.0)
    explorer.take_actions()
    actions: list[Action] = []
    for second in range(1, 200):
        explorer.hear_goal(status("driving"), float(second))
        advance(explorer, robot.scene(), float(second))
        actions = explorer.take_actions()
        if actions:
            break
    assert actions == [Cancel("map-run-1")]
    explorer.hear_goal(status("canceled", codes.CANCELED), 201.0)
    advance(explorer, robot.scene(), 202.0)
    assert [type(action) for action in explorer.take_actions()] == [Send]


def test_nothing_left_to_see_from_the_start_is_the_end_of_it() -> None:
    robot = PerfectRobot(two_rooms(None), START)
    explorer = explored(robot)
    assert explorer.state == "done"
    assert explorer.message.startswith("Explored: 9 m².")


class BehindGlass(PerfectRobot):
    """Sees through a pane from wall to wall at x = 3.2 m that it cannot pass."""

    def _drive(self, explorer: Explorer) -> None:
        if self._goal and self._path and max(one.x for one in self._path[:5]) > 3.2 - 0.2:
            self._say(explorer, "driving")
        else:
            super()._drive(explorer)


def test_what_the_robot_cannot_get_past_is_a_wall_from_the_second_stand_on() -> None:
    robot, explorer = BehindGlass(two_rooms(), START), make_explorer()
    robot.explore(explorer, limit_s=300.0)
    assert explorer.state == "done"
    assert len(explorer.barriers) <= 2
    assert robot.pose.distance_to(START) < 0.2
    assert "could not be reached" in explorer.message


def test_a_door_that_the_robot_squeezes_into_in_vain_is_not_taken_for_a_wall() -> None:
    robot, explorer = BehindGlass(two_rooms(1.5, 0.3), START), make_explorer()
    robot.explore(explorer, limit_s=600.0)
    assert explorer.state == "done"
    assert explorer.barriers == []
    assert "could not be reached" in explorer.message


class SeesEchoes(PerfectRobot):
    """Knows the floor only up to what its lidar meets, not where that meets nothing."""

    def _mark(
        self, at: Pose2D, angles: NDArray[np.float64], away: NDArray[np.float64], value: int
    ) -> None:
        ranges = cast_rays(self._occupied, EDGE, (at.x, at.y), angles, REACH_M)
        is_met = np.isfinite(ranges)
        super()._mark(at, angles[is_met], away[is_met], value)


def test_a_corridor_longer_than_the_lidar_sees_is_explored_to_its_end() -> None:
    cells = np.full((56, 336), OCCUPIED, np.int8)
    cells[8:-8, 8:-8] = FREE
    robot = SeesEchoes(GridMap("corridor", EDGE, Pose2D(-0.4, -0.4, 0.0), cells), START)
    assert explored(robot).state == "done"
    assert robot.share_found() > 0.97


@pytest.mark.parametrize(
    ("clearance", "width_m"),
    [
        pytest.param(Clearance(BOX, 0.245, 0.445, 0.2), 0.8, id="0.5 x 0.4 m"),
        pytest.param(Clearance(REAR, 0.125, 0.571, 0.1), 1.1, id="0.5 x 0.3 m about its rear axle"),
    ],
)
def test_a_corridor_with_less_room_than_goals_have_elsewhere_is_explored(
    clearance: Clearance, width_m: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(perfect_robot, "CLEARANCE", clearance)
    cells = np.full((84, 250), OCCUPIED, np.int8)
    cells[2:-2, 2:62] = cells[2:-2, 188:-2] = FREE
    cells[12 : 12 + round(width_m / EDGE), 62:188] = FREE
    robot = PerfectRobot(GridMap("corridor", EDGE, Pose2D.identity(), cells), Pose2D(2.0, 3.0, 0.0))
    explorer = Explorer("run", clearance, LIMITS)
    robot.explore(explorer)
    assert explorer.state == "done"
    assert robot.share_found() > 0.98


def test_a_corner_that_is_small_and_far_is_left_out_and_said() -> None:
    explorer = make_explorer()
    robot = PerfectRobot(two_rooms(), START)
    robot.explore(explorer)
    assert explorer.state == "done"
    near = Frontier(1.0, 1.0, START, 2.0, 0.5)
    assert near.is_worth_the_way
    assert not replace(near, distance_m=9.0).is_worth_the_way
    assert replace(near, distance_m=9.0, gain_m2=2.0).is_worth_the_way
    assert "1 small corner left out" in sentences.found(84.0, 0, 1)


@pytest.mark.parametrize(("step_m", "is_driven_to"), [(0.1, True), (0.6, False)])
def test_frontiers_that_move_about_while_the_robot_hardly_does_are_no_sign_of_a_mirror(
    step_m: float, is_driven_to: bool
) -> None:
    """From a doorway floor is seen bit by bit: the frontiers in it move, and none adds much."""
    explorer, grid = make_explorer(), two_rooms()
    for number in range(8):
        here = Pose2D(1.0 + number * step_m, 1.0, 0.0)
        scene = Scene(grid, here, False, False, (), START)
        area = lay_out_area(grid, (), here, CLEARANCE.passing_m, (START, LIMITS.radius_m))
        frontier = Frontier(3.0, 1.0 + 0.7 * (number % 2), Pose2D(2.5, 1.0, 0.0), 1.5, 4.0)
        report = FrontierReport([frontier], [], 14.0, can_move=True)
        explorer.step(scene, Survey(area, report, explorer.clearance), 2.0 * number)
    last = [one for one in explorer.take_actions() if isinstance(one, Send)][-1].goal
    assert explorer.state == ("exploring" if is_driven_to else "homing")
    assert (last.pose == START) is not is_driven_to
