"""The planner service on the bus: goals, commands, and what interrupts them."""

import math
from itertools import pairwise
from typing import Any

import msgspec
import numpy as np
import pytest
from support.flatland import Flatland, empty_room, with_block

from trolley import codes, requests, topics
from trolley.codes import Refused
from trolley.geometry import Pose2D
from trolley.messages import BaseState, GoalStatus, Path, SavedPose, SavedPoses, Scan
from trolley.messages.request_params import SendGoal, WhichGoal
from trolley.messages.types import floats_from_bytes, floats_to_bytes
from trolley.requests import Request
from trolley.runtime.bus import Query
from trolley_planner.service import PlannerService

from .conftest import START, Stage


def told(stage: Stage) -> list[tuple[str | None, str, str]]:
    """Every change of the goal, once."""
    found: list[tuple[str | None, str, str]] = []
    for status in stage.goals:
        now = (status.id, status.state, status.reason)
        if not found or found[-1] != now:
            found.append(now)
    return found


def test_a_goal_is_driven_to(stage: Stage, far_side: Pose2D) -> None:
    status = stage.send(far_side, id="go-1")
    assert (status.id, status.state) == ("go-1", "driving")
    assert status.distance_remaining == pytest.approx(5.9, abs=0.4)
    assert status.eta is not None
    stage.until("arrived")
    assert stage.world.pose.distance_to(far_side) <= 0.05
    assert stage.world.touches == 0
    assert told(stage) == [
        (None, "idle", ""),
        ("go-1", "planning", ""),
        ("go-1", "driving", ""),
        ("go-1", "arrived", ""),
    ]
    assert stage.stands()
    before = len(stage.commands)
    stage.lockstep.run(3.0)
    assert len(stage.commands) == before, "with no goal it is silent"


def test_it_turns_round_to_a_goal_behind_it(tmp_path) -> None:
    """It backed along the whole corridor, at half the speed: turning did not pay so soon."""
    world = Flatland(empty_room(12.0, 1.7), Pose2D(3.0, 0.85, math.pi))
    stage = Stage(tmp_path, world)
    stage.send(Pose2D(10.0, 0.85, math.pi))
    poses = [world.pose]

    def has_arrived() -> bool:
        poses.append(world.pose)
        return stage.goals[-1].state == "arrived"

    assert stage.lockstep.run_until(has_arrived, 60.0)
    stage.lockstep.close()
    moves_m = [(before.inverse() @ after).x for before, after in pairwise(poses)]
    assert sum(move_m for move_m in moves_m if move_m < 0.0) > -1.0
    assert world.touches == 0


def test_commands_come_evenly_stamped_and_name_their_scan(stage: Stage, far_side: Pose2D) -> None:
    began_s = stage.lockstep.now_s
    stage.send(far_side)
    stage.lockstep.run(5.0)
    stamps = [command.stamp_ns for command in stage.commands]
    assert stamps == sorted(set(stamps))
    rate = len(stamps) / (stage.lockstep.now_s - began_s)
    assert 15.0 <= rate <= 30.0
    from_scans = [command for command in stage.commands if command.scan_ns]
    assert len(from_scans) >= 45
    assert all(0 <= command.stamp_ns - command.scan_ns < 0.12e9 for command in from_scans)
    assert all(0.1 <= command.valid_for <= 0.5 for command in stage.commands)


def test_the_path_is_told_and_emptied_at_the_end(stage: Stage, far_side: Pose2D) -> None:
    stage.send(far_side)
    stage.lockstep.run(0.5)
    poses = np.frombuffer(stage.paths[-1].poses, dtype="<f4").reshape(-1, 3)
    assert stage.paths[-1].frame == "map"
    assert np.hypot(*(poses[-1, :2] - (far_side.x, far_side.y))) < 0.05
    assert poses[-1, 2] == pytest.approx(far_side.yaw, abs=1e-5)
    stage.until("arrived")
    stage.lockstep.run(0.1)
    assert len(stage.paths[-1].poses) == 0


