"""Say of every robot on the network where it is."""

from trolley import Refused, Robot

for name in Robot.names():
    with Robot(name) as robot:
        try:
            print(f"{name}: {robot.pose().state}")
        except Refused as refused:
            print(f"{name}: {refused.message}")
