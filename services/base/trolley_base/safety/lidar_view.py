"""How much of its surroundings the lidar sees on each side, and whether something closed a view.

A cover, dirt or a cable turns with the robot; a black cupboard or a window does not. So a side is
closed where its beams all failed at once though the robot hardly moved, or go on failing though it
has turned or driven on.

A beam without an echo says that nothing is in reach; in the middle of a hall all of them may. But
walls do not vanish: where many beams had echoes well within reach, and in the next scan hardly one
has, the lidar looks into the air, or its window is off, and sees nothing.
"""

import dataclasses
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D, wrap_angle
from trolley.geometry.polygon import edges_of
from trolley_base.drivers import LidarScan

SIDES = (
    "front",
    "front left",
    "left",
    "rear left",
    "rear",
    "rear right",
    "right",
    "front right",
)
"""Each an eighth of the circle about `base_link`, counter-clockwise; the first straight ahead."""


@dataclass(frozen=True, slots=True)
class LidarViewParams:
    """What counts as seeing, and as closed; set by hand."""

    cover_m: float = 0.005
    """Ranges this near to the shortest measurable one may be a cover on the lidar [m]."""
    cover_width: float = 0.7
    """Angle over which such ranges must lie side by side to be a cover: not even a wall that
    touches a lidar of 0.1 m is as near over more than 0.63 rad [rad]."""
    body_m: float = 0.02
    """An echo farther inside the footprint is the robot's own body, as for the stop field [m]."""
    least_echoes: float = 0.01
    """Share of beams with an echo below which a scan has none: stray light makes fewer."""
    many_echoes: float = 0.1
    """Share of beams whose echoes well within reach do not vanish from one scan to the next."""
    well_within: float = 0.8
    """Share of the longest measurable range up to which an echo lies well within reach."""
    fine: float = 0.5
    """Share of its beams that must see something for a side to be open."""
    closed: float = 0.1
    """Share of its beams below which a side is dark."""
    closed_s: float = 3.0
    """Time after which a dark side may be blocked [s]."""
    sudden_m: float = 0.1
    """Motion since a side was open below which, with `sudden_rad`, a dark side is blocked [m]."""
    sudden_rad: float = 0.15
    """Turn since a side was open below which, with `sudden_m`, a dark side is blocked [rad]."""
    past_m: float = 1.0
    """Motion since a side became dark above which it is also blocked [m]."""
    past_rad: float = 1.0
    """Turn since a side became dark above which it is also blocked [rad]."""


PARAMS = LidarViewParams()

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


def covered_beams(scan: LidarScan) -> Bools:
    """Return the beams (n,) that end at the sensor's nearest range, many of them side by side.

    Such a beam met a cover. As an echo it would pin the robot wherever it goes.
    """
    count = len(scan.ranges)
    width = max(3, round(PARAMS.cover_width / scan.angle_increment))
    nearest = (scan.ranges > 0.0) & (scan.ranges <= scan.range_min + PARAMS.cover_m)
    if np.count_nonzero(nearest) < min(width, count):
        return np.zeros(count, np.bool_)
    # Round the circle: a cover may lie across the first beam.
    padded = np.concatenate([nearest, nearest[: width - 1]])
    sums = np.cumsum(np.concatenate([[0], padded]))
    begins = np.flatnonzero(sums[width:] - sums[:-width] >= width)
    covered = np.zeros(count, np.bool_)
    covered[(begins[:, None] + np.arange(width)) % count] = True
    return covered


def without_cover(scan: LidarScan) -> LidarScan:
    """Return a scan in which beams that met a cover are invalid."""
    covered = covered_beams(scan)
    if not covered.any():
        return scan
    return dataclasses.replace(scan, ranges=np.where(covered, np.float32(0.0), scan.ranges))


@dataclass(slots=True)
class _Side:
    """One side: where the robot was when it was last open, and since when it has been dark."""

    share: float = 0.0
    open_at: Pose2D | None = None
    dark_ns: int | None = None
    dark_at: Pose2D | None = None
    is_closed: bool = False

    def update(self, share: float, base: Pose2D, now_ns: int) -> None:
        self.share = share
        if share >= PARAMS.fine:
            self.open_at, self.dark_ns, self.dark_at, self.is_closed = base, None, None, False
        elif share >= PARAMS.closed:
            self.dark_ns = self.dark_at = None
        elif self.dark_ns is None or self.dark_at is None:
            self.dark_ns, self.dark_at = now_ns, base
        elif self.open_at is not None and now_ns - self.dark_ns >= PARAMS.closed_s * 1e9:
            was_sudden = not _is_farther(
                self.open_at, self.dark_at, PARAMS.sudden_m, PARAMS.sudden_rad
            )
            self.is_closed = (
                self.is_closed
                or was_sudden
                or _is_farther(self.dark_at, base, PARAMS.past_m, PARAMS.past_rad)
            )


