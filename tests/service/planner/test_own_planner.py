"""The example's planner in the place of Trolley's, which none of the others notices."""

from pathlib import Path
from typing import Any

import pytest
from support.examples import load_example
from support.flatland import BOX, Flatland, two_rooms

from trolley import codes, requests, topics
from trolley.codes import Refused
from trolley.config import FootprintConfig, RobotConfig, RobotSection
from trolley.geometry import Pose2D
from trolley.messages.request_params import SendGoal, WhichGoal
from trolley.runtime.lockstep import Lockstep

from .conftest import START, PerfectRobot


def test_a_planner_of_one_s_own_drives_and_its_death_ends_the_commands(tmp_path: Path) -> None:
    planner: Any = load_example("own_planner")
    section = RobotSection(name="trolley", footprint=FootprintConfig(polygon_m=list(BOX)))
    with Lockstep(state=tmp_path) as lockstep:
        robot = lockstep.add(PerfectRobot(Flatland(two_rooms(), START)))
        goals = lockstep.record(topics.GOAL)
        commands = lockstep.record(topics.COMMAND, "planner")
        lockstep.add(planner.StraightPlanner(RobotConfig(robot=section)))
        lockstep.run(0.5)
        there = Pose2D(2.5, 3.5, 0.0)
        lockstep.ask(requests.GOAL_SEND, SendGoal(pose=there))
        assert lockstep.run_until(lambda: goals[-1].state == "arrived", 60.0)
        assert robot.world.pose.distance_to(there) < 0.06
        lockstep.run(0.1)
        assert commands[-1].twist.is_zero  # else base says that commands stopped arriving
        lockstep.ask(requests.GOAL_SEND, SendGoal(pose=START))
        lockstep.ask(requests.GOAL_CANCEL, WhichGoal())
        assert goals[-1].state == "canceled"
        with pytest.raises(Refused) as refused:
            lockstep.ask(requests.GOAL_SEND, SendGoal(name="kitchen"))
        assert refused.value.code == codes.UNKNOWN_NAME
        lockstep.ask(requests.GOAL_SEND, SendGoal(pose=START))
        lockstep.run(1.0)
        lockstep.kill("planner")
        robot.say(mode="ok")
        sent = len(commands)
        lockstep.run(1.0)
        assert len(commands) == sent
        assert robot.world.twist.is_zero
