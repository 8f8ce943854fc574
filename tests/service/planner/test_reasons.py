"""What the planner says on the wire when it makes no progress, and what it takes from there."""

import math
from pathlib import Path

import msgspec
import numpy as np
import pytest
from support.flatland import Flatland, Ice, empty_room, two_rooms, with_block

from trolley import codes, topics
from trolley.codes import Refused
from trolley.geometry import Pose2D, Twist2D
from trolley.gridmap import UNKNOWN, GridMap
from trolley.messages import Suspects
from trolley.messages.sensing import SuspectLine

from .conftest import START, Stage

FAR_SIDE = Pose2D(6.5, 4.5, 0.0)


def told(stage: Stage) -> list[tuple[str, str]]:
    """States with their reasons, each once in their order."""
    pairs = [(goal.state, goal.reason) for goal in stage.goals]
    return [pair for index, pair in enumerate(pairs) if index == 0 or pair != pairs[index - 1]]


def test_a_blocked_door_is_told_with_its_place_and_all_that_is_tried(tmp_path: Path) -> None:
    hall = two_rooms()  # in which there is no room beside the way
    for y in (0.0, 3.7):
        hall = with_block(hall, 1.6, y, 2.35, 2.3)
    world = Flatland(hall, START)
    world.set_truth(with_block(hall, 3.9, 2.5, 0.2, 1.0))
    stage = Stage(tmp_path, world, give_up_s=30.0)
    stage.send(FAR_SIDE)
    ended = stage.until("failed", 150.0)
    assert told(stage)[-3:] == [("driving", ""), ("recovering", "blocked"), ("failed", "blocked")]
    assert math.dist(ended.blocked[0], (3.9, 3.0)) < 0.6
    messages = {goal.message for goal in stage.goals if goal.state == "recovering"}
    for word in ("waits", "checking its surroundings", "backing up", "turns"):
        assert any(word in message for message in messages), word
    assert ended.recoveries >= 4
    assert world.touches == 0
    stage.lockstep.close()


class Swing(Flatland):
    """Whatever it wants, the robot rolls to and fro."""

    speed = 0.3

    def drive(self, twist: Twist2D, dt: float) -> None:
        if abs(self.pose.x - START.x) > 0.05:
            self.speed = math.copysign(self.speed, START.x - self.pose.x)
        super().drive(Twist2D(self.speed, 0.0, 0.0), dt)


class Stuck(Flatland):
    """The robot does not move, for no reason that anybody sees."""

    def drive(self, twist: Twist2D, dt: float) -> None:
        del twist, dt


@pytest.mark.parametrize(
    ("world", "reason"),
    [
        (Ice, codes.SLIP),
        pytest.param(Swing, codes.OSCILLATION, marks=pytest.mark.slow),
        (Stuck, codes.BLOCKED),
    ],
)
def test_why_it_does_not_get_on_is_told(tmp_path: Path, world, reason: str) -> None:
    stage = Stage(tmp_path, world(empty_room(), START), give_up_s=15.0)
    stage.send(FAR_SIDE)
    assert stage.until("recovering", 30.0).reason == reason
    ended = stage.until("failed", 200.0)
    assert (ended.reason, ended.message) == (reason, codes.SENTENCES[reason])
    stage.lockstep.close()


def test_a_goal_that_base_does_not_drive_to_blindly_says_so(tmp_path: Path) -> None:
    stage = Stage(tmp_path, Stuck(empty_room(), START), give_up_s=15.0)
    stage.send(FAR_SIDE)
    why = "The lidar sees nothing ahead, so it does not move there."
    stage.robot.say(mode="held", source="planner", reason=codes.BLIND, message=why)
    stage.lockstep.run(0.5)
    now = stage.goals[-1]
    assert (now.state, now.reason, now.message) == ("driving", codes.BLIND, why)
    assert stage.until("recovering", 30.0).reason == codes.BLIND
    stage.robot.say(mode="ok", source="planner")  # it does not even try for a moment
    stage.lockstep.run(0.5)
    assert stage.goals[-1].reason == codes.BLIND
    while stage.goals[-1].state != "failed" and stage.lockstep.now_s < 200.0:
        stage.robot.say(mode="held", source="planner", reason=codes.BLIND, message=why)
        stage.lockstep.run(5.0)
    assert stage.goals[-1].state == "failed"
    assert (stage.goals[-1].reason, stage.goals[-1].message) == (codes.BLIND, why)
    stage.lockstep.close()


def test_a_door_that_is_too_narrow_is_refused_with_its_place(tmp_path: Path) -> None:
    stage = Stage(tmp_path, Flatland(two_rooms(0.2), START))
    with pytest.raises(Refused) as refusal:
        stage.send(FAR_SIDE)
    assert refusal.value.code == codes.NO_PATH
    [place] = refusal.value.details["blocked"]
    assert math.dist(place, (4.0, 3.0)) < 0.15
    stage.lockstep.close()