def test_costmaps_are_told_rarely(stage: Stage) -> None:
    whole = stage.lockstep.record(topics.COSTMAP_GLOBAL)
    part = stage.lockstep.record(topics.COSTMAP)
    stage.lockstep.run(10.0)
    assert 3 <= len(whole) <= 20
    assert (whole[-1].width, whole[-1].height) == (160, 120)
    cells = np.frombuffer(whole[-1].cells, dtype=np.int8)
    assert set(np.unique(cells)) <= set(range(-1, 101))
    assert cells.max() == 100
    assert part[-1].width < 160
    local = np.frombuffer(part[-1].cells, dtype=np.int8).reshape(part[-1].height, part[-1].width)
    row, col = (int(v / 0.05) for v in (part[-1].origin.y, part[-1].origin.x))
    here = cells.reshape(120, 160)[row : row + local.shape[0], col : col + local.shape[1]]
    np.testing.assert_array_equal(local, here)


def test_get_answers_for_the_last_goals(stage: Stage, far_side: Pose2D) -> None:
    stage.send(far_side, id="a")
    stage.send(START, id="b")

    def state_of(goal_id: str) -> str | None:
        [reply] = stage.lockstep.get(f"{topics.GOAL.key('trolley')}?id={goal_id}")
        body = msgspec.json.decode(reply.payload)
        return body["code"] if reply.is_error else body["state"]

    assert state_of("a") == "canceled"
    assert state_of("b") in ("driving", "arrived")
    assert state_of("c") == codes.UNKNOWN_NAME


@pytest.mark.parametrize(
    ("payload", "code"),
    [
        (b'{"pose":{"x":NaN,"y":0,"yaw":0}}', codes.BAD_REQUEST),
        (b'{"pose":{"x":1e999,"y":0,"yaw":0}}', codes.BAD_REQUEST),
        (b'{"pose":{"x":1,"y":0,"yaw":0},"name":"kitchen"}', codes.BAD_REQUEST),
        (b"{}", codes.BAD_REQUEST),
        (b'{"pose":{"x":1,"y":0,"yaw":0},"colour":"red"}', codes.BAD_REQUEST),
        (b'{"pose":{"x":1,"y":0,"yaw":0},"xy_tolerance":-1}', codes.BAD_REQUEST),
        (b'{"pose":{"x":1,"y":0,"yaw":0},"xy_tolerance":0.004}', codes.BAD_REQUEST),
        (b'{"pose":{"x":1,"y":0,"yaw":0},"yaw_tolerance":0.009}', codes.BAD_REQUEST),
        (b'{"pose":{"x":1e12,"y":0,"yaw":0}}', codes.OUTSIDE_MAP),
        (b'{"pose":{"x":3,"y":3,"yaw":1e12},"xy_tolerance":1e12}', None),
        (b"[" * 100_000, codes.BAD_REQUEST),
    ],
)
def test_bad_goals_are_refused_and_the_service_lives(stage: Stage, payload, code) -> None:
    [reply] = stage.lockstep.get(requests.GOAL_SEND.key("trolley"), payload)
    if code is None:
        assert not reply.is_error
    else:
        assert msgspec.json.decode(reply.payload)["code"] == code
        assert stage.goals[-1].state == "idle"
    assert stage.send(Pose2D(2.0, 3.0, 0.0)).state == "driving"


def test_saved_places_are_driven_to_by_name(stage: Stage) -> None:
    def ask(name: str) -> str:
        try:
            return stage.lockstep.ask(requests.GOAL_SEND, SendGoal(name=name)).state
        except Refused as refusal:
            return refusal.code

    assert ask("sofa") == codes.TOUR_NOT_RUNNING
    here = SavedPose(name="caf\u00e9", map="room", pose=Pose2D(2.0, 2.0, 0.0))
    there = SavedPose(name="attic", map="upstairs", pose=Pose2D(2.0, 2.0, 0.0))
    stage.lockstep.publish(topics.POSES, SavedPoses(stamp_ns=0, poses=[here, there]))
    assert ask("cellar") == codes.UNKNOWN_NAME
    assert ask("attic") == codes.WRONG_MAP
    assert ask("caf\u00e9") == "driving"
    assert ask("cafe\u0301") == "driving"  # as file names on macOS have it


