"""A rosbag2 from a recording of Trolley: the topics that the bridge publishes."""

import shutil
from collections import Counter
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rosbags.interfaces import (
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

from trolley import topics
from trolley.messages import (
    Clock,
    OccupancyGrid,
    Odometry,
    PoseEstimate,
    Scan,
    Transform,
)
from trolley.messages import Path as PathMessage
from trolley.recording.reader import BadRecording, Entry, RecordingFile
from trolley.runtime import codec
from trolley_ros2 import cdr, names, published, to_ros
from trolley_ros2.published import RosTopic, TooManyFrames, Tree

VERSION = 8
"""Of metadata.yaml: Humble reads it, and so do all later ones."""


@dataclass
class Outcome:
    """What is in the bag, and what is not and why."""

    written: dict[str, int] = field(default_factory=dict[str, int])
    """Messages by topic of ROS 2."""
    left: dict[str, str] = field(default_factory=dict[str, str])
    """By topic of Trolley, why not."""
    notes: list[str] = field(default_factory=list[str])
    seconds: float = 0.0


def export(recording: RecordingFile, folder: Path, namespace: str) -> Outcome:
    """Write the recording as a bag into a new folder, with its stamps as they are.

    Raises:
        BadRecording: It holds nothing that ROS 2 knows. No folder is left.
        OSError: The bag cannot be written; what was written is removed.
    """
    writer = Writer(folder, version=VERSION, storage_plugin=StoragePlugin.MCAP)
    writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    run = _Export(writer, namespace)
    with ExitStack() as undo, writer:
        undo.callback(shutil.rmtree, folder, ignore_errors=True)
        for entry in recording.entries():
            run.take(entry)
        run.check(recording.path)
        undo.pop_all()
    return Outcome(
        written={names.joined(namespace, name): number for name, number in run.written.items()},
        left=dict(sorted(run.left.items())),
        notes=[
            *run.restarts,
            *(f"Left out: {number} {why}." for why, number in sorted(run.dropped.items())),
            *recording.damage.sentences(),
        ],
        seconds=run.seconds,
    )


class _Export:
    """Puts one message after the other into a bag."""

    def __init__(self, writer: Writer, namespace: str) -> None:
        self.written: Counter[str] = Counter()
        self.left: dict[str, str] = {}
        self.dropped: Counter[str] = Counter()
        self.restarts: list[str] = []
        self._writer = writer
        self._namespace = namespace
        self._connections: dict[RosTopic, Any] = {}
        self._tree = Tree()
        self._epoch: int | None = None
        self._span_ns: tuple[int, int] | None = None
        self._takers: dict[str, Callable[[Any, Entry], None]] = {
            topics.CLOCK.name: self._clock,
            topics.SCAN.name: self._scan,
            topics.ODOM.name: self._odom,
            topics.TF.name: self._tf,
            topics.MAP.name: self._map,
            topics.POSE.name: self._pose,
            topics.PATH.name: self._plan,
            topics.COSTMAP.name: self._costmap,
        }

    @property
    def seconds(self) -> float:
        """From the first to the last message in the bag."""
        return 0.0 if self._span_ns is None else (self._span_ns[1] - self._span_ns[0]) * 1e-9

    def take(self, entry: Entry) -> None:
        """Add what ROS 2 has of a message."""
        taker = self._takers.get(entry.topic.name)
        if taker is None:
            self.left[entry.name] = "`trolley ros2` publishes no such thing"
            return
        if entry.is_delete:
            return
        try:
            taker(codec.decode(entry.topic.message, entry.payload, entry.encoding), entry)
        except codec.BadPayload:
            self.dropped[f"of {entry.name} that cannot be understood"] += 1
        except cdr.NotWritten as problem:
            self.dropped[f"of {entry.name} that ROS 2's type cannot hold ({problem})"] += 1
        except TooManyFrames:
            self.dropped[f"of tf: there are more than {published.MOST_FRAMES} frames"] += 1

    def check(self, path: Path) -> None:
        """Refuse a bag without a message.

        Raises:
            BadRecording: There is none.
        """
        if not self.written:
            held = ", ".join(sorted(self.left)) or "nothing"
            raise BadRecording(
                f"{path}: holds nothing that a bag can hold, only {held}; record at least scan, "
                "odom, tf/* and map"
            )

    def _write(self, topic: RosTopic, message: Any, entry: Entry) -> None:
        data = cdr.write(message)
        if topic not in self._connections:
            self._connections[topic] = self._writer.add_connection(
                names.joined(self._namespace, topic.name),
                topic.type_name,
                typestore=cdr.STORE,
                offered_qos_profiles=[_offered(topic.qos)],
            )
        self._writer.write(self._connections[topic], entry.at_ns, data)
        self.written[topic.name] += 1
        first_ns = entry.at_ns if self._span_ns is None else self._span_ns[0]
        self._span_ns = first_ns, entry.at_ns

    def _clock(self, clock: Clock, entry: Entry) -> None:
        if self._epoch not in (None, clock.epoch):  # base was restarted: odometry starts over
            self._tree.map_T_odom = None
            last_ns = entry.at_ns if self._span_ns is None else self._span_ns[1]
            self.restarts.append(
                f"`base` was restarted after {self.seconds:.0f} s: `/odom` starts over there, and "
                f"time leaps by {(entry.at_ns - last_ns) * 1e-9:.0f} s."
            )
        self._epoch = clock.epoch

    def _scan(self, scan: Scan, entry: Entry) -> None:
        stamp_ns = _stamp(scan.stamp_ns, entry)
        self._write(published.SCAN, to_ros.laser_scan(scan, stamp_ns), entry)

    def _odom(self, odometry: Odometry, entry: Entry) -> None:
        stamp_ns = _stamp(odometry.stamp_ns, entry)
        self._write(published.ODOM, to_ros.odometry(odometry, stamp_ns), entry)
        self._write(published.TF, self._tree.moving(odometry, stamp_ns), entry)

    def _tf(self, transform: Transform, entry: Entry) -> None:
        child = entry.name.partition("/")[2]
        if child == "odom":
            self._tree.map_T_odom = transform
            return
        message = self._tree.fixed(transform, child, entry.at_ns)
        if message is not None:
            self._write(published.TF_STATIC, message, entry)

    def _map(self, grid: OccupancyGrid, entry: Entry) -> None:
        message = to_ros.grid(grid, _stamp(grid.stamp_ns, entry))
        self._write(published.MAP, message, entry)

    def _pose(self, estimate: PoseEstimate, entry: Entry) -> None:
        message = to_ros.pose(estimate, _stamp(estimate.stamp_ns, entry))
        if message is not None:
            self._write(published.AMCL_POSE, message, entry)

    def _plan(self, path: PathMessage, entry: Entry) -> None:
        message = to_ros.path(path, _stamp(path.stamp_ns, entry))
        self._write(published.PLAN, message, entry)

    def _costmap(self, grid: OccupancyGrid, entry: Entry) -> None:
        message = to_ros.grid(grid, _stamp(grid.stamp_ns, entry))
        self._write(published.LOCAL_COSTMAP, message, entry)


def _stamp(stamp_ns: int, entry: Entry) -> int:
    """A message's own stamp; when it came, where it has none."""
    return stamp_ns or entry.at_ns


def _offered(qos: names.Qos) -> Qos:
    unspecified = QosTime(0, 0)
    return Qos(
        history=QosHistory.KEEP_LAST,
        depth=qos.depth,
        reliability=QosReliability.RELIABLE,
        durability=(
            QosDurability.TRANSIENT_LOCAL if qos.is_transient_local else QosDurability.VOLATILE
        ),
        deadline=unspecified,
        lifespan=unspecified,
        liveliness=QosLiveliness.AUTOMATIC,
        liveliness_lease_duration=unspecified,
        avoid_ros_namespace_conventions=False,
    )
