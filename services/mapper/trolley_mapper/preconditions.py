"""What must be known before a map is begun."""

from collections.abc import Sequence

from trolley import codes, topics
from trolley.codes import Refused
from trolley.gridmap.wire import grid_of
from trolley.messages import MappingStatus, OccupancyGrid, PoseEstimate, Transform, Zones
from trolley.runtime.service import Later, Service
from trolley_mapper.map_session import Making


class Beginning:
    """A request to make a map, until the robot has been heard.

    Args:
        service: that was asked.
        making: what is to be made.
        extends: the map that it shall begin with, which the localizer is on.
    """

    def __init__(self, service: Service, making: Making, extends: str | None) -> None:
        self.making = making
        self.reply: Later[MappingStatus] = service.later()
        self.until_ns = 0
        self._extends = extends
        self._map: OccupancyGrid | None = None
        self._zones: Zones | None = None
        self._pose: PoseEstimate | None = None
        self._correction: Transform | None = None
        if extends is not None:
            service.get(topics.MAP, then=self._take_map)
            service.get(topics.ZONES, then=self._take_zones)
            service.get(topics.POSE, then=self._take_pose)
            service.get(topics.TF, "odom", then=self._take_correction)

    def missing(self) -> list[str]:
        """Return the names of what has not come, of that which the localizer knows."""
        if self._extends is None:
            return []
        needed = (("map", self._map), ("zones", self._zones), ("pose", self._pose))
        return [name for name, known in needed if known is None]

    def check(self, missing: Sequence[str]) -> None:
        """Let the map begin, with the one that the robot is on where that is extended.

        Args:
            missing: names of what has not come in time.

        Raises:
            Refused: something is missing; it is on another map, or not sure where.
        """
        if missing:
            raise Refused(
                codes.NOT_READY,
                f"A map cannot be made yet: nothing is heard of {', '.join(missing)}.",
                missing=missing,
            )
        if self._extends is None:
            return
        grid, pose, correction = self._map, self._pose, self._correction
        if grid is None or grid.name != self._extends:
            on = "none" if grid is None else grid.name
            raise Refused(
                codes.WRONG_MAP, f"The robot is on the map {on}; load {self._extends} first."
            )
        if pose is None or pose.state != "localized" or correction is None:
            raise Refused(codes.NOT_LOCALIZED)
        self.making.prior = grid_of(grid)
        self.making.map_T_odom = correction.pose
        self.making.zones = [] if self._zones is None else self._zones.zones

    def _take_map(self, found: dict[tuple[str, ...], OccupancyGrid]) -> None:
        self._map = found.get(())

    def _take_zones(self, found: dict[tuple[str, ...], Zones]) -> None:
        self._zones = found.get(())

    def _take_pose(self, found: dict[tuple[str, ...], PoseEstimate]) -> None:
        self._pose = found.get(())

    def _take_correction(self, found: dict[tuple[str, ...], Transform]) -> None:
        self._correction = found.get(("odom",))
