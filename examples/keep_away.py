"""A layer of costs: the robot prefers paths that keep away from a saved place.

    python examples/keep_away.py crib

It drives there if there is no other way, or if it is sent there. Costs count for 10 s, so they end
with this program.
"""

import sys
import time

import numpy as np

from trolley import Robot, topics
from trolley.geometry import Pose2D
from trolley.gridmap import GridMap
from trolley.gridmap.wire import map_message

RADIUS = 1.5
"""So far from the place it rather drives elsewhere [m]."""
CELL = 0.1
"""The edge of a cell of the layer [m]; it need not be the map's."""


def layer(on_map: str, x: float, y: float) -> GridMap:
    """Costs around a point of a map [m]: 100 there, 0 from `RADIUS` on."""
    count = round(2.0 * RADIUS / CELL)
    middle = CELL * (np.arange(count) + 0.5) - RADIUS
    away = np.hypot(middle[:, None], middle[None, :])
    costs = 100.0 * (1.0 - away / RADIUS).clip(0.0)
    return GridMap(on_map, CELL, Pose2D(x - RADIUS, y - RADIUS, 0.0), costs.astype(np.int8))


if __name__ == "__main__":
    with Robot() as robot:
        name, places = sys.argv[1], robot.places()
        if name not in places:
            raise SystemExit(f"There is no place {name!r}; there are {', '.join(places)}.")
        place = places[name]
        costs = layer(place.map, place.pose.x, place.pose.y)
        while True:
            robot.publish(topics.COSTS, map_message(robot.now_ns() or 0, costs), "keep_away")
            time.sleep(2.0)
