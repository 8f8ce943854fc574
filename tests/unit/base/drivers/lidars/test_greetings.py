"""How lidars are started, taken over and stopped."""

import numpy as np
import pytest
from bench.base.lidars.catalogue import RECORDS
from bench.base.lidars.hokuyo import UTM_STEPS
from hypothesis import given, settings
from hypothesis import strategies as st
from support.cases import cases
from support.lidars import Asked, Session, rplidar, started, stream, ydlidar

from trolley.config.hardware import LidarConfig

STOP, RESET, STANDARD = b"\xa5\x25", b"\xa5\x40", b"\xa5\x20"
EXPRESS = bytes.fromhex("A58205000000000022")
HOKUYO = {**RECORDS["Hokuyo URG"].answers, **RECORDS["Hokuyo URG"].begins}
HOKUYO_PIECES = [*HOKUYO.values(), *HOKUYO, b"00P\n", b"99b\n", b"AMAX:9999;"]


def test_an_rplidar_is_stopped_asked_and_started_in_the_express_scan() -> None:
    device = rplidar()
    session = Session(LidarConfig(model="rplidar_a1"), device)
    session.wait_for_stream()
    assert device.heard == [STOP, b"\xa5\x50", b"\xa5\x52", b"\xa5\x59", EXPRESS]
    session.hear(stream("RPLIDAR A1 express", 1.0))
    assert session.status.state == "up"
    assert len(session.scans[-1].intensities) == 0


def test_an_rplidar_without_the_express_scan_does_the_standard_one() -> None:
    device = rplidar(express=False)
    session = Session(LidarConfig(model="rplidar_a1"), device)
    session.wait_for_stream()
    assert device.heard[-3:] == [EXPRESS, STOP, STANDARD]
    session.hear(stream("RPLIDAR A1 standard", 1.0))
    assert session.status.state == "up"
    assert set(session.scans[-1].intensities.tolist()) == {15.0}


@pytest.mark.parametrize(
    ("mode", "express", "never"), [("standard", True, EXPRESS), ("express", False, STANDARD)]
)
def test_an_rplidar_is_never_asked_for_the_other_mode(
    mode: str, express: bool, never: bytes
) -> None:
    device = rplidar(express=express)
    session = Session(LidarConfig(model="rplidar_a1", mode=mode), device)  # pyrefly: ignore[bad-argument-type]
    session.wait(12.0)
    assert never not in device.heard
    assert device.streams == (mode == "standard")


def test_a_streaming_rplidar_is_taken_over() -> None:
    session = Session(LidarConfig(model="rplidar_a1"), rplidar())
    session.hear(stream("RPLIDAR A1 standard", 0.08))
    session.wait_for_stream()
    session.hear(stream("RPLIDAR A1 express", 1.0))
    assert session.status.state == "up"
    assert not session.counts


def test_a_faulty_rplidar_is_reset_and_never_started() -> None:
    device = rplidar(health=b"\x02\x34\x12")
    session = Session(LidarConfig(model="rplidar_a1"), device)
    session.wait(12.0)
    assert RESET in device.heard
    assert not {EXPRESS, STANDARD} & set(device.heard)
    assert session.status.state == "searching"
    assert "health error 4660" in session.status.message


@pytest.mark.parametrize("model", ["rplidar_a1", "ydlidar_x4"])
def test_a_fault_is_not_told_after_the_power_was_cut(model: str) -> None:
    make = rplidar if model == "rplidar_a1" else ydlidar
    device = make(health=b"\x02\x01\x00")
    session = Session(LidarConfig(model=model), device)
    session.wait(3.0)
    assert "health error 1" in session.status.message
    device.answers.clear()
    session.wait(3.0)
    session.lidar.begin(session.now_ns)  # its port is opened anew
    session.wait(3.0)
    assert "No answer" in session.status.message


def test_an_rplidar_that_a_reset_mends_is_started() -> None:
    device = rplidar(health=b"\x02\x01\x00")
    session = Session(LidarConfig(model="rplidar_a1"), device)
    while RESET not in device.heard:
        session.wait(0.02)
    device.answers[b"\xa5\x52"] = rplidar().answers[b"\xa5\x52"]
    session.wait_for_stream()
    session.hear(stream("RPLIDAR A1 express", 1.0))
    assert session.status.message == ""


