"""Each lidar's bytes: against published vectors, and decoded by hand against a known room."""

import math
import struct
from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest
from bench.base.plain_lidars import PLAIN, SAMPLES
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
Decode = Callable[[bytes], NDArray[np.float64]]
AT_BASE = Mount(Pose2D.identity())
PERFECT = LidarSpec(noise_m=0.0, noise_share=0.0, drop_out=0.0, invalid=0.0)
# Ahead on the left, so that a mirrored or turned picture is a wrong one.
POST = "[[circle]]\nx = 1.0\ny = 0.8\nradius_m = 0.2\n"
EXPRESS = bytes.fromhex("a58205000000000022")
DENSE, TYPICAL = bytes.fromhex("a58205010000000023"), bytes.fromhex("a58205020000000020")
PWM = bytes.fromhex("a5f0029402c1")


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


# Decoders in the plainest form: rows of angle [deg, as the sensor counts] and distance [m].
def decode_ld19(data: bytes) -> NDArray[np.float64]:
    rows = []
    for at in range(0, len(data), 47):
        head, kind, _speed, first = struct.unpack("<BBHH", data[at : at + 6])
        last, _stamp = struct.unpack("<HH", data[at + 42 : at + 46])
        assert (head, kind) == (0x54, 0x2C)
        check = 0
        for byte in data[at : at + 46]:
            check ^= byte
            for _ in range(8):
                check = ((check << 1) ^ (0x4D if check & 0x80 else 0)) & 0xFF
        assert check == data[at + 46]
        by = (last - first) % 36000 / 11
        for i in range(12):
            (mm,) = struct.unpack("<H", data[at + 6 + 3 * i : at + 8 + 3 * i])
            rows.append(((first + i * by) / 100, mm / 1000))
    return np.array(rows)


def decode_ld14p(data: bytes) -> NDArray[np.float64]:
    rows = decode_ld19(data)
    for row in rows:
        if row[1]:
            shift = math.atan((119.23 * row[1] - 18.975571) / (1000 * row[1] + 5.9))
            row[0] -= math.degrees(shift)
    return rows


def decode_camsense(data: bytes) -> NDArray[np.float64]:
    rows = []
    for at in range(0, len(data), 36):
        frame = data[at : at + 36]
        words = struct.unpack("<18H", frame)
        total = 0
        for word in words[:17]:
            total = (total << 1) + word & 0xFFFFFFFF
        assert (words[0], words[1]) == (0xAA55, 0x0803)
        assert words[17] == ((total & 0x7FFF) + (total >> 15)) & 0x7FFF
        if words[3] < 0xA000:
            continue
        step = (words[16] - words[3]) % 23040 / 7
        for i in range(8):
            mm = frame[8 + 3 * i] + 256 * frame[9 + 3 * i]
            rows.append((((words[3] - 0xA000) + i * step) / 64, mm / 1000))
    return np.array(rows)


def decode_hokuyo(data: bytes) -> NDArray[np.float64]:
    rows = []
    command, status, _, stream = data.split(b"\n", 3)
    assert (command, status) == (b"MD0044072501000", b"00P")
    for scan in stream.split(b"\n\n")[:-1]:
        lines = scan.split(b"\n")
        assert all(line[-1] == sum(line[:-1]) % 64 + 48 for line in lines[1:])
        assert (lines[0], lines[1], len(lines[2])) == (command, b"99b", 5)
        text = b"".join(line[:-1] for line in lines[3:])
        assert len(text) == 3 * 682
        for i in range(682):
            mm = 0
            for char in text[3 * i : 3 * i + 3]:
                mm = mm * 64 + char - 48
            rows.append(((44 + i - 384) * 360 / 1024, mm / 1000 if mm >= 20 else 0.0))
    return np.array(rows)


def decode_xv11(data: bytes) -> NDArray[np.float64]:
    rows = []
    for at in range(0, len(data), 22):
        words = struct.unpack("<11H", data[at : at + 22])
        total = 0
        for word in words[:10]:
            total = (total << 1) + word
        assert words[10] == ((total & 0x7FFF) + (total >> 15)) & 0x7FFF
        for i in range(4):
            word = words[2 + 2 * i]
            mm = 0 if word & 0x8000 else word & 0x3FFF
            rows.append((4 * (data[at + 1] - 0xA0) + i, mm / 1000))
    return np.array(rows)


def decode_lds01(data: bytes) -> NDArray[np.float64]:
    rows = []
    for at in range(0, len(data), 42):
        assert data[at] == 0xFA
        assert data[at + 40] == data[at + 41] == 0xFF - sum(data[at : at + 40]) % 256
        for i in range(6):
            _, mm, _ = struct.unpack("<HHH", data[at + 4 + 6 * i : at + 10 + 6 * i])
            rows.append((6 * (data[at + 1] - 0xA0) + i, mm / 1000))
    return np.array(rows)


