"""How far scans agree with what others saw of the same place."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from trolley.scan_matching.layout import Cloud
from trolley.scan_matching.surfels import EXPLAINED, UNKNOWN
from trolley.scan_matching.sweep import Sweep
from trolley_mapper.slam.keyframe_store import KeyframeStore
from trolley_mapper.slam.local_map import LocalMap


def count_explained(
    store: KeyframeStore,
    shown: Sequence[int],
    by: Sequence[int],
    centre: int,
    near_m: float,
    reach_m: float,
) -> tuple[int, int]:
    """Return how many points of some keyframes others know, and how many of these they explain.

    Args:
        store: the keyframes.
        shown: numbers of those whose points are counted.
        by: numbers of those that they are compared with.
        centre: number of the keyframe in the middle of what is compared.
        near_m: distance from a surface within which a point lies on it [m].
        reach_m: distance from the middle within which surfaces are compared [m].
    """
    if not shown or not by:
        return 0, 0
    local = LocalMap(
        [store.keyframes[store.rows[n]] for n in by],
        np.array([store.pose(n) for n in by]),
        store.pose(centre)[:2],
        reach_m,
    )
    known, explained = 0, 0
    for number in shown:
        one = store.keyframes[store.rows[number]]
        sweep = Sweep(one.cloud(), one.laser.astype(np.float64), is_blind=False)
        cloud = Cloud(sweep.cloud.points, np.zeros_like(sweep.cloud.normals))
        classes = local.classify(store.pose(number), replace(sweep, cloud=cloud), near_m)
        known += int(np.count_nonzero(classes != UNKNOWN))
        explained += int(np.count_nonzero(classes == EXPLAINED))
    return known, explained
