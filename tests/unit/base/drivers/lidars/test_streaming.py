"""What becomes of a stream: scans where things are, a status that says what is wrong."""

import math
from collections.abc import Callable
from itertools import compress, takewhile
from typing import Any

import numpy as np
import pytest
from bench.base.lidars.camsense import camsense_frame
from bench.base.lidars.catalogue import RECORDS
from bench.base.lidars.ld19 import ld19_frame, ld19_stream
from bench.base.lidars.record import chunks, distance_m
from bench.base.lidars.rplidar import capsule
from bench.base.lidars.xv11 import xv11_stream
from bench.base.lidars.ydlidar import with_intensity, x4_frame
from numpy.typing import NDArray
from support.lidars import Session, started, stream

from trolley.config.hardware import LidarConfig
from trolley_base.drivers.interface import DriverError, LidarScan
from trolley_base.drivers.lidars import MODELS, make_lidar
from trolley_base.emulators import delta2

TITLES = [
    pytest.param(title, marks=[pytest.mark.slow] * record.is_twin)
    for title, record in RECORDS.items()
]


def angles_of(scan: LidarScan) -> NDArray[Any]:
    return scan.angle_min + scan.angle_increment * np.arange(len(scan.ranges))


@pytest.mark.parametrize(
    "chunk_s", [0.02, *(pytest.param(one, marks=pytest.mark.slow) for one in (0.01, 0.05))]
)
@pytest.mark.parametrize("title", TITLES)
def test_scans_show_the_room(title: str, chunk_s: float) -> None:
    session, record = started(title), RECORDS[title]
    session.hear(stream(title, 2.0, chunk_s))
    assert session.status == type(session.status)("up")
    assert not session.counts
    assert not session.notes
    num_turns = int(2.0 * record.turns_hz)
    assert len(session.scans) in range(num_turns - 2, num_turns)
    sense = 1.0 if record.is_counter_clockwise else -1.0
    for scan in session.scans:
        degrees = (np.degrees(angles_of(scan)) + 180.0) % 360.0 - 180.0
        sees = (degrees >= record.sees_deg[0]) & (degrees <= record.sees_deg[1])
        assert sees.sum() == pytest.approx(record.samples_per_s / record.turns_hz, rel=0.03)
        assert (scan.ranges[~sees] == 0.0).all()
        truth = np.array([distance_m(math.degrees(sense * angle)) for angle in angles_of(scan)])
        truth = np.where(truth > scan.range_max, np.inf, truth)
        near = (truth < scan.range_max - 0.05) & sees
        # Where angles are coarse, walls seen at a slant are farther off.
        within_m = 0.03 if record.is_coarse else 0.02
        assert scan.ranges[near] == pytest.approx(truth[near], abs=within_m)
        assert np.isinf(scan.ranges[truth > scan.range_max + 0.05]).all()
        assert 2.0 * math.pi * scan.angle_increment > 0.0
        covered = len(scan.ranges) * scan.angle_increment
        assert abs(covered - 2.0 * math.pi) <= scan.angle_increment


@pytest.mark.parametrize("title", TITLES)
def test_beams_are_stamped_when_they_were_fired(title: str) -> None:
    session, record = started(title), RECORDS[title]
    # A scan that arrives as a whole is stamped as well as its last byte.
    is_whole = record.sends_whole_turns
    session.hear(stream(title, 2.0, 0.001 if is_whole else 0.02))
    sense = 1.0 if record.is_counter_clockwise else -1.0
    for scan in session.scans[1:]:
        head_deg = np.degrees(sense * angles_of(scan)) + record.beside_deg
        fired_s = head_deg / 360.0 / record.turns_hz
        stamped_s = (scan.stamp_ns - session.stream_ns) * 1e-9
        stamped_s = stamped_s + scan.time_increment * np.arange(len(scan.ranges))
        turns_late = (stamped_s - fired_s) * record.turns_hz
        late_s = (turns_late - np.rint(turns_late.mean())) / record.turns_hz
        assert np.abs(late_s).max() < (0.007 if is_whole else 0.003)


def test_an_evenly_sampling_sensor_loses_no_angle() -> None:
    # 450 / 0.9985 samples a turn: no whole number.
    session = Session(LidarConfig(model="ld19"))
    session.hear(chunks(ld19_stream(10.015), 230400, 2.0, 0.02))
    beams = {len(scan.ranges) for scan in session.scans}
    assert beams == {449, 450}
    for scan in session.scans:
        assert (scan.ranges > 0.0).all()
        truth = [distance_m(-math.degrees(angle)) for angle in angles_of(scan)]
        assert scan.ranges == pytest.approx(np.array(truth), abs=0.0016)


