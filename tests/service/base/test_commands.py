"""Who may drive, through the whole service."""

import pytest

from trolley import codes, topics
from trolley.geometry import Twist2D
from trolley.messages import VelocityCommand

from .conftest import MakeRig, Rig

AHEAD, BACK = Twist2D(0.2, 0.0, 0.0), Twist2D(-0.2, 0.0, 0.0)


def test_a_fresh_command_drives_and_is_published(rig: Rig) -> None:
    rig.drive(1.0, 0.2)
    assert rig.truth.twist.vx == pytest.approx(0.2)
    assert rig.driven[-1].twist == AHEAD
    assert (rig.state.mode, rig.state.source) == ("ok", "teleop")
    assert rig.odometry[-1].pose.x == pytest.approx(rig.truth.pose.x, abs=0.01)


def test_the_scan_of_the_command_that_is_driven_is_told(rig: Rig) -> None:
    command = VelocityCommand(stamp_ns=rig.now_ns, twist=AHEAD, valid_for=0.3, scan_ns=42)
    rig.lockstep.publish(topics.COMMAND, command, "planner")
    rig.run(0.1)
    assert rig.driven[-1].scan_ns == 42


def test_commands_of_thousands_of_strangers_keep_nobody_out(rig: Rig) -> None:
    for number in range(topics.COMMAND.max_keys + 10):
        rig.send(BACK, f"stranger{number}")
    rig.drive(1.0, 0.2)
    assert rig.driven[-1].twist == AHEAD
    assert rig.state.source == "teleop"


def test_the_robot_stands_half_a_second_after_the_commands_end(rig: Rig) -> None:
    for _ in range(10):
        rig.send(Twist2D(0.5, 0.0, 0.0), "planner", valid_for=100.0)
        rig.run(0.1)
    rig.run(0.45)
    assert rig.driven[-1].twist.is_zero
    assert (rig.state.mode, rig.state.reason) == ("held", codes.COMMAND_LOST)
    assert rig.state.source is None
    rig.run(0.35)
    assert rig.truth.twist.is_zero


def test_a_hand_on_teleop_takes_over_and_gives_back_after_a_second(rig: Rig) -> None:
    rig.drive(0.5, 0.2, source="planner")
    sources: list[str | None] = []
    for tenth in range(25):
        rig.send(AHEAD, "planner")
        if tenth < 5:
            rig.send(BACK, "teleop", valid_for=0.15)
        rig.run(0.1)
        sources.append(rig.state.source)
    assert sources[:5] == ["teleop"] * 5
    # The last command by hand was good until 0.55 s: the planner waits until 1.55 s.
    assert sources[5:15] == [None] * 10
    assert sources[16:] == ["planner"] * 9


def test_zero_from_above_holds_the_robot(rig: Rig) -> None:
    for _ in range(10):
        rig.send(Twist2D.zero(), "teleop")
        rig.send(AHEAD, "planner")
        rig.run(0.1)
    assert rig.truth.twist.is_zero
    assert rig.state.source == "teleop"


def test_strangers_are_dropped_and_counted(rig: Rig) -> None:
    rig.drive(0.5, 0.2, source="stranger")
    assert rig.truth.twist.is_zero
    assert rig.counters["cmd_vel/unknown_source"] == 5


def test_sources_can_be_configured(make_rig: MakeRig) -> None:
    rig = make_rig(base={"sources": {"joystick": 5}})
    rig.drive(0.5, 0.2, source="joystick")
    rig.drive(0.5, 0.3, source="teleop")
    assert rig.counters["cmd_vel/unknown_source"] == 5


def test_bad_commands_are_dropped_and_counted(rig: Rig) -> None:
    rig.run(2.0)
    rig.send(AHEAD, valid_for=0.0)
    rig.send(AHEAD, valid_for=-1.0)
    rig.send(AHEAD, stamp_ns=rig.now_ns + 300_000_000)
    rig.run(0.1)
    rig.send(AHEAD, stamp_ns=rig.now_ns)
    rig.run(0.1)
    rig.send(AHEAD, stamp_ns=rig.now_ns - 150_000_000)
    rig.run(0.1)
    assert {name: n for name, n in rig.counters.items() if name.startswith("cmd_vel")} == {
        "cmd_vel/not_valid": 2,
        "cmd_vel/ahead": 1,
        "cmd_vel/out_of_order": 1,
    }


