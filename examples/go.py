"""Drive to a place, and say how it goes and how it ends.

python examples/go.py kitchen
"""

import sys

from trolley import Robot

place = sys.argv[1] if len(sys.argv) > 1 else "kitchen"
with Robot() as robot:
    goal = robot.go_to(place, wait=False, speed=0.3)
    for status in robot.follow(goal.id):
        left = status.distance_remaining
        print(status.state, "" if left is None else f"{left:.1f} m to go", status.message)
