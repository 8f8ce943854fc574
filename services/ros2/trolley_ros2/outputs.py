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
from trolley_ros2 import cdr, published, to_ros
from trolley_ros2.graph import Graph, Publisher
from trolley_ros2.published import RosTopic, TooManyFrames, Tree
from trolley_ros2.timing import RosClock


@dataclass(frozen=True)
class Source:
    """A topic of Trolley's, and what is done with a message of it."""

    topic: Topic[Any]
    then: Callable[..., None]
    parts: tuple[str, ...] = ()


@dataclass
class _Output:
    publisher: Publisher
    sources: tuple[Source, ...]
    watches: list[Watch[Any]] = field(default_factory=lambda: [])


class Outputs:
    """Publishes the robot's topics to ROS 2 nodes."""

    def __init__(self, service: Service, graph: Graph) -> None:
        self._service = service
        self._graph = graph
        self._outputs: dict[str, _Output] = {}
        self._clock = RosClock()
        self._tree = Tree()

    def start(self) -> None:
        """Show all publishers."""
        odom_on_map = Source(topics.TF, self._keep_map_T_odom, ("odom",))
        self._add(published.SCAN, Source(topics.SCAN, self._scan))
        self._add(published.ODOM, Source(topics.ODOM, self._odom))
        self._add(published.TF, odom_on_map, Source(topics.ODOM, self._tf))
        self._add(published.TF_STATIC, Source(topics.TF, self._tf_static))
        self._add(published.MAP, Source(topics.MAP, self._map))
        self._add(published.AMCL_POSE, Source(topics.POSE, self._pose))
        self._add(published.PLAN, Source(topics.PATH, self._plan))
        self._add(published.LOCAL_COSTMAP, Source(topics.COSTMAP, self._local_costmap))
        for name in self._outputs:
            self._update(name)

    def forget_epoch(self) -> None:
        """Drop what was said in an earlier run of base."""
        self._tree.map_T_odom = None

    def _add(self, topic: RosTopic, *sources: Source) -> None:
        name = topic.name
        publisher = self._graph.advertise(
            name,
            topic.type_name,
            topic.qos,
            on_heard=lambda: self._service.call_soon(lambda: self._update(name), urgent=True),
        )
        self._outputs[name] = _Output(publisher, sources)

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

    def _publish(self, topic: RosTopic, message: Any) -> None:
        name = topic.name
        try:
            self._outputs[name].publisher.publish(message, self._service.unix_ns)
        except cdr.NotWritten as problem:
            self._service.count(f"{name}/not_written")
            self._service.log.limited(name, "Not passed on to ROS 2", topic=name, why=str(problem))

    def _stamp(self, stamp_ns: int) -> int:
        return self._clock.stamp(stamp_ns, self._service.now_ns, self._service.unix_ns)

    def _scan(self, scan: Scan) -> None:
        self._publish(published.SCAN, to_ros.laser_scan(scan, self._stamp(scan.stamp_ns)))

    def _odom(self, odometry: Odometry) -> None:
        self._publish(published.ODOM, to_ros.odometry(odometry, self._stamp(odometry.stamp_ns)))

    def _keep_map_T_odom(self, transform: Transform, _child: str) -> None:
        self._tree.map_T_odom = transform

    def _tf(self, odometry: Odometry) -> None:
        self._publish(published.TF, self._tree.moving(odometry, self._stamp(odometry.stamp_ns)))

    def _tf_static(self, mount: Transform, child: str) -> None:
        try:
            message = self._tree.fixed(mount, child, self._service.unix_ns)
        except TooManyFrames:
            self._service.count("tf_static/too_many")
            return
        if message is not None:
            self._publish(published.TF_STATIC, message)

    def _map(self, grid: OccupancyGrid) -> None:
        self._publish(published.MAP, to_ros.grid(grid, self._stamp(grid.stamp_ns)))

    def _pose(self, estimate: PoseEstimate) -> None:
        message = to_ros.pose(estimate, self._stamp(estimate.stamp_ns))
        if message is not None:
            self._publish(published.AMCL_POSE, message)

    def _plan(self, path: Path) -> None:
        self._publish(published.PLAN, to_ros.path(path, self._stamp(path.stamp_ns)))

    def _local_costmap(self, grid: OccupancyGrid) -> None:
        self._publish(published.LOCAL_COSTMAP, to_ros.grid(grid, self._stamp(grid.stamp_ns)))
