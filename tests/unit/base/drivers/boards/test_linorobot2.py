"""What a linorobot2's firmware is told and believed; most is in `test_emulated_boards.py`."""

import math
import random
import struct
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from support.emulated_boards import MS, EmulatedTalk, dialogue_of

from trolley import codes
from trolley.config.hardware import ChassisConfig
from trolley.geometry import Pose2D, Twist2D
from trolley_base.drivers.boards import linorobot2_messages as messages
from trolley_base.drivers.boards import make_board
from trolley_base.drivers.boards.device_clock import WINDOW, DeviceClock
from trolley_base.drivers.boards.linorobot2_messages import NoMessageError
from trolley_base.drivers.boards.velocities import StampedVelocities
from trolley_base.drivers.boards.xrce_frames import MessageDatagrams
from trolley_base.emulators.linorobot2 import Linorobot2, Linorobot2Options
from trolley_base.emulators.micro_ros import Cdr
from trolley_base.world import Simulation

MakeSimulation = Callable[..., Simulation]
AHEAD = Twist2D(0.15, 0.0, 0.0)
AXES = ("x", "y", "z")


def talk_of(
    simulate: MakeSimulation, told: dict[str, Any] | None = None, **built: bool
) -> EmulatedTalk:
    board = Linorobot2(Linorobot2Options(**built), np.random.default_rng(1))
    return EmulatedTalk(dialogue_of("linorobot2", **(told or {})), board, simulate())


def header(frame: str = "odom") -> Cdr:
    return Cdr().put("i", 5).put("I", 6).text(frame)


def odometry(frame: str = "odom", child: str = "base_footprint", **twist: float) -> bytes:
    numbers = [0.0] * 85
    numbers[43], numbers[44], numbers[48] = (twist.get(key, 0.0) for key in ("vx", "vy", "wz"))
    return header(frame).text(child).put("85d", *numbers).data


@pytest.mark.parametrize("frame", ["", "o", "odom", "odom_combined"])
@pytest.mark.parametrize("child", ["", "base_footprint", "base_link"])
def test_odometry_is_read_whatever_its_frames_are_called(frame: str, child: str) -> None:
    told = messages.parse_odometry(odometry(frame, child, vx=0.3, vy=-0.1, wz=0.7))
    assert told == messages.Odometry(5_000_000_006, Twist2D(0.3, -0.1, 0.7))


def test_odometry_has_the_size_that_it_has_on_the_line() -> None:
    """720 bytes, of which 496 fit into a fragment: 8 of head, 488 of it."""
    assert len(odometry()) == 720


@pytest.mark.parametrize(
    "body",
    [
        b"",
        odometry()[:-290],
        odometry(vx=float("nan")),
        odometry(vx=11.0),
        odometry(wz=-60.0),
        struct.pack("<iII", 1, 2, 0xFFFF_FFF0) + bytes(700),
    ],
)
def test_what_is_no_odometry_is_refused(body: bytes) -> None:
    with pytest.raises(NoMessageError):
        messages.parse_odometry(body)


def test_the_imu_is_turned_into_base_link() -> None:
    numbers = [0.0] * 37
    numbers[13:16], numbers[25:28] = (0.1, 0.2, 0.3), (1.0, 2.0, 9.8)
    body = header("imu_link").put("37d", *numbers).data
    imu = messages.parse_imu(body, ("y", "-x", "z"))
    assert imu.angular_velocity == (0.2, -0.1, 0.3)
    assert imu.linear_acceleration == (2.0, -1.0, 9.8)
    for bad in (body[:-80], header().put("37d", *[float("inf")] * 37).data):
        with pytest.raises(NoMessageError):
            messages.parse_imu(bad, AXES)


def test_a_twist_is_48_bytes() -> None:
    assert messages.encode_twist(Twist2D(0.25, 0.5, -1.0)).hex() == (
        "000000000000d03f000000000000e03f" + "00" * 24 + "000000000000f0bf"
    )


def test_stamps_are_the_board_s_and_its_drift_is_followed() -> None:
    clock = DeviceClock()
    clock.note_set()
    for number in range(WINDOW):
        at_ns = number * 100 * MS
        assert clock.stamp(at_ns, at_ns + 70 * MS + number % 3 * MS) == at_ns
    for number in range(WINDOW, 5 * WINDOW):  # its clock is slower by 0.1 %
        at_ns = number * 100 * MS
        told_ns = at_ns - (number - WINDOW) * MS // 10
        assert clock.stamp(told_ns, at_ns + 70 * MS) == pytest.approx(at_ns, abs=7 * MS)


