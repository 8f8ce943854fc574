"""Where beams end on round bodies."""

import numpy as np
from numpy.typing import NDArray


def ranges_to(bodies: NDArray[np.float64], angles: NDArray[np.float64]) -> NDArray[np.float64]:
    """How far beams (n,) [rad] from the origin, outside of all, go to each body; inf: they miss it.

    Args:
        bodies: (m, 3) x, y, radius [m].
        angles: of the beams.

    Returns:
        (n, m) [m].
    """
    x, y, radius = bodies.T
    cos, sin = np.cos(angles)[:, None], np.sin(angles)[:, None]
    ahead, aside = cos * x + sin * y, cos * y - sin * x
    chord = np.sqrt(np.maximum(radius**2 - aside**2, 0.0))
    meets = (ahead > 0.0) & (np.abs(aside) < radius)
    return np.where(meets, ahead - chord, np.inf)
