"""Whole sessions with a strict linorobot board, in simulated time."""

import math
import random
import struct
from itertools import pairwise
from typing import Any

import pytest
from support.fake_boards import MS, FakeLinorobot, Talk, frame, slow_frames, topic_info

from trolley.config.hardware import ChassisConfig, PidConfig
from trolley.geometry import Twist2D
from trolley.messages.motion import Drive
from trolley_base.drivers.boards import make_board
from trolley_base.drivers.dialogue import BoardDialogue

TURNING = Twist2D(0.3, 0.0, 0.4)


def make(drive: Drive = "differential", **settings: Any) -> BoardDialogue:
    return make_board(ChassisConfig(board="linorobot", port="/dev/x", **settings), drive)


@pytest.fixture
def board() -> FakeLinorobot:
    return FakeLinorobot()


@pytest.fixture
def talk(board: FakeLinorobot) -> Talk:
    return Talk(make(), board)


def test_it_comes_up_and_drives_as_it_was_told(talk: Talk, board: FakeLinorobot) -> None:
    assert talk.tick().link.state == "searching"
    assert talk.run(0.6).link.state == "up"
    talk.wanted = TURNING
    talk.run(10.0)
    talk.wanted = Twist2D.zero()
    talk.run(0.5)
    assert board.watchdog_trips == 0
    assert board.pose.distance_to(talk.pose) < 0.01
    assert abs(board.pose.yaw - talk.pose.yaw) < 0.02


def test_motions_join_without_gaps(talk: Talk) -> None:
    talk.run(3.0)
    motions = [motion for reading in talk.readings for motion in reading.motions]
    stamps = [motion.stamp_ns for motion in motions]
    assert len(stamps) > 45
    assert stamps == sorted(set(stamps))
    assert all(b - a < 100 * MS for a, b in pairwise(stamps))
    assert all(stamp <= talk.now_ns for stamp in stamps)


def test_commands_come_at_an_even_pace_zeros_too(talk: Talk, board: FakeLinorobot) -> None:
    talk.run(1.0)
    board.commands.clear()
    talk.run(4.0)
    assert 80 <= len(board.commands) <= 101
    assert all(twist.is_zero for _, twist in board.commands)


def test_a_zero_is_in_the_very_next_bytes(talk: Talk, board: FakeLinorobot) -> None:
    talk.run(1.0)
    for ticks in range(5, 12):
        talk.wanted = TURNING
        for _ in range(ticks):
            talk.tick()
        talk.wanted = Twist2D.zero()
        talk.tick()
        assert board.commands[-1] == (talk.now_ns - talk.start_ns, Twist2D.zero())


def test_nothing_drives_before_the_board_reports(talk: Talk, board: FakeLinorobot) -> None:
    talk.wanted = TURNING
    while talk.tick().link.state != "up":
        assert all(twist.is_zero for _, twist in board.commands)
    talk.tick()
    talk.dialogue.begin(talk.now_ns)
    assert slow_frames(talk.dialogue.outgoing(talk.now_ns)) == [(0, b"")]


def test_ids_are_those_that_the_board_announces(talk: Talk, board: FakeLinorobot) -> None:
    board.publishes = {130: ("raw_imu", "lino_msgs/Imu"), 140: ("raw_vel", "lino_msgs/Velocities")}
    board.subscribes = {111: ("cmd_vel", "geometry_msgs/Twist")}
    assert talk.run(1.0).link.state == "up"
    talk.wanted = TURNING
    talk.run(2.0)
    assert board.pose.x > 0.3


@pytest.mark.parametrize("name", ["raw_vel", "raw_imu", "cmd_vel", "pid"])
def test_another_layout_is_never_commanded(board: FakeLinorobot, name: str) -> None:
    board.wrong_md5[name] = "f" * 32
    talk = Talk(make(pid=PidConfig(p=1.0, i=0.0, d=0.0)), board)
    talk.wanted = TURNING
    link = talk.run(12.0).link
    assert link.state == "down"
    assert name in link.message
    assert "f" * 32 in link.message
    assert board.commands == []
    assert board.gains == []
    assert [round(at / 1e9) for at in board.requests] == [0, 5, 10]
    assert talk.dialogue.goodbye() == ()
    board.wrong_md5.clear()
    assert talk.run(6.0).link.state == "up"