def test_a_pose_off_the_map_stops_the_robot_and_says_so(stage: Stage) -> None:
    stage.send(FAR_SIDE)
    stage.lockstep.run(2.0)
    plain = stage.world.correction
    away = Pose2D(-30.0, 2.0, 0.3)
    stage.world.correction = lambda stamp_ns: msgspec.structs.replace(
        plain(stamp_ns), pose=away @ plain(stamp_ns).pose
    )
    assert stage.stands()
    assert (stage.goals[-1].state, stage.goals[-1].reason) == ("recovering", codes.OUTSIDE_MAP)
    with pytest.raises(Refused) as refusal:
        stage.send(START)
    assert refusal.value.code == codes.OUTSIDE_MAP
    del stage.world.correction
    assert stage.until("arrived").reason == ""
    assert stage.world.touches == 0


def test_nothing_is_seen_behind_a_suspected_mirror(tmp_path: Path) -> None:
    world = Flatland(empty_room(), START)
    world.set_truth(with_block(empty_room(), 3.0, 2.8, 0.3, 0.4))
    stage = Stage(tmp_path, world)
    context = stage.planner.navigator.costmap_manager.require_context()

    def is_seen() -> bool:
        return bool(np.any(context.costmap.obstacle_layer.grid.evidence[50:70, 58:68]))

    stage.lockstep.run(2.0)
    assert is_seen()
    line = SuspectLine(points=[(2.5, 2.0), (2.5, 4.0)], score=0.7)
    stage.lockstep.publish(topics.SUSPECTS, Suspects(stamp_ns=1, lines=[line]))
    context.costmap.forget_all()
    stage.lockstep.run(2.0)
    assert not is_seen()
    stage.lockstep.publish(topics.SUSPECTS, Suspects(stamp_ns=2, lines=[]))
    stage.lockstep.run(2.0)
    assert is_seen()
    stage.lockstep.close()


def left_room_only() -> GridMap:
    """A map that knows nothing of the room on the right."""
    known = two_rooms()
    cells = known.cells.copy()
    cells[:, round(4.2 / known.resolution) :] = UNKNOWN
    return GridMap(known.name, known.resolution, known.origin, cells)


def test_off_the_map_a_goal_further_off_waits_until_the_robot_is_back(tmp_path: Path) -> None:
    world = Flatland(left_room_only(), START, two_rooms())
    stage = Stage(tmp_path, world, unknown_is_free=True)
    stage.send(FAR_SIDE)
    assert stage.lockstep.run_until(lambda: world.pose.x > 4.5, 60.0)
    stage.robot.pose_state, stage.robot.off_map_m = "unsure", 0.3
    paused = stage.until("paused", 2.0)
    assert (paused.reason, paused.message) == (codes.OFF_MAP, codes.SENTENCES[codes.OFF_MAP])
    assert stage.stands()
    stage.robot.pose_state, stage.robot.off_map_m = "localized", None
    assert stage.until("arrived").reason == ""
    stage.lockstep.close()


@pytest.mark.parametrize("interrupt", ["stop", "restart", "hand"])
def test_off_the_map_a_goal_does_not_go_on_by_itself_after_a_stop_a_restart_or_a_hand(
    tmp_path: Path, interrupt: str
) -> None:
    world = Flatland(left_room_only(), START, two_rooms())
    stage = Stage(tmp_path, world, unknown_is_free=True)
    stage.send(FAR_SIDE)
    stage.lockstep.run(3.0)
    stage.robot.pose_state, stage.robot.off_map_m = "unsure", 30.0
    stage.until("paused", 2.0)
    assert stage.stands()
    match interrupt:
        case "stop":
            stage.robot.say(mode="stopped", reason="button")
            reason = codes.STOPPED
        case "restart":
            stage.robot.restart()
            reason = codes.RESTARTED
        case _:
            stage.robot.say(mode="ok", source="teleop")
            reason = codes.TAKEN_OVER
    stage.lockstep.run(1.0)
    assert (stage.goals[-1].state, stage.goals[-1].reason) == ("paused", reason)
    stage.robot.say(mode="ok", source=None)
    stage.robot.pose_state, stage.robot.off_map_m = "localized", None
    stage.lockstep.run(2.0)
    assert stage.goals[-1].state == "paused"
    assert world.twist.is_zero
    stage.lockstep.close()


def test_off_the_map_a_goal_on_the_way_back_is_driven_to(tmp_path: Path) -> None:
    there = Pose2D(6.0, 3.5, math.pi)
    stage = Stage(tmp_path, Flatland(left_room_only(), there, two_rooms()), unknown_is_free=True)
    stage.robot.pose_state, stage.robot.off_map_m = "unsure", 4.0
    stage.lockstep.run(0.5)
    stage.send(START)
    assert stage.until("arrived").reason == ""
    assert "paused" not in {goal.state for goal in stage.goals}
    stage.lockstep.close()
