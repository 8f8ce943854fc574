"""A Luxonis OAK-D as an extra sensor, with `pip install "depthai>=3,<4"`: see depth.py.

    python examples/oak.py front --height 0.25 --tilt 20

Its calls were checked against depthai 3.12, without a camera: there was none to try it with.
"""

import argparse
import importlib
import math
import sys
from typing import Any

from depth import Camera, DepthScanner, metres

from trolley import Robot, topics

COLUMNS, ROWS, FPS = 640, 400, 10.0


def start(dai: Any, pipeline: Any) -> Any:
    """Start both cameras and stereo on the device; return the queue of depth images."""
    left, right = (
        pipeline.create(dai.node.Camera).build(socket, sensorFps=FPS).requestOutput((COLUMNS, ROWS))
        for socket in (dai.CameraBoardSocket.CAM_B, dai.CameraBoardSocket.CAM_C)
    )
    stereo = pipeline.create(dai.node.StereoDepth).build(left, right)
    stereo.setLeftRightCheck(True)
    images = stereo.depth.createOutputQueue(maxSize=1, blocking=False)
    pipeline.start()
    return images


def camera_of(image: Any, height: float, tilt: float) -> Camera:
    """Return how a depth image was seen: it brings the numbers of the camera along."""
    matrix = image.getTransformation().getIntrinsicMatrix()
    focal, centre = (matrix[0][0], matrix[1][1]), (matrix[0][2], matrix[1][2])
    return Camera(focal, centre, height, tilt)


def age_ns(dai: Any, image: Any) -> int:
    """Return how long ago an image was exposed: stereo takes about a tenth of a second [ns]."""
    return round((dai.Clock.now() - image.getTimestamp()).total_seconds() * 1e9)


def main() -> None:
    """Publish what the camera sees until it is ended."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("name", help="of the sensor, as in [base.scans.NAME]")
    parser.add_argument("--height", type=float, required=True, help="above the floor [m]")
    parser.add_argument("--tilt", type=float, default=0.0, help="looks down by this [degrees]")
    given = parser.parse_args()
    try:
        dai = importlib.import_module("depthai")
    except ImportError:
        sys.exit('depthai is not installed here: pip install "depthai>=3,<4"')
    if not dai.__version__.startswith("3."):
        sys.exit(
            f'this is written for depthai 3, not {dai.__version__}: pip install "depthai>=3,<4"'
        )
    if not dai.Device.getAllAvailableDevices():
        sys.exit("no OAK camera is found: is it plugged in, and are Luxonis' udev rules installed?")
    with Robot() as robot, dai.Pipeline() as pipeline:
        images = start(dai, pipeline)
        scanner: DepthScanner | None = None
        while pipeline.isRunning():
            image = images.get()
            depth = metres(image.getFrame())
            if scanner is None:
                seen = camera_of(image, given.height, math.radians(given.tilt))
                scanner = DepthScanner(seen, depth.shape)
            now_ns = robot.now_ns()
            if now_ns is not None:
                scan = scanner.scan(depth, now_ns - age_ns(dai, image), given.name)
                robot.publish(topics.EXTRA_SCAN, scan, given.name)


if __name__ == "__main__":
    main()