def test_stamps_of_a_clock_that_nobody_has_set_are_those_of_arrival() -> None:
    clock = DeviceClock()
    for number in range(10):
        assert clock.stamp(number * MS, 10**18 + number * MS) == 10**18 + number * MS
    assert clock.stamp(10**15, 10**18 + 20 * MS) == 10**18 + 20 * MS
    clock.note_set()
    assert clock.stamp(10**15 + 5 * MS, 10**18 + 25 * MS) == 10**18 + 25 * MS
    assert clock.stamp(10**15, 10**18 + 26 * MS) == 10**18 + 25 * MS, "it never goes back"


def test_a_speed_holds_since_the_one_before_and_not_longer_than_the_board_knows() -> None:
    counts: list[str] = []
    wheels = StampedVelocities(1000 * MS, lambda name, _: counts.append(name))
    assert wheels.add(AHEAD, 5000 * MS) is None
    motion = wheels.add(AHEAD, 5800 * MS)
    assert motion is not None
    assert motion.previous_T_base.distance_to(Pose2D(0.12, 0.0, 0.0)) < 1e-9
    assert wheels.add(AHEAD, 5800 * MS) is None
    assert wheels.add(AHEAD, 6801 * MS) is None
    assert counts == ["gaps", "gaps"]
    assert wheels.add(AHEAD, 6811 * MS) is not None


def test_motion_gyro_and_battery_come_with_the_board_s_stamps(simulate: MakeSimulation) -> None:
    talk = talk_of(simulate)
    talk.come_up()
    talk.wanted = Twist2D(0.0, 0.0, 0.5)
    talk.run(3.0)
    imus = [imu for reading in talk.readings for imu in reading.imu]
    assert imus[-1].angular_velocity[2] == pytest.approx(0.5, abs=0.02)
    assert imus[-1].linear_acceleration[2] == pytest.approx(9.81, abs=0.3)
    assert 0 <= talk.now_ns - imus[-1].stamp_ns < 60 * MS
    stamps = [motion.stamp_ns for reading in talk.readings for motion in reading.motions]
    assert stamps == sorted(set(stamps))
    battery = talk.readings[-1].battery
    assert battery is not None
    assert battery.voltage == pytest.approx(11.8)


@pytest.mark.parametrize("volts", [math.inf, -math.inf, math.nan])
def test_a_voltage_that_is_no_number_is_none(volts: float) -> None:
    with pytest.raises(NoMessageError):
        messages.parse_voltage(header("base_link").put("f", volts).data)


def test_an_empty_battery_is_told(simulate: MakeSimulation) -> None:
    talk = talk_of(simulate, {"inputs": {"battery_empty_v": 12.0, "battery_full_v": 16.8}})
    talk.come_up()
    assert codes.BATTERY in talk.run(7.0).alarms


@pytest.mark.parametrize("built", [{"is_of_2021": True}, {"stops": True}, {"is_uart": True}])
def test_it_drives_with_every_build(simulate: MakeSimulation, built: dict[str, bool]) -> None:
    talk = talk_of(simulate, None, **built)
    talk.come_up()
    talk.wanted = AHEAD
    talk.run(3.0)
    talk.wanted = Twist2D.zero()
    talk.run(0.5)
    truth = talk.simulation.truth()
    assert truth.pose.x == pytest.approx(0.45, abs=0.05)
    assert truth.twist.speed < 0.01
    assert talk.pose.x == pytest.approx(truth.pose.x, abs=0.02)


def test_a_board_that_has_lost_us_drives_on_until_it_is_back_and_then_stands(
    simulate: MakeSimulation,
) -> None:
    """What nobody can help; so nothing else may keep a ping from being answered."""
    talk = talk_of(simulate)
    talk.come_up()
    talk.wanted = AHEAD
    talk.run(1.0)
    talk.is_cut = True
    talk.run(8.0)
    assert talk.readings[-1].link.state == "down"
    assert talk.simulation.truth().twist.vx > 0.1
    talk.is_cut = False
    talk.wanted = Twist2D.zero()
    talk.come_up()
    talk.run(0.3)
    assert talk.total("sessions") == 1
    assert talk.simulation.truth().twist.speed < 0.01


def test_a_firmware_that_stops_by_itself_does(simulate: MakeSimulation) -> None:
    talk = talk_of(simulate, is_of_2021=True)
    talk.come_up()
    talk.wanted = AHEAD
    talk.run(1.0)
    talk.is_cut = True
    talk.run(0.6)
    assert talk.simulation.truth().twist.speed < 0.01