@pytest.mark.parametrize("upside_down", [False, True])
@pytest.mark.parametrize("turned", [False, True])
def test_the_sense_of_rotation_can_be_set(upside_down: bool, turned: bool) -> None:
    session = Session(LidarConfig(model="ld19", upside_down=upside_down, reversed=turned))
    frames = [  # something near at 30 deg of the sensor
        ld19_frame(deg, 0.8, 3600.0, [500 if 25 < deg % 360 < 35 else 3000] * 12)
        for deg in np.arange(0.0, 1000.0, 9.6)
    ]
    session.hear([((i + 1) / 375.0, frame) for i, frame in enumerate(frames)])
    scan = session.scans[-1]
    sense = 1.0 if upside_down != turned else -1.0
    near = np.degrees(angles_of(scan)[scan.ranges < 1.0] + 4.0 * math.pi) % 360.0
    assert near.mean() == pytest.approx(sense * 33.0 % 360.0, abs=8.0)
    assert math.copysign(1.0, scan.time_increment) == sense


def test_masked_beams_are_invalid() -> None:
    session = Session(LidarConfig(model="ld19", masks_deg=[(80.0, 100.0), (350.0, 10.0)]))
    session.hear(stream("LD19", 0.5))
    scan = session.scans[-1]
    degrees = np.degrees(angles_of(scan)) % 360.0
    beside = np.minimum(np.abs(degrees - 90.0), np.abs((degrees + 180.0) % 360.0 - 180.0))
    assert (scan.ranges[beside <= 10.0] == 0.0).all()
    assert (scan.ranges[beside >= 10.1] > 0.0).all()


def test_limits_make_near_echoes_invalid_and_far_ones_none() -> None:
    session = Session(LidarConfig(model="ld19", range_min_m=2.5, range_max_m=3.2))
    session.hear(stream("LD19", 0.5))
    scan = session.scans[-1]
    assert (scan.range_min, scan.range_max) == (2.5, 3.2)
    values = set(np.unique(scan.ranges[(scan.ranges < 2.5) | (scan.ranges > 3.2)]).tolist())
    assert values == {0.0, math.inf}


@pytest.mark.parametrize(("lost", "published"), [(0.1, True), (0.3, False)])
@pytest.mark.parametrize("title", ["LD19", "XV11", "LDS-01", "YDLIDAR X4", "RPLIDAR A1 standard"])
def test_a_revolution_without_a_fifth_of_its_samples_is_dropped(
    title: str, lost: float, published: bool
) -> None:
    session, record = started(title), RECORDS[title]
    frames = list(takewhile(lambda frame: frame.at_s < 2.0, record.stream()))
    # Twenty samples of the standard scan go together, else frames.
    block = 20 if title == "RPLIDAR A1 standard" else 1
    per_turn = round(len(frames) / (2.0 * record.turns_hz) / block)
    rng = np.random.default_rng(4)
    gone = [rng.permutation(per_turn) < lost * per_turn for _ in range(60)]
    kept = compress(frames, ~np.repeat(np.concatenate(gone), block))
    session.hear(chunks(kept, record.baud, 1.9, 0.02))
    turns = int(1.9 * record.turns_hz)
    if published:
        assert len(session.scans) >= turns - 2
    else:
        assert len(session.scans) <= 1
        assert session.counts["lidar/short_revolutions"] >= turns - 3


def test_after_damage_the_next_good_frame_counts() -> None:
    session = Session(LidarConfig(model="ld19"))
    rng = np.random.default_rng(1)
    arrivals = stream("LD19", 2.0)
    noisy = [(at_s, rng.bytes(len(data)) if 0.5 < at_s < 1.0 else data) for at_s, data in arrivals]
    session.hear(noisy)
    assert len(session.scans) in range(11, 16)
    assert session.counts["lidar/skipped_bytes"] > 5000
    assert session.status.state == "up"
    assert sum(np.diff([scan.stamp_ns for scan in session.scans]) < 5e7) == 0


def test_a_frame_that_comes_twice_changes_nothing() -> None:
    session = Session(LidarConfig(model="ld19"))
    frames = list(takewhile(lambda frame: frame.at_s < 1.0, ld19_stream()))
    session.hear([(i / 375.0, one.data * (1 + i % 2)) for i, one in enumerate(frames, 1)])
    assert len(session.scans) == 8
    assert {len(scan.ranges) for scan in session.scans} == {450}
    assert not session.counts


