"""Print what is nearest to the robot, for ten revolutions of the lidar."""

import itertools

import numpy as np

from trolley import Robot

with Robot() as robot:
    for scan in itertools.islice(robot.scans(timeout=5.0), 10):
        distance = np.linalg.norm(scan.points(), axis=1)
        print(f"{len(distance)} echoes, the nearest at {distance.min(initial=np.inf):.2f} m")
