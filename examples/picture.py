"""Save a picture of the map, with the robot and what the lidar sees.

python examples/picture.py map.png
"""

import sys

from trolley import Robot

with Robot() as robot:
    robot.picture(1200).save(sys.argv[1] if len(sys.argv) > 1 else "map.png")
