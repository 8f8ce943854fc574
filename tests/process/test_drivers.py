"""The example's drivers, installed as a package is: found, emulated and driven like ours."""

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from support.metal import NAME, Hand, make_hall
from support.processes import Process, write_config
from support.waiting import PATIENCE_S, wait_until

from trolley import topics
from trolley.client import Robot
from trolley.config import load_config
from trolley.connection import Connection
from trolley.geometry import Twist2D
from trolley.messages import floats_from_bytes

EXAMPLE = Path(__file__).parents[2] / "examples/driver"


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the example is installed, and a package whose driver is broken."""
    site = tmp_path_factory.mktemp("site")
    uv = str(Path(sys.executable).with_name("uv"))
    how = ["--offline", "--no-index", "--no-deps", "--no-build-isolation", "--target", str(site)]
    done = subprocess.run(
        [uv, "pip", "install", *how, str(EXAMPLE)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    (site / "broken.py").write_text("import a_library_that_is_not_here\n")
    info = site / "broken-0.1.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: broken\nVersion: 0.1\n")
    (info / "entry_points.txt").write_text("[trolley.lidars]\nbroken = broken:DRIVERS\n")
    return site


def test_a_driver_of_ones_own_is_detected_emulated_and_driven(
    tmp_path: Path,
    site: Path,
    endpoint: str,
    monkeypatch: pytest.MonkeyPatch,
    trolley: Callable[..., subprocess.CompletedProcess[str]],
) -> None:
    monkeypatch.setenv("PYTHONPATH", str(site))
    ports = tmp_path / "ports"
    world = str(make_hall(tmp_path).resolve())
    arguments = ["emulate", "acme_m1", "acme_x1", "--ports", str(ports), "--world", world]
    emulator = Process(["-m", "trolley.cli", *arguments], tmp_path / "emulator.log")
    config = write_config(tmp_path / "robot.toml", endpoint, NAME)
    base = None
    try:
        wait_until((ports / "acme_x1").exists, lambda: emulator.log)
        named = [str(ports / name) for name in ("acme_m1", "acme_x1")]
        done = trolley("detect", *named, "--json", "--write", str(config))
        assert done.returncode == 0, done.stderr
        report = json.loads(done.stdout)
        found = [(one["found"]["model"], one["found"]["baud"]) for one in report["ports"]]
        assert found == [("acme_m1", 115200), ("acme_x1", 460800)]
        assert report["ports"][0]["found"]["details"] == ["firmware 7"]
        (left_out,) = [note for note in report["notes"] if "not used" in note]
        assert "lidar broken in broken 0.1" in left_out
        assert "No module named 'a_library_that_is_not_here'" in left_out

        with config.open("a") as file:
            file.write("\n[base.lidar.settings]\nadd_m = 0.05\n")
        assert load_config(config).base.lidar.model == "acme_x1"
        base = Process(["-m", "trolley_base", "--config", str(config)], tmp_path / "base.log")
        with Connection([endpoint], PATIENCE_S) as connection:
            robot = Robot.over(connection, NAME)
            with robot.subscribe(topics.SCAN) as scans, robot.subscribe(topics.ODOM) as odometry:
                first = scans.next(PATIENCE_S)
                assert first is not None, base.log
                scan = first.message
                ahead = floats_from_bytes(scan.ranges)[
                    np.argmin(np.abs(scan.angle_min + np.arange(360) * scan.angle_increment))
                ]
                assert ahead == pytest.approx(3.05, abs=0.06)
                hand = Hand(robot)
                try:
                    hand.drive(Twist2D(0.2, 0.0, 0.0))
                    wait_until(
                        lambda: (one := odometry.next(PATIENCE_S)) and one.message.pose.x > 0.1,
                        lambda: base.log if base else "",
                    )
                finally:
                    hand.close()
    finally:
        for process in (base, emulator):
            if process is not None:
                process.kill()
