"""What Waveshare's boards are told, and which of them are not driven."""

import json
from collections.abc import Callable
from typing import Any

import pytest
from support.emulated_boards import MS, EmulatedTalk, dialogue_of

from trolley import codes
from trolley.geometry import Twist2D
from trolley_base.drivers import DriverError
from trolley_base.drivers.boards import BOARDS, make_board
from trolley_base.drivers.boards.wheel_ticks import MOST_SPEED
from trolley_base.emulators.waveshare_ugv import WaveshareUgv
from trolley_base.world import Simulation

MakeSimulation = Callable[..., Simulation]
AHEAD = Twist2D(0.15, 0.0, 0.0)
REPORT = '{"T":1001,"L":%s,"R":%s,"r":-0.4,"p":0.9,"y":"null","v":11.8}\r\n'
CONFIRMED = b'{"T":136,"cmd":400}\n{"T":900,"main":2,"module":0}\n'


def talk_of(
    simulate: MakeSimulation, robot: Any = "ugv_rover", told: str = "ugv_rover", **built: Any
) -> EmulatedTalk:
    board = WaveshareUgv(robot, **{"is_general": False, **built})
    dialogue = dialogue_of("waveshare_ugv", settings={"type": told})
    return EmulatedTalk(dialogue, board, simulate())


def lines(talk: EmulatedTalk) -> list[str]:
    return [line for _, data in talk.sent for line in data.decode().splitlines()]


def test_each_connection_sets_the_board_up(simulate: MakeSimulation) -> None:
    talk = talk_of(simulate)
    talk.come_up()
    first = lines(talk)
    for line in (
        '{"T":136,"cmd":400}',
        '{"T":900,"main":2,"module":0}',
        '{"T":142,"cmd":40}',
        '{"T":131,"cmd":1}',
    ):
        assert line in first
    talk.sent.clear()
    talk.dialogue.begin(talk.now_ns)
    talk.tick()
    assert '{"T":136,"cmd":400}' in lines(talk)
    assert talk.dialogue.status(talk.now_ns).state != "up"


def test_every_line_ends_and_is_json(simulate: MakeSimulation) -> None:
    talk = talk_of(simulate)
    talk.come_up()
    talk.wanted = Twist2D(0.3, 0.0, 1.0)
    talk.run(2.0)
    for _, data in talk.sent:
        assert data.endswith(b"\n")
        for line in filter(None, data.split(b"\n")):
            assert isinstance(json.loads(line)["T"], int)
    drives = [json.loads(line) for line in lines(talk) if '"T":1,' in line]
    assert {type(one[side]) for one in drives for side in "LR"} == {float}
    assert drives[-1] == {"T": 1, "L": pytest.approx(0.214), "R": pytest.approx(0.386)}


def test_what_the_board_would_ignore_is_driven_slower_on_the_same_arc(
    simulate: MakeSimulation,
) -> None:
    talk = talk_of(simulate)
    talk.come_up()
    talk.wanted = Twist2D(3.0, 0.0, 10.0)
    talk.run(0.1)
    told = json.loads([line for line in lines(talk) if '"T":1,' in line][-1])
    assert told["R"] == 2.0
    assert told["L"] / told["R"] == pytest.approx((3.0 - 0.86) / (3.0 + 0.86), abs=1e-3)


def test_it_stops_by_itself_once_nobody_speaks(simulate: MakeSimulation) -> None:
    talk = talk_of(simulate)
    talk.come_up()
    talk.wanted = AHEAD
    talk.run(1.0)
    assert talk.simulation.truth().twist.vx > 0.1
    for _ in range(45):
        talk.step()
    assert talk.board.wheels().is_zero
    assert BOARDS["waveshare_ugv"].facts.watchdog_s == 0.4


@pytest.mark.parametrize("missing", ['"T":136', '"T":900'])
def test_a_board_that_confirms_only_half_is_not_driven(
    simulate: MakeSimulation, missing: str
) -> None:
    talk = talk_of(simulate)
    talk.spoil = lambda data: b"".join(
        line for line in data.splitlines(keepends=True) if missing.encode() not in line
    )
    talk.wanted = AHEAD
    reading = talk.run(6.0)
    assert reading.link.state == "down"
    assert "does not confirm" in reading.link.message
    assert all(one.twist.is_zero for one in talk.board.commands)


def test_a_reboot_is_known_by_its_first_lines(simulate: MakeSimulation) -> None:
    talk = talk_of(simulate)
    talk.come_up()
    talk.wanted = AHEAD
    talk.run(0.5)
    talk.dialogue.receive(b"\r\nrst:0x1 (POWERON_RESET),boot:0x13\r\n", talk.now_ns)
    talk.dialogue.receive((REPORT % (0.15, 0.15)).encode(), talk.now_ns)
    assert talk.dialogue.status(talk.now_ns).state != "up"
    talk.tick()
    assert talk.told is not None
    assert talk.told.is_zero


def test_a_robot_without_encoders_is_stopped_at_its_first_move(simulate: MakeSimulation) -> None:
    talk = talk_of(simulate, is_general=True)
    talk.come_up()
    talk.wanted = Twist2D(0.05, 0.0, 0.0)
    reading = talk.run(0.5)
    assert reading.link.state == "down"
    assert "no encoders" in reading.link.message
    assert talk.told is not None
    assert talk.told.is_zero
    assert talk.simulation.truth().pose.x < 0.03
    talk.run(5.0)
    assert talk.simulation.truth().twist.speed < 0.01


