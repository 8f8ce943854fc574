"""A Create 2: what it is told, its modes, its sensors, its counts."""

import math
import struct
from collections.abc import Callable

import pytest
from support.emulated_boards import MS, EmulatedTalk, config_of, dialogue_of

from trolley import codes
from trolley.geometry import Twist2D
from trolley_base.drivers import ChassisReading, Contact, DriverError
from trolley_base.drivers.boards import BOARDS, counted_track_m, make_board
from trolley_base.drivers.boards.create2 import FIELDS, drive_direct, parse_frame
from trolley_base.drivers.boards.fixed_frames import FrameFormat, FrameReader
from trolley_base.emulators.create2 import Create2
from trolley_base.world import Simulation

MakeSimulation = Callable[..., Simulation]
AHEAD = Twist2D(0.15, 0.0, 0.0)
MODE, CLIFF, CHARGING = 35, 10, 21


@pytest.fixture
def talk(simulate: MakeSimulation) -> EmulatedTalk:
    return EmulatedTalk(dialogue_of("create2"), Create2(is_asleep=False), simulate())


def feel(talk: EmulatedTalk, *felt: str) -> None:
    assert isinstance(talk.board, Create2)
    talk.board.felt = frozenset(felt)


def frame(**given: int) -> bytes:
    """A frame by hand, packet by packet: `p35=2` is packet 35."""
    told = {22: 15000, 25: 2000, 26: 2600, 35: 2}
    told |= {int(name[1:]): value for name, value in given.items()}
    body = b"".join(
        struct.pack(f">B{layout}", number, told.get(number, 0)) for number, layout in FIELDS
    )
    whole = bytes((19, len(body))) + body
    return whole + bytes(((256 - sum(whole)) % 256,))


def read(*frames: bytes) -> ChassisReading:
    dialogue = dialogue_of("create2")
    dialogue.begin(0)
    for number, data in enumerate(frames):
        dialogue.receive(data, (number + 1) * 15 * MS)
    return dialogue.take(len(frames) * 15 * MS)


def test_vectors_of_the_interface() -> None:
    assert drive_direct(200, 200) == bytes.fromhex("91 00 C8 00 C8")
    assert drive_direct(-500, 1) == bytes.fromhex("91 00 01 FE 0C")
    one = FrameFormat(b"\x13\x03", 6, lambda data: sum(data) % 256 == 0)
    frames, _ = FrameReader(one, lambda name, number: None).feed(bytes.fromhex("13032B03E8D4"))
    assert [found.data[3:5] for found in frames] == [(1000).to_bytes(2, "big")]


def test_a_frame_is_read() -> None:
    sensors = parse_frame(frame(p43=65535, p44=1, p7=0b1010, p22=14400))
    assert (sensors.left, sensors.right, sensors.bumps, sensors.millivolts) == (65535, 1, 10, 14400)


def test_it_is_started_step_by_step_with_rests(talk: EmulatedTalk) -> None:
    talk.come_up()
    sent = [data for _, data in talk.sent]
    assert sent[0] == bytes.fromhex("91 00 00 00 00 80")
    assert sent[1] == b"\x83"
    assert sent[2][:2] == bytes((148, 17))
    changes = [at for at, data in talk.sent[:3]]
    assert changes[1] - changes[0] >= 60 * MS
    assert changes[2] - changes[1] >= 60 * MS
    assert not [line for line in talk.board.take_remarks() if "within 20 ms" in line]


def test_one_that_was_left_driving_is_stopped_by_the_first_bytes(talk: EmulatedTalk) -> None:
    talk.come_up()
    talk.wanted = AHEAD
    talk.run(1.0)
    talk.wanted = Twist2D.zero()
    talk.dialogue.begin(talk.now_ns)
    talk.tick()
    assert talk.told is not None
    assert talk.told.is_zero
    assert talk.board.wheels().is_zero


def test_nobody_stops_it_once_its_host_is_gone(talk: EmulatedTalk) -> None:
    talk.come_up()
    talk.wanted = AHEAD
    talk.run(1.0)
    for _ in range(500):
        talk.step()
    assert talk.simulation.truth().twist.vx > 0.1
    assert BOARDS["create2"].facts.watchdog_s == float("inf")


@pytest.mark.parametrize(
    ("felt", "code"),
    [
        ("bump", codes.BUMPER),
        ("cliff", codes.CLIFF),
        ("drop", codes.CLIFF),
        ("clean", codes.BUTTON),
    ],
)
def test_what_it_feels_is_an_alarm_at_once(talk: EmulatedTalk, felt: str, code: str) -> None:
    talk.come_up()
    talk.wanted = AHEAD
    talk.run(0.5)
    feel(talk, felt)
    talk.tick()
    assert talk.tick().alarms == (code,)
    feel(talk)
    talk.wanted = Twist2D.zero()
    talk.run(0.1)
    assert talk.readings[-1].alarms == ()


