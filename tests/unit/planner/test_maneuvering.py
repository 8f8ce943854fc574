"""When maneuvers begin and end, and what is remembered from one to the next."""

import math
from dataclasses import replace

import numpy as np
import pytest
from support.all_poses import box
from support.flatland import Flatland, empty_room, two_rooms, with_block

from trolley.config import PlannerConfig
from trolley.geometry import Pose2D, Twist2D
from trolley.gridmap import GridMap
from trolley_planner.context.motion_state import ControlInput
from trolley_planner.control.controller import Motion, limits_of
from trolley_planner.driving.goal_execution import GoalExecution
from trolley_planner.driving.maneuver_follower import ManeuverFollower
from trolley_planner.paths.hybrid_astar.motion_primitives import BACKWARDS, FORWARDS, Maneuver

HOBBY = box(0.35, 0.30, 0.175)


def lane(width_m: float) -> GridMap:
    """A room, and a dead end to its right along y = 3."""
    below = with_block(empty_room(), 4.5, 0.1, 3.4, 2.9 - width_m / 2.0)
    return with_block(below, 4.5, 3.0 + width_m / 2.0, 3.4, 2.9 - width_m / 2.0)


def execution_of(drive, goal: Pose2D, **params) -> GoalExecution:
    """What drives to a goal from now on."""
    drive.step(4)
    drive.send(goal, **params)
    execution = drive.navigator.current.execution
    assert execution is not None
    return execution


def standing(drive, pose: Pose2D, speed: float = 0.0) -> ControlInput:
    """What a command is computed from for a robot at a pose."""
    motion = Motion(pose, Twist2D(speed, 0.0, 0.0))
    limits = limits_of(PlannerConfig(), 0.5, 1.5, 1.0)
    return ControlInput(drive.now_ns, drive.now_ns, motion, pose, Pose2D.identity(), limits, 0.05)


@pytest.mark.parametrize(("speed", "sense"), [(0.3, FORWARDS), (-0.25, BACKWARDS)])
def test_a_maneuver_begins_where_the_robot_can_stop_whichever_way_it_drives(
    ride, speed: float, sense: int
) -> None:
    # It must turn first.
    start = Pose2D(3.4, 3.0, 0.5 * math.pi)
    drive = ride(Flatland(two_rooms(0.45), start, footprint=HOBBY))
    execution = execution_of(drive, Pose2D(5.5, 3.0, 0.0))
    maneuvering = execution._maneuvering
    maneuvering.stop()  # That began where it stood.
    execution.update(Motion(start, Twist2D(speed, 0.0, 0.0)), drive.now_ns)
    driven = maneuvering._driven
    assert driven is not None
    assert driven.follower.sense == sense
    assert driven.follower.run_ahead(1.0)[-1, 1] == pytest.approx(3.0 + 0.4 * speed, abs=0.02)


def test_who_arrived_by_a_maneuver_has_not_where_the_goal_moves_on(ride) -> None:
    goal = Pose2D(4.0, 3.0, 0.0)
    drive = ride(Flatland(two_rooms(0.4), Pose2D(3.3, 3.0, 0.0), footprint=HOBBY))
    execution = execution_of(drive, goal)
    drive.until_over(20.0)
    assert execution._maneuvering.has_arrived
    execution.move_goal(replace(execution.goal, pose=drive.world.grid.origin @ Pose2D(4.5, 3, 0)))
    here = drive.world.pose
    # Noise of its pose has it turn back by a little.
    execution.command(standing(drive, Pose2D(here.x, here.y, here.yaw + 0.04)))
    assert execution.outcome is None


def test_after_giving_way_the_maneuver_from_elsewhere_is_not_gone_on_with(ride) -> None:
    drive = ride(Flatland(two_rooms(0.45), Pose2D(3.3, 3.0, 0.0), footprint=HOBBY))
    execution = execution_of(drive, Pose2D(5.5, 3.0, 0.0))
    drive.step(10)
    assert execution._maneuvering.is_active
    execution.resume_after_wait(round(5e9))
    assert not execution._maneuvering.is_active


@pytest.mark.parametrize("clearance_m", [0.03, 0.1])
def test_it_is_brisk_with_more_than_the_wanted_clearance_however_much_that_is(
    ride, clearance_m: float
) -> None:
    config, here = PlannerConfig(clearance_m=clearance_m), Pose2D(5.5, 3.0, 0.0)
    drive = ride(Flatland(lane(0.6), here, footprint=HOBBY), config)
    maneuvering = execution_of(drive, Pose2D(6.5, 3.0, 0.0))._maneuvering
    x = np.linspace(here.x, here.x + 1.5, 51)
    line = Maneuver(np.column_stack([x, np.full(51, 3.0), 0.0 * x]), np.ones(51, dtype=np.int8))
    now = standing(drive, here)
    now = replace(now, limits=now.limits._replace(clearance_m=clearance_m))
    limits, _ = maneuvering._limits(now, ManeuverFollower(line, 0.23))
    assert limits.clearance_m == clearance_m
    assert limits.slow_speed == pytest.approx(3.0 * config.slow_speed_mps)


class HeldTurning(Flatland):
    """It does not turn where it is told to turn on the spot."""

    def drive(self, twist: Twist2D, dt: float) -> None:
        super().drive(Twist2D.zero() if twist.vx == 0.0 else twist, dt)


def test_who_is_held_turning_after_it_backed_may_still_back(
    ride, monkeypatch: pytest.MonkeyPatch
) -> None:
    drive = ride(HeldTurning(lane(0.5), Pose2D(5.4, 3.0, 0.0), footprint=HOBBY))
    execution = execution_of(drive, Pose2D(4.8, 3.0, 0.35), yaw_tolerance=0.05)
    context, asked = execution.context, []
    find = context.find_maneuver

    def find_noted(task, half_m, *, may_back=True):
        asked.append(may_back)
        return find(task, half_m, may_back=may_back)

    monkeypatch.setattr(context, "find_maneuver", find_noted)
    drive.step(20 * 8)
    assert drive.world.pose.x < 4.9
    assert len(asked) > 1
    assert all(asked)
