"""Where the camera stands: above the map, at first a little to the south, so that all is seen."""

import math
from dataclasses import dataclass

import numpy as np
import viser
from numpy.typing import NDArray

FIELD_OF_VIEW = math.radians(42.0)
ELEVATION = math.radians(66.0)
FROM_ABOVE = math.radians(89.7)
"""Not quite straight down: there no way would be up."""
NORTH = 0.5 * math.pi
NEAR_M = 5.0
"""How far the camera is from what is looked at from near, and from a robot that it follows."""
BESIDE = np.array([0.0, 0.0, 1e-3])
"""What viser takes for another point to look at [m], and nobody sees."""
MARGIN = 1.1
SHIFT = 0.05
"""How far the map is moved up, by its height: Stop lies over the lower edge."""

Bounds = tuple[float, float, float, float]
"""x and y of the lower left, then of the upper right corner [m]."""


def bounds_of(points: NDArray[np.float64]) -> Bounds:
    """Return the box around points (n, 2) [m]."""
    (x0, y0), (x1, y1) = points.min(axis=0).tolist(), points.max(axis=0).tolist()
    return x0, y0, x1, y1


@dataclass(frozen=True)
class Look:
    """How a person wants to see the map.

    Attributes:
        is_flat: from straight above.
        follows: with the robot in the middle.
        turns: with the robot's heading up instead of north; it follows then.
    """

    is_flat: bool = False
    follows: bool = False
    turns: bool = False

    @property
    def elevation(self) -> float:
        """How high the camera stands over what it looks at [rad]."""
        return FROM_ABOVE if self.is_flat else ELEVATION


def stand(
    bounds: Bounds, aspect: float, elevation: float = ELEVATION
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return where the camera stands and what it looks at, (3,) [m] each; north is up.

    Args:
        bounds: what is to be seen.
        aspect: width of the picture over its height.
        elevation: how high it stands [rad].
    """
    x0, y0, x1, y1 = bounds
    half_x, half_y = max(0.5 * (x1 - x0), 0.5), max(0.5 * (y1 - y0), 0.5)
    tan_v = math.tan(0.5 * FIELD_OF_VIEW)
    # The near edge of the map is nearer to the camera than its middle by this much.
    nearer = half_y * math.cos(elevation)
    distance = (
        MARGIN * max(half_x / (tan_v * aspect), half_y * math.sin(elevation) / tan_v) + nearer
    )
    middle = np.array([0.5 * (x0 + x1), 0.5 * (y0 + y1) - SHIFT * (y1 - y0), 0.0])
    return middle + distance * away(elevation, NORTH), middle


def away(elevation: float, up: float) -> NDArray[np.float64]:
    """Return the direction (3,) from what is looked at to the camera.

    Args:
        elevation: how high it stands [rad].
        up: which heading is up in the picture [rad].
    """
    flat = math.cos(elevation)
    return np.array([-flat * math.cos(up), -flat * math.sin(up), math.sin(elevation)])


def turned(offset: NDArray[np.float64], by: float) -> NDArray[np.float64]:
    """Return an offset (3,) turned around the vertical [rad]."""
    cos, sin = math.cos(by), math.sin(by)
    x, y, z = offset.tolist()
    return np.array([cos * x - sin * y, sin * x + cos * y, z])


INITIAL_ASPECT = 1.3
UNKNOWN_MAP: Bounds = (-4.0, -3.0, 4.0, 3.0)
"""What is looked at before there is a map."""


def starts(bounds: Bounds) -> list[NDArray[np.float64]]:
    """Where the camera of a page begins, (3,) [m] each: before it knows of a map, and after."""
    return [stand(one, INITIAL_ASPECT)[0] for one in (UNKNOWN_MAP, bounds)]


def set_initial(server: viser.ViserServer, bounds: Bounds) -> None:
    """Start new browsers with this view."""
    position, look_at = stand(bounds, INITIAL_ASPECT)
    server.initial_camera.fov = FIELD_OF_VIEW
    server.initial_camera.position = position
    server.initial_camera.look_at = look_at


def fit(
    client: viser.ClientHandle, bounds: Bounds, aspect: float, elevation: float = ELEVATION
) -> None:
    """Move one browser's camera so that it sees all of `bounds`, `aspect` times as wide as high."""
    client.camera.fov = FIELD_OF_VIEW
    move(client, *stand(bounds, aspect, elevation))


def move(
    client: viser.ClientHandle, position: NDArray[np.float64], look_at: NDArray[np.float64]
) -> None:
    """Move one browser's camera: where it stands and what it looks at, (3,) [m] each.

    To move it, viser moves what it looks at along. It leaves out to set that back where it believes
    that the page looks there, and a page's report of before makes it believe so: hence by way of a
    point beside it.
    """
    with client.atomic():
        client.camera.position = position
        client.camera.look_at = look_at + BESIDE
        client.camera.look_at = look_at


def stands(client: viser.ClientHandle, bounds: Bounds, aspect: float) -> bool:
    """Whether the camera stands where `fit` put it: nobody has moved it since."""
    position, _ = stand(bounds, aspect)
    return np.allclose(client.camera.position, position, atol=1e-2)