def decode_standard(data: bytes) -> NDArray[np.float64]:
    assert data.startswith(bytes.fromhex("a55a0500004081"))
    rows = []
    for at in range(7, len(data), 5):
        flags, angle, distance = struct.unpack("<BHH", data[at : at + 5])
        assert (flags & 1) != (flags >> 1 & 1)
        assert angle & 1
        rows.append(((angle >> 1) / 64, distance / 4000))
    return np.array(rows)


def decode_express(data: bytes) -> NDArray[np.float64]:
    assert data.startswith(bytes.fromhex("a55a5400004082"))
    capsules = [data[at : at + 84] for at in range(7, len(data), 84)]
    rows = []
    for one, two in pairwise(capsules):
        check = 0
        for byte in one[2:]:
            check ^= byte
        assert (one[0], one[1]) == (0xA0 | check & 15, 0x50 | check >> 4)
        first, after = (struct.unpack("<H", c[2:4])[0] & 0x7FFF for c in (one, two))
        by = (after - first) % (360 * 64) / 64 / 32
        for i in range(16):
            a, b, c = struct.unpack("<HHB", one[4 + 5 * i : 9 + 5 * i])
            lags = ((a & 3) << 4 | c & 15) / 8, ((b & 3) << 4 | c >> 4) / 8
            rows.append((first / 64 + 2 * i * by - lags[0], (a & 0xFFFC) / 4000))
            rows.append((first / 64 + (2 * i + 1) * by - lags[1], (b & 0xFFFC) / 4000))
    return np.array(rows)


def decode_x4(data: bytes) -> NDArray[np.float64]:
    assert data.startswith(bytes.fromhex("a55a0500004081"))
    at, rows = 7, []
    while at < len(data):
        _, kind, count, first, last, check = struct.unpack("<HBBHHH", data[at : at + 10])
        samples = struct.unpack(f"<{count}H", data[at + 10 : at + 10 + 2 * count])
        for word in (0x55AA, first, *samples, count << 8 | kind, last):
            check ^= word
        assert check == 0
        assert (kind & 1 == 1) == (count == 1 and first == last)
        by = ((last >> 1) - (first >> 1)) % (360 * 64) / 64 / max(1, count - 1)
        for i, sample in enumerate(samples):
            mm = sample / 4
            beside = math.degrees(math.atan(21.8 * (155.3 - mm) / (155.3 * mm))) if mm else 0.0
            rows.append(((first >> 1) / 64 + i * by + beside, mm / 1000))
        at += 10 + 2 * count
    return np.array(rows)


def plainly(title: str, *, answered: bool = True) -> Decode:
    """By the plain decoder that the drivers are compared with, behind the answer to the command."""

    def decode(data: bytes) -> NDArray[np.float64]:
        if answered:
            assert data[:2] == b"\xa5\x5a"
            assert data[5] == 0x40
            data = data[7:]
        frames, read = PLAIN[title](), SAMPLES[title]()
        found = [sample for frame in frames.feed(data) for sample in read(frame)]
        assert frames.skipped == 0
        return np.array(found) / (1.0, 1000.0)

    return decode


KINDS: dict[str, tuple[str, Decode, bytes, float]] = {
    # model, decoder, what starts it, samples per second
    "ld19": ("ld19", decode_ld19, b"", 4500.0),
    "stl27l": ("stl27l", decode_ld19, b"", 21600.0),
    "ld14p": ("ld14p", decode_ld14p, b"", 4000.0),
    "xv11": ("xv11", decode_xv11, b"", 1800.0),
    "lds02rr": ("lds02rr", decode_xv11, b"", 1800.0),
    "lds01": ("lds01", decode_lds01, b"", 1800.0),
    "camsense": ("camsense_x1", decode_camsense, b"", 2080.0),
    "coin_d4": (
        "coin_d4",
        plainly("COIN-D4", answered=False),
        bytes.fromhex("AA55F00F"),
        5000.0,
    ),
    "delta2a": ("delta2a", plainly("Delta-2A", answered=False), b"", 1920.0),
    "delta2b": ("delta2b", plainly("Delta-2B", answered=False), b"", 3840.0),
    "hokuyo": ("hokuyo_urg", decode_hokuyo, b"MD0044072501000\n", 6820.0),
    "standard": ("rplidar_a1", decode_standard, b"\xa5\x20", 1 / 508e-6),
    "express": ("rplidar_a1", decode_express, EXPRESS, 1 / 254e-6),
    "ultra": ("rplidar_a3", plainly("RPLIDAR A3"), PWM + TYPICAL, 16000.0),
    "dense": ("rplidar_c1", plainly("RPLIDAR C1"), DENSE, 5000.0),
    "ultra dense": ("rplidar_s3", plainly("RPLIDAR S3"), DENSE, 32000.0),
    "x4": ("ydlidar_x4", decode_x4, b"\xa5\x60", 5000.0),
    "x2": ("ydlidar_x2", plainly("YDLIDAR X2", answered=False), b"", 3000.0),
    "g2": ("ydlidar_g2", plainly("YDLIDAR G2"), b"\xa5\x60", 5000.0),
    "g4": ("ydlidar_g4", plainly("YDLIDAR G4"), b"\xa5\x60", 9000.0),
    "tmini": ("ydlidar_tmini", plainly("YDLIDAR T-mini"), b"\xa5\x60", 4000.0),
}
TRIED = [
    pytest.param(
        one,
        marks=[pytest.mark.slow]
        * (samples_per_s > 10_000 or one in ("g2", "x2", "delta2b", "lds02rr")),
    )
    for one, (_, _, _, samples_per_s) in KINDS.items()
]
"""Those with many samples, and those that differ from another by numbers alone, take their time."""


