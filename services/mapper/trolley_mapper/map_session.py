"""One map while it is being made: the SLAM core, the places on it, and what goes with both."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from msgspec import structs

from trolley import codes
from trolley.codes import Refused
from trolley.config import MapperConfig
from trolley.geometry import Pose2D
from trolley.gridmap import GridMap
from trolley.gridmap.wire import map_message
from trolley.messages import OccupancyGrid, SuspectLine, Zone
from trolley.scanning import Reject, ScanInput
from trolley.zones import is_known
from trolley_mapper.anchored_places import AnchoredPlaces
from trolley_mapper.anchored_zones import AnchoredZones
from trolley_mapper.checkpoint import Checkpoint, LastScan
from trolley_mapper.edit.map_transform import moved_zones
from trolley_mapper.explore.barriers import Barriers
from trolley_mapper.slam.estimate import Anchor, MapEstimate

if TYPE_CHECKING:  # with numba and SciPy: a robot that has its map need not load them
    from trolley_mapper.explore.explorer import Explorer
    from trolley_mapper.slam.finishing import FinishJob
    from trolley_mapper.slam.mapper import Mapper

LONGEST_GAP_S = 10.0
"""Most robot time between two scans that counts as time of mapping [s]."""
RESTART_NS = 120_000_000_000
"""Robot time within which a mapper that was killed is back before anybody carries the robot
[ns]."""


class MapSession:
    """A map in the making; its core is made with the first scan, or comes from a checkpoint.

    Args:
        config: of the core.
        extends: the map that it continues, if any.
    """

    def __init__(self, config: MapperConfig, name: str, extends: str | None = None) -> None:
        self.name = name
        self.extends = extends
        self.zones = AnchoredZones()
        self.core: Mapper | None = None
        self.explorer: Explorer | None = None
        self.home: Anchor | None = None
        """Where the map was first explored from."""
        self.barriers = Barriers()
        self.places = AnchoredPlaces()
        self.estimate: MapEstimate | None = None
        self.seconds = 0.0
        self.loops = 0
        self._config = config
        self._mirrors: list[list[tuple[float, float]]] = []
        self._prior: tuple[GridMap, Pose2D] | None = None
        self._starts_paused = False
        # Before the run of the mapper before was killed.
        self._last_scan: LastScan | None = None

    def extend(self, prior: GridMap, map_T_odom: Pose2D, zones: Sequence[Zone]) -> None:
        """Continue a map: its grid, where the odometry began on it, and its zones."""
        self._prior, self.zones = (prior, map_T_odom), AnchoredZones(zones)

    @classmethod
    def restore(cls, config: MapperConfig, checkpoint: Checkpoint) -> "MapSession":
        """Continue from a checkpoint (takes long: the core is imported).

        Raises:
            ValueError: the core's bytes are damaged.
        """
        from trolley_mapper.slam.mapper import Mapper

        session = cls(config, checkpoint.name, checkpoint.extends)
        session.zones = AnchoredZones(
            checkpoint.zones, checkpoint.zone_ties, checkpoint.zones_deleted
        )
        session.places = AnchoredPlaces(checkpoint.anchors, checkpoint.saved_at, checkpoint.older)
        session.barriers, session.home = Barriers(checkpoint.mirrors), checkpoint.home
        session.seconds, session.loops = checkpoint.seconds, checkpoint.loops
        session.core = Mapper.from_bytes(config, checkpoint.core)
        session._last_scan = checkpoint.last_scan
        if checkpoint.is_paused:
            session.core.pause()
        return session

    def go_on(self, scan: ScanInput, epoch_ns: int) -> None:
        """Follow the odometry from the checkpoint to the first scan, if it leads there.

        Args:
            scan: that comes next.
            epoch_ns: run of base in which it was taken [ns].
        """
        last, self._last_scan = self._last_scan, None
        if last is None or self.core is None or last.epoch_ns != epoch_ns:
            return
        if scan.stamp_ns - last.stamp_ns < RESTART_NS:
            odom = last.odom_T_base
            before = replace(scan, stamp_ns=last.stamp_ns, odom_T_base=odom, odom_T_base_end=odom)
            self.core.go_on_from(before)

    def step(self, scan: ScanInput) -> MapEstimate | Reject:
        """Take a scan into account."""
        if self.core is None:
            self.core = self._make_core(scan)
        self._update_mirrors(self.core)
        estimate = self.core.step(scan)
        if isinstance(estimate, Reject):
            return estimate
        before, self.estimate = self.estimate, estimate
        if before is not None and not self.core.is_paused:
            gap_s = (estimate.stamp_ns - before.stamp_ns) * 1e-9
            self.seconds += min(max(gap_s, 0.0), LONGEST_GAP_S)
        self.loops += estimate.closed_loop
        if self.explorer is not None and self.is_exploring and estimate.state == "mapping":
            ranges = scan.ranges.astype(np.float64)
            beams = np.arange(len(ranges), dtype=np.float64)
            angles = scan.angle_min + beams * scan.angle_increment
            map_T_laser = estimate.pose @ scan.base_T_laser
            self.explorer.hear_scan(map_T_laser, ranges, angles, self.core.mirrors)
        return estimate

    def _update_mirrors(self, core: "Mapper") -> None:
        """Leave off the map what is seen through mirrors, as soon as these are known."""
        mirrors = [zone.points for zone in self.zones_shown if zone.kind == "mirror"]
        if mirrors != self._mirrors:
            self._mirrors = mirrors
            core.set_mirrors(mirrors)

    def _make_core(self, scan: ScanInput) -> "Mapper":
        from trolley_mapper.slam.mapper import Mapper

        if self._prior is None:
            core = Mapper(self._config)
        else:
            prior, map_T_odom = self._prior
            core = Mapper(self._config, map_T_odom @ scan.odom_T_base, prior)
        if self._starts_paused:
            core.pause()
        return core

    def explore_with(self, explorer: "Explorer") -> None:
        """Let an explorer choose where the robot drives."""
        self.explorer = explorer

    @property
    def is_exploring(self) -> bool:
        """Whether the robot is driving to frontiers, or back."""
        return self.explorer is not None and self.explorer.is_under_way

    @property
    def zones_shown(self) -> list[Zone]:
        """Its zones, and lines that the robot could not get past while exploring: not saved."""
        return [*self.zones.all, *self.barriers.zones]

    @property
    def suspects(self) -> list[SuspectLine]:
        """Mirrors in which the robot has seen itself while exploring, and that nobody has drawn."""
        known = [zone.points for zone in self.zones.all if zone.kind == "mirror"]
        return [
            SuspectLine(points=one.points, score=1.0)
            for one in self.barriers.mirrors
            if not is_known(one.points, known)
        ]

    @property
    def is_paused(self) -> bool:
        """Whether the map does not grow."""
        return self._starts_paused if self.core is None else self.core.is_paused

    def pause(self, *, is_on: bool) -> None:
        """Stop the map from growing, or let it grow again."""
        self._starts_paused = is_on
        if self.core is not None and self.core.is_paused != is_on:
            if is_on:
                self.core.pause()
            else:
                self.core.resume()
        if self.estimate is not None:  # its message may be about the pause before
            self.estimate = replace(self.estimate, message="")

    def undo(self, seconds: float) -> bool:
        """Remove what was mapped in the last seconds; False where nothing of the map is left."""
        if self.core is None:
            return False
        left = self.core.undo(seconds)
        self.places.tie_anew(self.core)
        self.seconds = max(0.0, self.seconds - seconds)
        return left is not None

    def mapped_core(self) -> "Mapper":
        """Return the core.

        Raises:
            Refused: `not_ready` as long as nothing has been mapped.
        """
        if self.core is None or (self.core.num_keyframes == 0 and self.extends is None):
            raise Refused(codes.NOT_READY, "Nothing has been mapped yet.")
        return self.core

    @property
    def num_loose(self) -> int:
        """Number of scans in parts of which it is not known how they lie to the map."""
        return 0 if self.core is None else self.core.num_loose

    def drop_loose(self) -> None:
        """Forget these parts."""
        if self.core is not None:
            self.core.drop_loose()
            self.places.tie_anew(self.core)

    def turn(self, job: "FinishJob") -> None:
        """Turn the map as it was saved, and with it what lies on it: places and the robot."""
        if self.core is None:
            return
        from trolley_mapper.slam.pose_graph import turned

        self.places.tie_loose(self.core)
        new_T_old = self.core.turn(job)
        for lines in (self.barriers.mirrors, self.barriers.stood):
            lines[:] = moved_zones(lines, new_T_old.inverse())
        if self.estimate is not None:
            self.estimate = replace(
                self.estimate,
                pose=new_T_old @ self.estimate.pose,
                covariance=turned(self.estimate.covariance, new_T_old.yaw),
                map_T_odom=new_T_old @ self.estimate.map_T_odom,
            )

    @property
    def revision(self) -> tuple[object, ...]:
        """Differs from the previous one whenever a checkpoint would."""
        core = self.core
        grown = (0, 0) if core is None else (core.version, core.num_keyframes)
        zones = tuple((one.name, *one.points) for one in self.zones.all)
        is_unheard = self.places.older is None
        return (self, *grown, self.is_paused, self.is_exploring, self.home, zones, is_unheard)

    def checkpoint(self, last_scan: LastScan | None) -> Callable[[], Checkpoint] | None:
        """Return what makes a checkpoint of the map as it is now; None while there is nothing.

        That takes long for a large map: call it aside.

        Args:
            last_scan: if the robot was on the map then.
        """
        if self.core is None:
            return None
        from trolley_mapper.slam.serialization import pack

        snapshot = self.core.snapshot()
        checkpoint = Checkpoint(
            name=self.name,
            extends=self.extends,
            zones=list(self.zones.all),
            zone_ties=dict(self.zones.ties),
            zones_deleted=sorted(self.zones.deleted),
            anchors=dict(self.places.anchors),
            saved_at=dict(self.places.saved_at),
            older=self.places.older,
            mirrors=list(self.barriers.mirrors),
            seconds=self.seconds,
            loops=self.loops,
            is_paused=self.core.is_paused,
            is_exploring=self.is_exploring,
            home=self.home,
            last_scan=last_scan,
            core=b"",
        )
        return lambda: structs.replace(checkpoint, core=pack(snapshot))

    def map_message(self, stamp_ns: int) -> OccupancyGrid | None:
        """Return the map as it is now."""
        return None if self.core is None else map_message(stamp_ns, self.core.grid(), self.name)
