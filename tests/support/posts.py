"""Posts that stand about, as a mapper sees them."""

import numpy as np
from numpy.typing import NDArray

from trolley.scan_matching.layout import Cloud
from trolley.scan_matching.sweep import Sweep
from trolley_mapper.slam.keyframe import Keyframe


def keyframe_among(posts: NDArray[np.float64], number: int, true: NDArray[np.float64]) -> Keyframe:
    """What is seen of posts (n, 2) within 5 m of a true place; nothing hides anything."""
    away = posts - true[:2]
    points = away[np.hypot(*away.T) < 5.0]
    normals = -points / np.hypot(*points.T)[:, None]
    return Keyframe.of(number, 0, Sweep(Cloud(points, normals), np.zeros(2), is_blind=False))
