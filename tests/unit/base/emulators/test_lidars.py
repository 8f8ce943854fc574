"""Each lidar's bytes: against published vectors, and decoded by hand against a known room."""

import math
import struct
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from bench.base.lidars.catalogue import RECORDS
from bench.base.lidars.record import LidarRecord
from bench.base.lidars.rplidar import EXPRESS
from numpy.typing import NDArray

from trolley.geometry import Pose2D, Twist2D
from trolley_base.emulators import (
    camsense,
    coin_d4,
    delta2,
    ld19,
    lds01,
    rplidar,
    xv11,
    ydlidar,
)
from trolley_base.emulators.catalogue import LIDARS
from trolley_base.emulators.lidar import BadView, Mount, SpinningLidar
from trolley_base.emulators.port import USB_BAUD
from trolley_base.world import STEP_NS, LidarSpec, Simulation

pytestmark = pytest.mark.drives

MakeSimulation = Callable[..., Simulation]
AT_BASE = Mount(Pose2D.identity())
PERFECT = LidarSpec(noise_m=0.0, noise_share=0.0, drop_out=0.0, invalid=0.0)
# Ahead on the left, so that a mirrored or turned picture is a wrong one.
POST = "[[circle]]\nx = 1.0\ny = 0.8\nradius_m = 0.2\n"


def test_ld19_packet_matches_the_manual():
    manual = bytes.fromhex(
        "542c6808ab7ee000e4dc00e2d900e5d500e3d300e4d000e9cd00e4ca00e2c700e9c500e5c200e5c000e5be82"
        "3a1a50"
    )
    assert ld19.encode(2152, (32427, 33470), manual[6:42], 6714) == manual


def test_camsense_packet_matches_the_vector():
    points = b"".join(struct.pack("<HB", 1000 + i, 50) for i in range(8))
    assert camsense.encode(5.2, (90.0, 96.0), points) == bytes.fromhex(
        "55AA0308 004E80B6 E80332 E90332 EA0332 EB0332 EC0332 ED0332 EE0332 EF0332 00B8 8021"
    )


def test_coin_d4_packet_matches_the_vector():
    points = bytes.fromhex("00A00F 00C80F")  # of the maker's format: 1000 mm, 1010 mm
    assert points == coin_d4.point(1000, 0) + coin_d4.point(1010, 0)
    assert coin_d4.encode(100, (640, 768), points) == bytes.fromhex(
        "AA55C902 01050106 0B54 00A00F 00C80F"
    )


def test_delta2_packet_matches_the_vector():
    assert delta2.encode(6.0, 24.0, [(50, 4000), (50, 4004), (50, 4008)]) == bytes.fromhex(
        "AA001601 61AD000E 7800000960 320FA0 320FA4 320FA8 056D"
    )


def test_hokuyo_answers_as_a_real_one_does():
    # As a user of a URG-04LX-UG01 has published it.
    real = (
        "VV\n00P\nVEND:Hokuyo Automatic Co.,Ltd.;[\n"
        "PROD:SOKUIKI Sensor URG-04LX-UG01(Simple-URG);[\nFIRM:3.4.03(17/Dec./2012);T\n"
        "PROT:SCIP 2.0;N\nSERI:H1510998;V\n\n"
    )
    assert bytes.fromhex(answers("hokuyo_urg", b"VV\n".hex())).decode() == real
    assert bytes.fromhex(answers("hokuyo_urg", b"what\n".hex())) == b"what\n0Ee\n\n"


def test_hokuyo_sends_what_it_is_asked_for(simulate: MakeSimulation):
    lidar, simulation = start("hokuyo_urg"), simulate()
    # Every second scan, two of them, the nearest of each three steps, two characters each.
    lidar.receive(b"MS0100039903102\n", 0)
    sent = [data for _, data in run(lidar, simulation, 1.0, Twist2D.zero())]
    assert sent[0] == b"MS0100039903102\n00P\n\n"
    assert [data[:20] for data in sent[1:]] == [
        b"MS0100039903101\n99b\n",
        b"MS0100039903100\n99b\n",
    ]
    text = b"".join(line[:-1] for line in sent[1].split(b"\n")[3:-2])
    assert len(text) == 200
    lidar.receive(b"MD0044072601000\nMD0700060001000\nMDxxxx072501000\n", simulation.now_ns)
    refused = [frame.data[16:] for frame in lidar.take_frames()]
    assert [one[:2] for one in refused] == [b"04", b"05", b"0C"]


