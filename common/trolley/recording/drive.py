"""The part of a recording that services can be run on: scans, odometry, and the robot's shape."""

import dataclasses
from bisect import bisect_left
from pathlib import Path
from typing import Any

from trolley import topics
from trolley.geometry import Pose2D, interpolate
from trolley.messages import (
    Clock,
    OccupancyGrid,
    Odometry,
    PoseEstimate,
    Robot,
    Scan,
    Transform,
    Zones,
)
from trolley.recording.reader import BadRecording, Entry, RecordingFile
from trolley.runtime import codec

MIN_SCANS = 2
_LASER = "tf/laser"


@dataclasses.dataclass
class Drive:
    """One run of a robot, as it was measured; stamps are robot time."""

    scans: list[Scan] = dataclasses.field(default_factory=list[Scan])
    odometry: list[Odometry] = dataclasses.field(default_factory=list[Odometry])
    base_T_laser: Pose2D | None = None
    robot: Robot | None = None
    map: OccupancyGrid | None = None
    zones: Zones | None = None
    estimate: PoseEstimate | None = None
    """The first one in which the robot knew where it was."""
    notes: list[str] = dataclasses.field(default_factory=list[str])
    """Sentences about what of the file is not in it."""

    @property
    def seconds(self) -> float:
        """From the first to the last scan."""
        return (self.scans[-1].stamp_ns - self.scans[0].stamp_ns) * 1e-9

    @property
    def map_T_start(self) -> Pose2D | None:
        """Where the robot stood at the first scan, None where it never knew."""
        if self.estimate is None or self.estimate.pose is None:
            return None
        odom_T_then = self.odom_T_base(self.estimate.stamp_ns)
        odom_T_start = self.odom_T_base(self.scans[0].stamp_ns)
        return self.estimate.pose @ odom_T_then.inverse() @ odom_T_start

    def odom_T_base(self, stamp_ns: int) -> Pose2D:
        """The odometry at a moment, interpolated; outside the drive its first or last pose."""
        rows = self.odometry
        after = bisect_left(rows, stamp_ns, key=lambda row: row.stamp_ns)
        if after in (0, len(rows)):
            return rows[min(after, len(rows) - 1)].pose
        one, other = rows[after - 1], rows[after]
        share = (stamp_ns - one.stamp_ns) / (other.stamp_ns - one.stamp_ns)
        return interpolate(one.pose, other.pose, share)


def read_drive(path: Path) -> Drive:
    """Read the first run of base in a recording; a restart ends it, since odometry starts over.

    Raises:
        BadRecording: It is not a recording, or lacks something.
    """
    drive = Drive()
    epoch: int | None = None
    recording = RecordingFile(path)
    for entry in recording.entries():
        message = _message(entry)
        if isinstance(message, Clock):
            if epoch not in (None, message.epoch) and drive.scans:
                drive.notes.append(
                    f"`base` was restarted after {drive.seconds:.0f} s, where the drive ends."
                )
                break
            epoch = message.epoch
        elif message is not None:
            _take(drive, entry, message)
    drive.notes += recording.damage.sentences()
    _check(path, drive)
    # A scan needs odometry before it; what is stamped twice or backwards is of no use.
    drive.scans = [scan for scan in drive.scans if scan.stamp_ns >= drive.odometry[0].stamp_ns]
    if len(drive.scans) < MIN_SCANS:
        raise BadRecording(f"{path}: holds too few scans with odometry to be played")
    return drive


def _message(entry: Entry) -> Any | None:
    try:
        return codec.decode(entry.topic.message, entry.payload, entry.encoding)
    except codec.BadPayload:
        return None


def _take(drive: Drive, entry: Entry, message: Any) -> None:
    match message:
        case Scan() if not drive.scans or message.stamp_ns > drive.scans[-1].stamp_ns:
            drive.scans.append(message)
        case Odometry() if not drive.odometry or message.stamp_ns > drive.odometry[-1].stamp_ns:
            drive.odometry.append(message)
        case Transform() if entry.name == _LASER:
            drive.base_T_laser = message.pose
        case Robot():
            drive.robot = message
        case OccupancyGrid() if entry.topic is topics.MAP:
            drive.map = drive.map or message
        case Zones():
            drive.zones = message
        case PoseEstimate(state="localized") if drive.estimate is None:
            drive.estimate = message
        case _:
            pass


def _check(path: Path, drive: Drive) -> None:
    missing = [
        name
        for name, there in (
            ("scan", len(drive.scans) >= MIN_SCANS),
            ("odom", bool(drive.odometry)),
            (_LASER, drive.base_T_laser is not None),
        )
        if not there
    ]
    if missing:
        raise BadRecording(
            f"{path}: holds no {' and no '.join(missing)}; record at least scan, odom and tf/laser"
        )
