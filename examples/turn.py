"""Turn on the spot for a second, as a joystick would."""

import time

from trolley import Robot
from trolley.geometry import Twist2D

with Robot() as robot:
    for _ in range(20):
        robot.drive(Twist2D(0.0, 0.0, 0.5))  # the robot stands soon after the last of them
        time.sleep(0.05)
