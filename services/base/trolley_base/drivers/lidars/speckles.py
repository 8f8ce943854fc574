"""Single echoes close by that are dust or light rather than things, as LDROBOT's driver finds them.

Source:
    LDROBOT, ldlidar_stl_sdk, tofbf.cpp, `NearFilter`. Where all echoes of a turn form one group,
    the maker's joins it with itself and loses it; here it stays.
"""

from dataclasses import dataclass

import numpy as np

from trolley_base.drivers.lidars.scan_grid import Flags, Floats


@dataclass(frozen=True, slots=True)
class SpeckleParams:
    """When echoes are none; the maker's numbers."""

    near_m: float = 5.0
    """Only echoes nearer than this are looked at [m]."""
    steps: float = 2.0
    """Neighbours of a group are at most this far apart [steps]."""
    share: float = 0.03
    """Their ranges differ by at most this share of the former's."""
    few: int = 3
    """Groups of fewer echoes than this must be bright."""
    bright: int = 220
    """The least mean intensity, whole, of such a group."""
    many: int = 15
    """Groups of more than this stay, however dark they are."""
    dark: float = 15.0
    """The mean intensity up to which a group is dropped."""


PARAMS = SpeckleParams()


def speckles(angle_deg: Floats, range_m: Floats, intensity: Floats, step_deg: float) -> Flags:
    """Say which echoes of a revolution are speckles.

    Args:
        angle_deg: (n,) where each sample looked, in any order.
        range_m: (n,) 0 invalid, which belong to no group.
        intensity: (n,) of the echoes.
        step_deg: between two samples.
    """
    angle_deg = angle_deg % 360.0
    near = np.flatnonzero((range_m > 0.0) & (range_m < PARAMS.near_m))
    near = near[np.argsort(angle_deg[near], kind="stable")]
    dropped = np.zeros(len(range_m), np.bool_)
    if not len(near):
        return dropped
    angle, far, bright = angle_deg[near], range_m[near], intensity[near]
    apart = np.abs(np.diff(far))
    widest = PARAMS.steps * step_deg
    begins = (np.diff(angle) > widest) | (apart > PARAMS.share * far[:-1])
    group = np.concatenate([[0], np.cumsum(begins)])
    joins = angle[0] + 360.0 - angle[-1] < widest and (
        abs(far[0] - far[-1]) < PARAMS.share * far[-1]
    )
    if joins:
        group[group == group[-1]] = 0
    size = np.bincount(group)
    mean = np.bincount(group, bright) / np.maximum(size, 1)
    is_dropped = (size < PARAMS.few) & (np.floor(mean) < PARAMS.bright)
    is_dropped |= (size <= PARAMS.many) & (mean <= PARAMS.dark)
    dropped[near] = is_dropped[group]
    return dropped