def test_a_preview_drives_nothing(stage: Stage, far_side: Pose2D) -> None:
    path = stage.lockstep.ask(requests.GOAL_PREVIEW, SendGoal(pose=far_side))
    assert isinstance(path, Path)
    assert path.dt > 0.0
    assert stage.commands == []
    assert stage.goals[-1].state == "idle"


def test_pause_cancel_and_resume(stage: Stage, far_side: Pose2D) -> None:
    stage.send(far_side, id="a")
    stage.lockstep.run(2.0)
    ask = stage.lockstep.ask
    assert ask(requests.GOAL_PAUSE, WhichGoal(id="a")).state == "paused"
    assert stage.stands()
    assert ask(requests.GOAL_RESUME, WhichGoal()).state == "driving"
    stage.lockstep.run(2.0)
    assert not stage.world.twist.is_zero
    with pytest.raises(Refused) as refusal:
        ask(requests.GOAL_CANCEL, WhichGoal(id="z"))
    assert refusal.value.code == codes.NOT_CURRENT
    assert ask(requests.GOAL_CANCEL, WhichGoal(id="a")).reason == codes.CANCELED
    assert stage.stands()


def test_a_stop_and_a_hand_pause_and_nothing_sets_off_by_itself(
    stage: Stage, far_side: Pose2D
) -> None:
    for state in ({"mode": "stopped", "reason": "button"}, {"mode": "ok", "source": "teleop"}):
        stage.send(far_side)
        stage.lockstep.run(2.0)
        stage.robot.say(**state)
        assert stage.stands()
        assert stage.goals[-1].state == "paused"
        stage.robot.say(mode="ok")
        stage.lockstep.run(5.0)
        assert stage.world.twist.is_zero
        assert stage.lockstep.ask(requests.GOAL_RESUME, WhichGoal()).state == "driving"


def test_a_goal_is_refused_while_the_robot_is_stopped(stage: Stage, far_side: Pose2D) -> None:
    stage.robot.say(mode="stopped", reason="button")
    stage.lockstep.run(0.1)
    with pytest.raises(Refused) as refusal:
        stage.send(far_side)
    assert refusal.value.code == codes.STOPPED


def test_a_stop_that_is_over_counts_no_more_however_late_it_is_heard(
    stage: Stage, far_side: Pose2D
) -> None:
    stopped = BaseState(stamp_ns=stage.robot.robot_ns, mode="stopped", reason="button")
    stage.lockstep.run(0.1)
    stage.robot.say(mode="ok")
    stage.lockstep.publish(topics.BASE, stopped)  # it was held up on its way
    stage.lockstep.run(0.0)
    assert stage.send(far_side).state == "driving"
    stage.lockstep.publish(topics.BASE, stopped)
    stage.lockstep.run(1.0)
    assert stage.goals[-1].state == "driving"
    stage.robot.say(mode="stopped", reason="button")
    assert stage.stands()
    assert stage.goals[-1].state == "paused"
    stage.lockstep.kill("base")
    with pytest.raises(Refused) as refusal:
        stage.lockstep.ask(requests.GOAL_RESUME, WhichGoal())
    assert refusal.value.code == codes.STOPPED


def test_a_new_epoch_pauses_the_goal(stage: Stage, far_side: Pose2D) -> None:
    stage.send(far_side)
    stage.lockstep.run(2.0)
    stage.robot.restart()
    assert stage.stands()
    assert (stage.goals[-1].state, stage.goals[-1].reason) == ("paused", codes.RESTARTED)
    stage.lockstep.run(3.0)
    assert stage.world.twist.is_zero
    stage.lockstep.ask(requests.GOAL_RESUME, WhichGoal())
    stage.until("arrived")


