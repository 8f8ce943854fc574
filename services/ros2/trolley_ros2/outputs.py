"""What ROS 2 nodes see of the robot. Only what somebody subscribes to is watched and published."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from trolley import topics
from trolley.messages import (
    OccupancyGrid,
    Odometry,
    Path,
    PoseEstimate,
    Scan,
    Transform,
)
from trolley.runtime.service import Service, Watch
from trolley.topics import Topic
from trolley_ros2 import cdr, outgoing
from trolley_ros2.graph import Graph, Publisher
from trolley_ros2.names import Qos
from trolley_ros2.timing import RosClock

SENSOR = Qos(depth=10)
TREE = Qos(depth=100)
"""As tf2's broadcasters publish."""
KEPT = Qos(depth=1, is_transient_local=True)
"""As `map_server` and AMCL publish: who comes later gets the newest."""
NEWEST = Qos(depth=1)
MOVING_FRAMES = ("odom", "base_link")
"""Frames that are on `/tf`; those on the robot are on `/tf_static`."""
MOST_FRAMES = 64
"""Frames on `/tf_static`: any program may publish some, and all are said again with each."""


@dataclass(frozen=True)
class Source:
    """A topic of Trolley's, and what is done with a message of it."""

    topic: Topic[Any]
    then: Callable[..., None]
    parts: tuple[str, ...] = ()


@dataclass
class _Output:
    name: str
    publisher: Publisher
    sources: tuple[Source, ...]
    watches: list[Watch[Any]] = field(default_factory=lambda: [])


class Outputs:
    """The robot's publishers."""

    def __init__(self, service: Service, graph: Graph) -> None:
        self._service = service
        self._graph = graph
        self._outputs: dict[str, _Output] = {}
        self._clock = RosClock()
        self._map_T_odom: Transform | None = None
        self._mounts: dict[str, Transform] = {}

    def start(self) -> None:
        """Show all publishers."""
        odom_on_map = Source(topics.TF, self._keep_map_T_odom, ("odom",))
        grid = cdr.OCCUPANCY_GRID
        self._add("scan", cdr.LASER_SCAN, SENSOR, Source(topics.SCAN, self._scan))
        self._add("odom", cdr.ODOMETRY, SENSOR, Source(topics.ODOM, self._odom))
        self._add("tf", cdr.TF_MESSAGE, TREE, odom_on_map, Source(topics.ODOM, self._tf))
        self._add("tf_static", cdr.TF_MESSAGE, KEPT, Source(topics.TF, self._tf_static))
        self._add("map", grid, KEPT, Source(topics.MAP, self._map))
        self._add("amcl_pose", cdr.POSE_WITH_COVARIANCE, KEPT, Source(topics.POSE, self._pose))
        self._add("plan", cdr.PATH, NEWEST, Source(topics.PATH, self._plan))
        self._add("local_costmap/costmap", grid, KEPT, Source(topics.COSTMAP, self._local_costmap))
        for name in self._outputs:
            self._update(name)

    def forget_epoch(self) -> None:
        """Drop what was said in an earlier run of base."""
        self._map_T_odom = None

    def _add(self, name: str, type_name: str, qos: Qos, *sources: Source) -> None:
        publisher = self._graph.advertise(
            name,
            type_name,
            qos,
            on_heard=lambda: self._service.call_soon(lambda: self._update(name), urgent=True),
        )
        self._outputs[name] = _Output(name, publisher, sources)

    def _update(self, name: str) -> None:
        """Watch what is subscribed to, and nothing else."""
        output = self._outputs.get(name)
        if output is None:
            return
        if output.publisher.is_heard and not output.watches:
            output.watches = [
                self._service.watch(one.topic, *one.parts, then=one.then) for one in output.sources
            ]
        elif not output.publisher.is_heard and output.watches:
            for watch in output.watches:
                self._service.close_watch(watch)
            output.watches = []
            output.publisher.forget()

    def _publish(self, name: str, message: Any) -> None:
        try:
            self._outputs[name].publisher.publish(message, self._service.unix_ns)
        except cdr.NotWritten as problem:
            self._service.count(f"{name}/not_written")
            self._service.log.limited(name, "Not passed on to ROS 2", topic=name, why=str(problem))

    def _stamp(self, stamp_ns: int) -> int:
        return self._clock.stamp(stamp_ns, self._service.now_ns, self._service.unix_ns)

    def _scan(self, scan: Scan) -> None:
        self._publish("scan", outgoing.laser_scan(scan, self._stamp(scan.stamp_ns)))

    def _odom(self, odometry: Odometry) -> None:
        self._publish("odom", outgoing.odometry(odometry, self._stamp(odometry.stamp_ns)))

    def _keep_map_T_odom(self, transform: Transform, _child: str) -> None:
        self._map_T_odom = transform

    def _tf(self, odometry: Odometry) -> None:
        # The correction holds until the next one: with each odometry it is said anew, as AMCL
        # does, so that what is seen now can be placed on the map now.
        stamp_ns = self._stamp(odometry.stamp_ns)
        known = [outgoing.base_in_odom(odometry)]
        if self._map_T_odom is not None:
            known.insert(0, self._map_T_odom)
        self._publish("tf", outgoing.transforms((one, stamp_ns) for one in known))

    def _tf_static(self, mount: Transform, child: str) -> None:
        if child in MOVING_FRAMES:
            return
        if child not in self._mounts and len(self._mounts) >= MOST_FRAMES:
            self._service.count("tf_static/too_many")
            return
        self._mounts[child] = mount
        # All of them each time, as tf2's static broadcaster does: only the newest is kept.
        stamp_ns = self._service.unix_ns
        self._publish(
            "tf_static", outgoing.transforms((one, stamp_ns) for one in self._mounts.values())
        )

    def _map(self, grid: OccupancyGrid) -> None:
        self._publish("map", outgoing.grid(grid, self._stamp(grid.stamp_ns)))

    def _pose(self, estimate: PoseEstimate) -> None:
        message = outgoing.pose(estimate, self._stamp(estimate.stamp_ns))
        if message is not None:
            self._publish("amcl_pose", message)

    def _plan(self, path: Path) -> None:
        self._publish("plan", outgoing.path(path, self._stamp(path.stamp_ns)))

    def _local_costmap(self, grid: OccupancyGrid) -> None:
        self._publish("local_costmap/costmap", outgoing.grid(grid, self._stamp(grid.stamp_ns)))
