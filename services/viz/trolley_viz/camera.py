"""Where the camera stands: above the map, a little to the south, so that all of it is seen."""

import math

import numpy as np
import viser
from numpy.typing import NDArray

FIELD_OF_VIEW = math.radians(42.0)
ELEVATION = math.radians(66.0)
PANEL_PIXELS = 330
NARROW_PIXELS = 576
"""Below this width viser puts its panel over the lower part of the scene."""
BELOW = 0.8
"""How much more than the map is to be seen then, by its height."""
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


def set_initial(server: viser.ViserServer, bounds: Bounds) -> None:
    """Let new browsers begin with this view, and "Reset View" come back to it."""
    position, look_at = stand(bounds, 1.3)
    server.initial_camera.fov = FIELD_OF_VIEW
    server.initial_camera.position = position
    server.initial_camera.look_at = look_at


def fit(client: viser.ClientHandle, bounds: Bounds, *, is_new: bool) -> None:
    """Move one client's camera so that it sees all of `bounds`.

    A client that `is_new` tells the width of its window from before the panel was docked.
    """
    camera = client.camera
    width, height = camera.image_width, camera.image_height
    if width <= NARROW_PIXELS:
        x0, y0, x1, y1 = bounds
        bounds = (x0, y0 - BELOW * (y1 - y0), x1, y1)
    elif is_new:
        width -= PANEL_PIXELS
    position, look_at = stand(bounds, max(width, 1) / max(height, 1))
    with client.atomic():
        camera.fov = FIELD_OF_VIEW
        camera.position = position
        camera.look_at = look_at