def test_a_rplidar_that_falls_silent_is_greeted_again() -> None:
    session = started("RPLIDAR A1 express")
    session.hear(stream("RPLIDAR A1 express", 1.0))
    session.device.streams = False
    session.wait(0.6)
    assert session.status.state == "down"
    session.wait(2.0)
    session.wait_for_stream()
    session.hear(stream("RPLIDAR A1 express", 1.0))
    assert session.status.state == "up"


def test_another_model_is_named() -> None:
    session = Session(LidarConfig(model="rplidar_a1"), rplidar(model=0x28))
    session.wait_for_stream()
    assert "0x28" in session.notes["lidar_model"]


def test_a_warning_of_its_health_is_passed_on() -> None:
    session = Session(LidarConfig(model="ydlidar_x4"), ydlidar(health=b"\x01\x07\x00"))
    session.wait_for_stream()
    assert "health code 7" in session.notes["lidar_health"]


def test_a_ydlidar_is_stopped_asked_and_started() -> None:
    device = ydlidar()
    session = Session(LidarConfig(model="ydlidar_x4"), device)
    session.wait(0.4)
    assert device.heard == []  # its motor gets up to speed
    session.wait_for_stream()
    assert device.heard == [b"\xa5\x00", b"\xa5\x65", b"\xa5\x90", b"\xa5\x92", b"\xa5\x60"]


@pytest.mark.parametrize(
    ("title", "motor"), [("RPLIDAR C1", "A5A802580255"), ("RPLIDAR A3", "A5F0029402C1")]
)
def test_another_rplidar_is_asked_for_its_typical_mode(title: str, motor: str) -> None:
    session = started(title)
    heard = session.device.heard
    assert heard[:3] == [STOP, b"\xa5\x50", b"\xa5\x52"]
    assert heard[3] == bytes.fromhex("A584047C00000059")
    assert heard[-2:] == [bytes.fromhex(motor), bytes.fromhex("A582050100000000 23")]
    session.hear(stream(title, 0.5))
    assert session.status.state == "up"
    assert session.lidar.goodbye()[0] == STOP
    assert session.lidar.goodbye()[1][:2] == bytes.fromhex(motor)[:2]


def test_a_scan_that_nobody_can_read_is_told_and_the_standard_one_is_used() -> None:
    device = Asked("RPLIDAR C1")
    device.start[bytes.fromhex("A582050100000000 23")] = bytes.fromhex("A55A0D030040 83")
    session = Session(LidarConfig(model="rplidar_c1"), device)
    session.wait_for_stream()
    session.wait(1.0)
    assert device.heard[-1] == STANDARD
    assert "0x83" in session.notes["lidar_mode"]


def test_an_rplidar_whose_typical_mode_is_the_standard_one_is_started_in_it() -> None:
    device = Asked("RPLIDAR S2")
    device.answers[bytes.fromhex("A584047C00000059")] = bytes.fromhex(
        "A55A06000000 20 7C000000 0000"
    )
    session = Session(LidarConfig(model="rplidar_s2"), device)
    session.wait_for_stream()
    assert device.heard[-1] == STANDARD


def test_a_g4_is_asked_how_fast_it_samples() -> None:
    session = started("YDLIDAR G4")
    assert session.device.heard[-2:] == [b"\xa5\xd1", b"\xa5\x60"]


def test_an_lds01_is_asked_to_start_until_it_does() -> None:
    session = Session(LidarConfig(model="lds01"))
    start_ns = session.now_ns
    asked = [at_s for at_s in range(4) if session.lidar.outgoing(start_ns + at_s * 10**9) == b"b"]
    assert asked == [0, 1, 2, 3]
    session.hear(stream("LDS-01", 1.0))
    assert session.lidar.outgoing(session.now_ns) == b""