def test_at_a_cliff_it_stops_itself_and_may_back_away(talk: EmulatedTalk) -> None:
    talk.come_up()
    talk.wanted = AHEAD
    talk.run(0.5)
    feel(talk, "cliff")
    talk.tick()
    assert talk.board.wheels().is_zero
    talk.wanted = Twist2D.zero()
    assert talk.tick().link.state == "down"
    talk.run(1.0)
    assert talk.readings[-1].link.state == "up"
    assert talk.readings[-1].alarms == (codes.CLIFF,)
    talk.wanted = Twist2D(-0.1, 0.0, 0.0)
    talk.run(1.0)
    assert talk.simulation.truth().twist.vx < -0.05


@pytest.mark.parametrize(("felt", "says"), [("drop", "hangs in the air"), ("dock", "charged")])
def test_it_is_left_in_peace_while_it_is_lifted_or_charged(
    talk: EmulatedTalk, felt: str, says: str
) -> None:
    talk.come_up()
    feel(talk, felt)
    talk.wanted = AHEAD
    talk.run(0.2)
    talk.sent.clear()
    talk.run(2.0)
    assert says in talk.readings[-1].link.message
    assert b"\x83" not in [data for _, data in talk.sent]
    assert talk.board.wheels().is_zero
    feel(talk)
    talk.wanted = Twist2D.zero()
    talk.run(1.0)
    assert talk.readings[-1].link.state == "up"


def test_a_roomba_that_was_made_to_clean_is_stopped(talk: EmulatedTalk) -> None:
    talk.come_up()
    talk.board.receive(bytes((135,)), talk.now_ns)
    talk.run(0.2)
    assert talk.readings[-1].link.state == "down"
    talk.run(1.0)
    assert talk.readings[-1].link.state == "up"
    assert talk.board.wheels().is_zero


def test_a_byte_that_is_lost_is_made_good_by_the_next_commands(talk: EmulatedTalk) -> None:
    talk.come_up()
    talk.board.receive(drive_direct(0, 0)[:-1], talk.now_ns)
    talk.run(0.2)
    assert talk.board.wheels().is_zero
    assert talk.simulation.truth().pose.x < 0.02


def test_it_tells_its_battery(talk: EmulatedTalk) -> None:
    talk.come_up()
    battery = talk.readings[-1].battery
    assert battery is not None
    assert (battery.voltage, battery.charging) == (pytest.approx(15.2), False)
    assert battery.fraction == pytest.approx(2100 / 2696)
    feel(talk, "dock")
    battery = talk.run(0.2).battery
    assert battery is not None
    assert battery.charging is True


def test_an_empty_battery_stops_it() -> None:
    frames = [frame(p25=60) for _ in range(150)]
    assert codes.BATTERY in read(*frames).alarms
    assert read(frame(p26=0)).battery is None


@pytest.mark.parametrize("mode", [0, 1, 3, 32])
def test_in_another_mode_it_is_not_up(mode: int) -> None:
    assert read(frame(p35=mode)).link.state == "down"


@pytest.mark.parametrize(
    ("before", "after", "way"), [(65530, 4, 10), (3, 65533, -6), (0, 32767, 0), (100, 100, 0)]
)
def test_counts_go_around_their_corner(before: int, after: int, way: int) -> None:
    reading = read(*(frame(p43=count, p44=count) for count in (before, before, after, after)))
    metres = sum(motion.previous_T_base.x for motion in reading.motions)
    assert metres == pytest.approx(way * 3.14159265 * 0.072 / 508.8, abs=1e-6)
    assert reading.num_jumps == (1 if after == 32767 else 0)


@pytest.mark.parametrize("silent_s", [0.1, 1.0, 4.0])
def test_one_that_boots_while_it_drives_has_not_moved(talk: EmulatedTalk, silent_s: float) -> None:
    talk.come_up()
    talk.wanted = AHEAD
    talk.run(3.0)
    talk.board.restart(talk.now_ns)
    talk.hear()  # the words with which it boots
    driven = talk.pose
    talk.wanted, talk.is_cut = Twist2D.zero(), True
    talk.run(silent_s)
    talk.is_cut = False
    talk.come_up()
    talk.run(1.0)
    assert talk.pose.distance_to(driven) < 0.01
    assert talk.total("restarts") == 1