@pytest.mark.parametrize("name", ["raw_vel", "cmd_vel"])
def test_a_board_without_what_driving_needs_is_named(board: FakeLinorobot, name: str) -> None:
    for topics in (board.publishes, board.subscribes):
        for topic_id, (known, _) in list(topics.items()):
            if known == name:
                del topics[topic_id]
    talk = Talk(make(), board)
    link = talk.run(2.0).link
    assert link.state == "down"
    assert name in link.message
    assert board.commands == []


def stall(talk: Talk, board: FakeLinorobot, seconds: float) -> None:
    """Base stands still; what the board says meanwhile is discarded."""
    talk.now_ns += round(seconds * 1e9)
    board.step(talk.now_ns - talk.start_ns)


@pytest.mark.parametrize("kept_from", [60, 150, 260])
def test_a_round_is_not_judged_where_base_stood_still(
    talk: Talk, board: FakeLinorobot, kept_from: int
) -> None:
    talk.run(1.0)
    board.reboot()
    stall(talk, board, 6.0)
    ends = [0]
    for topic_id, payload in slow_frames(announced()):
        ends.append(ends[-1] + len(frame(topic_id, payload)))
    cut = min(ends, key=lambda end: abs(end - kept_from))
    woke_ns = talk.now_ns

    def discard(data: bytes) -> bytes:
        """For a moment after the stall whole frames are still discarded."""
        return data[cut:] if talk.now_ns - woke_ns <= 100 * MS else data

    talk.spoil = discard
    talk.readings.clear()
    assert talk.run(3.0).link.state == "up"
    assert not any("firmware" in reading.link.message for reading in talk.readings)


def test_half_a_round_before_a_stall_is_not_judged(board: FakeLinorobot) -> None:
    talk = Talk(make(), board)
    talk.spoil = lambda data: (
        data[: len(frame(10, bytes(8)))]
        + frame(0, topic_info(125, "raw_vel", "lino_msgs/Velocities"))
        if data
        else data
    )
    talk.run(0.04)
    stall(talk, board, 3.0)
    talk.spoil = lambda data: data
    assert talk.run(3.0).link.state == "up"
    assert not any("firmware" in reading.link.message for reading in talk.readings)


def test_a_damaged_announcement_is_asked_for_again(board: FakeLinorobot) -> None:
    talk = Talk(make(), board)
    whole = announced()
    at = whole.index(b"cmd_vel")
    talk.spoil = lambda data: data[:at] + b"?" + data[at + 1 :] if len(data) > at else data
    talk.run(0.5)
    talk.spoil = lambda data: data
    assert talk.run(2.0).link.state == "up"
    assert not any("firmware" in reading.link.message for reading in talk.readings)


def test_a_round_of_which_a_part_comes_late_is_not_judged(board: FakeLinorobot) -> None:
    """As through a computer that is too busy to fetch it."""
    talk = Talk(make(), board)
    whole, said, passed = announced(), bytearray(), 0
    cut = whole.index(b"cmd_vel") - 20

    def falter(data: bytes) -> bytes:
        nonlocal passed
        said.extend(data)
        before = passed
        passed = len(said) if talk.now_ns - talk.start_ns > 600 * MS else min(len(said), cut)
        return bytes(said[before:passed])

    talk.spoil = falter
    assert talk.run(2.0).link.state == "up"
    assert not any("firmware" in reading.link.message for reading in talk.readings)


def announced() -> bytes:
    """What such a board says when it is asked for its topics."""
    twin = FakeLinorobot()
    twin.receive(frame(0), 0)
    return twin.step(MS)


def test_a_board_without_imu_and_pid_drives(board: FakeLinorobot) -> None:
    del board.publishes[126], board.subscribes[100]
    talk = Talk(make(pid=PidConfig(p=1.0, i=0.0, d=0.0)), board)
    assert talk.run(2.0).link.state == "up"
    texts = [note.text for reading in talk.readings for note in reading.notes]
    assert len(texts) == 2
    assert any("raw_imu" in text for text in texts)
    assert any("PID" in text for text in texts)


def test_gains_are_sent_after_each_negotiation_in_the_order_of_the_wire(
    board: FakeLinorobot,
) -> None:
    talk = Talk(make(pid=PidConfig(p=0.5, i=0.25, d=2.0)), board)
    talk.run(1.0)
    assert board.gains == [(0.5, 2.0, 0.25)]
    board.reboot()
    talk.run(3.0)
    assert board.gains == [(0.5, 2.0, 0.25)] * 2


