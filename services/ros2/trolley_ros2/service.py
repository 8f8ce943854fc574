"""The robot as ROS 2 nodes see it: one node more among them."""

from trolley.config import Ros2Config
from trolley.runtime.foreign_bus import ForeignBus
from trolley.runtime.service import Service, every
from trolley.supervision import Supervision
from trolley_ros2.graph import Graph
from trolley_ros2.inputs import Inputs
from trolley_ros2.outputs import Outputs

ALIVE_S = 5.0
"""How often systemd hears that the bridge does not hang; it waits for 20 s."""


class Ros2Service(Service):
    """Between the robot and ROS 2 nodes that use rmw_zenoh.

    Args:
        ros: a session at the nodes' router.
        settings: `[ros2]`.
        namespace: where the robot's topics are.
    """

    name = "ros2"

    def __init__(self, ros: ForeignBus, settings: Ros2Config, namespace: str) -> None:
        self._ros = ros
        self._supervision = Supervision()
        self._graph = Graph(ros, settings.domain, namespace, settings.distro)
        self._outputs = Outputs(self, self._graph)
        self._inputs = Inputs(self, self._graph) if settings.role == "operator" else None

    def start(self) -> None:
        """Join the nodes' graph."""
        self._graph.join()
        self._outputs.start()
        if self._inputs is not None:
            self._inputs.start()
        self._ros.bus.on_connection(
            lambda is_up: self.call_soon(lambda: self._note_connection(is_up=is_up), urgent=True)
        )
        self._supervision.ready()

    @every(ALIVE_S, clock="local")
    def say_alive(self) -> None:
        """Tell systemd, where it started the bridge."""
        self._supervision.alive()

    def epoch_began(self) -> None:
        """Forget what the run of base before said."""
        self._outputs.forget_epoch()

    def _note_connection(self, *, is_up: bool) -> None:
        if is_up:
            self.set_health("ok")
            self.log.info("The nodes' router is there again")
        else:
            why = "The router of the ROS 2 nodes does not answer."
            self.set_health("degraded", why)
            self.log.warning(why)
