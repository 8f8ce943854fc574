"""What ROS 2 nodes publish, on its way to the service's thread."""

from collections.abc import Callable
from typing import Any, cast

from trolley.runtime.foreign_bus import ForeignSample
from trolley.runtime.inbox import MAX_WAITING
from trolley.runtime.lockstep import Lockstep
from trolley.runtime.service import Service
from trolley_ros2 import cdr
from trolley_ros2.graph import Graph
from trolley_ros2.inputs import Input
from trolley_ros2.names import NO_HASH, Attachment, Endpoint, Qos

KEY = Endpoint("cmd_vel", cdr.TWIST, NO_HASH, Qos(depth=1)).key(0)


class Nodes:
    """The ROS graph, as far as an input needs it: whoever publishes calls `hear`."""

    hear: Callable[[ForeignSample], None]

    def listen(self, _name: str, _type: str, callback: Callable[[ForeignSample], None]) -> None:
        self.hear = callback

    def takes_hash(self, _type: str, _hash: str) -> bool:
        return True


def twist(vx: float) -> Any:
    along = cdr.make("geometry_msgs/msg/Vector3", vx, 0.0, 0.0)
    return cdr.make(cdr.TWIST, along, cdr.make("geometry_msgs/msg/Vector3", 0.0, 0.0, 0.0))


class Bridge(Service):
    name = "ros2"


def test_an_input_goes_on_after_a_flood_of_other_things_to_do() -> None:
    heard: list[float] = []
    with Lockstep() as lockstep:
        bridge, nodes = lockstep.add(Bridge()), Nodes()
        velocities = Input(
            bridge,
            cast("Graph", nodes),
            "cmd_vel",
            (cdr.TWIST,),
            lambda message: heard.append(message.linear.x),
            20_000_000,
            300_000_000,
        )
        velocities.start()
        lockstep.run(0.1)
        for _ in range(MAX_WAITING):
            bridge.call_soon(lambda: None, urgent=True)
        for number, vx in enumerate((0.1, 0.2), start=1):
            stamp = Attachment(number, bridge.unix_ns, bytes(16)).pack()
            nodes.hear(ForeignSample(KEY, cdr.write(twist(vx)), stamp))
            lockstep.run(1.0)
    assert heard == [0.1, 0.2]
