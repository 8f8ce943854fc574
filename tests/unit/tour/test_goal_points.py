"""Reading the goal list of a ROS script."""

import math

import pytest

from trolley_tour.goal_points import GoalPointsError, read_goal_points, tour_of

SCRIPT = '''#!/usr/bin/env python
import rospy
# Define Goal Points and orientations for TurtleBot in a list
"""
pose x,y,x; orientation: x,y,z,w
"""
GoalPoints = [ [(5.31514576482, 1.36578380326, 0.0), (0.0, 0.0, \
-0.498454937648, 0.866915610157)], #corridor
\t\t[(5.77521810772, -1.2464049907, 0.0), (0.0, 0.0,  -0.959487358308, 0.281751680114)], #prixozaya
\t\t[(2.14926455346, -2.7055208156, 0.0), (0.0, 0.0,  -0.99147032254, 0.130332649487)]] #kitchen
def assign_goal(pose):
    goal_pose = MoveBaseGoal()
    goal_pose.target_pose.pose.position.x = pose[0][0]
    print "Python 2, which is no Python any more"
'''


def names(text: str) -> list[str]:
    return [point.name for point in read_goal_points(text)]


def one_goal(goal: str) -> str:
    return f"GoalPoints = [{goal}]"


def test_the_whole_script_is_read():
    points = read_goal_points(SCRIPT)
    assert [point.name for point in points] == ["corridor", "prixozaya", "kitchen"]
    assert points[0].pose.x == 5.31514576482
    assert points[1].pose.y == -1.2464049907
    assert points[2].pose.yaw == pytest.approx(2 * math.atan2(-0.99147032254, 0.130332649487))


def test_the_list_alone_is_read():
    start = SCRIPT.index("[ [")
    end = SCRIPT.index("def assign_goal")
    assert read_goal_points(SCRIPT[start:end]) == read_goal_points(SCRIPT)
    assert read_goal_points("\ufeff\n  " + SCRIPT[start:end]) == read_goal_points(SCRIPT)


def test_prose_around_it_does_not_matter():
    assert read_goal_points("[sic\n" + SCRIPT + "\n[1] see there") == read_goal_points(SCRIPT)


def test_tour_visits_the_names_in_order():
    tour = tour_of(read_goal_points(SCRIPT), "home")
    assert (tour.name, [stop.name for stop in tour.stops]) == (
        "home",
        ["corridor", "prixozaya", "kitchen"],
    )


def test_goals_without_a_comment_are_numbered():
    text = "GoalPoints = [[(1, 2, 0), (0, 0, 0, 1)], [(3, 4), [0, 0, 1, 0]],]"
    points = read_goal_points(text)
    assert [point.name for point in points] == ["goal-1", "goal-2"]
    assert points[1].pose.yaw == pytest.approx(math.pi)


@pytest.mark.parametrize(
    ("comment", "name"),
    [
        ("#corridor", "corridor"),
        ("## living room, by the sofa!", "living room by the sofa"),
        ("# Küche", "Küche"),
        ("# .hidden", "hidden"),
        ("# прихожая", "прихожая"),
        ("#", "goal-1"),
        ("# ???", "goal-1"),
        ("# " + "a" * 80, "a" * 64),
    ],
)
def test_comment_becomes_a_name(comment: str, name: str):
    assert names(f"GoalPoints = [[(1, 2, 0), (0, 0, 0, 1)]] {comment}\nx = 1\n") == [name]


def test_goals_of_one_line_share_no_comment():
    two = "[(1, 2, 0), (0, 0, 0, 1)], [(1, 2, 0), (0, 0, 0, 1)]"
    assert names(f"GoalPoints = [{two}, # kitchen\n]") == ["goal-1", "kitchen"]


def test_equal_comments_are_told_apart():
    goal = "[(1, 2, 0), (0, 0, 0, 1)], # door\n"
    assert names(f"GoalPoints = [\n{goal}{goal}{goal}]") == ["door", "door-2", "door-3"]


def test_brackets_in_comments_do_not_count():
    assert names("GoalPoints = [ # ]] (\n[(1, 2, 0), (0, 0, 0, 1)]] # bed )") == ["bed"]


def test_quaternion_is_normalised():
    (point,) = read_goal_points(one_goal("[(0, 0, 0), (0, 0, 2, 2)]"))
    assert point.pose.yaw == pytest.approx(math.pi / 2)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        (one_goal("[(0, 0, 0), (0.7, 0, 0, 0.7)]"), r"Goal 1 \(goal-1\): .*about z only"),
        (one_goal("[(0, 0, 0), (0, 0, 0, 0)]"), "length zero"),
        (one_goal("[(1e999, 0, 0), (0, 0, 0, 1)]"), "finite"),
        (one_goal(f"[({'9' * 400}, 0, 0), (0, 0, 0, 1)]"), "too large"),
        (one_goal("[(True, 0, 0), (0, 0, 0, 1)]"), "True is not a number"),
        (one_goal("[(0, 0, 0), (0, 0, 1)]"), "a goal is written"),
        (one_goal("[(0, 0, 0) (0, 0, 0, 1)]"), "only numbers"),
        (one_goal("__import__('os').system('true')"), "only numbers"),
        (one_goal("[(0, 0, 0), (0, 0, 0, 1)"), "a bracket is missing"),
        ("GoalPoints = []", "holds 0 goals"),
        ("GoalPoints = [[(0, 0, 0), (0, 0,, 1)]]", "not valid Python"),
        ("x = 1", "no list called GoalPoints"),
        ("", "no list called GoalPoints"),
        ("a = [1]\nb = [2]", "no list called GoalPoints"),
        ("GoalPoints = " + "[" * 5000 + "]" * 5000, "deeply|not valid Python"),
        ("#" * 2_000_000, "longer than"),
    ],
)
def test_what_cannot_be_read_says_why(text: str, why: str):
    with pytest.raises(GoalPointsError, match=why):
        read_goal_points(text)