def test_hokuyo_gives_single_scans_while_its_laser_is_on(simulate: MakeSimulation):
    """As the Python library hokuyolx reads them."""
    lidar, simulation = start("hokuyo_urg"), simulate()
    lidar.receive(b"GD0044072501\nBM\nBM\nGD0044072501\n", 0)
    sent = [data for _, data in run(lidar, simulation, 0.5, Twist2D.zero())]
    assert sent[:3] == [b"GD0044072501\n10Q\n\n", b"BM\n00P\n\n", b"BM\n02R\n\n"]
    (scan,) = sent[3:]
    assert scan.startswith(b"GD0044072501\n00P\n")
    assert len(b"".join(line[:-1] for line in scan.split(b"\n")[3:-2])) == 3 * 682
    lidar.receive(b"GS0384038400\nGS0300040004\n", simulation.now_ns)
    said = [data for _, data in run(lidar, simulation, 0.5, Twist2D.zero())]
    assert [data[:15] for data in said] == [b"GS0384038400\n05", b"GS0300040004\n00"]
    assert len(said[1].split(b"\n")[3]) == 2 * 26 + 1


def test_hokuyo_tells_its_time_and_nothing_else_meanwhile(simulate: MakeSimulation):
    lidar, simulation = start("hokuyo_urg"), simulate()
    lidar.receive(b"TM1\nTM0\nTM0\nPP\nBM\n", 0)
    refused = [frame.data for frame in lidar.take_frames()]
    assert [data.split(b"\n")[1] for data in refused] == [b"04T", b"00P", b"02R", b"10Q", b"10Q"]
    run(lidar, simulation, 0.5, Twist2D.zero())
    lidar.receive(b"TM1\nTM2\nTM2\n", simulation.now_ns)
    time, *left = [frame.data for frame in lidar.take_frames()]
    assert time == b"TM1\n00P\n007dk\n\n", "500 ms"
    assert [data.split(b"\n")[1] for data in left] == [b"00P", b"03S"]


def test_xv11_packet_matches_the_vector():
    assert xv11.encode(0, 5.0, [(1000 + i, 100) for i in range(4)]) == bytes.fromhex(
        "faa0004be8036400e9036400ea036400eb0364009930"
    )


def test_lds01_packet_matches_the_vector():
    assert lds01.encode(0, 5.0, [(200, 1000 + i) for i in range(6)]) == bytes.fromhex(
        "faa0b80bc800e8030000c800e9030000c800ea030000c800eb030000c800ec030000c800ed0300006161"
    )


def test_x4_packet_matches_the_manual():
    frame = bytes.fromhex("aa55010153ae53aeab540000")
    head = (0xAE53 - 1) // 2
    assert ydlidar.encode(0.0, (head, head), [0]) == frame


def test_ydlidar_packet_with_intensity_matches_the_vector():
    packet = ydlidar.encode_with_intensity(None, (640, 704), [(100, 4000), (101, 4004)])
    assert packet == bytes.fromhex("aa550002010581052f5764a00f65a40f")


def test_rplidar_dense_and_ultra_dense_match_the_vectors():
    capsule = rplidar.encode_dense(False, 90 * 64, list(range(1000, 1040)))
    assert capsule[:8] == bytes.fromhex("a6598016e803e903")
    assert capsule[-2:] == bytes.fromhex("0f04")
    # The quality's field is 5 in each; it stands for 5, 10, 20 and 40.
    packed = [
        rplidar.pack_ultra_dense(mm, quality)
        for mm, quality in ((1000, 5), (3000, 10), (9999, 20), (26002, 40))
    ]
    assert packed == [0x057D0, 0x0A4F9, 0x14716, 0x2847F]


def test_rplidar_sample_matches_the_vector():
    assert rplidar.encode_sample(True, 45 * 64, 1000) == bytes.fromhex("3d8116a00f")


def run(
    lidar: SpinningLidar, simulation: Simulation, seconds: float, command: Twist2D
) -> list[tuple[int, bytes]]:
    sent: list[tuple[int, bytes]] = []
    for _ in range(round(seconds * 100)):
        simulation.step(command)
        lidar.step(simulation, simulation.now_ns - STEP_NS, simulation.now_ns)
        sent += [(frame.due_ns, frame.data) for frame in lidar.take_frames()]
    return sent


def start(
    kind: str,
    mount: Mount = AT_BASE,
    errors: LidarSpec = PERFECT,
) -> SpinningLidar:
    lidar = LIDARS[kind](mount, errors, np.random.default_rng(5))
    lidar.restart(0)
    return lidar


