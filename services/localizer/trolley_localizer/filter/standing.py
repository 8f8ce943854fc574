"""A robot that stands and sees what it saw has nothing to learn: it need not look at each scan."""

import math
from dataclasses import dataclass

from trolley.scanning import ScanInput
from trolley_localizer.kernels.overlap import count_alike


@dataclass(frozen=True, slots=True)
class StandingParams:
    """When a scan is left unread. All values were set by hand."""

    still_m: float = 0.002
    still_rad: float = 0.002
    """Wheels that have moved by no more since the last look stand [m, rad]."""
    slack_m: float = 0.05
    slack_share: float = 0.02
    """Ranges that differ by no more than this [m], and this share, are alike: lidars are noisy."""
    least_alike: float = 0.95
    """Where a smaller share of the beams is alike, something has changed."""
    least_compared: int = 30
    """Fewer beams than this say nothing."""
    settled_looks: int = 10
    """After so many looks in a row at the same, pose and covariance have settled."""
    look_s: float = 0.9
    """From then on it looks this often, and at once when something changes [s]."""


PARAMS = StandingParams()


class Standing:
    """Says which scans are to be looked at."""

    def __init__(self) -> None:
        self._looked_at: ScanInput | None = None
        self._looks = 0

    def forget(self) -> None:
        """Look at the next scans, whatever they show."""
        self._looked_at, self._looks = None, 0

    def is_news(self, scan: ScanInput) -> bool:
        """Say whether a scan is to be looked at."""
        looked_at = self._looked_at
        if looked_at is None or self._looks < PARAMS.settled_looks:
            return True
        is_due = (scan.stamp_ns - looked_at.stamp_ns) * 1e-9 >= PARAMS.look_s
        return is_due or not shows_the_same(looked_at, scan)

    def look(self, scan: ScanInput) -> None:
        """Note that a scan has been looked at."""
        is_same = self._looked_at is not None and shows_the_same(self._looked_at, scan)
        self._looks = self._looks + 1 if is_same else 0
        self._looked_at = scan


def shows_the_same(before: ScanInput, scan: ScanInput) -> bool:
    """Say whether the robot has stood between two scans, by its wheels and by what it sees."""
    step = before.odom_T_base.inverse() @ scan.odom_T_base
    if math.hypot(step.x, step.y) > PARAMS.still_m or abs(step.yaw) > PARAMS.still_rad:
        return False
    if (
        scan.ranges.size != before.ranges.size
        or (scan.angle_min, scan.angle_increment) != (before.angle_min, before.angle_increment)
        or scan.base_T_laser != before.base_T_laser
    ):
        return False
    alike, compared = count_alike(before.ranges, scan.ranges, PARAMS.slack_m, PARAMS.slack_share)
    return compared >= PARAMS.least_compared and alike >= PARAMS.least_alike * compared
