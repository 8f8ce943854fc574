"""Where the camera stands: above the map, a little to the south, so that all of it is seen."""

import math

import numpy as np
import viser
from numpy.typing import NDArray

FIELD_OF_VIEW = math.radians(42.0)
ELEVATION = math.radians(66.0)
MARGIN = 1.1
SHIFT = 0.05
"""How far the map is moved up, by its height: Stop lies over the lower edge."""

Bounds = tuple[float, float, float, float]
"""x and y of the lower left, then of the upper right corner [m]."""


def bounds_of(points: NDArray[np.float64]) -> Bounds:
    """Return the box around points (n, 2) [m]."""
    (x0, y0), (x1, y1) = points.min(axis=0).tolist(), points.max(axis=0).tolist()
    return x0, y0, x1, y1


def stand(bounds: Bounds, aspect: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return where the camera stands and what it looks at, (3,) [m] each.

    Args:
        bounds: what is to be seen.
        aspect: width of the picture over its height.
    """
    x0, y0, x1, y1 = bounds
    half_x, half_y = max(0.5 * (x1 - x0), 0.5), max(0.5 * (y1 - y0), 0.5)
    tan_v = math.tan(0.5 * FIELD_OF_VIEW)
    # The near edge of the map is nearer to the camera than its middle by this much.
    nearer = half_y * math.cos(ELEVATION)
    distance = (
        MARGIN * max(half_x / (tan_v * aspect), half_y * math.sin(ELEVATION) / tan_v) + nearer
    )
    middle = np.array([0.5 * (x0 + x1), 0.5 * (y0 + y1) - SHIFT * (y1 - y0), 0.0])
    away = np.array([0.0, -math.cos(ELEVATION), math.sin(ELEVATION)])
    return middle + distance * away, middle


INITIAL_ASPECT = 1.3
UNKNOWN_MAP: Bounds = (-4.0, -3.0, 4.0, 3.0)
"""What is looked at before there is a map."""


def set_initial(server: viser.ViserServer, bounds: Bounds) -> None:
    """Start new browsers with this view; "Reset View" returns to it."""
    position, look_at = stand(bounds, INITIAL_ASPECT)
    server.initial_camera.fov = FIELD_OF_VIEW
    server.initial_camera.position = position
    server.initial_camera.look_at = look_at


def fit(client: viser.ClientHandle, bounds: Bounds, aspect: float) -> None:
    """Move one browser's camera so that it sees all of `bounds`, `aspect` times as wide as high."""
    position, look_at = stand(bounds, aspect)
    with client.atomic():
        client.camera.fov = FIELD_OF_VIEW
        client.camera.position = position
        client.camera.look_at = look_at


def stands(client: viser.ClientHandle, bounds: Bounds, aspect: float) -> bool:
    """Whether the camera stands where `fit` put it: nobody has moved it since."""
    position, _ = stand(bounds, aspect)
    return np.allclose(client.camera.position, position, atol=1e-2)


def was_reset(client: viser.ClientHandle, bounds: Bounds) -> bool:
    """Whether the camera stands where every page begins.

    A page that is slow to start goes there after it has been told where to look.
    """
    starts = (stand(one, INITIAL_ASPECT)[0] for one in (bounds, UNKNOWN_MAP))
    return any(np.allclose(client.camera.position, start, atol=1e-3) for start in starts)
