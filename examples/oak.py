"""A Luxonis OAK-D as a further sense, with `pip install "depthai<3"`: see depth.py.

    python examples/oak.py front --height 0.25 --tilt 20

Written from depthai's documentation, and not run yet: there was no camera to try it with.
"""

import argparse
import importlib
import math
import sys

from depth import Camera, DepthScanner, metres

from trolley import Robot, topics

COLUMNS, ROWS = 640, 400


def main() -> None:
    """Publish what the camera sees until it is ended."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("name", help="of the sense, as in [base.scans.NAME]")
    parser.add_argument("--height", type=float, required=True, help="above the floor [m]")
    parser.add_argument("--tilt", type=float, default=0.0, help="looks down by this [degrees]")
    given = parser.parse_args()
    try:
        dai = importlib.import_module("depthai")
    except ImportError:
        sys.exit('depthai is not installed here: pip install "depthai<3"')
    pipeline = dai.Pipeline()
    stereo = pipeline.create(dai.node.StereoDepth)
    for socket, into in (("CAM_B", stereo.left), ("CAM_C", stereo.right)):
        camera = pipeline.create(dai.node.MonoCamera)
        camera.setBoardSocket(getattr(dai.CameraBoardSocket, socket))
        camera.setResolution(dai.MonoCameraProperties.SensorResolution.THE_400_P)
        camera.setFps(10.0)
        camera.out.link(into)
    stereo.setLeftRightCheck(True)
    out = pipeline.create(dai.node.XLinkOut)
    out.setStreamName("depth")
    stereo.depth.link(out.input)
    with Robot() as robot, dai.Device(pipeline) as device:
        # Depth is as the right camera sees it.
        matrix = device.readCalibration().getCameraIntrinsics(
            dai.CameraBoardSocket.CAM_C, COLUMNS, ROWS
        )
        focal, centre = (matrix[0][0], matrix[1][1]), (matrix[0][2], matrix[1][2])
        seen = Camera(focal, centre, given.height, math.radians(given.tilt))
        scanner = DepthScanner(seen, (ROWS, COLUMNS))
        images = device.getOutputQueue("depth", maxSize=1, blocking=False)
        while True:
            depth = metres(images.get().getFrame())
            stamp_ns = robot.now_ns()
            if stamp_ns is not None:
                robot.publish(topics.SENSE, scanner.scan(depth, stamp_ns, given.name), given.name)


if __name__ == "__main__":
    main()
