"""Sensors beside the lidar: what is published as `scan/<name>`, kept near the robot.

Each echo stays where it was seen while the robot moves on: until its own sensor sees past that
place, for `kept_s` where it does not look. What has come nearer than `range_min`, within which a
sensor may overlook things, stays as long as it looks that way, for the robot may stand before it.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley.config.base import ExtraSensorConfig, SensorUse
from trolley.geometry import Pose2D, wrap_angle
from trolley.messages import Scan
from trolley.messages.types import floats_from_bytes
from trolley.scanning import end_ns

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class ExtraSensorParams:
    """What is believed of extra sensors, and for how long; set by hand."""

    late_s: float = 0.5
    """Scans that are older than this are not used [s, robot time]."""
    early_s: float = 0.1
    """Scans stamped more than this ahead are not used: their program has another clock [s]."""
    longest_s: float = 2.0
    """No sensor takes longer from a scan's first beam to its last [s]."""
    widest_rad: float = 2.0 * math.tau
    """None turns farther meanwhile [rad]."""
    silent_s: float = 1.0
    """A sensor that was heard and has sent nothing for this long is missing [s]."""
    past_m: float = 0.05
    """A beam sees past a point that is nearer than what it measures by this [m]."""
    cell_m: float = 0.02
    """Kept points nearer together than about this count as one [m]."""
    most_points: int = 2000
    """Of each sensor at most so many are kept, the newest."""


PARAMS = ExtraSensorParams()


class ExtraSensor:
    """The echoes of one sensor, in `odom`.

    Args:
        kept_s: for how long those are kept that nothing has seen past.
    """

    def __init__(self, kept_s: float) -> None:
        self._kept_ns = round(kept_s * 1e9)
        self.stamp_ns: int | None = None
        """Of its newest scan."""
        self._points_odom: Floats = np.empty((0, 2))
        self._seen_ns: NDArray[np.int64] = np.empty(0, np.int64)

    def update(self, scan: Scan, start: Pose2D, end: Pose2D) -> None:
        """Take a scan of at least one beam in place of what it looks at anew.

        Args:
            scan: in the frame of the sensor.
            start: odom_T_sensor at the first beam.
            end: and at the last.
        """
        ranges = floats_from_bytes(scan.ranges).astype(np.float64)
        count = len(ranges)
        is_valid = ranges > 0.0
        is_echo = is_valid & (ranges <= scan.range_max)
        share = np.linspace(0.0, 1.0, count)
        angles = scan.angle_min + scan.angle_increment * np.arange(count)
        yaws = angles + start.yaw + share * wrap_angle(end.yaw - start.yaw)
        beside = np.stack(
            [start.x + share * (end.x - start.x), start.y + share * (end.y - start.y)]
        )
        ahead = np.stack([np.cos(yaws), np.sin(yaws)])
        new = (beside + np.where(is_echo, ranges, 0.0) * ahead).T[is_echo]
        # How far each beam is known to be free.
        free_m = np.where(is_valid, np.minimum(ranges, scan.range_max), 0.0)
        is_past, is_too_near = self._judge(scan, free_m, start)
        known_ns = np.where(is_too_near, scan.stamp_ns, self._seen_ns)
        kept = ~is_past & (known_ns > scan.stamp_ns - self._kept_ns)
        points = np.concatenate([new, self._points_odom[kept]])
        seen_ns = np.concatenate([np.full(len(new), scan.stamp_ns), known_ns[kept]])
        cells = np.floor(points / PARAMS.cell_m).astype(np.int64)
        first = np.unique(cells, axis=0, return_index=True)[1]
        first = np.sort(first)[: PARAMS.most_points]
        self._points_odom, self._seen_ns = points[first], seen_ns[first]
        self.stamp_ns = scan.stamp_ns

    def points_odom(self, now_ns: int) -> Floats:
        """Return the echoes (n, 2) that are kept now."""
        return self._points_odom[self._seen_ns > now_ns - self._kept_ns]

    def _judge(
        self, scan: Scan, free_m: Floats, start: Pose2D
    ) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Say which points (n,) a scan measures anew or sees past, which are too near for it."""
        points = start.inverse().transform_points(self._points_odom)
        away = np.hypot(points[:, 0], points[:, 1])
        turned = np.arctan2(points[:, 1], points[:, 0]) - scan.angle_min
        beam = np.rint(turned % math.tau / scan.angle_increment)
        # Just right of the first beam is nearly a whole turn left of it.
        beam = np.where(turned % math.tau > math.tau - 0.5 * scan.angle_increment, 0, beam)
        is_in_view = beam < len(free_m)
        free = free_m[np.minimum(beam, len(free_m) - 1).astype(np.int64)]
        is_measurable = is_in_view & (away >= scan.range_min)
        is_past = is_measurable & (free > 0.0) & (away < free + PARAMS.past_m)
        return is_past, is_in_view & (away < scan.range_min + PARAMS.past_m)


class ExtraSensors:
    """The sensors that `[base.scans]` lists for one use.

    Args:
        listed: by name.
        use: for what.
    """

    def __init__(self, listed: Mapping[str, ExtraSensorConfig], use: SensorUse) -> None:
        self._listed = listed
        self._sensors = {
            name: ExtraSensor(one.kept_s) for name, one in listed.items() if use in one.uses
        }

    def update(
        self, name: str, scan: Scan, now_ns: int, odom_T_base: Callable[[int], Pose2D]
    ) -> str:
        """Take a scan.

        Args:
            name: of the sensor.
            scan: in its frame.
            now_ns: robot time.
            odom_T_base: where the robot was at a robot time.

        Returns:
            Why it is not used: `unlisted`, `empty`, `impossible`, `late` or `early`; "" if nothing
            is wrong.
        """
        if name not in self._listed:
            return "unlisted"
        sensor = self._sensors.get(name)
        if sensor is None:
            return ""
        if not scan.ranges:
            return "empty"
        beams = len(scan.ranges) // 4
        lasts_s, turns_rad = beams * abs(scan.time_increment), beams * scan.angle_increment
        if lasts_s > PARAMS.longest_s or turns_rad > PARAMS.widest_rad:
            return "impossible"
        age_ns = now_ns - scan.stamp_ns
        is_newer = sensor.stamp_ns is None or scan.stamp_ns > sensor.stamp_ns
        if age_ns > PARAMS.late_s * 1e9 or not is_newer:
            return "late"
        if age_ns < -PARAMS.early_s * 1e9:
            return "early"
        base_T_sensor = self._listed[name].pose.as_pose()
        start, end = (odom_T_base(one) @ base_T_sensor for one in (scan.stamp_ns, end_ns(scan)))
        sensor.update(scan, start, end)
        return ""

    def points_odom(self, now_ns: int) -> Floats:
        """Return the echoes (n, 2) [m] of all of them in `odom`."""
        if not self._sensors:
            return np.empty((0, 2))
        return np.concatenate([one.points_odom(now_ns) for one in self._sensors.values()])

    def silent(self, now_ns: int) -> list[str]:
        """Return the names of those that were heard and have gone silent."""
        return [
            name
            for name, one in self._sensors.items()
            if one.stamp_ns is not None and now_ns - one.stamp_ns > PARAMS.silent_s * 1e9
        ]

    def forget(self) -> None:
        """Forget everything: base began a new run."""
        self._sensors = {name: ExtraSensor(self._listed[name].kept_s) for name in self._sensors}
