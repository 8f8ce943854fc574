"""Whether there is nothing to learn from a scan: the robot stands and sees what it saw."""

from dataclasses import dataclass

from trolley.geometry import wrap_angle
from trolley.scanning import ScanInput
from trolley_localizer.kernels.resting import count_same


@dataclass(frozen=True, slots=True)
class RestParams:
    """When the localizer rests; set by hand."""

    settled: int = 10
    """Number of scans in a row that must show the same before the localizer rests."""
    look_s: float = 1.0
    """Time after which a scan is used even at rest [s]."""
    still_m: float = 0.005
    """Distance within which the odometry of a standing robot stays [m]."""
    still_rad: float = 0.005
    """Turn within which the odometry of a standing robot stays [rad]."""
    same_m: float = 0.03
    """Difference in range within which an echo is the same [m]."""
    same_share: float = 0.02
    """Share of its range that adds to `same_m`."""
    least_same: float = 0.85
    """Share of the echoes that must be the same."""
    least_both: float = 0.7
    """Share of the echoes that both scans must have: lidars miss one now and then."""


PARAMS = RestParams()


class Rest:
    """Compares scans with the one at which the robot came to stand."""

    def __init__(self) -> None:
        self._first: ScanInput | None = None
        self._num_same = 0
        self._looked_ns = 0

    def end(self) -> None:
        """Use each scan again, until the next have shown the same."""
        self._first = None

    def tells_nothing(self, scan: ScanInput) -> bool:
        """Say whether a scan need not be used."""
        first = self._first
        if first is None or not shows_same(first, scan):
            self._first, self._num_same = scan, 0
            return False
        self._num_same += 1
        is_due = scan.stamp_ns - self._looked_ns >= PARAMS.look_s * 1e9
        if self._num_same < PARAMS.settled or is_due:
            self._looked_ns = scan.stamp_ns
            return False
        return True


def shows_same(first: ScanInput, scan: ScanInput) -> bool:
    """Say whether a scan shows what an earlier one has shown, from the same place."""
    return _stands(first, scan) and _looks_same(first, scan)


def _stands(first: ScanInput, scan: ScanInput) -> bool:
    """Say whether robot and lidar have stood since, by the odometry, and during the scan."""
    before, now, during = first.odom_T_base, scan.odom_T_base, scan.motion
    if first.base_T_laser != scan.base_T_laser:
        return False
    return (
        before.distance_to(now) <= PARAMS.still_m
        and abs(wrap_angle(now.yaw - before.yaw)) <= PARAMS.still_rad
        and max(abs(during.x), abs(during.y)) <= PARAMS.still_m
        and abs(during.yaw) <= PARAMS.still_rad
    )


def _looks_same(first: ScanInput, scan: ScanInput) -> bool:
    """Say whether nearly all echoes of two scans are at the same distance."""
    begin = (scan.angle_min - first.angle_min) / first.angle_increment
    step = scan.angle_increment / first.angle_increment
    most, both, num_same = count_same(
        first.ranges, scan.ranges, begin, step, PARAMS.same_m, PARAMS.same_share
    )
    enough = max(1.0, PARAMS.least_both * most)
    return both >= enough and num_same >= PARAMS.least_same * both