@pytest.mark.parametrize("off_s", [-1.5, 3600.0])
def test_who_stamps_commands_by_another_clock_reads_in_the_log_what_to_do(
    rig: Rig, caplog: pytest.LogCaptureFixture, off_s: float
) -> None:
    rig.run(2.0)
    for _ in range(3):
        rig.send(AHEAD, stamp_ns=rig.now_ns + round(off_s * 1e9))
        rig.run(0.1)
    (said,) = [one for one in caplog.records if one.getMessage() == "Command dropped"]
    about = vars(said)["trolley_fields"]
    assert about["source"] == "teleop"
    assert about["late_s"] == pytest.approx(-off_s, abs=0.1)
    assert "stamp commands by robot time" in about["why"]


def test_what_was_recorded_of_a_drive_cannot_be_played_back_to_the_robot(rig: Rig) -> None:
    """Nor can a command that waited on its way for longer than half a second."""
    rig.run(2.0)
    heard = [
        VelocityCommand(stamp_ns=rig.now_ns + i * 50_000_000, twist=AHEAD, valid_for=0.5)
        for i in range(10)
    ]
    for command in heard:
        rig.lockstep.publish(topics.COMMAND, command, "teleop")
        rig.run(0.05)
    rig.run(1.0)
    assert rig.truth.twist.is_zero
    for command in heard:
        rig.lockstep.publish(topics.COMMAND, command, "teleop")
        rig.run(0.05)
        assert rig.driven[-1].twist.is_zero
    assert rig.counters["cmd_vel/old"] == 9
    assert rig.counters["cmd_vel/repeated"] == 1, "the newest is known byte for byte"
    assert (rig.state.mode, rig.state.reason) == ("held", codes.COMMAND_LATE)
    rig.drive(0.5, 0.2)
    assert (rig.state.mode, rig.state.source) == ("ok", "teleop")


def test_a_command_that_is_valid_for_a_millisecond_moves_the_robot_for_a_moment(rig: Rig) -> None:
    rig.send(AHEAD, valid_for=0.001)
    rig.run(0.1)
    assert rig.odometry[-1].pose.x > 0.0
    assert rig.driven[-1].twist.is_zero


@pytest.mark.parametrize(
    "payload",
    [
        b"",
        b"\x81",
        b"{}",
        b"[" * 100_000,
        b'{"stamp_ns": 1, "twist": {"vx": NaN, "vy": 0, "wz": 0}, "valid_for": 0.3}',
        b'{"stamp_ns": 1, "twist": {"vx": 1e999, "vy": 0, "wz": 0}, "valid_for": 0.3}',
        b'{"stamp_ns": 1, "twist": {"vx": "fast", "vy": 0, "wz": 0}, "valid_for": 0.3}',
        b'{"stamp_ns": -1, "twist": {"vx": 0.2, "vy": 0, "wz": 0}, "valid_for": 0.3}',
    ],
)
def test_garbage_moves_nothing_and_is_counted(rig: Rig, payload: bytes) -> None:
    rig.lockstep.put("trolley/trolley/cmd_vel/teleop", payload)
    rig.run(0.5)
    assert rig.truth.twist.is_zero
    assert rig.counters["cmd_vel/invalid"] == 1


def test_the_limits_bind_every_source(make_rig: MakeRig) -> None:
    limits = {"max_speed_mps": 0.3, "max_wz_radps": 0.6, "acceleration_mps2": 0.5}
    rig = make_rig(base={"limits": limits})
    before = 0.0
    for source in ("planner", "calibrate", "teleop"):
        for _ in range(8):
            rig.drive(0.1, 5.0, 2.0, source)
            driven = rig.driven[-1].twist
            assert driven.vx <= 0.3
            assert abs(driven.wz) <= 0.6
            assert driven.vx - before <= 0.5 * 0.1 + 1e-6
            before = driven.vx


def test_the_planner_sees_what_limits_hold(make_rig: MakeRig) -> None:
    rig = make_rig(base={"limits": {"max_speed_mps": 0.3, "deceleration_mps2": 0.7}})
    (reply,) = rig.lockstep.get("trolley/*/robot")
    robot = __import__("json").loads(reply.payload)
    assert reply.key == "trolley/trolley/robot"
    assert (robot["max_speed"], robot["max_wz"], robot["deceleration"]) == (0.3, 1.5, 0.7)
    assert (robot["protocol"], robot["simulated"], robot["title"]) == (1, True, "trolley")
    assert len(robot["footprint"]) == 4