def test_a_restarted_planner_has_no_goal_and_is_silent(stage: Stage, far_side: Pose2D) -> None:
    stage.send(far_side)
    stage.lockstep.run(2.0)
    stage.lockstep.kill("planner")
    stage.lockstep.run(1.0)
    stage.lockstep.add(PlannerService(stage.config))
    before = len(stage.commands)
    stage.lockstep.run(3.0)
    assert stage.goals[-1].state == "idle"
    assert stage.goals[-1].id is None
    assert len(stage.commands) == before


@pytest.mark.parametrize(
    ("silent", "reason"),
    [("pose", codes.STALE), ("scan", codes.SCAN_LOST), ("odom", codes.LINK_LOST)],
)
def test_it_stands_while_its_sensors_are_silent(stage, far_side, silent, reason) -> None:
    stage.send(far_side)
    stage.lockstep.run(2.0)
    stage.robot.silent.add(silent)
    stage.lockstep.run(2.0)
    assert stage.world.twist.is_zero
    assert (stage.goals[-1].state, stage.goals[-1].reason) == ("recovering", reason)
    stage.robot.silent.clear()
    stage.until("arrived")
    assert stage.world.touches == 0


@pytest.mark.parametrize(
    ("silent", "reason"),
    [("pose", codes.STALE), ("scan", codes.SCAN_LOST), ("odom", codes.LINK_LOST)],
)
def test_a_message_of_the_future_does_not_hide_that_no_other_follows(
    stage: Stage, far_side: Pose2D, silent: str, reason: str
) -> None:
    stage.send(far_side)
    stage.lockstep.run(2.0)
    stage.robot.silent.add(silent)
    in_an_hour_ns = stage.robot.robot_ns + 3_600_000_000_000
    if silent == "pose":
        stage.robot.publish(topics.POSE, stage.world.estimate(in_an_hour_ns, "localized"))
    elif silent == "scan":
        stage.lockstep.run(0.1)  # one that comes at once after the last is skipped
        stage.robot.publish(topics.SCAN, stage.world.scan(in_an_hour_ns))
    else:
        stage.robot.publish(topics.ODOM, stage.world.odometry(in_an_hour_ns))
    stage.lockstep.run(2.0)
    assert stage.world.twist.is_zero
    assert (stage.goals[-1].state, stage.goals[-1].reason) == ("recovering", reason)


@pytest.mark.parametrize("clock", [set(), {"clock"}])
def test_after_a_long_silence_of_base_nothing_sets_off_by_itself(
    stage: Stage, far_side: Pose2D, clock: set[str]
) -> None:
    stage.send(far_side)
    stage.lockstep.run(2.0)
    stage.robot.silent |= {"odom", "scan", "pose"} | clock
    stage.lockstep.run(3.0)
    assert (stage.goals[-1].state, stage.goals[-1].reason) == ("recovering", codes.SCAN_LOST)
    stage.lockstep.run(70.0)
    stage.robot.silent.clear()
    stage.lockstep.run(2.0)
    assert (stage.goals[-1].state, stage.goals[-1].reason) == ("failed", codes.SCAN_LOST)
    assert stage.world.twist.is_zero


def test_a_lost_pose_stops_the_robot(stage: Stage, far_side: Pose2D) -> None:
    stage.send(far_side)
    stage.lockstep.run(2.0)
    stage.robot.pose_state = "lost"
    assert stage.stands()
    with pytest.raises(Refused) as refusal:
        stage.send(START)
    assert refusal.value.code == codes.NOT_LOCALIZED