def test_firmware_that_counts_no_way_is_integrated(simulate: MakeSimulation) -> None:
    talk = talk_of(simulate, "ugv_beast", "ugv_beast", is_general=True)
    talk.come_up()
    talk.wanted = Twist2D(0.2, 0.0, 0.3)
    talk.run(5.0)
    truth = talk.simulation.truth().pose
    assert truth.yaw == pytest.approx(1.5, abs=0.1)
    assert talk.pose.distance_to(truth) < 0.06
    assert talk.total("restarts") == 0


def test_firmware_that_counts_whole_centimetres_is_known_by_its_battery(
    simulate: MakeSimulation,
) -> None:
    talk = talk_of(simulate, is_whole=True)
    talk.come_up()
    talk.wanted = Twist2D(0.2, 0.0, 0.3)
    reading = talk.run(5.0)
    truth = talk.simulation.truth().pose
    assert truth.yaw == pytest.approx(1.5, abs=0.1)
    assert talk.pose.distance_to(truth) < 0.06
    assert talk.total("encoder_jumps") == 0
    assert reading.battery is not None
    assert reading.battery.voltage == pytest.approx(11.8)


def test_the_beast_is_told_that_it_is_one(simulate: MakeSimulation) -> None:
    talk = talk_of(simulate, "ugv_beast", "ugv_beast")
    talk.come_up()
    talk.wanted = AHEAD
    talk.run(2.0)
    assert talk.simulation.truth().pose.x > 0.25


def test_its_battery_is_reported_and_stops_it_when_empty() -> None:
    dialogue = dialogue_of("waveshare_ugv")
    dialogue.begin(0)
    dialogue.outgoing(0)
    dialogue.receive(CONFIRMED, 1)
    for tick in range(150):
        now_ns = tick * 20 * MS
        dialogue.receive((REPORT % (0.0, 0.0)).replace("11.8", "9.8").encode(), now_ns)
    reading = dialogue.take(150 * 20 * MS)
    assert reading.battery is not None
    assert reading.battery.voltage == pytest.approx(9.8)
    assert reading.battery.fraction == 0.0
    assert reading.alarms == (codes.BATTERY,)


@pytest.mark.parametrize(
    "line",
    [
        '{"T":1001,"L":null,"R":0.0}',
        '{"T":1001,"L":"1","R":0.0}',
        '{"T":1001,"L":true,"R":0.0}',
        '{"T":1001}',
        '{"T":1001,"L":1e999,"R":0.0}',
        '{"T":1001,"L":%s,"R":0.0}' % (400 * "9"),
    ],
)
def test_a_report_without_speeds_is_none(line: str) -> None:
    dialogue = dialogue_of("waveshare_ugv")
    dialogue.begin(0)
    dialogue.outgoing(0)
    dialogue.receive(CONFIRMED + line.encode() + b"\n", 1)
    assert dialogue.status(1).state != "up"
    counts = dialogue.take(1).counts
    assert sum(counts.get(f"chassis/{name}", 0) for name in ("bad_messages", "stray_lines")) == 1


@pytest.mark.parametrize("number", ["1e305", 400 * "9"])
def test_ways_and_volts_that_no_robot_has_are_none(number: str) -> None:
    dialogue = dialogue_of("waveshare_ugv")
    dialogue.begin(0)
    dialogue.outgoing(0)
    report = f'{{"T":1001,"L":0.1,"R":0.1,"odl":{number},"odr":0.0,"v":{number}}}\n'.encode()
    dialogue.receive(CONFIRMED + report, 1)
    dialogue.receive(report, 41 * MS)
    reading = dialogue.take(41 * MS)
    assert len(reading.motions) == 1, "of the speeds"
    assert reading.battery is None
    assert BOARDS["waveshare_ugv"].questions[0].recognise(report) is not None


def test_confirmations_that_were_not_asked_for_count_for_nothing() -> None:
    dialogue = dialogue_of("waveshare_ugv")
    dialogue.begin(0)
    dialogue.receive(CONFIRMED + (REPORT % (0.0, 0.0)).encode(), 1)
    assert dialogue.status(1).state != "up"


def test_a_line_without_end_is_dropped() -> None:
    dialogue = dialogue_of("waveshare_ugv")
    dialogue.begin(0)
    for _ in range(40):
        dialogue.receive(b"x" * 100, 1)
    assert dialogue.take(1).counts["chassis/stray_lines"] >= 1


def test_speeds_that_no_wheel_has_are_power() -> None:
    assert MOST_SPEED < 10, "the power of the slowest command that moves a motor"


@pytest.mark.parametrize(("odl", "volts"), [("0.1", "11.8"), ("10", "1180")])
def test_one_speed_that_was_misread_is_no_power_where_the_way_is_counted(
    odl: str, volts: str
) -> None:
    dialogue = dialogue_of("waveshare_ugv")
    dialogue.begin(0)
    dialogue.outgoing(0)
    dialogue.receive(CONFIRMED, 1)
    motions = 0
    for number, speed in enumerate(["0.1", "0.1", "-3.4", "0.1", "0.1"]):
        report = f'{{"T":1001,"L":{speed},"R":0.1,"odl":{odl},"odr":{odl},"v":{volts}}}\n'
        dialogue.receive(report.encode(), number * 41 * MS)
        reading = dialogue.take(number * 41 * MS)
        assert reading.link.state == "up"
        assert all(motion.twist.speed < 0.2 for motion in reading.motions)
        motions += len(reading.motions)
    assert motions >= 3


def test_it_drives_no_mecanum_wheels() -> None:
    from support.emulated_boards import config_of

    with pytest.raises(DriverError, match="drives two"):
        make_board(config_of("waveshare_ugv"), "mecanum")
    with pytest.raises(DriverError, match="missing key `type`"):
        make_board(config_of("waveshare_ugv", settings={}), "differential")