def plainly(record: LidarRecord, data: bytes) -> NDArray[np.float64]:
    """Rows of angle [deg, as the sensor counts] and distance [m], read plainly."""
    finder, read = record.finder(), record.reader()
    found = [sample for frame in finder.feed(data) for sample in read(frame)]
    assert finder.skipped in (0, record.ramp_bytes)
    return np.array(found) / (1.0, 1000.0)


EMULATED = [
    pytest.param(record, id=title, marks=[pytest.mark.slow] * record.is_twin)
    for title, record in RECORDS.items()
    if record.emulated is not None
]
OF_LD19 = RECORDS["LD19"]


def begun(record: LidarRecord, **more: Any) -> SpinningLidar:
    """A lidar that has answered, and streams."""
    assert record.emulated is not None
    lidar = start(record.model, **more)
    if record.emulated.command:
        lidar.receive(record.emulated.command, 0)
        assert b"".join(frame.data for frame in lidar.take_frames()) == record.emulated.answer
    return lidar


def measured(
    lidar: SpinningLidar, record: LidarRecord, simulation: Simulation, seconds: float
) -> NDArray[np.float64]:
    """What it says while its robot stands, see `plainly`."""
    sent = run(lidar, simulation, seconds, Twist2D.zero())
    return plainly(record, b"".join(data for _, data in sent))


def to_walls(bearings: NDArray[np.float64]) -> NDArray[np.float64]:
    """Range [m] from the middle of the 6 x 4 m room."""
    along, across = np.abs(np.cos(bearings)), np.abs(np.sin(bearings))
    return np.minimum(3.0 / np.maximum(along, 1e-6), 2.0 / np.maximum(across, 1e-6))