def samples(kind: str, simulation: Simulation, seconds: float = 1.0, **more) -> NDArray[np.float64]:
    model, decode, begin, _ = KINDS[kind]
    lidar = start(model, **more)
    lidar.receive(begin, 0)
    sent = run(lidar, simulation, seconds, Twist2D.zero())
    return decode(b"".join(data for _, data in sent))


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


@pytest.mark.parametrize("kind", TRIED)
@pytest.mark.parametrize("hangs", [False, True])
def test_what_it_says_is_where_things_are(simulate: MakeSimulation, kind: str, hangs: bool):
    mount = Mount(Pose2D(0.1, 0.05, 0.7), reversed=hangs)
    angles, ranges = samples(kind, simulate(POST), mount=mount).T
    found = ranges > 0.0
    assert found.mean() > 0.6  # some do not see that far
    counter_clockwise = (kind in ("xv11", "hokuyo")) is not hangs
    bearing = np.radians(angles[found]) * (1 if counter_clockwise else -1)
    points = np.column_stack((np.cos(bearing), np.sin(bearing))) * ranges[found, None]
    errors = off_walls(mount.base_T_laser.transform_points(points))
    assert np.quantile(errors, 0.97) < 0.012
    near_post = np.hypot(*(mount.base_T_laser.transform_points(points) - (1.0, 0.8)).T) < 0.25
    assert near_post.sum() > 20


@pytest.mark.parametrize("kind", TRIED)
def test_it_measures_at_its_pace_and_sends_as_it_measures(simulate: MakeSimulation, kind: str):
    model, decode, begin, per_s = KINDS[kind]
    lidar = start(model)
    lidar.receive(begin, 0)
    sent = run(lidar, simulate(), 2.0, Twist2D.zero())
    num = len(decode(b"".join(data for _, data in sent)))
    assert num == pytest.approx(2.0 * per_s, rel=0.02)
    turns = np.abs(np.diff(np.unwrap(np.radians(decode(b"".join(d for _, d in sent))[:, 0])))).sum()
    assert turns / (2 * math.pi) == pytest.approx(2.0 * lidar.facts.turns_hz, rel=0.03)
    dues = np.array([due_ns for due_ns, _ in sent[1:]])
    assert np.all(np.diff(dues) >= 0)
    longest_s = 0.105 if kind == "hokuyo" else 40 / per_s  # it sends a whole turn at once
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
        angles, ranges = decode_ld19(data).T
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
    spoilt = samples("ld19", simulate(), 2.0, errors=noisy)
    failed = spoilt[:, 1] == 0.0
    assert failed.mean() == pytest.approx(0.1, abs=0.02)
    expected = to_walls(-np.radians(spoilt[~failed, 0]))
    assert np.std(spoilt[~failed, 1] - expected) == pytest.approx(0.01, rel=0.1)


@pytest.mark.parametrize("kind", [one for one in TRIED if one.values != ("hokuyo",)])
def test_stuck_it_reports_one_angle_and_goes_on_later(simulate: MakeSimulation, kind: str):
    model, decode, begin, _ = KINDS[kind]
    lidar, simulation = start(model), simulate()
    lidar.receive(begin, 0)
    opening = run(lidar, simulation, 0.5, Twist2D.zero())[:1] if begin else []
    if kind == "coin_d4":  # which does not answer
        opening = []
    prefix = opening[0][1] if opening else b""
    lidar.is_stuck = True
    run(lidar, simulation, 0.1, Twist2D.zero())
    stuck = run(lidar, simulation, 0.5, Twist2D.zero())
    angles = decode(prefix + b"".join(data for _, data in stuck))[:, 0]
    # Of those with packets at fixed angles it is one packet.
    within = {"xv11": 6.0, "lds02rr": 6.0, "lds01": 6.0, "delta2a": 22.5, "delta2b": 22.5}.get(
        kind, 0.2
    )
    if kind != "express":  # whose host can only guess the angles of a head that does not turn
        assert np.ptp(angles) <= within
    lidar.is_stuck = False
    run(lidar, simulation, 0.1, Twist2D.zero())
    later = run(lidar, simulation, 0.5, Twist2D.zero())
    assert np.ptp(decode(prefix + b"".join(data for _, data in later))[:, 0]) > 350.0


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
    return decode_ld19(b"".join(data for _, data in sent))


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
