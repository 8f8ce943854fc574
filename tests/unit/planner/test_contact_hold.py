"""Standing still while somebody touches the robot."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from support.flatland import Flatland, empty_room, with_block

from trolley.config import PlannerConfig
from trolley.geometry import Pose2D, wrap_angle
from trolley_planner.costmap.footprint import Footprint
from trolley_planner.driving.contact_hold import ContactHold
from trolley_planner.driving.goal_execution import GoalExecution
from trolley_planner.people.tracker import (
    TrackedPerson,
)

pytestmark = pytest.mark.drives

STEP_S = 0.05
HERE = Pose2D(0.0, 0.0, 0.0)


def mover(x: float, y: float, vx: float, vy: float) -> list[TrackedPerson]:
    """One thing of 0.2 m."""
    points: NDArray[np.float64] = np.array([[x, y - 0.1], [x, y], [x, y + 0.1]])
    return [TrackedPerson(points, np.array([x, y]), np.array([vx, vy]))]


def test_who_never_gets_out_of_the_way_makes_the_goal_fail(
    ride, monkeypatch: pytest.MonkeyPatch
) -> None:
    def always(watch: ContactHold, now_ns: int) -> bool:
        return True

    monkeypatch.setattr(ContactHold, "must_stand", always)
    drive = ride(Flatland(empty_room(), Pose2D(1.0, 3.0, 0.0)), PlannerConfig(give_up_s=20.0))
    drive.send(Pose2D(6.5, 3.0, 0.0))
    assert isinstance(drive.navigator.current.execution, GoalExecution)
    status = drive.until_over(120.0)
    assert status.state == "failed"
    assert status.reason


def echoes_at(points: list[tuple[float, float]]) -> NDArray[np.float64]:
    """Beams from the robot's own place to these points."""
    x, y = np.array(points).T
    ranges = np.hypot(x, y)
    zeros = np.zeros(len(points))
    return np.stack([zeros, zeros, x / ranges, y / ranges, ranges, ranges], axis=1)


SECOND_NS = 1_000_000_000
TOUCHING, BESIDE = echoes_at([(0.18, 0.0), (2.0, 1.0)]), echoes_at([(0.3, 0.0), (2.0, 1.0)])


def touched() -> ContactHold:
    box = [(0.15, 0.12), (-0.15, 0.12), (-0.15, -0.12), (0.15, -0.12)]
    return ContactHold(Footprint.from_polygon(box), patience_s=5.0)


def test_stands_while_who_came_touches_it_but_not_for_ever() -> None:
    watch = touched()
    watch.update(0, BESIDE, mover(0.4, 0.0, -1.0, 0.0), HERE)
    assert not watch.must_stand(0)
    for tenth in range(5, 55):
        now_ns = tenth * SECOND_NS // 10
        watch.update(now_ns, TOUCHING, [], HERE)
        assert watch.must_stand(now_ns)
    watch.update(6 * SECOND_NS, TOUCHING, [], HERE)
    assert not watch.must_stand(6 * SECOND_NS)


def test_does_not_stand_for_ever_for_somebody_who_steps_about_before_it() -> None:
    watch = touched()
    for tenth in range(55):
        watch.update(tenth * SECOND_NS // 10, TOUCHING, mover(0.3, 0.0, -1.0, 0.0), HERE)
    assert not watch.must_stand(55 * SECOND_NS // 10)


def test_drives_on_when_who_touched_it_has_gone() -> None:
    watch = touched()
    watch.update(0, BESIDE, mover(0.4, 0.0, -1.0, 0.0), HERE)
    watch.update(SECOND_NS // 2, TOUCHING, [], HERE)
    watch.update(SECOND_NS, BESIDE, [], HERE)
    assert not watch.must_stand(SECOND_NS)


def test_does_not_stand_for_what_it_drove_up_to() -> None:
    watch = touched()
    watch.update(0, BESIDE, mover(2.0, 0.0, -1.0, 0.0), HERE)
    watch.update(SECOND_NS // 2, TOUCHING, [], HERE)
    assert not watch.must_stand(SECOND_NS // 2)
    watch.update(0, np.empty((0, 6)), [], HERE)


def test_the_robot_stands_while_somebody_leans_on_it(ride) -> None:
    room = empty_room()
    world = Flatland(room, Pose2D(1.0, 3.0, 0.0))
    drive = ride(world)
    drive.send(Pose2D(6.0, 3.0, 0.0))
    drive.step(60)
    walked = 0.0
    # Somebody comes from the left until they touch it, and stays there for two seconds.
    for step in range(80):
        y = max(world.pose.y + 0.25, 4.8 - 1.0 * step * STEP_S)
        world.set_truth(with_block(room, world.pose.x - 0.1, y - 0.1, 0.2, 0.2))
        before = world.pose
        drive.step()
        if step > 40:
            walked += world.pose.distance_to(before)
    assert walked < 0.02
    world.set_truth(room)
    assert drive.until_over().state == "arrived"
    assert world.touches == 0


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_the_robot_has_stopped_turning_when_somebody_walks_into_it(ride, side: float) -> None:
    room, start = empty_room(), Pose2D(3.0, 3.0, 0.0)
    world = Flatland(room, start)
    drive = ride(world)
    touch_m, walking_mps, since_s = 0.25, 1.0, 1.5

    def walk(step: int) -> float:
        """Let somebody walk on, who began to so as to be there while it turns."""
        off_m = touch_m + walking_mps * max(30 * STEP_S + since_s - step * STEP_S, 0.0)
        world.set_truth(with_block(room, start.x - 0.1, start.y + side * off_m - 0.1, 0.2, 0.2))
        return off_m

    for step in range(30):
        walk(step)
        drive.step()
    drive.send(Pose2D(start.x, start.y, math.pi))
    turned: list[float] = []
    for step in range(30, 200):
        before = world.pose.yaw
        off_m = walk(step)
        drive.step()
        turned.append(abs(wrap_angle(world.pose.yaw - before)) / STEP_S)
        if off_m <= touch_m + 0.1:
            break
    assert max(turned) > 0.5, "it turned"
    assert turned[-1] < 0.1, "and stood before they were there"


def test_a_wall_beside_it_is_nobody_who_touches_it() -> None:
    watch = touched()
    beside_a_wall = echoes_at([(0.0, -0.15), (0.1, -0.15), (0.6, 0.0)])
    for tenth in range(8):
        now_ns = tenth * SECOND_NS // 10
        watch.update(now_ns, beside_a_wall, mover(0.5, 0.15, -0.8, 0.0), HERE)
        assert not watch.must_stand(now_ns)
