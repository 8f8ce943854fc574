"""Print where the robot is, and whether it is sure of that."""

from trolley import Robot

with Robot() as robot:
    estimate = robot.wait_until_localized(timeout=30.0)
    print(f"{robot.name} is at {estimate.pose} on the map {estimate.map}")
    print(f"{estimate.match:.0%} of the beams fit the map")
