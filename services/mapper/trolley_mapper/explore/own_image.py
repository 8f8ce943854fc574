"""The robot's own image: where it is seen again and again, a mirror hangs halfway to it.

In a mirror a lidar sees its own robot, straight ahead of the mirror and twice as far away. Halfway
to a thing that stands still the place moves by half of what the robot drives towards it; halfway to
its own image it stays on the mirror.
"""

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D, segments_meet
from trolley.laser_scan import is_echo


@dataclass(frozen=True, slots=True)
class OwnImageParams:
    """What counts as the robot's own image, and when it proves a mirror. Set by hand."""

    step_m: float = 0.05
    """Distance after which the next scan counts: scans from nearly one place say the same [m]."""
    num_looks: int = 30
    """Number of scans that are compared."""
    max_width_m: float = 0.6
    """What is wider is no robot [m]."""
    edge_m: float = 0.3
    """Beside the image the lidar sees at least so much farther [m]."""
    same_m: float = 0.04
    """Distance from the mirror within which the halfway places lie [m]."""
    same_normal: float = 0.99
    """Least product of the mirror's normal and the direction of an image (cosine)."""
    beside_m: float = 1.5
    """Greatest distance along a mirror between two halfway places [m]."""
    min_looks: int = 10
    """Number of scans that must show the image."""
    min_share: float = 0.8
    """Share of the scans meanwhile that must show it."""
    min_toward_m: float = 0.4
    """Least distance that the robot has driven towards the mirror, or away from it [m]."""
    side_m: float = 0.1
    """A mirror reaches at least so much farther to both sides than it showed the image [m]."""
    straight: float = 0.02
    """Tangent of the angle to a mirror's normal within which a beam goes straight at it."""
    beyond_m: float = 0.1
    """Distance behind the image from which on what is seen there lies beyond it [m]."""
    half_width_m: float = 0.8
    """What is seen so far beside the image is seen in the mirror, too [m]."""
    mirrored_m: float = 0.2
    """Distance within which what is seen in the mirror lies from what stands before it [m]."""
    shifts_m: tuple[float, float] = (-0.4, 0.4)
    """Shifts at which what tells where the mirror hangs does not stand before it [m]."""
    num_before: int = 40
    """Number of scans from which it is known what stands before a mirror."""
    step_before_m: float = 0.25
    """Distance between two of them [m]."""
    min_mirrored: int = 8
    """Number of echoes beside the image that must tell where the mirror hangs."""
    min_mirrored_share: float = 0.85
    """Share of them, and of all beside the image, that must stand before it."""


PARAMS = OwnImageParams()

CELL_M = 0.05
"""Edge of the cells to which surfaces before a mirror are rounded [m]."""

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Look:
    """What one scan shows, in `map`.

    Attributes:
        place: (2,) x, y of the lidar [m].
        halfway: (n, 4) of what may be an image: the place halfway to it [m], and a unit vector
            towards it.
        echoes: (m, 2) x, y of all that is seen [m].
    """

    place: Floats
    halfway: Floats
    echoes: Floats

    def shows(self, middle: Floats, normal: Floats) -> bool:
        """Say whether one of the things is an image in the mirror at a place, with that normal."""
        away = self.halfway[:, :2] - middle
        is_image = np.abs(away @ normal) < PARAMS.same_m
        is_image &= np.hypot(away[:, 0], away[:, 1]) < PARAMS.beside_m
        is_image &= self.halfway[:, 2:] @ normal > PARAMS.same_normal
        return bool(is_image.any())

    def is_beyond(self, middle: Floats, normal: Floats, side_m: tuple[float, float]) -> bool:
        """Say whether the lidar looks straight at a mirror and sees farther than its image.

        Args:
            middle: (2,) a place on it.
            normal: (2,) of it, away from the robot.
            side_m: how far to the right and left of that place it is known to reach.
        """
        along = np.array([-normal[1], normal[0]])
        away_m = float((middle - self.place) @ normal)
        if away_m <= 0.0 or not side_m[0] < float((self.place - middle) @ along) < side_m[1]:
            return False
        beams = self.echoes - self.place
        ahead = beams @ normal
        ahead = ahead[np.abs(beams @ along) < PARAMS.straight * ahead]
        return bool(len(ahead) and np.median(ahead) > 2.0 * away_m + PARAMS.beyond_m)