@pytest.mark.parametrize(
    ("model", "dtr", "goodbye"),
    [
        ("rplidar_a1", (False, True), (STOP,)),
        ("ydlidar_x4", (True, False), (b"\xa5\x00", b"\xa5\x65")),
        ("rplidar_c1", (None, None), (STOP, bytes.fromhex("A5A80200000F"))),
        ("rplidar_a2", (False, True), (STOP, bytes.fromhex("A5F002000057"))),
        ("ld19", (None, None), ()),
        ("ydlidar_x2", (True, False), ()),
        ("ydlidar_tmini", (True, False), (b"\xa5\x00", b"\xa5\x65")),
        ("xv11", (None, None), ()),
        ("lds01", (None, None), (b"e",)),
    ],
)
def test_what_stops_it(model: str, dtr: tuple[bool | None, ...], goodbye: tuple[bytes]) -> None:
    lidar = Session(LidarConfig(model=model)).lidar
    assert (lidar.line.dtr, lidar.line.dtr_after) == dtr
    assert lidar.goodbye() == goodbye


def test_a_hokuyo_that_makes_no_sense_is_asked_until_it_does() -> None:
    device = Asked("Hokuyo URG")
    right = device.answers[b"PP\n"]
    device.answers[b"PP\n"] = right.replace(b"AMAX:725;o", b"AMAX:725;p")  # its sum is wrong
    session = Session(LidarConfig(model="hokuyo_urg"), device)
    session.wait(2.0)
    assert not device.streams
    assert "does not say in full how it measures" in session.status.message
    device.answers[b"PP\n"] = right
    session.wait_for_stream()
    session.hear(stream("Hokuyo URG", 0.5, 0.001))
    assert session.status.state == "up"
    assert len(session.scans) == 4
    assert session.lidar.goodbye() == (b"QT\n",)


def test_a_hokuyo_is_asked_for_intensities_and_may_refuse_them() -> None:
    session = started("Hokuyo UTM-30LX")
    session.hear(stream("Hokuyo UTM-30LX", 0.2, 0.001))
    scan = session.scans[-1]
    assert (scan.ranges > 0.0).sum() == UTM_STEPS
    seen = scan.intensities[scan.ranges > 0.0]
    assert np.diff(seen) == pytest.approx(3.0, abs=0.01)
    assert not scan.intensities[scan.ranges == 0.0].any()
    session = started("Hokuyo URG")
    assert session.device.heard[-2:] == [b"ME0044072501000\n", b"MD0044072501000\n"]
    session.hear(stream("Hokuyo URG", 0.5, 0.001))
    assert len(session.scans[-1].intensities) == 0


def test_a_hokuyo_that_was_left_telling_its_time_measures() -> None:
    """In that state it tells its version, and refuses all else."""
    device = Asked("Hokuyo URG")
    refused = {b"PP\n": b"PP\n10Q\n\n"}
    right, device.answers = device.answers, device.answers | refused

    def hear(data: bytes, now_ns: int) -> bytes:
        if b"TM2\n" in data:
            device.answers = right
        return Asked.hear(device, data, now_ns)

    device.hear = hear  # type: ignore[method-assign]
    session = Session(LidarConfig(model="hokuyo_urg"), device)
    session.wait_for_stream()
    session.hear(stream("Hokuyo URG", 0.5, 0.001))
    assert session.status.state == "up"


def test_a_hokuyo_that_says_its_own_limits_is_believed() -> None:
    device = Asked("Hokuyo URG")
    device.answers[b"PP\n"] = device.answers[b"PP\n"].replace(b"DMAX:5600;_", b"DMAX:2500;[")
    session = Session(LidarConfig(model="hokuyo_urg"), device)
    session.wait_for_stream()
    session.hear(stream("Hokuyo URG", 0.5, 0.001))
    scan = session.scans[-1]
    assert (scan.range_min, scan.range_max) == pytest.approx((0.02, 2.5))
    # What is farther is the number of an error, and no free way.
    assert np.isfinite(scan.ranges).all()
    assert 2.0 < scan.ranges.max() <= 2.5


@given(
    data=st.lists(st.sampled_from([*HOKUYO_PIECES, b"\n", b"A", b"\xff", b"0" * 70]), max_size=40)
)
@settings(deadline=None, max_examples=cases(50))
def test_nothing_that_a_hokuyo_could_say_stops_its_driver(data: list[bytes]) -> None:
    session = Session(LidarConfig(model="hokuyo_urg"))
    for piece in data:
        session.wait(0.1)
        session.lidar.receive(piece, session.now_ns)
    assert session.status.state in ("searching", "down", "up")
