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


class Heard:
    """An input of velocities, and what it lets through."""

    def __init__(self, lockstep: Lockstep) -> None:
        self.bridge, self._nodes = lockstep.add(Bridge()), Nodes()
        self.velocities: list[float] = []
        Input(
            self.bridge,
            cast("Graph", self._nodes),
            "cmd_vel",
            (cdr.TWIST,),
            lambda message: self.velocities.append(message.linear.x),
            20_000_000,
            300_000_000,
            lambda message: message.linear.x == 0.0,
        ).start()
        self._number = 0

    def publish(self, vx: float, took_s: float = 0.0) -> None:
        self._number += 1
        source_ns = self.bridge.unix_ns - round(took_s * 1e9)
        stamp = Attachment(self._number, source_ns, bytes(16)).pack()
        self._nodes.hear(ForeignSample(KEY, cdr.write(twist(vx)), stamp))


def test_an_input_goes_on_after_a_flood_of_other_things_to_do() -> None:
    with Lockstep() as lockstep:
        heard = Heard(lockstep)
        lockstep.run(0.1)
        for _ in range(MAX_WAITING):
            heard.bridge.call_soon(lambda: None, urgent=True)
        for vx in (0.1, 0.2):
            heard.publish(vx)
            lockstep.run(1.0)
    assert heard.velocities == [0.1, 0.2]


def test_of_what_was_long_on_its_way_only_a_stop_holds() -> None:
    with Lockstep() as lockstep:
        heard = Heard(lockstep)
        for vx, took_s in ((0.1, 0.0), (0.2, 0.5), (0.0, 0.5), (0.3, 0.5), (0.4, 0.0)):
            heard.publish(vx, took_s)
            lockstep.run(0.1)
    assert heard.velocities == [0.1, 0.0, 0.4]
