"""What base does for a simulated world: it tells the truth, and meets others who drive there."""

from collections.abc import Callable

import msgspec

from trolley import topics
from trolley.messages import Robot, Truth
from trolley.runtime.service import Service
from trolley_base.persistence import WORLD_FILE, SavedWorld
from trolley_base.robot_clock import Beat
from trolley_base.simulation.other_robots import Neighbours
from trolley_base.simulation.simulated_device import SimulatedRun

TRUTH_S = 0.05


class SharedWorld:
    """A simulated world as the wire sees it.

    Args:
        service: base, which publishes and watches.
        simulated: the robot in the world.
        world: the world's name.
        save: writes a state file.
    """

    def __init__(
        self,
        service: Service,
        simulated: SimulatedRun,
        world: str,
        save: Callable[[str, msgspec.Struct], None],
    ) -> None:
        self._service = service
        self._simulated = simulated
        self._write = save
        self._saved: SavedWorld | None = None
        self._beat = Beat(TRUTH_S)
        self._neighbours = Neighbours(service.robot, world)
        service.watch(topics.ROBOT, robot="*", then=self._hear_robot)
        service.watch(topics.SIM_TRUTH, robot="*", then=self._hear_truth)

    def tell(self, now_ns: int) -> None:
        """Publish the truth when it is due, and see where the others are."""
        if not self._beat.is_due(now_ns):
            return
        self._service.publish(topics.SIM_TRUTH, self._simulated.truth())
        outlines = self._neighbours.outlines(self._service.monotonic_ns)
        if outlines is not None:
            self._simulated.set_others(outlines)

    def save(self) -> None:
        """Keep where the robot stands, so that a restart goes on there."""
        saved = self._simulated.saved()
        if saved != self._saved:
            self._saved = saved
            self._write(WORLD_FILE, saved)

    def _hear_robot(self, robot: Robot, name: str) -> None:
        self._neighbours.hear_robot(name, robot)

    def _hear_truth(self, truth: Truth, name: str) -> None:
        self._neighbours.hear_truth(name, truth, self._service.arrived_ns)