def test_pings_are_answered_whatever_else_is_wrong(simulate: MakeSimulation) -> None:
    talk = talk_of(simulate)
    talk.come_up()
    talk.board.says_nan = True  # type: ignore[attr-defined]
    talk.wanted = AHEAD
    talk.run(2.0)
    status = talk.dialogue.status(talk.now_ns)
    assert status.state == "down"
    assert "no robot can have" in status.message
    assert talk.board.take_remarks()[-1] == "it has an agent"
    assert talk.told is not None
    assert talk.told.is_zero


def test_another_firmware_is_not_driven_and_named(simulate: MakeSimulation) -> None:
    talk = talk_of(simulate)
    talk.board.has_wrong_md5 = True  # type: ignore[attr-defined]
    talk.wanted = AHEAD
    talk.run(8.0)
    status = talk.dialogue.status(talk.now_ns)
    assert status.state == "down"
    assert "cmd_vel as geometry_msgs::msg::dds_::TwistStamped_" in status.message
    assert not talk.board.commands
    assert "it has lost its agent" not in talk.board.take_remarks()


def test_micro_ros_that_is_no_linorobot2_is_named(simulate: MakeSimulation) -> None:
    talk = talk_of(simulate)
    talk.board._published = lambda: {"chatter": "std_msgs::String"}  # type: ignore[method-assign,attr-defined]
    talk.board._publish_data = lambda: iter(())  # type: ignore[method-assign,attr-defined]
    talk.run(10.0)
    assert "has no odom/unfiltered" in talk.dialogue.status(talk.now_ns).message


def test_a_board_in_another_agent_s_session_comes_over(simulate: MakeSimulation) -> None:
    talk = talk_of(simulate)
    talk.run(1.0)
    talk.board.join_another_agent()  # type: ignore[attr-defined]
    talk.run(0.3)
    assert "session of another agent" in talk.dialogue.status(talk.now_ns).message
    talk.come_up()
    talk.wanted = AHEAD
    talk.run(1.0)
    assert talk.simulation.truth().twist.vx > 0.1


def test_a_session_whose_streams_have_come_apart_is_given_up(simulate: MakeSimulation) -> None:
    talk = talk_of(simulate)
    talk.come_up()
    talk.board.join_another_agent()  # type: ignore[attr-defined]
    talk.wanted = AHEAD
    talk.run(8.0)
    talk.come_up()
    assert talk.total("sessions_given_up") == 1
    talk.run(1.0)
    assert talk.simulation.truth().twist.vx > 0.1


def test_a_dead_line_is_told_apart_from_a_wrong_speed() -> None:
    dialogue = dialogue_of("linorobot2")
    dialogue.begin(0)
    assert "waited for" in dialogue.status(0).message
    dialogue.receive(b"\x00\xf3\x80" * 40, MS)
    assert "baud" in dialogue.status(2 * MS).message
    late = dialogue.status(6_000 * MS)
    assert (late.state, late.reopen) == ("down", True)


def test_only_mecanum_wheels_go_sideways(simulate: MakeSimulation) -> None:
    config = ChassisConfig(board="linorobot2")
    for drive, vy in (("mecanum", 0.1), ("differential", 0.0)):
        dialogue = make_board(config, drive)  # type: ignore[arg-type]
        board = Linorobot2(Linorobot2Options(), np.random.default_rng(1))
        talk = EmulatedTalk(dialogue, board, simulate())
        talk.come_up()
        bodies: list[bytes] = []
        board._client.on_data = lambda _, body, bodies=bodies: bodies.append(body)  # type: ignore[misc]
        talk.wanted = Twist2D(0.2, 0.1, 0.0)
        talk.run(0.3)
        assert struct.unpack("<6d", bodies[-1])[:2] == (0.2, vy)


def test_its_sonar_is_a_range_in_robot_time(simulate: MakeSimulation) -> None:
    talk = talk_of(simulate, has_sonar=True)
    talk.come_up()
    talk.run(1.0)
    scans = [scan for reading in talk.readings for scan in reading.ranges]
    assert len(scans) >= 5
    assert {scan.frame for scan in scans} == {"ultrasound"}
    assert all(0 <= talk.now_ns - scan.stamp_ns < 1500 * MS for scan in scans)
    assert scans[-1].range_max == pytest.approx(0.8075)
    assert scans[-1].angle_min == pytest.approx(math.radians(-7.5), abs=1e-4)


