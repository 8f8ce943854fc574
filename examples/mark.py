"""Draw a flag where the robot is; everybody sees it in the viewer."""

from trolley import Robot
from trolley.messages import Marker

with Robot() as robot:
    here = robot.pose().pose
    if here is not None:
        flag = Marker(kind="icon", icon="flag", frame="map", pose=here, z=0.4)
        robot.put_marker("examples", "flag", flag)
