"""Odometry at the moments of a scan, from the messages around them."""

from bisect import bisect_left
from collections.abc import Sequence

from trolley.geometry import Pose2D, integrate_twist, interpolate
from trolley.messages import Odometry, Scan

# Odometry is carried on by its twist for at most so long [s].
MAX_EXTRAPOLATION_S = 0.2
# Odometry of a scan's last beam is waited for so long [s, robot time].
WAIT_S = 0.1


def pose_at(history: Sequence[Odometry], stamp_ns: int) -> Pose2D | None:
    """Return odom_T_base at a moment: interpolated along an arc, or carried on by the twist.

    Args:
        history: messages, oldest first.
        stamp_ns: robot time [ns].

    Returns:
        None if the history is empty or ends or begins too far from the moment.
    """
    if not history:
        return None
    index = bisect_left(history, stamp_ns, key=lambda message: message.stamp_ns)
    if 0 < index < len(history):
        before, after = history[index - 1], history[index]
        span_ns = after.stamp_ns - before.stamp_ns
        share = (stamp_ns - before.stamp_ns) / span_ns if span_ns > 0 else 1.0
        return interpolate(before.pose, after.pose, share)
    edge = history[0] if index == 0 else history[-1]
    away_s = (stamp_ns - edge.stamp_ns) * 1e-9
    if abs(away_s) > MAX_EXTRAPOLATION_S:
        return None
    return integrate_twist(edge.pose, edge.twist, away_s)


def is_covered(history: Sequence[Odometry], stamp_ns: int) -> bool:
    """Say whether odometry has arrived from a moment or later."""
    return bool(history) and history[-1].stamp_ns >= stamp_ns


def end_ns(scan: Scan) -> int:
    """Return robot time of a scan's last beam [ns]; earlier than the first's if clockwise."""
    beams = len(scan.ranges) // 4
    return scan.stamp_ns + round(max(beams - 1, 0) * scan.time_increment * 1e9)


class WaitingScan:
    """The newest scan, until the odometry of its last beam is there or does not come."""

    def __init__(self) -> None:
        self._scan: Scan | None = None
        self._since_ns = 0

    def put(self, scan: Scan, now_ns: int) -> Scan | None:
        """Let a scan wait from now on (local monotonic time); returns the one that had to go."""
        before, self._scan, self._since_ns = self._scan, scan, now_ns
        return before

    def take(self, history: Sequence[Odometry], now_ns: int, rate: float) -> Scan | None:
        """Return the scan if it need not wait any more.

        Args:
            history: odometry, oldest first.
            now_ns: local monotonic time.
            rate: of robot time to it.
        """
        scan = self._scan
        if scan is None:
            return None
        waited_s = (now_ns - self._since_ns) * 1e-9 * rate
        if waited_s < WAIT_S and not is_covered(history, max(scan.stamp_ns, end_ns(scan))):
            return None
        self._scan = None
        return scan

    def forget(self) -> None:
        """Let no scan wait."""
        self._scan = None
