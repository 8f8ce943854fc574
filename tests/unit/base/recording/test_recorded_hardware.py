"""Recorded drives as hardware, and what is said about files that are none."""

import io
import math
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from trolley.geometry import Pose2D, Twist2D
from trolley_base.drivers import DriverError, Hardware
from trolley_base.recording.recorded_device import load_recording
from trolley_base.recording.recorded_hardware import RecordedHardware

MS = 1_000_000
START_NS = 7_000_000_000


def fields() -> dict[str, Any]:
    """A drive of 1 s: forward 0.5 m, then a gap, in which it turns left by 90 degrees."""
    return {
        "stamps": np.array([100.0, 100.25, 100.5, 101.0]),
        "odom": np.array(
            [[3.0, 4.0, 0.5], [3.2, 4.0, 0.5], [3.5, 4.0, 0.5], [3.5, 4.0, 0.5 + math.pi / 2]]
        ),
        "reference": np.array([[1.0, 2.0, 0.3]] * 4),
        "ranges_mm": np.array([[1000, 65535, 0, 9000]] * 4, dtype=np.uint16),
        "angle_min": np.float64(-1.0),
        "angle_increment": np.float64(0.5),
        "range_max": np.float64(8.0),
        "laser_in_base": np.array([0.1, 0.0, 1.5]),
    }


def write(folder: Path, **changes: Any) -> Path:
    file = folder / "drive.npz"
    content = {name: value for name, value in {**fields(), **changes}.items() if value is not None}
    np.savez(file, **content)
    return file