def test_a_reboot_is_noticed_and_mended(talk: Talk, board: FakeLinorobot) -> None:
    talk.run(1.0)
    talk.wanted = TURNING
    talk.run(2.0)
    pose = board.pose
    board.reboot()
    talk.wanted = Twist2D.zero()
    talk.readings.clear()
    assert talk.run(2.5).link.state == "up"
    assert "down" in {reading.link.state for reading in talk.readings}
    assert board.pose.distance_to(pose) < 1e-9
    assert talk.pose.distance_to(pose) < 0.05


def test_silence_is_told_then_reopened(talk: Talk, board: FakeLinorobot) -> None:
    talk.run(1.0)
    talk.spoil = lambda data: b""
    talk.run(0.7)
    status = talk.dialogue.status(talk.now_ns)
    assert (status.state, status.reopen) == ("down", False)
    assert "stopped reporting" in status.message
    talk.run(5.0)
    assert talk.dialogue.status(talk.now_ns).reopen
    talk.spoil = lambda data: data
    assert talk.run(1.5).link.state == "up"


def test_a_board_that_is_not_heard_is_stopped_all_the_same(
    talk: Talk, board: FakeLinorobot
) -> None:
    talk.run(1.0)
    talk.wanted = TURNING
    talk.run(1.0)
    talk.spoil = lambda data: b""
    while talk.tick().link.state == "up":
        assert not board.twist.is_zero
    assert board.commands[-1] == (talk.now_ns - talk.start_ns, Twist2D.zero())
    talk.run(1.0)
    assert board.watchdog_trips == 0
    assert talk.now_ns - talk.start_ns - board.commands[-1][0] <= 60 * MS


def test_noise_between_frames_costs_nothing(talk: Talk, board: FakeLinorobot) -> None:
    dice = random.Random(3)
    talk.run(1.0)
    talk.spoil = lambda data: dice.randbytes(dice.randrange(30)) + data if data else data
    talk.wanted = TURNING
    talk.run(10.0)
    talk.wanted = Twist2D.zero()
    talk.run(0.5)
    assert {reading.link.state for reading in talk.readings[50:]} == {"up"}
    assert board.pose.distance_to(talk.pose) < 0.05
    assert talk.total("skipped_bytes") > 1000


def test_bursts_do_not_bend_the_way(board: FakeLinorobot) -> None:
    """Frames that are held up and come together, while speed and turn rate change."""
    talk = Talk(make(), board)
    talk.run(1.0)
    dice = random.Random(5)
    held = b""

    def hold(data: bytes) -> bytes:
        nonlocal held
        held += data
        if dice.random() < 0.75:
            return b""
        sent, held = held, b""
        return sent

    talk.spoil = hold
    for step in range(600):
        talk.wanted = Twist2D(0.3 + 0.2 * math.sin(step / 20), 0.0, 0.8 * math.sin(step / 13))
        talk.tick()
    talk.wanted = Twist2D.zero()
    talk.spoil = lambda data: held + data
    talk.tick()
    talk.spoil = lambda data: data
    talk.run(0.5)
    # Of 3.6 m; stamped at arrival it is 0.3 m.
    assert board.pose.distance_to(talk.pose) < 0.06
    assert abs(board.pose.yaw - talk.pose.yaw) < 0.03


def test_every_time_request_is_answered(talk: Talk, board: FakeLinorobot) -> None:
    talk.run(11.0)
    assert len(board.times) == 1 + 4
    assert board.times[0][0] == talk.start_ns // 10**9


def test_a_board_that_asks_no_more_for_the_time_is_asked_again(
    talk: Talk, board: FakeLinorobot
) -> None:
    talk.run(1.0)
    request = frame(10, bytes(8))
    talk.spoil = lambda data: data.replace(request, b"")
    talk.run(16.0)
    assert len(board.requests) == 2 or len(board.requests) == 3
    assert talk.readings[-1].link.state == "up"


def test_an_unknown_id_makes_it_ask_again(talk: Talk, board: FakeLinorobot) -> None:
    talk.run(2.0)
    asked = len(board.requests)
    board.publishes[140] = ("more", "lino_msgs/Imu")
    talk.dialogue.receive(frame(140, b"abc"), talk.now_ns)
    talk.run(1.0)
    assert len(board.requests) == asked + 1
    talk.dialogue.receive(frame(140, b"abc"), talk.now_ns)
    talk.run(2.0)
    assert len(board.requests) == asked + 1
    assert talk.total("unknown_topics") == 1


