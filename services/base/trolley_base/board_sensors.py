"""The motor board's range sensors, bumpers and cliff sensors, as scans of extra sensors.

What only feels that something is there has no range: its echoes lie just outside of the robot's
outline, in the directions in which it feels it.
"""

import math
from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray

from trolley.geometry.polygon import edges_of
from trolley.messages import Scan, floats_to_bytes
from trolley_base.drivers import ChassisReading, Contact

STEP_DEG = 5
"""Between two echoes of a bumper [degrees]: 2 cm on a robot of 0.2 m."""
BEARINGS = np.radians(np.arange(-180, 180, STEP_DEG))
AGAIN_NS = 100_000_000
"""What is felt is said again after this long, also where nothing has changed [ns]."""

Floats = NDArray[np.float64]


def outline_distances(footprint: Floats, bearings: Floats) -> Floats:
    """Return how far the outline is from `base_link` (n,) in directions (n,).

    Args:
        footprint: (m, 2) corners [m], counter-clockwise; where it lies beside `base_link`, its
            farther side counts, and directions that miss it are 0.
        bearings: [rad].
    """
    edges = edges_of(footprint)
    ahead = np.stack([np.cos(bearings), np.sin(bearings)], axis=1)
    cross = ahead[:, None, 0] * edges[None, :, 1] - ahead[:, None, 1] * edges[None, :, 0]
    parallel = np.abs(cross) < 1e-12
    divisor = np.where(parallel, 1.0, cross)
    corner = footprint[None]
    away = (corner[..., 0] * edges[None, :, 1] - corner[..., 1] * edges[None, :, 0]) / divisor
    along = (corner[..., 0] * ahead[:, None, 1] - corner[..., 1] * ahead[:, None, 0]) / divisor
    is_met = ~parallel & (along >= -1e-9) & (along <= 1.0 + 1e-9) & (away > 0.0)
    return np.where(is_met, away, 0.0).max(axis=1)


class BoardSensors:
    """Turns what a board's sensors say into scans.

    Args:
        listed: names of the tables `[base.scans.NAME]`; others are left out.
        footprint: (n, 2) corners [m] in `base_link`, counter-clockwise.
    """

    def __init__(self, listed: Collection[str], footprint: Floats) -> None:
        self._listed = frozenset(listed)
        self._outline_m = outline_distances(footprint, BEARINGS)
        self._said: dict[str, tuple[Contact, int]] = {}
        self.names: set[str] = set()
        """Of the sensors that the board has."""

    def scans(self, reading: ChassisReading, now_ns: int) -> list[Scan]:
        """Return what is to be said of a reading; `frame` is the name of the sensor."""
        found = [scan for scan in reading.ranges if scan.frame in self._listed]
        for contact in reading.contacts:
            if contact.name not in self._listed:
                continue
            said, said_ns = self._said.get(contact.name, (None, 0))
            if contact == said and 0 <= now_ns - said_ns < AGAIN_NS:
                continue
            self._said[contact.name] = contact, now_ns
            found.append(self._scan_of(contact, now_ns))
        self.names |= {scan.frame for scan in found}
        return found

    def _scan_of(self, contact: Contact, now_ns: int) -> Scan:
        """Return echoes where it feels something; of the rest it knows nothing."""
        felt = np.zeros(len(BEARINGS), np.bool_)
        for begin, end in contact.sectors:
            felt |= (BEARINGS - begin) % math.tau <= (end - begin) % math.tau
        felt &= self._outline_m > 0.0
        away = self._outline_m + contact.beyond_m
        return Scan(
            stamp_ns=now_ns,
            frame=contact.name,
            angle_min=float(BEARINGS[0]),
            angle_increment=math.radians(STEP_DEG),
            time_increment=0.0,
            # What it stands before does not go away while it stands there.
            range_min=float(away.max()),
            range_max=float(away.max()) + 0.01,
            ranges=floats_to_bytes(np.where(felt, away, 0.0).astype(np.float32)),
        )
