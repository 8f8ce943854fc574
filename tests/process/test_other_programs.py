"""Emulated devices on their ports, driven by other people's programs."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pycreate2
import pytest
import serial
from pyrplidarsdk import RplidarDriver
from support.processes import Process
from support.room_with_posts import distances_to_walls, make_world
from support.waiting import wait_until

from trolley.geometry import Pose2D
from trolley_base.emulators.catalogue import LIDARS
from trolley_base.emulators.lidar import Mount
from trolley_base.world import LidarSpec

pytestmark = pytest.mark.slow

SLAMTEC = [model for model in LIDARS if model.startswith("rplidar_")]
NUM_SCANS = 8
NEAR_M = 0.01
"""How near echoes are to a wall; what an A2 or A3 sends is rounded to 4 mm and more."""


@contextmanager
def emulated(device: str, folder: Path) -> Iterator[str]:
    """The port of a device that another process emulates."""
    port = folder / "ports" / device
    words = ["-m", "trolley.cli", "emulate", "--quiet", device, "--ports", str(port.parent)]
    process = Process([*words, "--world", str(make_world(folder))], folder / "emulate.log")
    try:
        wait_until(port.exists, f"{device} is on its port")
        yield str(port)
    finally:
        process.kill()


@pytest.mark.parametrize("model", SLAMTEC)
def test_the_makers_sdk_sees_the_walls_where_they_are(model: str, tmp_path: Path) -> None:
    baud = LIDARS[model](Mount(Pose2D.identity()), LidarSpec(), np.random.default_rng(1)).baud
    with emulated(model, tmp_path) as port:
        sdk = RplidarDriver(port=port, baudrate=baud)
        assert sdk.connect()
        about, health = sdk.get_device_info(), sdk.get_health()
        assert about is not None
        assert about.serial_number
        assert health is not None
        assert health.status == 0
        assert sdk.start_scan()
        scans: list[Any] = []
        wait_until(lambda: take_scan(sdk, scans), "it has scanned the room")
        sdk.stop_scan()
        sdk.disconnect()
    seen = np.hstack([np.array(scan[:2]) for scan in scans[2:]])  # it has come up to speed
    angles, ranges = seen[:, seen[1] > 0.0]
    assert np.unique(np.floor(np.degrees(angles))).size == 360
    off = np.abs(distances_to_walls(-angles) - ranges)
    assert np.median(off) < NEAR_M
    assert np.percentile(off, 95.0) < 2.0 * NEAR_M


def take_scan(sdk: RplidarDriver, scans: list[Any]) -> bool:
    """Wait for a scan, and keep it; whether there are enough."""
    if (scan := sdk.get_scan_data()) is not None:
        scans.append(scan)
    return len(scans) >= NUM_SCANS


def test_pycreate2_drives_a_create_2(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for line in ("_update_dtr_state", "_update_rts_state"):  # a pseudo-terminal has neither
        monkeypatch.setattr(serial.Serial, line, lambda _: None)
    with emulated("create2", tmp_path) as port:
        drive_about(port)


def drive_about(port: str) -> None:
    """Start, drive a bend and stop; the robot is let go at the end, as pycreate2 wants it."""
    robot = pycreate2.Create2(port)
    robot.start()
    robot.safe()
    first = robot.get_sensors()
    assert 12_000 < first.voltage < 17_000
    assert not any(first.bumps_wheeldrops)
    robot.drive_direct(100, 60)  # right, left
    wait_until(lambda: turned(first, robot.get_sensors())[0] > 200, "its right wheel turns")
    right, left = turned(first, robot.get_sensors())
    assert 0.4 * right < left < 0.75 * right
    robot.drive_direct(0, 0)
    wait_until(lambda: robot.get_sensors().velocity_right == 0, "it is told to stop")


def turned(before: pycreate2.packets.Sensors, after: pycreate2.packets.Sensors) -> tuple[int, int]:
    """How far right and left wheel have turned since, in counts of 16 bits."""
    right = after.encoder_counts_right - before.encoder_counts_right
    left = after.encoder_counts_left - before.encoder_counts_left
    return right % 65536, left % 65536
