"""Zones of the map that is being made: those drawn on it move with it when loops are closed."""

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from trolley.geometry import Pose2D
from trolley.messages import Zone
from trolley.zones import with_zone, without_zone
from trolley_mapper.anchored_places import MapAnchoring, differ
from trolley_mapper.edit.map_transform import moved_zones
from trolley_mapper.slam.estimate import Anchor


@dataclass(frozen=True, slots=True)
class ZoneTie:
    """What ties a zone to the map: an anchor, and where that was when the zone lay as it does."""

    anchor: Anchor
    pose: Pose2D


class AnchoredZones:
    """The zones of one map. Those of the map that is extended stay; those drawn since are tied.

    Args:
        zones: as they lie now.
        ties: of those drawn on the map in the making, by name.
        deleted: names of zones of the extended map that are gone.
    """

    def __init__(
        self,
        zones: Iterable[Zone] = (),
        ties: Mapping[str, ZoneTie] | None = None,
        deleted: Collection[str] = (),
    ) -> None:
        self.all = list(zones)
        """Sorted by name."""
        self.ties = dict(ties or {})
        self.deleted = set(deleted)

    def put(self, zone: Zone, core: MapAnchoring) -> None:
        """Add a zone, or replace the one of its name.

        Raises:
            Refused: there are too many.
        """
        self.all = with_zone(self.all, zone)
        self.deleted.discard(zone.name)
        x, y = np.mean(zone.points, axis=0).tolist()
        middle = Pose2D(x, y, 0.0)
        self.ties[zone.name] = ZoneTie(core.anchor(middle), middle)

    def delete(self, name: str) -> Zone:
        """Remove a zone and return it.

        Raises:
            Refused: `unknown_name`.
        """
        self.all, zone = without_zone(self.all, name)
        self.ties.pop(zone.name, None)
        self.deleted.add(zone.name)
        return zone

    def settle(self, name: str) -> None:
        """Note that the localizer has what became of a zone."""
        self.ties.pop(name, None)
        self.deleted.discard(name)

    def follow(self, core: MapAnchoring) -> bool:
        """Move zones to where the map has them now; returns whether any has moved."""
        moved = False
        for row, zone in enumerate(self.all):
            tie = self.ties.get(zone.name)
            if tie is None:
                continue
            pose = core.moved(tie.anchor)
            if differ(tie.pose, pose):
                self.all[row] = moved_zones([zone], tie.pose @ pose.inverse())[0]
                self.ties[zone.name] = ZoneTie(tie.anchor, pose)
                moved = True
        return moved

    @property
    def drawn(self) -> list[Zone]:
        """Those that were drawn on the map in the making."""
        return [zone for zone in self.all if zone.name in self.ties]
