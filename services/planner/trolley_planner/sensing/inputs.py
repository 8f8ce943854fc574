"""The planner's inputs: the newest messages of the other services."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from trolley import codes
from trolley.config import PlannerConfig
from trolley.extra_sensors import ExtraSensors
from trolley.geometry import Pose2D, Twist2D, integrate_twist, interpolate
from trolley.messages import (
    BaseState,
    OccupancyGrid,
    Odometry,
    PoseEstimate,
    Robot,
    SavedPoses,
    Scan,
    Suspects,
    Transform,
    Zones,
)
from trolley.messages.types import floats_from_bytes
from trolley.scanning import end_ns
from trolley_planner.sensing.published_costs import PublishedCosts

OWN_SOURCE = "planner"
"""The name under which base hears this service's commands."""


@dataclass(frozen=True, slots=True)
class InputParams:
    """When inputs are old, and how the pose is smoothed; by hand."""

    stale_s: float = 1.0
    """A pose estimate older than this is stale, as is one stamped this far ahead."""
    silent_s: float = 0.5
    """Without a scan or odometry for this long the robot is blind. One that is stamped this far
    ahead does not count: it would hide that none follows."""
    most_extrapolation_s: float = 0.2
    """Odometry is extrapolated for no longer than this."""
    smoothing: float = 0.25
    """Share of a new correction that the smoothed pose takes over at once."""
    jump_m: float = 0.3
    """Distance above which a correction of the pose is a jump, not noise."""
    jump_rad: float = 0.3
    """Angle above which a correction of the pose is a jump, not noise."""


INPUTS = InputParams()