def test_silence_is_noticed() -> None:
    session = Session(LidarConfig(model="ld19"))
    session.hear(stream("LD19", 1.0))
    session.wait(0.44)
    assert session.status.state == "up"
    session.wait(0.1)
    assert session.status.state == "down"
    assert "gone silent" in session.status.message
    assert not session.status.reopen
    session.wait(5.0)
    assert session.status.reopen
    session.lidar.begin(session.now_ns)
    assert not session.status.reopen
    assert session.status.state == "searching"


def test_no_answer_names_the_usual_cause() -> None:
    session = Session(LidarConfig(model="rplidar_a1"))
    session.wait(0.2)
    assert session.status.message == "Waiting for the RPLIDAR A1."
    session.wait(2.0)
    assert session.status.message == (
        "No answer from the RPLIDAR A1: check power and cable "
        "(a weak 5 V supply is the usual cause)."
    )
    session.wait(4.0)
    assert session.status.reopen


def test_other_data_is_noticed() -> None:
    session = Session(LidarConfig(model="ld19"))
    session.hear(stream("XV11", 2.0))
    assert session.status.state == "searching"
    assert "not what the LD19 sends" in session.status.message


def test_a_head_that_stands_still_is_noticed() -> None:
    session = Session(LidarConfig(model="ld19"))
    frame = ld19_frame(30.0, 0.0, 0.0, [1000] * 12)
    session.hear([(i / 375.0, frame) for i in range(1, 1200)])
    assert session.scans == []
    assert session.status.state == "searching"
    assert "turns at 0 rpm" in session.status.message


@pytest.mark.parametrize(
    ("title", "frame"),
    [
        ("LD19", lambda at, back: ld19_frame(at, -back / 11, 0.0, [1000] * 12)),
        ("YDLIDAR X4", lambda at, back: x4_frame(False, at, at - back, [4000] * 40)),
        ("COIN-D4", lambda at, back: with_intensity(False, at, at - back, [4000] * 40)),
        ("Camsense X1", lambda at, back: camsense_frame(at, -back / 7, 0.0, [1000] * 8)),
        ("RPLIDAR A1 express", lambda at, back: capsule(False, at - back, [(1000, 0)] * 32)),
    ],
)
def test_a_head_that_stands_and_trembles_makes_no_scans(
    title: str, frame: Callable[[float, float], bytes]
) -> None:
    session = started(title)
    back_deg = np.random.default_rng(1).integers(-1, 2, 600) / 32.0
    session.hear([(i / 200.0, frame(30.0, back)) for i, back in enumerate(back_deg.tolist(), 1)])
    assert session.scans == []
    assert session.status.state == "searching"


@pytest.mark.parametrize(("hz", "is_told"), [(2.8, True), (3.1, False), (5.7, False), (6.1, True)])
def test_a_wrong_speed_is_told(hz: float, is_told: bool) -> None:
    session = Session(LidarConfig(model="xv11"))
    session.hear(chunks(xv11_stream(hz), 115200, 2.0, 0.02))
    assert session.status.state == "up"
    assert ("lidar_speed" in session.notes) == is_told
    if is_told:
        assert f"{60 * hz:.0f} rpm instead of 180 to 349" in session.status.message
        assert "controller" in session.notes["lidar_speed"]


def test_what_is_not_taken_is_bounded() -> None:
    lidar = make_lidar(LidarConfig(model="ld19"))
    lidar.begin(0)
    for at_s, data in stream("LD19", 4.0):
        lidar.receive(data, round(at_s * 1e9))
    scans = lidar.take(4 * 10**9).scans
    assert len(scans) == 16
    assert scans[-1].stamp_ns > 3.7e9


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({}, "needs model, one of rplidar_a1"),
        ({"model": "lds01", "range_min_m": 4.0}, "range_min_m"),
        ({"model": "ld19", "mode": "express"}, 'no mode "express"'),
    ],
)
def test_settings_that_do_not_fit_are_refused(settings: dict[str, Any], words: str) -> None:
    with pytest.raises(DriverError, match=words):
        make_lidar(LidarConfig(**settings))


@pytest.mark.parametrize("model", MODELS)
def test_the_baud_rate_can_be_set(model: Any) -> None:
    assert make_lidar(LidarConfig(model=model)).line.baud == MODELS[model].facts.baud
    assert make_lidar(LidarConfig(model=model, baud=256000)).line.baud == 256000


def test_a_delta2_that_turns_too_slowly_says_so() -> None:
    session = Session(LidarConfig(model="delta2a"))
    for _ in range(20):
        session.wait(0.1)
        session.lidar.receive(delta2.encode_speed(2.0), session.now_ns)
    assert session.status.state == "searching"
    assert "turns at 120 rpm, too slowly to measure" in session.status.message
    assert not session.counts
    session.hear(stream("Delta-2A", 1.0))
    assert session.status.state == "up"