def test_what_is_missing_is_named(tmp_path) -> None:
    stage = Stage(tmp_path, Flatland(empty_room(), START))
    stage.robot.silent |= {"clock", "pose"}
    stage.lockstep.kill("planner")
    stage.lockstep.run(2.0)
    stage.lockstep.add(PlannerService(stage.config))
    with pytest.raises(Refused) as refusal:
        stage.send(Pose2D(2.0, 3.0, 0.0))
    assert refusal.value.code == codes.NOT_READY
    assert "clock" in refusal.value.details["missing"]
    stage.lockstep.close()


def test_the_same_seed_gives_the_same_bytes(tmp_path, far_side: Pose2D) -> None:
    def drive(folder) -> list[object]:
        folder.mkdir()
        stage = Stage(folder, Flatland(empty_room(), START))
        stage.send(far_side, via=[Pose2D(3.0, 4.5, 0.0)])
        stage.lockstep.run(8.0)
        stage.lockstep.close()
        return [stage.commands, stage.goals]

    assert drive(tmp_path / "a") == drive(tmp_path / "b")


def looking_round(tmp_path, world: Flatland) -> Stage:
    """A robot that is lost and may turn."""
    stage = Stage(tmp_path, world, turn_to_find=True)
    robot = stage.robot
    robot.say(mode="ok")
    robot.pose_state = "lost"
    plain = robot.world.estimate
    robot.world.estimate = lambda stamp, *said: msgspec.structs.replace(  # type: ignore[method-assign]
        plain(stamp, *said), wants_turn=True
    )
    return stage


def turned_within(stage: Stage, seconds: float) -> float:
    """How far the robot turns in the next seconds [rad]."""
    turned, last = 0.0, stage.world.pose.yaw
    for _ in range(round(seconds / 0.05)):
        stage.lockstep.run(0.05)
        turned += math.remainder(stage.world.pose.yaw - last, 2.0 * math.pi)
        last = stage.world.pose.yaw
    return turned


def test_a_robot_that_may_look_round_turns_once_in_place(tmp_path) -> None:
    stage = looking_round(tmp_path, Flatland(empty_room(), START))
    assert turned_within(stage, 20.0) == pytest.approx(2.0 * math.pi, abs=0.4)
    assert stage.world.pose.distance_to(START) < 0.01
    stage.lockstep.close()


def test_a_lidar_that_looks_ahead_only_may_look_round_too(tmp_path) -> None:
    world = Flatland(empty_room(), START)
    stage = looking_round(tmp_path, world)
    plain = world.scan
    world.scan = lambda stamp_ns: half_of(plain(stamp_ns))  # type: ignore[method-assign]
    assert turned_within(stage, 20.0) == pytest.approx(2.0 * math.pi, abs=0.4)
    stage.lockstep.close()


def half_of(scan: Scan) -> Scan:
    """What a lidar that looks 90 degrees to both sides measures of a whole revolution."""
    ranges = floats_from_bytes(scan.ranges)
    quarter = len(ranges) // 4
    return msgspec.structs.replace(
        scan,
        angle_min=-quarter * scan.angle_increment,
        ranges=floats_to_bytes(np.roll(ranges, quarter)[: 2 * quarter]),
    )


def test_a_robot_that_is_searched_for_is_not_told_that_the_localizer_is_silent(tmp_path) -> None:
    stage = Stage(tmp_path, Flatland(empty_room(), START))
    stage.robot.silent.add("correction")
    stage.robot.pose_state = "searching"
    stage.robot.restart()
    stage.lockstep.run(1.0)
    with pytest.raises(Refused) as refused:
        stage.send(Pose2D(3.0, 3.0, 0.0))
    assert refused.value.message == codes.SENTENCES[codes.NOT_LOCALIZED]
    stage.lockstep.close()


