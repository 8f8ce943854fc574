"""Other simulated robots of the same world, which are obstacles to this one."""

import numpy as np
from numpy.typing import NDArray

from trolley.messages import Robot, Truth

# A robot that has not been heard of for this long has been taken away [ns, local].
GONE_NS = 2_000_000_000


class Neighbours:
    """Where the others are, from what they publish.

    Args:
        name: this robot.
        world: its world.
    """

    def __init__(self, name: str, world: str) -> None:
        self._name = name
        self._world = world
        self._footprints: dict[str, NDArray[np.float64]] = {}
        self._truths: dict[str, tuple[Truth, int]] = {}
        self._changed = False

    def hear_robot(self, name: str, robot: Robot) -> None:
        """Take a robot's description."""
        self._footprints[name] = np.array(robot.footprint, dtype=np.float64)

    def hear_truth(self, name: str, truth: Truth, arrived_ns: int) -> None:
        """Take where a robot really is."""
        if name == self._name or truth.world != self._world:
            return
        known = self._truths.get(name)
        self._truths[name] = truth, arrived_ns
        self._changed |= known is None or known[0].pose != truth.pose

    def outlines(self, monotonic_ns: int) -> dict[str, NDArray[np.float64]] | None:
        """Return the outlines (n, 2) [m] in `map` by name; None if nothing has changed."""
        gone = [
            name
            for name, (_, arrived_ns) in self._truths.items()
            if monotonic_ns - arrived_ns > GONE_NS
        ]
        for name in gone:
            del self._truths[name]
        if not gone and not self._changed:
            return None
        self._changed = False
        return {
            name: truth.pose.transform_points(self._footprints[name])
            for name, (truth, _) in self._truths.items()
            if name in self._footprints
        }
