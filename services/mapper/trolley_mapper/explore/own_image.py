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
    min_toward_m: float = 0.25
    """Least distance that the robot has driven towards the mirror, or away from it [m]."""
    half_width_m: float = 0.8
    """What is seen so far beside the image is seen in the mirror, too [m]."""
    mirrored_m: float = 0.2
    """Distance within which what is seen in the mirror lies from what stands before it [m]."""
    min_mirrored: int = 5
    """Number of echoes beside the image that a mirror must show."""
    min_mirrored_share: float = 0.75
    """Share of them that must stand before it."""


PARAMS = OwnImageParams()

Floats = NDArray[np.float64]


class OwnImage:
    """Watches scans for the robot's own image."""

    def __init__(self) -> None:
        # The newest scans: where the lidar was, (2,), and what may be images: halfway places and
        # directions, (n, 4) x, y [m] and unit vector.
        self._looks: deque[tuple[Floats, Floats]] = deque(maxlen=PARAMS.num_looks)

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
        if self._looks and np.hypot(*(place - self._looks[-1][0])) < PARAMS.step_m:
            return None
        found = narrow_things(ranges, angles)
        directions = map_T_laser.yaw + found[:, 1]
        normals = np.stack([np.cos(directions), np.sin(directions)], axis=1)
        things = place + found[:, :1] * normals
        is_seen = ~segments_meet(place, things[:, None], mirrors[:, :2], mirrors[:, 2:]).any(axis=1)
        halfway = np.concatenate([0.5 * (place + things), normals], axis=1)
        self._looks.append((place, halfway[is_seen]))
        for x, y, nx, ny in self._looks[-1][1].tolist():
            mirror = Pose2D(x, y, math.atan2(ny, nx))
            if self._is_proven(np.array([x, y]), np.array([nx, ny])) and is_mirrored(
                mirror.inverse() @ map_T_laser, ranges, angles
            ):
                return mirror
        return None

    def _is_proven(self, middle: Floats, normal: Floats) -> bool:
        """Say whether the scans before show an image in the same mirror."""
        shown = [_shows(things, middle, normal) for _, things in self._looks]
        num_looks = len(shown) - shown.index(True)
        if sum(shown) < PARAMS.min_looks or sum(shown) < PARAMS.min_share * num_looks:
            return False
        toward = [
            float(place @ normal) for (place, _), one in zip(self._looks, shown, strict=True) if one
        ]
        return max(toward) - min(toward) >= PARAMS.min_toward_m


def _shows(things: Floats, middle: Floats, normal: Floats) -> bool:
    """Say whether one of the things (n, 4) is an image in a mirror."""
    away = things[:, :2] - middle
    is_image = np.abs(away @ normal) < PARAMS.same_m
    is_image &= np.hypot(away[:, 0], away[:, 1]) < PARAMS.beside_m
    is_image &= things[:, 2:] @ normal > PARAMS.same_normal
    return bool(is_image.any())


def is_mirrored(mirror_T_laser: Pose2D, ranges: Floats, angles: Floats) -> bool:
    """Say whether what is seen in a mirror, x pointing into it, stands before it as well."""
    is_echo = np.isfinite(ranges) & (ranges > 0.0)
    directions = mirror_T_laser.yaw + angles[is_echo]
    beams = ranges[is_echo, None] * np.stack([np.cos(directions), np.sin(directions)], axis=1)
    ends = np.array([mirror_T_laser.x, mirror_T_laser.y]) + beams
    with np.errstate(divide="ignore", invalid="ignore"):
        crossed = mirror_T_laser.y - mirror_T_laser.x * beams[:, 1] / beams[:, 0]
    is_inside = (ends[:, 0] > PARAMS.edge_m) & (np.abs(crossed) < PARAMS.half_width_m)
    # The image itself lies ahead.
    is_inside &= np.abs(ends[:, 1] - mirror_T_laser.y) > 0.5 * PARAMS.max_width_m
    inside, before = ends[is_inside] * [-1.0, 1.0], ends[ends[:, 0] < 0.0]
    if len(inside) < PARAMS.min_mirrored or len(before) == 0:
        return False
    apart = np.hypot(*(inside[:, None] - before).transpose(2, 0, 1)).min(axis=1)
    return bool(np.mean(apart < PARAMS.mirrored_m) >= PARAMS.min_mirrored_share)


def narrow_things(ranges: Floats, angles: Floats) -> Floats:
    """Return range [m] and angle [rad] (n, 2) of what is as narrow as a robot and stands out."""
    is_echo = np.isfinite(ranges) & (ranges > 0.0)
    away = np.where(is_echo, ranges, np.inf)
    with np.errstate(invalid="ignore"):
        jumps = np.flatnonzero(~(np.abs(np.diff(away)) < PARAMS.edge_m))
    found: list[tuple[float, float]] = []
    for first, last in zip(jumps[:-1] + 1, jumps[1:], strict=True):
        if not is_echo[first]:
            continue
        near = float(away[first : last + 1].min())
        beside = min(away[first - 1] - away[first], away[last + 1] - away[last])
        width = near * float(angles[last] - angles[first])
        if beside >= PARAMS.edge_m and width <= PARAMS.max_width_m:
            middle = (int(first) + int(last)) // 2
            found.append((float(away[middle]), 0.5 * float(angles[first] + angles[last])))
    return np.array(found, np.float64).reshape(-1, 2)
