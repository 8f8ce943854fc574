"""Odometry at the moments of a scan, from the messages around them."""

from bisect import bisect_left
from collections.abc import Sequence

from trolley.geometry import Pose2D, integrate_twist, interpolate
from trolley.messages import Odometry

# Odometry is carried on by its twist for at most so long [s].
MAX_EXTRAPOLATION_S = 0.2


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