class OwnImage:
    """Watches scans for the robot's own image."""

    def __init__(self) -> None:
        self._looks: deque[Look] = deque(maxlen=PARAMS.num_looks)
        self._before: deque[Look] = deque(maxlen=PARAMS.num_before)

    def update(
        self, map_T_laser: Pose2D, ranges: Floats, angles: Floats, mirrors: Floats
    ) -> Pose2D | None:
        """Return where a mirror hangs, x pointing into it, if this scan proves one (`map`).

        Args:
            map_T_laser: where the lidar was.
            ranges: (n,) [m], as of a scan: no echo is +inf, invalid is 0.
            angles: (n,) of the beams in `laser` [rad].
            mirrors: (m, 4) x, y, x, y [m] of those that are known: what is seen in them proves
                nothing.
        """
        place = np.array([map_T_laser.x, map_T_laser.y])
        if self._looks and np.hypot(*(place - self._looks[-1].place)) < PARAMS.step_m:
            return None
        found = narrow_things(ranges, angles)
        normals = _unit_vectors(map_T_laser.yaw + found[:, 1])
        things = place + found[:, :1] * normals
        is_seen = ~segments_meet(place, things[:, None], mirrors[:, :2], mirrors[:, 2:]).any(axis=1)
        halfway = np.concatenate([0.5 * (place + things), normals], axis=1)
        seen = is_echo(ranges)
        beams = ranges[seen, None] * _unit_vectors(map_T_laser.yaw + angles[seen])
        look = Look(place, halfway[is_seen], place + beams)
        self._looks.append(look)
        if not self._before or np.hypot(*(place - self._before[-1].place)) >= PARAMS.step_before_m:
            self._before.append(look)
        for x, y, nx, ny in look.halfway.tolist():
            mirror = Pose2D(x, y, math.atan2(ny, nx))
            if self._is_proven(np.array([x, y]), np.array([nx, ny])) and self._is_mirrored(mirror):
                return mirror
        return None

    def _is_proven(self, middle: Floats, normal: Floats) -> bool:
        """Say whether the scans before show an image in the same mirror."""
        looks = list(self._looks)
        shown = [look.shows(middle, normal) for look in looks]
        places = np.array([look.place for look, one in zip(looks, shown, strict=True) if one])
        toward = places @ normal
        if len(places) < PARAMS.min_looks or np.ptp(toward) < PARAMS.min_toward_m:
            return False
        side = (places - middle) @ np.array([-normal[1], normal[0]])
        side_m = float(side.min()) - PARAMS.side_m, float(side.max()) + PARAMS.side_m
        first = shown.index(True)
        num_beyond = sum(look.is_beyond(middle, normal, side_m) for look in looks[:first])
        return len(places) >= PARAMS.min_share * (len(looks) - first + num_beyond)

    def _is_mirrored(self, mirror: Pose2D) -> bool:
        """Say whether what the newest scan shows in a mirror stands before it as well.

        What stands there wherever the mirror hangs, as a corridor's walls do, tells nothing.
        """
        look = self._looks[-1]
        mirror_T_map = mirror.inverse()
        place = mirror_T_map.transform_points(look.place[None])[0]
        ends = mirror_T_map.transform_points(look.echoes)
        beams = ends - place
        with np.errstate(divide="ignore", invalid="ignore"):
            crossed = place[1] - place[0] * beams[:, 1] / beams[:, 0]
        is_inside = (ends[:, 0] > PARAMS.edge_m) & (np.abs(crossed) < PARAMS.half_width_m)
        # The image itself lies ahead.
        is_inside &= np.abs(ends[:, 1] - place[1]) > 0.5 * PARAMS.max_width_m
        inside = ends[is_inside] * [-1.0, 1.0]
        seen = np.concatenate(
            [ends, *(mirror_T_map.transform_points(one.echoes) for one in self._before)]
        )
        if len(inside) == 0:
            return False
        margin_m = max(PARAMS.shifts_m) + PARAMS.mirrored_m
        is_near = (seen > inside.min(axis=0) - margin_m) & (seen < inside.max(axis=0) + margin_m)
        # The scans show the same surfaces over and over: one point of each cell will do.
        cells = np.round(seen[is_near.all(axis=1) & (seen[:, 0] < 0.0)] / CELL_M)
        before = CELL_M * np.unique(_as_complex(cells))
        if len(before) == 0:
            return False
        points = _as_complex(inside)
        is_there = _stands_at(points, before)
        shifted = [_stands_at(points + shift_m, before) for shift_m in PARAMS.shifts_m]
        tells = ~np.logical_and.reduce(shifted)
        if np.count_nonzero(tells) < PARAMS.min_mirrored:
            return False
        share = min(np.mean(is_there), np.mean(is_there[tells]))
        return bool(share >= PARAMS.min_mirrored_share)


def _unit_vectors(angles: Floats) -> Floats:
    return np.stack([np.cos(angles), np.sin(angles)], axis=1)


def _as_complex(points: Floats) -> NDArray[np.complex128]:
    """Return points (n, 2) as numbers x + iy (n,)."""
    return points[:, 0] + 1j * points[:, 1]


def _stands_at(points: NDArray[np.complex128], seen: NDArray[np.complex128]) -> NDArray[np.bool_]:
    """Say of each point (n,) [m] whether one of those seen (m,) lies there."""
    return np.abs(points[:, None] - seen).min(axis=1) < PARAMS.mirrored_m


def narrow_things(ranges: Floats, angles: Floats) -> Floats:
    """Return range [m] and angle [rad] (n, 2) of what is as narrow as a robot and stands out."""
    seen = is_echo(ranges)
    away = np.where(seen, ranges, np.inf)
    with np.errstate(invalid="ignore"):
        jumps = np.flatnonzero(~(np.abs(np.diff(away)) < PARAMS.edge_m))
    found: list[tuple[float, float]] = []
    for first, last in zip(jumps[:-1] + 1, jumps[1:], strict=True):
        if not seen[first]:
            continue
        near = float(away[first : last + 1].min())
        beside = min(away[first - 1] - away[first], away[last + 1] - away[last])
        width = near * float(angles[last] - angles[first])
        if beside >= PARAMS.edge_m and width <= PARAMS.max_width_m:
            middle = (int(first) + int(last)) // 2
            found.append((float(away[middle]), 0.5 * float(angles[first] + angles[last])))
    return np.array(found, np.float64).reshape(-1, 2)
