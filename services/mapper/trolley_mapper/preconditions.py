"""Beginning a map: what must be known before, and the requests that wait for it."""

from collections.abc import Callable, Sequence

import numpy as np

from trolley import codes, requests, topics
from trolley.codes import Refused
from trolley.config import RobotConfig
from trolley.gridmap import MAX_CELLS, GridMap
from trolley.gridmap.wire import grid_of
from trolley.messages import MappingStatus, OccupancyGrid, PoseEstimate, Transform, Zones
from trolley.messages.request_params import MapNamed
from trolley.runtime.service import Later, Service, answers, every
from trolley_mapper.map_names import check_name_is_free, why_not_overwritten
from trolley_mapper.map_session import MapSession
from trolley_mapper.mapping import ANSWER_NS, Mapping

MOST_AWAY_M = 20_000.0
"""Most that a map to be extended may lie from its origin: its walls are kept in single precision,
whose steps are 2 mm there, and half a metre in coordinates of a country [m]."""


class Preconditions:
    """What a map to be extended must have: the localizer's map, zones and pose on it.

    Args:
        service: that asks for them.
        extends: the map that the robot must be on; None: a new map needs nothing.
        resolution_m: edge of the cells in which it will be drawn [m].
    """

    def __init__(self, service: Service, extends: str | None, resolution_m: float) -> None:
        self._extends = extends
        self._resolution_m = resolution_m
        self._map: OccupancyGrid | None = None
        self._zones: Zones | None = None
        self._pose: PoseEstimate | None = None
        self._correction: Transform | None = None
        if extends is not None:
            service.get(topics.MAP, then=self._hear_map)
            service.get(topics.ZONES, then=self._hear_zones)
            service.get(topics.POSE, then=self._hear_pose)
            service.get(topics.TF, "odom", then=self._hear_correction)

    def missing(self) -> list[str]:
        """Return the names of what the localizer has not sent yet."""
        if self._extends is None:
            return []
        needed = (("map", self._map), ("zones", self._zones), ("pose", self._pose))
        return [name for name, known in needed if known is None]

    def check(self, missing: Sequence[str]) -> None:
        """Refuse to begin if anything is missing, or the robot is not where it must be.

        Args:
            missing: names of what has not come in time.

        Raises:
            Refused: `not_ready`, `wrong_map`, `not_localized`, or `bad_request` where the map is
                too large or too far away.
        """
        if missing:
            raise Refused(
                codes.NOT_READY,
                f"Mapping cannot start yet: nothing received on {', '.join(missing)}.",
                missing=missing,
            )
        if self._extends is None:
            return
        if self._map is None or self._map.name != self._extends:
            on = "no map" if self._map is None else f"the map {self._map.name}"
            raise Refused(codes.WRONG_MAP, f"The robot is on {on}; load {self._extends} first.")
        is_localized = self._pose is not None and self._pose.state == "localized"
        if not is_localized or self._correction is None:
            raise Refused(codes.NOT_LOCALIZED)
        self._check_extent(grid_of(self._map))

    def _check_extent(self, grid: GridMap) -> None:
        """Refuse a map that would take all memory, or whose walls would be blurred.

        Raises:
            Refused: `bad_request`.
        """
        corners = grid.corners()
        width, height = np.ptp(corners, axis=0)
        if width * height > MAX_CELLS * self._resolution_m**2:
            raise Refused(
                codes.BAD_REQUEST,
                f"The map {grid.name} is {width:.0f} x {height:.0f} m, too large to be drawn in "
                f"cells of {self._resolution_m:g} m: crop it first, or set a larger [mapper] "
                "resolution_m.",
            )
        if np.abs(corners).max() > MOST_AWAY_M:
            raise Refused(
                codes.BAD_REQUEST,
                f"The map {grid.name} lies more than {MOST_AWAY_M / 1000:.0f} km from where its "
                "coordinates are 0, too far to be extended exactly: give its file an `origin` near "
                "0.",
            )

    def apply(self, session: MapSession) -> None:
        """Let a session continue the map, after `check`."""
        if self._map is not None and self._correction is not None:
            zones = [] if self._zones is None else self._zones.zones
            session.extend(grid_of(self._map), self._correction.pose, zones)

    def _hear_map(self, found: dict[tuple[str, ...], OccupancyGrid]) -> None:
        self._map = found.get(())

    def _hear_zones(self, found: dict[tuple[str, ...], Zones]) -> None:
        self._zones = found.get(())

    def _hear_pose(self, found: dict[tuple[str, ...], PoseEstimate]) -> None:
        self._pose = found.get(())

    def _hear_correction(self, found: dict[tuple[str, ...], Transform]) -> None:
        self._correction = found.get(("odom",))


