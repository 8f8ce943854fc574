"""The other robots of the same simulated world, which are obstacles to this one."""

import numpy as np
from numpy.typing import NDArray

from trolley.messages import Robot, Truth

GONE_NS = 2_000_000_000
"""A robot that has been silent for this long is no longer in the world [ns, local clock]."""


class OtherRobots:
    """The other robots' outlines, from what they publish.

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

    def update_robot(self, name: str, robot: Robot) -> None:
        """Keep a robot's footprint."""
        self._footprints[name] = np.array(robot.footprint, dtype=np.float64)

    def update_truth(self, name: str, truth: Truth, arrived_ns: int) -> None:
        """Keep where a robot truly is."""
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
