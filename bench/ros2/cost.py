"""What `trolley ros2` costs beside a simulated robot: idle, with all topics wanted, and flooded.

python -m bench.ros2.cost [--seconds 10]
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from trolley import ports
from trolley.connection import Connection
from trolley.runtime.foreign_bus import ForeignBus, open_foreign_bus
from trolley_ros2 import cdr
from trolley_ros2.names import NO_HASH, Attachment, Endpoint, Qos

TROLLEY = str(Path(sys.executable).with_name("trolley"))
ROBOT = "bench"
FLOOD_HZ = 1000.0
PATIENCE_S = 120.0


def _cpu_s(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _start(folder: str, *arguments: str) -> "subprocess.Popen[bytes]":
    environment = {**os.environ, "TROLLEY_CONFIG": "", "TROLLEY_STATE": folder}
    return subprocess.Popen(
        [TROLLEY, *arguments],
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )


def _wait(endpoint: str, service: str) -> None:
    """Wait until somebody whose name begins so is there."""
    deadline_s = time.monotonic() + PATIENCE_S
    while time.monotonic() < deadline_s:
        if ports.is_listening(ports.port_of(endpoint) or 0):
            with Connection([endpoint]) as connection:
                if any(name.startswith(service) for _, name in connection.services(ROBOT)):
                    return
        time.sleep(0.5)
    raise SystemExit(f"{service} did not start")


def _flood(ros: ForeignBus, seconds: float) -> None:
    """Publish a velocity of zero, as a node does that has gone mad."""
    vector: Any = cdr.make("geometry_msgs/msg/Vector3", 0.0, 0.0, 0.0)
    payload = cdr.write(cdr.make(cdr.TWIST, vector, vector))
    key = Endpoint(f"/{ROBOT}/cmd_vel", cdr.TWIST, NO_HASH, Qos(1)).key(0)
    publisher = ros.publisher(key, keeps_newest=False, on_heard=lambda: None)
    began_s = time.monotonic()
    for number in range(1, round(seconds * FLOOD_HZ)):
        publisher.put(payload, Attachment(number, time.time_ns(), bytes(16)).pack())
        time.sleep(max(0.0, began_s + number / FLOOD_HZ - time.monotonic()))


def main() -> None:
    """Measure."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=10.0)
    seconds = parser.parse_args().seconds
    port = next(one for one in range(17_447, 18_000) if ports.is_free(one))
    endpoint = f"tcp/127.0.0.1:{port}"
    with tempfile.TemporaryDirectory() as folder:
        demo = _start(folder, "demo", "--headless", "--port", str(port), "--name", ROBOT)
        bridge = None
        try:
            _wait(endpoint, "tour")
            bridge = _start(folder, "ros2", "--connect", endpoint, "--robot", ROBOT)
            _wait(endpoint, "ros2-")
            time.sleep(2.0)
            with open_foreign_bus([endpoint], PATIENCE_S) as ros:
                pid = bridge.pid

                def report(what: str, before_s: float) -> None:
                    share = 100.0 * (_cpu_s(pid) - before_s) / seconds
                    print(f"{what}: {share:.1f} % of a core")

                before_s = _cpu_s(pid)
                time.sleep(seconds)
                report("nobody subscribes", before_s)
                before_s = _cpu_s(pid)
                _flood(ros, seconds)
                report(f"{FLOOD_HZ:g} velocities a second", before_s)
                ros.subscribe(f"0/{ROBOT}/**", lambda _sample: None)
                time.sleep(2.0)
                before_s = _cpu_s(pid)
                time.sleep(seconds)
                report("all topics subscribed to", before_s)
        finally:
            for process in filter(None, (bridge, demo)):
                process.terminate()
                process.wait()
    print("load of this machine: {:.1f}, {:.1f}, {:.1f}".format(*os.getloadavg()))


if __name__ == "__main__":
    main()
