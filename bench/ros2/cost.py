"""What `trolley ros2` costs beside a simulated robot: idle, with all topics wanted, and flooded.

python -m bench.ros2.cost [--seconds 10]
"""

import argparse
import os
import tempfile
import threading
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from bench.stack.bridges import (
    PATIENCE_S,
    ROBOT,
    TROLLEY,
    find_free_port,
    running,
    share,
    wait_for,
)

from trolley.runtime.foreign_bus import ForeignBus, open_foreign_bus
from trolley_ros2 import cdr
from trolley_ros2.names import NO_HASH, Attachment, Endpoint, Qos

FLOOD_HZ = 1000.0


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
    port = find_free_port(17_447)
    endpoint = f"tcp/127.0.0.1:{port}"
    demo = (TROLLEY, "demo", "--headless", "--port", str(port), "--name", ROBOT)
    ros2 = (TROLLEY, "ros2", "--connect", endpoint, "--robot", ROBOT)
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        stack.enter_context(running(folder, *demo))
        wait_for(endpoint, "tour")
        bridge = stack.enter_context(running(folder, *ros2))
        wait_for(endpoint, "ros2-")
        time.sleep(2.0)
        ros = stack.enter_context(open_foreign_bus([endpoint], PATIENCE_S))
        print(f"nobody subscribes: {100.0 * share(bridge, seconds):.1f} % of a core")
        flood = threading.Thread(target=_flood, args=(ros, seconds))
        flood.start()
        print(f"{FLOOD_HZ:g} velocities a second: {100.0 * share(bridge, seconds):.1f} % of a core")
        flood.join()
        ros.subscribe(f"0/{ROBOT}/**", lambda _sample: None)
        time.sleep(2.0)
        print(f"all topics subscribed to: {100.0 * share(bridge, seconds):.1f} % of a core")
    print("load of this machine: {:.1f}, {:.1f}, {:.1f}".format(*os.getloadavg()))


if __name__ == "__main__":
    main()
