"""The map from above with the robot on it, as a picture at the broker."""

import numpy as np

from trolley.gridmap.wire import grid_of
from trolley.messages.types import floats_from_bytes
from trolley.picture import MapPicture
from trolley.runtime.service import Service
from trolley_mqtt.outbox import Outbox
from trolley_mqtt.robot_inputs import RobotInputs

SIDE = 640
"""The longer side of the picture [pixels]; some 10 to 40 kB."""
MOVED_M, TURNED_RAD = 0.1, 0.2
"""The robot must have moved, or turned, so far that a new picture is worth it."""


class MapImage:
    """Draws anew when something of it has changed, at most once in a while.

    Args:
        service: the bridge.
        robot: what is drawn.
        outbox: where it goes.
        every_s: time between two pictures [s]; 0: none is drawn.
    """

    def __init__(
        self, service: Service, robot: RobotInputs, outbox: Outbox, every_s: float
    ) -> None:
        self._service = service
        self._robot = robot
        self._outbox = outbox
        self._every_s = every_s
        self._shown: tuple[object, ...] = ()
        self._next_ns = 0
        self._is_drawing = False

    def update(self) -> None:
        """Draw and send a picture, if there is a new one to be seen."""
        now_ns = self._service.monotonic_ns
        if not self._every_s or self._is_drawing or now_ns < self._next_ns:
            return
        picture, seen = self._picture()
        if picture is None or seen == self._shown:
            return
        self._shown, self._is_drawing = seen, True
        self._next_ns = now_ns + round(self._every_s * 1e9)
        self._service.work(lambda: picture.png(SIDE), self._send)

    def repeat(self) -> None:
        """Draw anew at the next `update`: the broker may have forgotten."""
        self._shown, self._next_ns = (), 0

    def _send(self, png: bytes) -> None:
        self._is_drawing = False
        if self._outbox.is_open:
            self._outbox.keep(self._outbox.topic("map"), png)

    def _picture(self) -> tuple[MapPicture | None, tuple[object, ...]]:
        """What would be drawn, and by what one tells it from another."""
        robot = self._robot
        grid = robot.map.latest
        if grid is None:
            return None, ()
        view, about, path = robot.view, robot.about.latest, robot.path.latest
        pose = view.estimate.pose if view.estimate is not None and view.is_placed else None
        seen = (
            grid.name,
            grid.stamp_ns,
            None if robot.zones.latest is None else robot.zones.latest.stamp_ns,
            None if robot.poses.latest is None else robot.poses.latest.stamp_ns,
            None if path is None else path.stamp_ns,
            None
            if pose is None
            else (
                round(pose.x / MOVED_M),
                round(pose.y / MOVED_M),
                round(pose.yaw / TURNED_RAD),
            ),
        )
        points = np.empty((0, 2))
        if path is not None and path.frame == "map":
            points = floats_from_bytes(path.poses, 3)[:, :2].astype(np.float64)
        picture = MapPicture(
            grid_of(grid),
            pose,
            () if about is None else about.footprint,
            path=points,
            places=view.places,
            zones=() if robot.zones.latest is None else robot.zones.latest.zones,
        )
        return picture, seen