def test_scans_keep_the_spacing_of_the_file(tmp_path: Path) -> None:
    hardware = RecordedHardware(load_recording(write(tmp_path)), START_NS)
    stamps = []
    for step in range(0, 1001, 10):
        hardware.advance(START_NS + step * MS)
        for scan in hardware.lidar.read().scans:
            stamps.append((scan.stamp_ns - START_NS) // MS)
            np.testing.assert_array_equal(
                scan.ranges, np.array([1.0, np.inf, 0.0, np.inf], np.float32)
            )
            assert (scan.angle_min, scan.angle_increment) == (-1.0, 0.5)
    assert stamps == [0, 250, 500, 1000]
    assert hardware.has_ended


def test_odometry_starts_at_zero_and_comes_at_20_hz(tmp_path: Path) -> None:
    hardware = RecordedHardware(load_recording(write(tmp_path)), START_NS)
    odom_T_base, poses, stamps = Pose2D.identity(), [], []
    hardware.advance(START_NS + 1000 * MS)
    for motion in hardware.chassis.read().motions:
        odom_T_base = odom_T_base @ motion.previous_T_base
        poses.append(odom_T_base)
        stamps.append((motion.stamp_ns - START_NS) // MS)
    assert stamps == list(range(50, 1001, 50))
    first = Pose2D(3.0, 4.0, 0.5)
    expected = first.inverse() @ Pose2D(3.2, 4.0, 0.5)
    assert poses[4].distance_to(expected) < 1e-9
    assert poses[14].yaw == pytest.approx(math.pi / 4)
    assert poses[-1].yaw == pytest.approx(math.pi / 2)


def test_the_velocity_is_that_of_the_recording(tmp_path: Path) -> None:
    hardware = RecordedHardware(load_recording(write(tmp_path)), START_NS)
    hardware.advance(START_NS + 700 * MS)
    twist = hardware.chassis.read().motions[-1].twist
    assert twist.wz == pytest.approx(math.pi)
    assert twist.speed < 1e-9


def test_commands_change_nothing(tmp_path: Path) -> None:
    hardware = RecordedHardware(load_recording(write(tmp_path)), START_NS)
    hardware.chassis.drive(Twist2D(9.0, 0.0, 9.0))
    hardware.advance(START_NS + 50 * MS)
    assert hardware.chassis.read().motions[0].previous_T_base.distance_to(
        Pose2D.identity()
    ) == pytest.approx(0.04)


def test_at_the_end_it_stands_and_goes_on_to_see(tmp_path: Path) -> None:
    devices: Hardware = RecordedHardware(load_recording(write(tmp_path)), START_NS)
    devices.advance(START_NS + 1000 * MS)
    devices.chassis.read()
    devices.lidar.read()
    devices.advance(START_NS + 2000 * MS)
    motions, scans = devices.chassis.read().motions, devices.lidar.read().scans
    assert [motion.twist.is_zero for motion in motions] == [True] * 20
    assert [(scan.stamp_ns - START_NS) // MS for scan in scans] == [1250, 1500, 1750, 2000]
    devices.close()


def test_the_signed_odometry_is_preferred(tmp_path: Path) -> None:
    signed = fields()["odom"] * -1.0
    assert load_recording(write(tmp_path, odom_signed=signed)).odom[0, 0] == -3.0


def test_mount_and_start_are_told(tmp_path: Path) -> None:
    recording = load_recording(write(tmp_path))
    assert recording.base_T_laser == Pose2D(0.1, 0.0, 1.5)
    assert recording.map_T_start == Pose2D(1.0, 2.0, 0.3)
    bare = load_recording(write(tmp_path, laser_in_base=None, reference=None))
    assert bare.base_T_laser == Pose2D.identity()
    assert bare.map_T_start is None


@pytest.mark.parametrize(
    ("field", "value", "words"),
    [
        ("stamps", None, "is missing"),
        ("stamps", np.array([0.0, 1.0, 1.0, 2.0]), "each later"),
        ("stamps", np.array([0.0]), "at least two"),
        ("stamps", np.array([0.0, np.nan, 1.0, 2.0]), "not finite"),
        ("stamps", np.array([0.0, 1e30, 2e30, 3e30]), "in seconds"),
        ("odom", None, "is missing"),
        ("odom", np.zeros((3, 3)), "shape"),
        ("odom", np.zeros((4, 2)), "shape"),
        ("odom", np.array([["a"] * 3] * 4), "numbers"),
        ("ranges_mm", np.zeros((4, 9)), "uint16"),
        ("ranges_mm", np.zeros((3, 9), np.uint16), "each of the 4 stamps"),
        ("ranges_mm", np.zeros((4, 0), np.uint16), "each of the 4 stamps"),
        ("angle_min", np.array([1.0, 2.0]), "shape"),
        ("angle_increment", np.float64(-0.1), "above zero"),
        ("range_max", np.float64(np.inf), "not finite"),
        ("laser_in_base", np.zeros(2), "shape"),
        ("reference", np.full((4, 3), np.nan), "not finite"),
    ],
)
def test_a_bad_field_is_named(tmp_path: Path, field: str, value: Any, words: str) -> None:
    file = write(tmp_path, **{field: value})
    with pytest.raises(DriverError) as caught:
        load_recording(file)
    message = str(caught.value)
    assert str(file) in message
    assert f"`{field}`" in message
    assert words in message


def test_files_that_are_no_recordings_are_refused(tmp_path: Path) -> None:
    file = tmp_path / "drive.npz"
    single = io.BytesIO()
    np.save(single, np.zeros(3))
    whole = write(tmp_path).read_bytes()
    for content in (b"", b"hello", pickle.dumps([1]), whole[: len(whole) // 2], single.getvalue()):
        file.write_bytes(content)
        with pytest.raises(DriverError, match=r"drive\.npz"):
            load_recording(file)
    with pytest.raises(DriverError, match="cannot be read"):
        load_recording(tmp_path / "none.npz")
    np.savez(file, **{**fields(), "odom": np.array([{}], dtype=object)}, allow_pickle=True)
    with pytest.raises(DriverError, match=r"drive\.npz"):
        load_recording(file)


@pytest.mark.parametrize("name", ["freiburg-079", "create3-rplidar-mac"])
def test_real_recordings_play_to_their_end(recordings: Path, name: str) -> None:
    recording = load_recording(recordings / f"{name}.npz")
    hardware = RecordedHardware(recording, START_NS)
    odom_T_base, scans = Pose2D.identity(), 0
    now_ns, end_ns = START_NS, START_NS + int(recording.stamps_ns[-1])
    while now_ns <= end_ns:
        hardware.advance(now_ns)
        for motion in hardware.chassis.read().motions:
            odom_T_base = odom_T_base @ motion.previous_T_base
        scans += len(hardware.lidar.read().scans)
        now_ns += 25 * MS
    hardware.advance(end_ns + 50 * MS)
    for motion in hardware.chassis.read().motions:
        odom_T_base = odom_T_base @ motion.previous_T_base
    scans += sum(scan.stamp_ns <= end_ns for scan in hardware.lidar.read().scans)
    first, last = (Pose2D.from_array(recording.odom[row]) for row in (0, -1))
    assert odom_T_base.distance_to(first.inverse() @ last) < 1e-6
    assert scans == len(recording.stamps_ns)