class Inputs:
    """The newest messages of the other services, in the frame of the goals (`config.frame`)."""

    def __init__(self, config: PlannerConfig) -> None:
        self.frame = config.frame
        self.robot: Robot | None = None
        self.base_T_laser: Pose2D | None = None
        self.scan: Scan | None = None
        self.odometry: Odometry | None = None
        self.map: OccupancyGrid | None = None
        self.zones: Zones | None = None
        self.suspects: Suspects | None = None
        self.costs = PublishedCosts()
        self.extra_sensors = ExtraSensors({}, "mark")
        self.pose: PoseEstimate | None = None
        self.base: BaseState | None = None
        self.places: SavedPoses | None = None
        self.frame_T_odom: Pose2D | None = Pose2D.identity() if self.frame == "odom" else None
        self.steady_T_odom = self.frame_T_odom
        """The same, but smooth: what the final approach steers by."""
        self.num_jumps = 0
        """How often the pose was corrected by more than noise."""

    def update_scan(self, scan: Scan) -> bool:
        """Keep a scan; False if it has no usable beam, which is no better than silence."""
        if not (floats_from_bytes(scan.ranges) > 0.0).any():
            return False
        self.scan = scan
        return True

    def update_correction(self, transform: Transform) -> None:
        """Apply `tf/odom`: jumps at once, noise smoothly."""
        if self.frame != "map":
            return
        before, self.frame_T_odom = self.steady_T_odom, transform.pose
        if before is None or self.odometry is None:
            self.steady_T_odom = transform.pose
            return
        # Compared where the robot is: far from the odometry's origin a small turn moves it far.
        change = (before @ self.odometry.pose).inverse() @ (transform.pose @ self.odometry.pose)
        if math.hypot(change.x, change.y) > INPUTS.jump_m or abs(change.yaw) > INPUTS.jump_rad:
            self.num_jumps += 1
            self.steady_T_odom = transform.pose
            return
        part = Pose2D(
            INPUTS.smoothing * change.x, INPUTS.smoothing * change.y, INPUTS.smoothing * change.yaw
        )
        pose = self.odometry.pose
        self.steady_T_odom = before @ pose @ part @ pose.inverse()

    def begin_epoch(self) -> None:
        """Forget what was measured before the base restarted."""
        self.scan = self.odometry = self.pose = None
        self.extra_sensors.forget()
        if self.frame == "map":
            self.frame_T_odom = self.steady_T_odom = None

    def missing(self, has_time: bool) -> list[str]:
        """Return the names of what must be known before the first goal, in words of the wire."""
        needed: list[tuple[str, object]] = [
            ("clock", True if has_time else None),
            ("robot", self.robot),
            ("tf/laser", self.base_T_laser),
            ("scan", self.scan),
            ("odom", self.odometry),
        ]
        if self.frame == "map":
            # The pose's transform comes just before it.
            needed += [("map", self.map), ("zones", self.zones), ("pose", self.pose)]
        return [name for name, known in needed if known is None]

    def base_pose(self, steady: bool = False) -> Pose2D | None:
        """Return frame_T_base by the newest odometry; None while it is not known."""
        frame_T_odom = self.steady_T_odom if steady else self.frame_T_odom
        if frame_T_odom is None or self.odometry is None:
            return None
        return frame_T_odom @ self.odometry.pose

    def twist(self) -> Twist2D:
        """Return the robot's velocity by the newest odometry."""
        return Twist2D.zero() if self.odometry is None else self.odometry.twist

    def sweep_poses(self, scan: Scan, history: Sequence[Odometry]) -> tuple[Pose2D, Pose2D] | None:
        """Return the pose of the lidar at the first and at the last beam of a scan.

        Args:
            scan: the scan.
            history: odometry around the time of the scan, oldest first.
        """
        if self.frame_T_odom is None or self.base_T_laser is None or not history:
            return None
        first = odometry_at(history, scan.stamp_ns)
        last = odometry_at(history, end_ns(scan))
        return (
            self.frame_T_odom @ first @ self.base_T_laser,
            self.frame_T_odom @ last @ self.base_T_laser,
        )

    def pose_trouble(self, now_ns: int) -> str | None:
        """Return why the pose cannot be trusted, `lost` or `stale`; None if it can."""
        if self.frame == "odom":
            return None
        if self.pose is None:
            return "stale"
        if self.pose.state in ("lost", "searching") or self.pose.pose is None:
            return "lost"
        if self.frame_T_odom is None:
            return "stale"
        # After another map was loaded, its first pose may come before the map itself.
        if self.map is not None and self.pose.map not in (None, self.map.name):
            return "stale"
        return "stale" if abs(now_ns - self.pose.stamp_ns) > INPUTS.stale_s * 1e9 else None

    def silence(self, now_ns: int) -> str | None:
        """Return the code of what fell silent: the lidar, or the wheels' odometry; None if neither.

        The robot's own `base` sends both, so the odometry is silent when its motor board is.
        """
        for message, code in ((self.scan, codes.SCAN_LOST), (self.odometry, codes.LINK_LOST)):
            if message is None or abs(now_ns - message.stamp_ns) > INPUTS.silent_s * 1e9:
                return code
        return None

    @property
    def off_map_m(self) -> float | None:
        """How far the robot has driven since the map ended [m], None on the map."""
        return None if self.frame == "odom" or self.pose is None else self.pose.off_map

    @property
    def is_unsure(self) -> bool:
        """Whether the localizer itself doubts the pose."""
        return self.frame == "map" and self.pose is not None and self.pose.state == "unsure"


def odometry_at(history: Sequence[Odometry], stamp_ns: int) -> Pose2D:
    """Return odom_T_base at a moment: between two messages along the arc, beyond the last one on.

    Args:
        history: at least one message, oldest first.
        stamp_ns: robot time.
    """
    after = next((i for i, one in enumerate(history) if one.stamp_ns >= stamp_ns), len(history))
    if after == len(history):
        last = history[-1]
        ahead = min((stamp_ns - last.stamp_ns) * 1e-9, INPUTS.most_extrapolation_s)
        return integrate_twist(last.pose, last.twist, ahead)
    if after == 0:
        return history[0].pose
    before, later = history[after - 1], history[after]
    share = (stamp_ns - before.stamp_ns) / (later.stamp_ns - before.stamp_ns)
    return interpolate(before.pose, later.pose, share)
