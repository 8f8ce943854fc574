"""The linorobot board: its session, its watchdog, what it measures and how it says it."""

import math
import struct
from collections.abc import Callable

import numpy as np
import pytest

from trolley.geometry import Twist2D
from trolley_base.emulators.linorobot import Linorobot, LinorobotOptions
from trolley_base.world import Simulation

from .boards import MS, Bench, messages

TOPICS_PLEASE = bytes.fromhex("fffe0000ff0000ff")
TIME_ANSWER = bytes.fromhex("fffe0800f70a0000f153650000000" + "04c")
STOP = bytes.fromhex("fffe0000ff0b00f4")
VELOCITIES, IMU, LOG, TIME = 125, 126, 7, 10
MakeSimulation = Callable[..., Simulation]


def frame(topic: int, payload: bytes) -> bytes:
    size = struct.pack("<H", len(payload))
    body = struct.pack("<H", topic) + payload
    return (
        b"\xff\xfe" + size + bytes([255 - sum(size) % 256]) + body + bytes([255 - sum(body) % 256])
    )


def twist(vx: float, wz: float) -> bytes:
    return frame(101, struct.pack("<6d", vx, 0, 0, 0, 0, wz))


def bench(simulate: MakeSimulation, **options: bool) -> Bench:
    return Bench(Linorobot(LinorobotOptions(**options), np.random.default_rng(3)), simulate())


def of(sent: list[tuple[int, bytes]], topic: int) -> list[bytes]:
    return [one for _, data in sent for have, one in messages(data) if have == topic]


def drive(board: Bench, vx: float, wz: float, seconds: float) -> list[tuple[int, bytes]]:
    sent: list[tuple[int, bytes]] = []
    for _ in range(round(seconds * 10)):
        board.write(twist(vx, wz))
        sent += board.wait(0.1)
    return sent


def test_it_says_nothing_before_it_is_asked_for_its_topics(simulate: MakeSimulation):
    assert bench(simulate).wait(2.0) == []


def test_it_announces_what_it_publishes_and_what_it_takes(simulate: MakeSimulation):
    answer = list(messages(bench(simulate).write(TOPICS_PLEASE)))
    assert answer[0] == (TIME, bytes(8))
    told: list[tuple[int, int, list[bytes]]] = []
    for channel, info in answer[1:5]:
        (topic,) = struct.unpack("<H", info[:2])
        rest, texts = info[2:], []
        for _ in range(3):
            (length,) = struct.unpack("<I", rest[:4])
            texts.append(rest[4 : 4 + length])
            rest = rest[4 + length :]
        assert rest == struct.pack("<i", 512)
        told.append((channel, topic, texts))
    assert told == [
        (0, 125, [b"raw_vel", b"lino_msgs/Velocities", b"0ee8ad4cb7809be2d5a0a76352fea86a"]),
        (0, 126, [b"raw_imu", b"lino_msgs/Imu", b"275110405f08e1b7c0c0f1aba3e19c67"]),
        (1, 100, [b"pid", b"lino_msgs/PID", b"a559df187bdf63f426d5f304b6b28bb4"]),
        (1, 101, [b"cmd_vel", b"geometry_msgs/Twist", b"9f195f881246fdfa2798d1d3eebca84a"]),
    ]
    assert answer[5] == (LOG, b"\x01" + struct.pack("<I", 18) + b"LINOBASE CONNECTED")


def test_it_reports_20_times_a_second_and_logs_as_shipped(simulate: MakeSimulation):
    board = bench(simulate)
    board.write(TOPICS_PLEASE)
    sent = board.wait(2.0)
    assert len(of(sent, VELOCITIES)) == len(of(sent, IMU)) == 40
    assert len(of(sent, LOG)) == 2 * 5 * 4
    assert {len(one) for one in of(sent, VELOCITIES)} == {12}
    assert {len(one) for one in of(sent, IMU)} == {72}
    assert len(of(bench(simulate, debug=False).wait(1.0), LOG)) == 0


def test_it_asks_for_the_time_and_gives_up_after_11_s(simulate: MakeSimulation):
    board = bench(simulate)
    board.write(TOPICS_PLEASE)
    sent = board.wait(10.9)
    times = [due_ns for due_ns, data in sent for topic, _ in messages(data) if topic == TIME]
    assert [round(t / 1e9, 1) for t in times] == [2.5, 5.0, 7.5, 10.0]
    board.wait(0.2)
    sent = board.wait(2.0)
    assert of(sent, VELOCITIES) == of(sent, TIME) == []
    assert len(of(sent, LOG)) == 40  # its log needs no session
    board.write(TOPICS_PLEASE)
    for _ in range(5):
        board.wait(4.0)
        board.write(TIME_ANSWER)
    assert of(board.wait(1.0), VELOCITIES)
    board.write(STOP)
    assert of(board.wait(1.0), VELOCITIES) == []