def test_a_board_without_a_sonar_has_no_range(simulate: MakeSimulation) -> None:
    talk = talk_of(simulate)
    talk.come_up()
    talk.run(1.0)
    assert not any(reading.ranges for reading in talk.readings)
    assert talk.total("bad_messages") == 0


@pytest.mark.parametrize(
    "values",
    [(0.26, 0.02, math.nan, 1.0), (0.0, 0.02, 4.0, 1.0), (0.26, 5.0, 4.0, 1.0), (4.0, 0, 1e9, 1)],
)
def test_a_sonar_that_cannot_be_is_no_message(values: tuple[float, ...]) -> None:
    with pytest.raises(NoMessageError):
        messages.parse_range(header("sonar_link").put("B", 0).put("4f", *values).data)
    with pytest.raises(NoMessageError):
        messages.parse_range(header("sonar_link").data)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_datagrams_that_come_twice_or_out_of_order_cost_nothing(
    simulate: MakeSimulation, seed: int
) -> None:
    """As they may over Wi-Fi, where each message is one."""
    rng, framing = random.Random(seed), MessageDatagrams()

    def shuffled(data: bytes) -> bytes:
        messages = [one for one in framing.cut(data) for _ in range(1 + (rng.random() < 0.1))]
        for at in range(1, len(messages)):
            if rng.random() < 0.1:
                messages[at - 1], messages[at] = messages[at], messages[at - 1]
        return b"".join(map(framing.join, messages))

    talk = talk_of(simulate)
    talk.spoil = shuffled
    talk.come_up()
    talk.wanted = Twist2D(0.15, 0.0, 0.2)
    talk.run(5.0)
    talk.wanted = Twist2D.zero()
    talk.run(1.0)
    assert talk.readings[-1].link.state == "up"
    assert talk.total("sessions") == 0
    truth = talk.simulation.truth().pose
    assert (talk.pose.x, talk.pose.y) == pytest.approx((truth.x, truth.y), abs=0.03)


def test_what_gets_lost_is_asked_for_again(simulate: MakeSimulation) -> None:
    """All but pings, whose loss costs the session by the board's own rule."""
    rng, framing = random.Random(6), MessageDatagrams()

    def thinned(data: bytes) -> bytes:
        kept = [one for one in framing.cut(data) if rng.random() > 0.05 or _is_ping(one)]
        return b"".join(map(framing.join, kept))

    talk = talk_of(simulate)
    talk.come_up()
    talk.spoil = thinned
    talk.wanted = Twist2D(0.15, 0.0, 0.0)
    talk.readings.clear()
    talk.run(5.0)
    assert sum(len(reading.motions) for reading in talk.readings) > 35
    assert all(reading.link.state == "up" for reading in talk.readings)
    talk.spoil = lambda data: data
    talk.wanted = Twist2D.zero()
    talk.run(1.0)
    assert talk.readings[-1].link.state == "up"
    assert talk.total("sessions") == 0
    assert talk.total("lost_messages") == 0
    assert talk.pose.x == pytest.approx(talk.simulation.truth().pose.x, abs=0.04)


def test_a_session_that_was_not_heard_of_for_seconds_goes_on(simulate: MakeSimulation) -> None:
    """The firmware waits a second for each acknowledgement, and pings in between."""
    talk = talk_of(simulate)
    talk.come_up()
    talk.is_cut = True
    talk.run(1.5)
    assert talk.readings[-1].link.state == "down"
    talk.is_cut = False
    talk.run(0.3)
    assert talk.readings[-1].link.state == "up"
    assert talk.total("sessions") == 0


@pytest.mark.parametrize("cut_s", [0.5, 1.0])
def test_commands_arrive_again_after_several_in_a_row_were_lost(
    simulate: MakeSimulation, cut_s: float
) -> None:
    talk = talk_of(simulate)
    talk.run(12.0)
    talk.wanted = AHEAD
    talk.run(0.2)
    talk.is_cut = True
    talk.run(cut_s)
    talk.is_cut, talk.wanted = False, Twist2D.zero()
    talk.run(2.0)
    before = len(talk.readings)
    talk.wanted = AHEAD
    talk.run(3.0)
    untaken = sum(one.counts.get("chassis/not_taken", 0) for one in talk.readings[before:])
    assert untaken == 0
    assert talk.simulation.truth().twist.vx == pytest.approx(AHEAD.vx, abs=0.03)


def _is_ping(message: bytes) -> bool:
    return message[0] == 0x80