class PendingStart:
    """A request to begin a map that waits for its preconditions.

    Args:
        service: that was asked.
        session: what is to be begun.
        params: how: whether the robot is to explore then, and how fast.
        resolution_m: edge of the map's cells [m].
    """

    def __init__(
        self, service: Service, session: MapSession, params: MapNamed, resolution_m: float
    ) -> None:
        self.session, self.params = session, params
        self.preconditions = Preconditions(service, session.extends, resolution_m)
        self.reply: Later[MappingStatus] = service.later()
        self.until_ns = service.monotonic_ns + ANSWER_NS


class MapStarter:
    """Answers `map/new` and `map/extend`.

    Args:
        mapping: which makes the map.
        is_editing: whether a stored map is being changed.
        explore: called when a map has begun, with whether the robot is to explore and how fast.
    """

    def __init__(
        self,
        service: Service,
        config: RobotConfig,
        mapping: Mapping,
        is_editing: Callable[[], bool],
        explore: Callable[[bool, float | None], None],
    ) -> None:
        self._service, self._config, self._mapping = service, config, mapping
        self._is_editing, self._explore = is_editing, explore
        self._pending: PendingStart | None = None

    @property
    def is_waiting(self) -> bool:
        """Whether a map is about to begin."""
        return self._pending is not None

    def check_idle(self) -> None:
        """Refuse while a map is being made, or is about to be.

        Raises:
            Refused: `mapping` or `not_ready`.
        """
        self._mapping.check_idle()
        if self.is_waiting:
            raise Refused(codes.MAPPING, "A map is being made; save or cancel it first.")

    @answers(requests.MAP_NEW)
    def begin_new(self, params: MapNamed) -> Later[MappingStatus]:
        """Begin a map where the robot stands."""
        check_name_is_free(self._service.maps.path, self._config, params.name)
        return self._begin(MapSession(self._config.mapper, params.name), params)

    @answers(requests.MAP_EXTEND)
    def extend(self, params: MapNamed) -> Later[MappingStatus]:
        """Continue the map that the robot is on."""
        return self._begin(MapSession(self._config.mapper, params.name, params.name), params)

    def _begin(self, session: MapSession, params: MapNamed) -> Later[MappingStatus]:
        self.check_idle()
        if self._is_editing():
            raise Refused(codes.NOT_READY, "A map is being edited; try again when that is done.")
        resolution_m = self._config.mapper.resolution_m
        pending = PendingStart(self._service, session, params, resolution_m)
        self._mapping.listen()
        self._pending = pending
        self._try_to_begin()
        return pending.reply

    @every(0.1, clock="local", when=lambda start: start._pending is not None)  # noqa: SLF001
    def _try_to_begin(self) -> None:
        """Begin once everything that is needed has come."""
        pending, inputs = self._pending, self._mapping.inputs
        if pending is None or inputs is None:
            return
        missing = [*inputs.missing(), *pending.preconditions.missing()]
        if missing and self._service.monotonic_ns < pending.until_ns:
            return
        if pending.session.extends is None and self._service.now_ns is not None:
            # A lidar that starts late: the status says what the map waits for.
            missing = []
        self._pending = None
        try:
            pending.preconditions.check(missing)
        except Refused as refused:
            self._mapping.stop_listening()
            pending.reply.refuse(refused)
            return
        pending.preconditions.apply(pending.session)
        self._explore(pending.params.explore, pending.params.speed)
        extends = pending.session.extends
        note = "" if extends is None else why_not_overwritten(self._config, extends)
        pending.reply.reply(self._mapping.begin(pending.session, note))
        self._mapping.load(pending.session)
