"""One map while it is being made: the core, the places on it, and what goes with both."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from msgspec import structs

from trolley.config import MapperConfig
from trolley.geometry import Pose2D
from trolley.gridmap import GridMap
from trolley.gridmap.wire import map_message
from trolley.messages import OccupancyGrid, Zone
from trolley.scanning.front_end import Reject, ScanInput
from trolley_mapper.checkpoint import Kept
from trolley_mapper.saved_places import Places
from trolley_mapper.slam.estimate import MapEstimate

if TYPE_CHECKING:  # with numba and SciPy: a robot that has its map need not carry them
    from trolley_mapper.slam.mapper import Mapper

LONGEST_GAP_S = 10.0
"""Robot time between two scans that counts as time of mapping at most."""


class Making:
    """A map in the making; its core is made with the first scan, or comes from the disk.

    Args:
        config: of the core.
        name: of the map.
    """

    def __init__(self, config: MapperConfig, name: str) -> None:
        self.name = name
        self.extends: str | None = None
        self.zones: Sequence[Zone] = ()
        self.prior: GridMap | None = None
        self.map_T_odom: Pose2D | None = None
        """Where the odometry began on the map that is extended."""
        self.core: Mapper | None = None
        self.places = Places()
        self.estimate: MapEstimate | None = None
        self.seconds = 0.0
        self.loops = 0
        self.wants_pause = False
        self._config = config

    @classmethod
    def from_kept(cls, config: MapperConfig, kept: Kept) -> "Making":
        """Go on with what was kept (takes long: the core is imported).

        Raises:
            ValueError: the core's bytes are damaged.
        """
        from trolley_mapper.slam.mapper import Mapper

        making = cls(config, kept.name)
        making.extends, making.zones = kept.extends, kept.zones
        making.places = Places(kept.anchors)
        making.seconds, making.loops = kept.seconds, kept.loops
        making.core = Mapper.from_bytes(config, kept.core)
        if kept.is_paused:
            making.core.pause()
        return making

    def to_keep(self, *, is_exploring: bool) -> Callable[[], Kept] | None:
        """Return what makes the map as it is now ready for the disk; None while there is nothing.

        That takes long for a large map: call it aside.
        """
        if self.core is None:
            return None
        from trolley_mapper.slam.serialization import pack

        state = self.core.snapshot()
        kept = Kept(
            name=self.name,
            extends=self.extends,
            zones=list(self.zones),
            anchors=dict(self.places.anchors),
            seconds=self.seconds,
            loops=self.loops,
            is_paused=self.core.is_paused,
            is_exploring=is_exploring,
            core=b"",
        )
        return lambda: structs.replace(kept, core=pack(state))

    def step(self, scan: ScanInput) -> MapEstimate | Reject:
        """Take a scan into account."""
        if self.core is None:
            from trolley_mapper.slam.mapper import Mapper

            start = None if self.map_T_odom is None else self.map_T_odom @ scan.odom_T_base
            self.core = Mapper(self._config, start, self.prior)
            if self.wants_pause:
                self.core.pause()
        result = self.core.step(scan)
        if isinstance(result, Reject):
            return result
        before, self.estimate = self.estimate, result
        if before is not None and not self.core.is_paused:
            self.seconds += min((result.stamp_ns - before.stamp_ns) * 1e-9, LONGEST_GAP_S)
        self.loops += result.closed_loop
        return result

    @property
    def is_paused(self) -> bool:
        """Whether the map is let be as it is."""
        return self.wants_pause if self.core is None else self.core.is_paused

    def pause(self, *, is_on: bool) -> None:
        """Let the map be, or go on."""
        self.wants_pause = is_on
        if self.core is not None and self.core.is_paused != is_on:
            if is_on:
                self.core.pause()
            else:
                self.core.resume()
        if self.estimate is not None:  # what it said of the pause before holds no more
            self.estimate = replace(self.estimate, message="")

    def undo(self, seconds: float) -> bool:
        """Forget the last seconds; False where nothing is left of the map."""
        if self.core is None:
            return False
        left = self.core.undo(seconds)
        self.places.tie_anew(self.core)
        self.seconds = max(0.0, self.seconds - seconds)
        return left is not None

    def map_message(self, stamp_ns: int) -> OccupancyGrid | None:
        """Return the map as it is now."""
        return None if self.core is None else map_message(stamp_ns, self.core.grid(), self.name)
