"""Print what the robot's base does, whenever that changes, for three seconds."""

import time

from trolley import Robot, topics

with Robot() as robot:
    print(f"battery: {robot.battery().fraction}")
    robot.on(topics.BASE, lambda base: print(f"{base.mode} {base.message}"))
    time.sleep(3.0)