def off_walls(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Distance [m] of points from the walls of the 6 x 4 m room, or from the post in it."""
    x, y = np.abs(points).T
    walls = np.minimum(np.hypot(x - 3, np.maximum(y - 2, 0)), np.hypot(y - 2, np.maximum(x - 3, 0)))
    post = np.abs(np.hypot(points[:, 0] - 1.0, points[:, 1] - 0.8) - 0.2)
    return np.minimum(walls, post)


@pytest.mark.parametrize("record", EMULATED)
@pytest.mark.parametrize("hangs", [False, True])
def test_what_it_says_is_where_things_are(
    simulate: MakeSimulation, record: LidarRecord, hangs: bool
):
    mount = Mount(Pose2D(0.1, 0.05, 0.7), reversed=hangs)
    angles, ranges = measured(begun(record, mount=mount), record, simulate(POST), 1.0).T
    found = ranges > 0.0
    assert found.mean() > 0.6  # some do not see that far
    bearing = np.radians(angles[found]) * (1 if record.is_counter_clockwise != hangs else -1)
    points = np.column_stack((np.cos(bearing), np.sin(bearing))) * ranges[found, None]
    errors = off_walls(mount.base_T_laser.transform_points(points))
    assert np.quantile(errors, 0.97) < 0.012
    near_post = np.hypot(*(mount.base_T_laser.transform_points(points) - (1.0, 0.8)).T) < 0.25
    assert near_post.sum() > 20


@pytest.mark.parametrize("record", EMULATED)
def test_it_measures_at_its_pace_and_sends_as_it_measures(
    simulate: MakeSimulation, record: LidarRecord
):
    lidar, per_s = begun(record), record.samples_per_s
    sent = run(lidar, simulate(), 2.0, Twist2D.zero())
    rows = plainly(record, b"".join(data for _, data in sent))
    assert len(rows) == pytest.approx(2.0 * per_s, rel=0.02)
    turns = np.abs(np.diff(np.unwrap(np.radians(rows[:, 0])))).sum()
    assert turns / (2 * math.pi) == pytest.approx(2.0 * lidar.facts.turns_hz, rel=0.03)
    dues = np.array([due_ns for due_ns, _ in sent[1:]])
    assert np.all(np.diff(dues) >= 0)
    longest_s = 1.05 / record.turns_hz if record.sends_whole_turns else 40 / per_s
    assert np.diff(dues).max() < longest_s * 1e9 + STEP_NS
    carried = sum(len(data) for _, data in sent) * 10 / 2.0
    assert carried < (USB_BAUD if lidar.is_usb else lidar.baud)


def test_the_robot_drives_on_while_the_head_turns(simulate: MakeSimulation):
    simulation = simulate()
    lidar = start("ld19")
    run(lidar, simulation, 1.0, Twist2D(0.0, 0.0, 2.0))
    yaw_ns = simulation.truth().pose.yaw, simulation.now_ns
    first = run(lidar, simulation, 0.1, Twist2D(0.0, 0.0, 2.0))
    wrong = []
    for due_ns, data in first[1:]:
        angles, ranges = plainly(OF_LD19, data).T
        yaw = yaw_ns[0] + 2.0 * ((due_ns - yaw_ns[1]) * 1e-9 - np.arange(11, -1, -1) / 4500)
        wrong += np.abs(ranges - to_walls(yaw - np.radians(angles))).tolist()
    assert max(wrong) < 0.003


def test_an_ld14p_turns_as_fast_as_it_is_told(simulate: MakeSimulation):
    lidar, simulation = start("ld14p"), simulate()
    told = bytes.fromhex("54a20470080000a1")  # 2160 degrees a second, as the maker's program says
    lidar.receive(told.replace(b"\x70", b"\x71"), 0)  # its checksum is wrong
    lidar.receive(bytes.fromhex("54a204a005000000"), 0)
    for command, dps in ((told, 2160), (command_14p(0xA2, 1440), 1440)):
        lidar.receive(command, simulation.now_ns)
        sent = run(lidar, simulation, 0.5, Twist2D.zero())
        speeds = [struct.unpack("<H", data[2:4])[0] for _, data in sent]
        assert speeds == pytest.approx([dps] * len(sent), rel=0.02)


def command_14p(kind: int, value: int) -> bytes:
    body = struct.pack("<BBBI", 0x54, kind, 4, value)
    return body + bytes([ld19.crc8(body)])


def test_noise_and_failures_are_the_worlds(simulate: MakeSimulation):
    noisy = LidarSpec(noise_m=0.01, noise_share=0.0, drop_out=0.1, invalid=0.0)
    spoilt = measured(begun(OF_LD19, errors=noisy), OF_LD19, simulate(), 2.0)
    failed = spoilt[:, 1] == 0.0
    assert failed.mean() == pytest.approx(0.1, abs=0.02)
    expected = to_walls(-np.radians(spoilt[~failed, 0]))
    assert np.std(spoilt[~failed, 1] - expected) == pytest.approx(0.01, rel=0.1)


@pytest.mark.parametrize(
    "record", [one for one in EMULATED if not RECORDS[str(one.id)].sends_whole_turns]
)
def test_stuck_it_reports_one_angle_and_goes_on_later(
    simulate: MakeSimulation, record: LidarRecord
):
    lidar, simulation = begun(record), simulate()
    run(lidar, simulation, 0.5, Twist2D.zero())
    lidar.is_stuck = True
    run(lidar, simulation, 0.1, Twist2D.zero())
    assert np.ptp(measured(lidar, record, simulation, 0.5)[:, 0]) <= record.stuck_deg
    lidar.is_stuck = False
    run(lidar, simulation, 0.1, Twist2D.zero())
    assert np.ptp(measured(lidar, record, simulation, 0.5)[:, 0]) > 350.0


def test_a_stuck_hokuyo_sends_nothing_and_goes_on_later(simulate: MakeSimulation):
    lidar, simulation = start("hokuyo_urg"), simulate()
    lidar.receive(b"MD0044072501000\n", 0)
    assert len(run(lidar, simulation, 0.5, Twist2D.zero())) > 3
    lidar.is_stuck = True
    assert run(lidar, simulation, 0.5, Twist2D.zero()) == []
    lidar.is_stuck = False
    assert run(lidar, simulation, 0.5, Twist2D.zero())
    lidar.receive(b"QT\n", simulation.now_ns)
    assert [data for _, data in run(lidar, simulation, 0.5, Twist2D.zero())] == [b"QT\n00P\n\n"]


def answers(kind: str, request: str) -> str:
    lidar = start(kind)
    lidar.receive(bytes.fromhex(request), 0)
    return b"".join(frame.data for frame in lidar.take_frames()).hex()


@pytest.mark.parametrize(
    ("kind", "request_hex", "begin"),
    [
        ("rplidar_a1", "a550", "a55a1400000004" + "18"),
        ("rplidar_a1", "a552", "a55a0300000006" + "000000"),
        ("rplidar_a1", "a559", "a55a0400000015" + "fc01fe00"),
        ("rplidar_a1", "a5840470000000" + "55", "a55a0600000020" + "70000000" + "0200"),
        ("rplidar_a1", "a584047c00000059", "a55a0600000020" + "7c000000" + "0100"),
        ("rplidar_a1", "a58406710000000000" + "56", "a55a0800000020" + "71000000" + "00fc0100"),
        ("rplidar_c1", "a550", "a55a1400000004" + "41"),
        ("rplidar_c1", "a584047c00000059", "a55a0600000020" + "7c000000" + "0100"),
        ("rplidar_c1", "a5840401000000" + "24", "a55a0800000020" + "01000000" + "58020000"),
        ("rplidar_s2", "a58406710000000100" + "57", "a55a0800000020" + "71000000" + "401f0000"),
        ("rplidar_a2", "a5ff04000000005e", "a55a04000000ff" + "01000000"),
        ("ydlidar_x4", "a590", "a55a1400000004" + "06"),
        ("ydlidar_tmini", "a590", "a55a1400000004" + "97"),
        ("ydlidar_g4", "a5d1", "a55a0100000004" + "02"),
        ("ydlidar_x4", "a592", "a55a0300000006" + "000000"),
    ],
)
def test_requests_are_answered(kind: str, request_hex: str, begin: str):
    assert answers(kind, request_hex).startswith(begin)


def test_a_request_with_a_wrong_checksum_is_ignored():
    assert answers("rplidar_a1", "a58205000000000023") == ""
    assert answers("rplidar_a1", "a58205000000000023" + "a550") != ""


@pytest.mark.parametrize(
    ("kind", "begin", "stop"),
    [
        ("rplidar_a1", b"\xa5\x20", b"\xa5\x25"),
        ("rplidar_a1", EXPRESS, b"\xa5\x25"),
        ("ydlidar_x4", b"\xa5\x60", b"\xa5\x65"),
        ("lds01", b"b", b"e"),
        ("coin_d4", bytes.fromhex("AA55F00F"), bytes.fromhex("AA55F50A")),
        ("ld14p", bytes.fromhex("54a004000000005e"), bytes.fromhex("54a104000000004a")),
    ],
)
def test_it_scans_when_told_to_and_stops(
    simulate: MakeSimulation, kind: str, begin: bytes, stop: bytes
):
    lidar, simulation = start(kind), simulate()
    lidar.receive(stop, 0)
    assert run(lidar, simulation, 0.3, Twist2D.zero()) == []
    lidar.receive(begin, simulation.now_ns)
    assert run(lidar, simulation, 0.5, Twist2D.zero())
    lidar.receive(stop, simulation.now_ns)
    assert run(lidar, simulation, 0.3, Twist2D.zero()) == []


def test_a_turn_of_the_a1_begins_with_a_flag_and_one_of_the_x4_with_a_packet(
    simulate: MakeSimulation,
):
    lidar = start("rplidar_a1")
    lidar.receive(b"\xa5\x20", 0)
    frames = [data for _, data in run(lidar, simulate(), 2.0, Twist2D.zero())[1:]]
    assert sum(data[0] & 1 for data in frames) == 11
    lidar = start("ydlidar_x4")
    lidar.receive(b"\xa5\x60", 0)
    packets = [data for _, data in run(lidar, simulate(), 2.0, Twist2D.zero())[1:]]
    zero = [data for data in packets if data[2] & 1]
    assert len(zero) == pytest.approx(16, abs=1)
    assert all(data[3] == 1 and data[2] >> 1 == pytest.approx(80, abs=1) for data in zero)


def seen_by(bad_view: BadView, simulate: MakeSimulation) -> NDArray[np.float64]:
    """What an LD19, mounted with its zero to the robot's left, measures with a bad view."""
    lidar = start("ld19", Mount(Pose2D(0.0, 0.0, 0.5 * math.pi)))
    lidar.bad_view = bad_view
    sent = run(lidar, simulate(), 1.0, Twist2D.zero())
    return plainly(OF_LD19, b"".join(data for _, data in sent))


def test_a_bad_view_finds_nothing_where_it_is_bad(simulate: MakeSimulation):
    rows = seen_by(BadView(blind=math.radians(60.0)), simulate)
    ahead = np.abs((90.0 - rows[:, 0] + 180.0) % 360.0 - 180.0)  # its angles grow clockwise
    assert np.all(rows[ahead < 29.0, 1] == 0.0)
    assert np.all(rows[ahead > 31.0, 1] > 1.0)
    assert np.mean(seen_by(BadView(failing=0.95), simulate)[:, 1] == 0.0) == pytest.approx(
        0.95, abs=0.02
    )
    covered = seen_by(BadView(is_covered=True), simulate)
    assert np.all(covered[:, 1] == ld19.FACTS.range_min_m)