def test_a_frame_that_comes_in_drips_is_not_taken(simulate: MakeSimulation):
    board, sent = bench(simulate), twist(0.3, 0.0)

    def drip(pause_s: float) -> None:
        for at in range(0, len(sent), 14):
            board.write(sent[at : at + 14])
            board.wait(pause_s)

    drip(0.03)
    assert not board.board.commands
    drip(0.0)
    assert [one.twist for one in board.board.commands] == [Twist2D(0.3, 0.0, 0.0)]


def test_it_drives_as_commanded_and_stands_400_ms_after_the_last_command(
    simulate: MakeSimulation,
):
    board = bench(simulate)
    board.write(TOPICS_PLEASE)
    drive(board, 0.3, 0.0, 2.0)
    assert board.simulation.truth().twist.vx == pytest.approx(0.3)
    began_ns = board.now_ns - 100 * MS  # of the last command
    while board.board.wheels() != Twist2D.zero():
        board.wait(0.01)
    assert 400 * MS <= board.now_ns - began_ns <= 460 * MS
    board.wait(0.5)
    assert board.simulation.truth().twist.vx == 0.0
    commands = board.board.commands
    assert len(commands) == 20
    assert commands[0].twist == Twist2D(0.3, 0.0, 0.0)
    assert commands[1].at_ns - commands[0].at_ns == 100 * MS


def test_wheel_speeds_are_whole_revolutions_per_minute(simulate: MakeSimulation):
    per_rpm = math.pi * 0.1 / 60
    means = {}
    for truncates in (True, False):
        board = bench(simulate, truncates=truncates)
        board.write(TOPICS_PLEASE)
        told = [struct.unpack("<3f", one) for one in of(drive(board, 0.2, 0.4, 3.0), VELOCITIES)]
        means[truncates] = np.mean(told[20:], axis=0)
        wheels = [(vx - 0.1175 * wz, vx + 0.1175 * wz) for vx, _, wz in told]
        whole = np.abs(np.array(wheels) / per_rpm - np.rint(np.array(wheels) / per_rpm)) < 1e-3
        assert np.all(whole) == truncates
    assert means[False] == pytest.approx([0.2, 0.0, 0.4], abs=1e-4)
    lost = means[False] - means[True]
    assert 0.0 < lost[0] <= per_rpm
    board = bench(simulate)
    board.write(TOPICS_PLEASE)
    crawling = of(drive(board, 0.004, 0.0, 1.0), VELOCITIES)
    assert {struct.unpack("<3f", one) for one in crawling} == {(0.0, 0.0, 0.0)}


def test_the_gyro_feels_the_true_turn_with_a_bias(simulate: MakeSimulation):
    board = bench(simulate)
    board.write(TOPICS_PLEASE)
    still = np.array([struct.unpack("<9d", one) for one in of(board.wait(3.0), IMU)])
    bias = still[:, 5].mean()
    assert 0.0 < abs(bias) < 0.05
    assert 0.0005 < still[:, 5].std() < 0.01
    assert still[:, 2].mean() == pytest.approx(9.81, abs=0.05)
    drive(board, 0.0, 1.0, 1.0)
    turning = np.array([struct.unpack("<9d", one) for one in of(drive(board, 0, 1, 2), IMU)])
    assert turning[:, 5].mean() - bias == pytest.approx(1.0, abs=0.01)


def test_without_imu_it_complains_20_times_a_second(simulate: MakeSimulation):
    board = bench(simulate, has_imu=False, debug=False)
    board.write(TOPICS_PLEASE)
    sent = board.wait(1.0)
    assert of(sent, IMU) == []
    logs = of(sent, LOG)
    assert len(logs) == 20
    assert all(one[0] == 4 and b"IMU failed to initialize" in one for one in logs)


def test_another_firmware_says_another_md5_after_a_restart(simulate: MakeSimulation):
    board = bench(simulate)
    assert isinstance(board.board, Linorobot)
    board.write(TOPICS_PLEASE)
    board.board.has_wrong_md5 = True
    board.board.restart(board.now_ns)
    assert board.wait(1.0) == []
    answer = board.write(TOPICS_PLEASE)
    assert b"0ee8ad4c" not in answer
    assert b"275110405f08e1b7" in answer


def test_what_would_crash_a_real_board_is_told(simulate: MakeSimulation):
    board = bench(simulate)
    board.write(TOPICS_PLEASE)
    board.board.take_remarks()
    board.write(frame(102, bytes(4)))
    board.write(frame(101, bytes(47)))
    board.write(frame(101, bytes(513)))
    remarks = board.board.take_remarks()
    assert len(remarks) == 3
    assert "topic 102" in remarks[0]
    assert "47 bytes" in remarks[1]
    assert "512" in remarks[2]
    assert board.board.commands == type(board.board.commands)(maxlen=20_000)


def test_stuck_it_repeats_itself_while_it_drives(simulate: MakeSimulation):
    board = bench(simulate)
    board.write(TOPICS_PLEASE)
    board.wait(0.2)
    board.board.is_stuck = True
    assert len(set(of(drive(board, 0.2, 0.0, 1.0), VELOCITIES))) == 1
    assert board.simulation.truth().twist.vx == pytest.approx(0.2)
    board.board.is_stuck = False
    assert len(set(of(board.wait(0.6), VELOCITIES))) > 1