class LidarView:
    """Follows the view from scan to scan.

    Args:
        footprint: (n, 2) corners [m] in `base_link`, counter-clockwise.
        base_T_laser: where the lidar sits.
    """

    def __init__(self, footprint: Floats, base_T_laser: Pose2D) -> None:
        self._yaw = base_T_laser.yaw
        origin = np.array([base_T_laser.x, base_T_laser.y])
        self._body = _distances_out(footprint, origin)
        self._sides = [_Side() for _ in SIDES]
        self.share = 0.0
        """Share of the newest scan's beams that see something, or that nothing is in reach."""
        self.lacks_echoes = False
        """Whether the newest scan says that nothing is in reach where much was a moment ago."""
        self._many: tuple[float, Pose2D] | None = None
        """Range within which the last scan with echoes had many of them, and from where."""

    @property
    def shares(self) -> dict[str, float]:
        """The same of each side; 0 where it does not look."""
        return {name: side.share for name, side in zip(SIDES, self._sides, strict=True)}

    @property
    def closed(self) -> list[str]:
        """The sides that something has closed."""
        return [name for name, side in zip(SIDES, self._sides, strict=True) if side.is_closed]

    def update(self, scan: LidarScan, odom_T_base: Pose2D) -> LidarScan:
        """Take a new scan without what met a cover; return what it sees.

        That is without echoes of the own body, and nothing at all if all echoes have vanished.
        """
        count = len(scan.ranges)
        angles = self._yaw + scan.angle_min + np.arange(count) * scan.angle_increment
        part = np.floor(angles * (len(self._body) / (2.0 * math.pi))).astype(np.int64)
        # What hides in the robot's own outline hides what lies behind it, too.
        sees = scan.ranges > np.maximum(0.0, self._body[part % len(self._body)] - PARAMS.body_m)
        echoes = sees & np.isfinite(scan.ranges)
        self.lacks_echoes = self._have_vanished(scan, echoes, odom_T_base)
        if self.lacks_echoes:
            sees = echoes
        side = np.rint(angles * (len(SIDES) / (2.0 * math.pi))).astype(np.int64) % len(SIDES)
        of_side = np.bincount(side, minlength=len(SIDES))
        seeing = np.bincount(side[sees], minlength=len(SIDES))
        # Of all beams that a whole side has: one of which the lidar sees but the edge is no view.
        whole = 2.0 * math.pi / scan.angle_increment / len(SIDES)
        shares = seeing / np.maximum(of_side, 0.5 * whole)
        self.share = float(sees.mean())
        for one, share in zip(self._sides, shares.tolist(), strict=True):
            one.update(min(1.0, share), odom_T_base, scan.stamp_ns)
        return dataclasses.replace(scan, ranges=np.where(sees, scan.ranges, np.float32(0.0)))

    def _have_vanished(
        self, scan: LidarScan, echoes: NDArray[np.bool_], odom_T_base: Pose2D
    ) -> bool:
        """Say whether what stood well within reach is there no more though the lidar measures."""
        found = scan.ranges[echoes]
        if len(found) >= PARAMS.least_echoes * len(echoes):
            many = math.ceil(PARAMS.many_echoes * len(echoes))
            has_many = len(found) >= many
            self._many = (
                (float(np.partition(found, many - 1)[many - 1]), odom_T_base) if has_many else None
            )
            return False
        if self._many is None or not np.isinf(scan.ranges).any():
            return False
        within_m, place = self._many
        farthest_m = within_m + place.distance_to(odom_T_base)
        return farthest_m < PARAMS.well_within * scan.range_max


def _is_farther(before: Pose2D, after: Pose2D, metres: float, radians: float) -> bool:
    turned = abs(wrap_angle(after.yaw - before.yaw))
    return before.distance_to(after) > metres or turned > radians


def _distances_out(outline: Floats, origin: Floats) -> Floats:
    """Return how far beams from a point run inside an outline, for each degree (360,) [m]."""
    angles = (np.arange(360) + 0.5) * (2.0 * math.pi / 360)
    rays = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    starts = outline - origin
    edges = edges_of(outline)
    across = rays[:, :1] * edges[:, 1] - rays[:, 1:] * edges[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        along = (starts[:, 0] * edges[:, 1] - starts[:, 1] * edges[:, 0]) / across
        part = (starts[:, 0] * rays[:, 1:] - starts[:, 1] * rays[:, :1]) / across
    meets = (part >= 0.0) & (part <= 1.0) & (along > 0.0) & np.isfinite(along)
    return np.max(np.where(meets, along, 0.0), axis=1)
