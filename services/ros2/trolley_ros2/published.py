"""The robot's topics as ROS 2 nodes and bags have them: names, types and quality."""

from dataclasses import dataclass
from typing import Any

from trolley.messages import Odometry, Transform
from trolley_ros2 import cdr, to_ros
from trolley_ros2.names import Qos

SENSOR = Qos(depth=10)
TREE = Qos(depth=100)
"""As tf2's broadcasters publish."""
KEPT = Qos(depth=1, is_transient_local=True)
"""As `map_server` and AMCL publish: who comes later gets the newest."""
NEWEST = Qos(depth=1)
MOVING_FRAMES = ("odom", "base_link")
"""Frames that are on `/tf`; those on the robot are on `/tf_static`."""
MOST_FRAMES = 64
"""Frames on `/tf_static`: any program may publish some, and all are said again with each."""


@dataclass(frozen=True, slots=True)
class RosTopic:
    """A topic that ROS 2 users know.

    Attributes:
        name: below the robot's namespace.
        type_name: `sensor_msgs/msg/LaserScan`.
        qos: as it is published.
    """

    name: str
    type_name: str
    qos: Qos


SCAN = RosTopic("scan", cdr.LASER_SCAN, SENSOR)
ODOM = RosTopic("odom", cdr.ODOMETRY, SENSOR)
TF = RosTopic("tf", cdr.TF_MESSAGE, TREE)
TF_STATIC = RosTopic("tf_static", cdr.TF_MESSAGE, KEPT)
MAP = RosTopic("map", cdr.OCCUPANCY_GRID, KEPT)
AMCL_POSE = RosTopic("amcl_pose", cdr.POSE_WITH_COVARIANCE, KEPT)
PLAN = RosTopic("plan", cdr.PATH, NEWEST)
LOCAL_COSTMAP = RosTopic("local_costmap/costmap", cdr.OCCUPANCY_GRID, KEPT)


class TooManyFrames(Exception):
    """Programs publish more frames than `/tf_static` says."""


class Tree:
    """The frames, as `/tf` and `/tf_static` say them."""

    def __init__(self) -> None:
        self.map_T_odom: Transform | None = None
        """The newest correction, None while there is none."""
        self._mounts: dict[str, Transform] = {}

    def moving(self, odometry: Odometry, stamp_ns: int) -> Any:
        """What `/tf` says with each odometry.

        The correction holds until the next one: it is said anew each time, as AMCL does, so that
        what is seen now can be placed on the map now.
        """
        known = [to_ros.base_in_odom(odometry)]
        if self.map_T_odom is not None:
            known.insert(0, self.map_T_odom)
        return to_ros.transforms((one, stamp_ns) for one in known)

    def fixed(self, mount: Transform, child: str, stamp_ns: int) -> Any | None:
        """What `/tf_static` says after a new mount; None where that frame moves.

        All of them each time, as tf2's static broadcaster does: only the newest message is kept.

        Raises:
            TooManyFrames: It is one more than `MOST_FRAMES`.
        """
        if child in MOVING_FRAMES:
            return None
        if child not in self._mounts and len(self._mounts) >= MOST_FRAMES:
            raise TooManyFrames
        self._mounts[child] = mount
        return to_ros.transforms((one, stamp_ns) for one in self._mounts.values())
