"""What the lidar sees during setup, as a picture from above: the robot's front is up."""

import math
from collections.abc import Iterable

from trolley.messages import SetupSight
from trolley.messages.types import Point
from trolley_viz.controls.markup import note

LEAST, MOST_M = 1.5, 4.0
"""It shows at least so many times the room that has to be free, and at most so far [m]."""
SHARE = 0.8
"""Share of the echoes that it shows within these."""
BELIEVED = (
    "What the lidar sees from above, if it is mounted as robot.toml says. The circle is to be free."
)
MEASURED = (
    "What the lidar sees from above, as it was measured. The robot's front is up: compare it with "
    "the room."
)


def sight_html(sight: SetupSight) -> str:
    """Draw the echoes, the robot, its lidar and the room that has to be free, and say so."""
    reach = _reach_m(sight)
    box = f"{-reach:.3f} {-reach:.3f} {2.0 * reach:.3f} {2.0 * reach:.3f}"
    dots = "".join(f"M{_at(point)}h0" for point in sight.points if math.hypot(*point) < 2.0 * reach)
    front = max((x for x, _ in sight.outline), default=0.0)
    arrow = ((front + 0.14, 0.0), (front + 0.04, 0.06), (front + 0.04, -0.06))
    return (
        f'<div class="sight"><svg viewBox="{box}" role="img">'
        f'<circle class="sight-room" r="{sight.room_m:.3f}"/>'
        f'<path class="sight-echo" d="{dots}"/>'
        f'<polygon class="sight-robot" points="{_corners(sight.outline)}"/>'
        f'<polygon class="sight-front" points="{_corners(arrow)}"/>'
        f'<path class="sight-lidar" d="M{_at(sight.laser)}h0"/>'
        f"</svg></div>{note(MEASURED if sight.is_measured else BELIEVED)}"
    )


def _reach_m(sight: SetupSight) -> float:
    """Return how far the picture shows the room in each direction [m]."""
    away = sorted(max(abs(x), abs(y)) for x, y in sight.points)
    far = away[int(SHARE * (len(away) - 1))] if away else 0.0
    return max(LEAST * sight.room_m, min(1.05 * far, MOST_M))


def _corners(points: Iterable[Point]) -> str:
    return " ".join(map(_at, points))


def _at(point: Point) -> str:
    """Return a point in `base_link` as the picture has it: ahead is up, left is left."""
    x, y = point
    return f"{-y:.3f},{-x:.3f}"
