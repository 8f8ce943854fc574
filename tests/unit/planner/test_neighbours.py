"""What is known of other robots: who counts, where they will be, and what is not believed."""

import math

import msgspec
import numpy as np
import pytest
from support.flatland import BOX, Flatland, empty_room
from support.samples import make_robot

from trolley import codes
from trolley.geometry import Pose2D
from trolley.messages import GoalStatus, Path, PoseEstimate
from trolley.messages.types import floats_to_bytes
from trolley_planner.fleet.neighbours import NEIGHBOURS, Neighbours, outline_discs

SECOND_NS = 1_000_000_000
pytestmark = pytest.mark.drives


def estimate(x: float, **changes: object) -> PoseEstimate:
    pose = Flatland(empty_room(), Pose2D(x, 1.0, 0.0)).estimate(0)
    return msgspec.structs.replace(pose, **changes)


def path(points: list[tuple[float, float]], dt: float = 0.0, frame: str = "map") -> Path:
    poses = np.array([(x, y, 0.0) for x, y in points])
    return Path(stamp_ns=0, frame=frame, poses=floats_to_bytes(poses), dt=dt)


@pytest.fixture
def others() -> Neighbours:
    made = Neighbours()
    made.own_name = "me"
    made.update_pose(estimate(1.0), "b", SECOND_NS)
    made.update_path(path([(1.0, 1.0), (3.0, 1.0)]), "b")
    made.update_goal(GoalStatus(stamp_ns=0, id="x", state="driving"), "b", SECOND_NS)
    return made


def test_a_robot_on_the_way_has_the_rest_of_its_path(others: Neighbours) -> None:
    (b,) = others.on_map("room", SECOND_NS)
    assert (b.name, b.is_going, b.is_waiting) == ("b", True, False)
    assert b.path[-1].tolist() == [3.0, 1.0]
    others.update_pose(estimate(2.0), "b", SECOND_NS)
    (b,) = others.on_map("room", SECOND_NS)
    assert b.path[0] == pytest.approx([2.0, 1.0], abs=0.05)


@pytest.mark.parametrize("state", ["idle", "paused", "arrived", "failed", "canceled"])
def test_without_a_goal_under_way_it_has_none(others: Neighbours, state: str) -> None:
    status = GoalStatus(stamp_ns=0, id="x", state=state)  # pyrefly: ignore[bad-argument-type]
    others.update_goal(status, "b", SECOND_NS)
    assert not others.on_map("room", SECOND_NS)[0].is_going


def test_how_long_it_has_been_waiting_counts_from_when_it_said_so_first(others: Neighbours) -> None:
    waits = GoalStatus(stamp_ns=0, id="x", state="recovering", reason=codes.WAITING)
    for second in (1, 2, 3):
        others.update_goal(waits, "b", second * SECOND_NS)
    others.update_pose(estimate(1.0), "b", 4 * SECOND_NS)
    assert others.on_map("room", 4 * SECOND_NS)[0].waited_s == pytest.approx(3.0)
    others.update_goal(GoalStatus(stamp_ns=0, id="x", state="driving"), "b", 4 * SECOND_NS)
    assert others.on_map("room", 4 * SECOND_NS)[0].waited_s is None


def test_only_who_is_sure_heard_of_and_on_this_map_counts(others: Neighbours) -> None:
    assert others.on_map("other map", SECOND_NS) == []
    assert others.on_map("room", 4 * SECOND_NS) == []
    others.update_pose(estimate(1.0, state="lost"), "b", SECOND_NS)
    assert others.on_map("room", SECOND_NS) == []
    others.update_pose(estimate(1.0), "me", SECOND_NS)
    assert others.on_map("room", SECOND_NS) == []


def test_nobody_waits_for_a_recording_that_is_played(others: Neighbours) -> None:
    robot = make_robot("b")
    others.update_robot(msgspec.structs.replace(robot, replayed=True), "b")
    assert others.on_map("room", SECOND_NS) == []
    others.update_robot(robot, "b")
    assert len(others.on_map("room", SECOND_NS)) == 1


def test_where_it_will_be_is_read_from_its_trajectory(others: Neighbours) -> None:
    ahead = [(1.0 + 0.05 * step, 1.0) for step in range(25)]
    others.update_trajectory(path(ahead, dt=0.1), "b", SECOND_NS)
    track = others.on_map("room", SECOND_NS)[0].track
    middle = track[:, 10, :2].mean(axis=0)
    assert middle == pytest.approx([1.5, 1.0], abs=0.02)
    # Half a second later it is half a second farther on, and then it is not believed any more.
    others.update_pose(estimate(1.25), "b", 3 * SECOND_NS // 2)
    later = others.on_map("room", 3 * SECOND_NS // 2)[0].track
    assert later[:, 5, :2].mean(axis=0) == pytest.approx([1.5, 1.0], abs=0.02)
    assert len(others.on_map("room", 2 * SECOND_NS)[0].track) == 0


def test_who_stands_is_left_to_the_lidar(others: Neighbours) -> None:
    others.update_trajectory(path([(1.0, 1.0)] * 25, dt=0.1), "b", SECOND_NS)
    assert len(others.on_map("room", SECOND_NS)[0].track) == 0


@pytest.mark.parametrize(
    "bad",
    [
        path([(math.nan, 1.0), (2.0, 1.0)]),
        path([(1.0, 1.0), (2.0, 1.0)], frame="odom"),
        path([]),
    ],
)
def test_a_path_that_cannot_be_used_is_none(others: Neighbours, bad: Path) -> None:
    others.update_path(bad, "b")
    assert not others.on_map("room", SECOND_NS)[0].is_going
    others.update_trajectory(msgspec.structs.replace(bad, dt=0.1), "b", SECOND_NS)
    assert len(others.on_map("room", SECOND_NS)[0].track) == 0


def test_no_more_robots_are_remembered_than_live_in_a_house(others: Neighbours) -> None:
    for index in range(10 * NEIGHBOURS.most_robots):
        others.update_pose(estimate(1.0), f"r{index}", SECOND_NS)
    assert len(others.on_map("room", SECOND_NS)) == NEIGHBOURS.most_robots
    # Those that fell silent make room for new ones.
    others.update_pose(estimate(1.0), "b", 100 * SECOND_NS)
    others.update_pose(estimate(1.0), "new", 100 * SECOND_NS)
    assert [one.name for one in others.on_map("room", 100 * SECOND_NS)] == ["b", "new"]


def test_discs_hold_the_outline() -> None:
    corners = np.array(BOX)
    discs = outline_discs(corners)
    gaps = np.hypot(*np.moveaxis(corners[:, None] - discs[None, :, :2], -1, 0)) - discs[:, 2]
    assert (gaps.min(axis=1) < 1e-9).all()
