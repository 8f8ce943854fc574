"""A simulated world on the wire: its truth is published, and robots of one world meet in it."""

from trolley import topics
from trolley.messages import Robot, Truth
from trolley.runtime.service import Service, every
from trolley_base.drivers.device import SimulatedWorld
from trolley_base.persistence import WORLD_FILE, SavedWorld
from trolley_base.robot_clock import Beat
from trolley_base.simulation.other_robots import OtherRobots

TRUTH_S = 0.05
"""Period of `sim/truth`."""
SAVE_WORLD_S = 1.0
"""Period at which the robot's true pose is saved, if it has changed."""


class SharedWorld:
    """A simulated world as the wire sees it.

    Args:
        service: base, which publishes and watches.
        name: of the world.
    """

    def __init__(self, service: Service, name: str) -> None:
        self._service = service
        self._name = name
        self._saved: SavedWorld | None = None
        self._beat = Beat(TRUTH_S)

    def begin(self, world: SimulatedWorld) -> None:
        """Begin a run in a world that has been opened."""
        self._world = world
        self._others = OtherRobots(self._service.robot, self._name)
        self._service.watch(topics.ROBOT, robot="*", then=self._take_robot)
        truth = self._service.watch(topics.SIM_TRUTH, robot="*", then=self._take_truth)
        truth.wakes = False

    def update(self, now_ns: int) -> None:
        """Publish the truth when it is due, and put the other robots where they are."""
        if not self._beat.is_due(now_ns):
            return
        self._service.publish(topics.SIM_TRUTH, self._world.truth())
        outlines = self._others.outlines(self._service.monotonic_ns)
        if outlines is not None:
            self._world.set_others(outlines)

    @every(SAVE_WORLD_S, clock="local")
    def save(self) -> None:
        """Save where the robot stands, so that a restart goes on there."""
        saved = self._world.to_save()
        if saved != self._saved:
            self._saved = saved
            self._service.save(WORLD_FILE, saved)

    def _take_robot(self, robot: Robot, name: str) -> None:
        self._others.update_robot(name, robot)

    def _take_truth(self, truth: Truth, name: str) -> None:
        self._others.update_truth(name, truth, self._service.arrived_ns)