@pytest.mark.parametrize(("after", "moved_m"), [(3, 0.0), (4600, 0.27)])
def test_one_that_counts_from_zero_after_a_silence_has_booted(after: int, moved_m: float) -> None:
    dialogue = dialogue_of("create2")
    dialogue.begin(0)
    times = [*range(20), *range(300, 360)]
    for number in times:
        count = 4000 if number < 300 else after
        dialogue.receive(frame(p43=count, p44=count), number * 15 * MS)
    motions = dialogue.take(times[-1] * 15 * MS).motions
    assert sum(one.previous_T_base.x for one in motions) == pytest.approx(moved_m, abs=0.01)


def test_it_is_asked_for_no_more_than_it_can_do(talk: EmulatedTalk) -> None:
    talk.come_up()
    talk.wanted = Twist2D(1.0, 0.0, 2.0)
    talk.run(0.1)
    assert talk.told is not None
    assert talk.told.vx + 0.1175 * talk.told.wz == pytest.approx(0.5, abs=1e-3)
    assert talk.told.wz / talk.told.vx == pytest.approx(2.0, abs=0.02)


def test_goodbye_leaves_it_off(talk: EmulatedTalk) -> None:
    talk.come_up()
    for last in talk.dialogue.goodbye():
        talk.now_ns += 5 * MS
        talk.board.receive(last, talk.now_ns)
    talk.step()
    talk.board.take_frames()
    talk.step()
    talk.step()
    assert talk.board.take_frames() == []


def test_it_has_two_wheels() -> None:
    with pytest.raises(DriverError, match="drives two"):
        make_board(config_of("create2"), "mecanum")
    assert counted_track_m(config_of("create2")) == 0.235


def test_a_speed_at_which_its_frames_do_not_fit_is_refused() -> None:
    with pytest.raises(DriverError, match="too slow"):
        dialogue_of("create2", baud=19200)
    assert dialogue_of("create2", baud=57600).line.baud == 57600


def test_its_port_is_opened_so_that_it_wakes() -> None:
    line = dialogue_of("create2").line
    assert (line.baud, line.clears_rts) == (115200, True)
    # Three pulses of 50 to 500 ms would make it speak at 19200 baud.
    assert line.settle_s > 0.5


def contact(reading: ChassisReading, name: str) -> Contact:
    return next(one for one in reading.contacts if one.name == name)


@pytest.mark.parametrize(
    ("felt", "name", "least_deg", "most_deg"),
    [
        ("left", "bumper", 5, 75),
        ("right", "bumper", -75, -5),
        ("bump", "bumper", -30, 30),
        ("cliff", "cliff", 5, 25),
        ("near", "light_bumper", -25, 25),
        ("wall", "light_bumper", -75, -60),
    ],
)
def test_it_says_on_which_side_it_feels_something(
    talk: EmulatedTalk, felt: str, name: str, least_deg: float, most_deg: float
) -> None:
    talk.come_up()
    assert not any(one.sectors for one in talk.tick().contacts)
    feel(talk, felt)
    talk.run(0.1)
    sectors = contact(talk.readings[-1], name).sectors
    assert math.degrees(min(begin for begin, _ in sectors)) == pytest.approx(least_deg)
    assert math.degrees(max(end for _, end in sectors)) == pytest.approx(most_deg)
    feel(talk)
    talk.run(0.1)
    assert not any(one.sectors for one in talk.readings[-1].contacts)


def test_one_that_is_silent_feels_nothing(talk: EmulatedTalk) -> None:
    talk.come_up()
    feel(talk, "bump")
    talk.run(0.1)
    talk.is_cut = True
    assert talk.run(1.0).contacts == ()


def test_one_that_rolls_over_its_start_in_a_silence_has_not_restarted() -> None:
    dialogue = dialogue_of("create2")
    dialogue.begin(0)
    for n in [*range(60), *range(135, 195)]:
        count = (10 * min(n, 135) - 1300) & 0xFFFF
        dialogue.receive(frame(p43=count, p44=count), n * 15 * MS)
    reading = dialogue.take(195 * 15 * MS)
    assert "chassis/restarts" not in reading.counts
    way = sum(motion.previous_T_base.x for motion in reading.motions)
    assert way == pytest.approx(1350 * math.pi * 0.072 / 508.8, abs=0.03)


def test_one_that_stands_near_its_start_does_not_restart_with_every_silence() -> None:
    dialogue = dialogue_of("create2")
    dialogue.begin(0)
    for n in [*range(60), *range(160, 220), *range(320, 380)]:
        dialogue.receive(frame(p43=20, p44=20), n * 15 * MS)
    assert "chassis/restarts" not in dialogue.take(380 * 15 * MS).counts