def test_log_lines_are_few(talk: Talk, board: FakeLinorobot) -> None:
    board.logs = [
        (4, "IMU failed to initialize. Check your IMU connection."),
        (1, "Encoder FrontLeft  : {}"),
        (4, "Driver too hot"),
    ]
    talk.run(1.0)
    talk.readings.clear()
    for _ in range(50):  # nothing is taken meanwhile
        talk.now_ns += 20 * MS
        talk.dialogue.receive(board.step(talk.now_ns - talk.start_ns), talk.now_ns)
    notes = talk.tick().notes
    assert [note.level for note in notes] == ["warning", "info", "error"]
    assert len({note.kind for note in notes}) == 3


def test_velocities_that_no_robot_drives_are_dropped(talk: Talk) -> None:
    talk.run(1.0)
    for bad in (math.nan, math.inf, 11.0):
        talk.dialogue.receive(frame(125, struct.pack("<3f", bad, 0.0, 0.0)), talk.now_ns)
    talk.dialogue.receive(frame(126, struct.pack("<9d", *[math.nan] * 9)), talk.now_ns)
    talk.run(1.0)
    assert talk.total("bad_messages") == 4
    assert talk.pose.distance_to(talk.pose.identity()) == 0.0


def test_a_board_that_reports_only_such_speeds_is_told_of_as_that(talk: Talk) -> None:
    talk.run(1.0)
    bad = frame(125, struct.pack("<3f", math.nan, 0.0, 0.0))
    for _ in range(40):
        talk.now_ns += 20 * MS
        talk.dialogue.receive(bad, talk.now_ns)
    status = talk.dialogue.status(talk.now_ns)
    assert status.state == "down"
    assert "speeds that no robot can have" in status.message


def test_a_command_that_holds_for_one_period_reaches_the_board(
    talk: Talk, board: FakeLinorobot
) -> None:
    talk.run(1.0)
    for pause in range(8):
        board.commands.clear()
        talk.wanted = TURNING
        talk.tick()
        talk.wanted = Twist2D.zero()
        for _ in range(6 + pause):
            talk.tick()
        told = [twist for _, twist in board.commands]
        assert TURNING in told
        assert told[-1].is_zero


def test_inertial_readings_are_turned_into_the_robot(board: FakeLinorobot) -> None:
    talk = Talk(make(imu_axes=("y", "-x", "z")), board)
    talk.run(1.0)
    imu = [imu for reading in talk.readings for imu in reading.imu][-1]
    assert imu.linear_acceleration == (0.2, -0.1, 9.8)
    assert imu.angular_velocity == (0.02, -0.01, 0.3)


def test_sideways_is_for_mecanum_alone(board: FakeLinorobot) -> None:
    talk = Talk(make("mecanum"), board)
    talk.run(1.0)
    talk.wanted = Twist2D(0.1, 0.2, 0.0)
    talk.run(2.0)
    assert talk.pose.y == pytest.approx(board.pose.y, abs=0.03)
    assert talk.pose.y > 0.3
    plain = FakeLinorobot()
    talk = Talk(make(), plain)
    talk.run(1.0)
    talk.wanted = Twist2D(0.1, 0.2, 0.0)
    talk.run(1.0)
    assert plain.twist == Twist2D(0.1, 0.0, 0.0)


def test_goodbye_is_a_zero_and_then_the_stop(talk: Talk, board: FakeLinorobot) -> None:
    talk.run(1.0)
    talk.wanted = TURNING
    talk.run(0.5)
    zero, stop = talk.dialogue.goodbye()
    board.receive(zero, 0)
    assert board.twist.is_zero
    board.receive(stop, 0)
    assert board.stops == 1
    assert not board.is_configured


def test_another_device_is_told_from_silence() -> None:
    dialogue = make()
    dialogue.begin(0)
    assert dialogue.status(MS).state == "searching"
    dialogue.receive(b"hello\r\n" * 20, 100 * MS)
    assert "not rosserial" in dialogue.status(200 * MS).message
    assert dialogue.status(6000 * MS).reopen


def test_an_announcement_of_a_reserved_topic_is_refused(talk: Talk) -> None:
    talk.dialogue.receive(frame(1, topic_info(7, "cmd_vel", "geometry_msgs/Twist")), talk.now_ns)
    talk.tick()
    assert talk.total("bad_messages") == 1