def test_somebody_who_steps_near_only_interrupts_the_look_round(tmp_path) -> None:
    room = empty_room()
    stage = looking_round(tmp_path, Flatland(room, START))
    first = turned_within(stage, 4.0)
    assert 0.5 < first < 5.0
    stage.world.set_truth(with_block(room, START.x + 0.15, START.y - 0.05, 0.1, 0.1))
    turned_within(stage, 0.5)
    assert turned_within(stage, 3.0) == pytest.approx(0.0, abs=0.01)
    stage.world.set_truth(room)
    assert first + turned_within(stage, 16.0) == pytest.approx(2.0 * math.pi, abs=0.6)
    stage.lockstep.close()


def test_a_goal_that_is_canceled_ends_the_look_round_too(tmp_path, far_side: Pose2D) -> None:
    stage = Stage(tmp_path, Flatland(empty_room(), START), turn_to_find=True)
    robot = stage.robot
    robot.say(mode="ok")
    stage.send(far_side)
    stage.lockstep.run(1.0)
    plain = robot.world.estimate
    robot.world.estimate = lambda stamp, *said: msgspec.structs.replace(  # type: ignore[method-assign]
        plain(stamp, *said), wants_turn=True
    )
    robot.pose_state = "lost"
    assert turned_within(stage, 4.0) > 1.0
    stage.lockstep.ask(requests.GOAL_CANCEL, WhichGoal())
    assert stage.stands()
    assert turned_within(stage, 2.0) == 0.0
    stage.lockstep.close()


class SlowBase:
    """A stage whose planner still knows of a stop that is over, and whose base answers late."""

    def __init__(self, stage: Stage) -> None:
        self._stage = stage
        self._queries: list[Query] = []
        stage.robot.say(mode="ok")
        stage.lockstep.run(0.0)
        stopped = BaseState(stamp_ns=stage.robot.robot_ns, mode="stopped", reason="button")
        stage.lockstep.publish(topics.BASE, stopped)
        stage.lockstep.run(0.0)
        stage.lockstep.bus.serve(topics.BASE.key("trolley"), self._queries.append)

    def ask(self, request: Request, **params: Any) -> list[str]:
        """Ask the planner; the goal's state, or why not, is in the list once it has answered."""
        answers: list[str] = []

        def hear(answer: GoalStatus | Refused) -> None:
            answers.append(answer.code if isinstance(answer, Refused) else answer.state)

        self._stage.robot.request(request, request.params(**params), hear)
        self._stage.lockstep.run(0.0)
        return answers

    def answer(self) -> None:
        """Let base answer what it was asked."""
        for query in self._queries:
            query.finish()
        self._stage.lockstep.run(1.0)


def test_a_goal_that_is_canceled_while_base_is_asked_does_not_set_off(
    stage: Stage, far_side: Pose2D
) -> None:
    base = SlowBase(stage)
    sent = base.ask(requests.GOAL_SEND, pose=far_side, id="a")
    canceled = base.ask(requests.GOAL_CANCEL, id="a")
    assert not sent
    base.answer()
    assert (sent, canceled) == (["driving"], ["canceled"])
    assert stage.goals[-1].state == "canceled"
    assert stage.world.twist.is_zero


def test_a_goal_that_is_paused_while_base_is_asked_whether_to_resume_it_stays_paused(
    stage: Stage, far_side: Pose2D
) -> None:
    stage.send(far_side)
    stage.lockstep.ask(requests.GOAL_PAUSE, WhichGoal())
    base = SlowBase(stage)
    base.ask(requests.GOAL_RESUME)
    base.ask(requests.GOAL_PAUSE)
    base.answer()
    assert stage.goals[-1].state == "paused"
    assert stage.world.twist.is_zero


def test_the_last_of_two_goals_is_driven_to_although_base_was_asked_for_the_first(
    stage: Stage, far_side: Pose2D
) -> None:
    base = SlowBase(stage)
    base.ask(requests.GOAL_SEND, pose=far_side, id="a")
    stage.robot.say(mode="ok")
    stage.lockstep.run(0.0)
    base.ask(requests.GOAL_SEND, pose=Pose2D(2.0, 3.0, 0.0), id="b")
    base.answer()
    assert stage.goals[-1].id == "b"
