"""How good a pose estimate must be to be saved, and the mean of several."""

import dataclasses
import math

from trolley import codes
from trolley.codes import Refused
from trolley.geometry import Pose2D, Twist2D, angle_difference
from trolley.messages import PoseEstimate


@dataclasses.dataclass(frozen=True, slots=True)
class CaptureLimits:
    """What the robot must know of its pose for it to be saved. All by hand."""

    max_age_s: float = 1.0
    """Greatest age of the newest estimate."""
    max_std_m: float = 0.15
    """Standard deviation along the long axis of the position's ellipse."""
    max_std_rad: float = math.radians(5.0)
    """Standard deviation of the heading."""
    standing_mps: float = 0.02
    """Up to this speed the robot counts as standing."""
    standing_radps: float = 0.05
    """Up to this turning speed the robot counts as standing."""
    min_estimates: int = 2
    """Fewer do not make a mean."""
    max_estimates: int = 5
    """Number of estimates that are enough."""
    window_s: float = 1.5
    """Robot time that the estimates may span."""


LIMITS = CaptureLimits()


def age_s(estimate: PoseEstimate | None, now_ns: int | None) -> float | None:
    """How old the newest estimate is [s], None where it or robot time is missing."""
    if estimate is None or now_ns is None:
        return None
    return max(0.0, (now_ns - estimate.stamp_ns) * 1e-9)


def checked_estimate(estimate: PoseEstimate | None, now_ns: int | None) -> PoseEstimate:
    """The newest estimate, if it says where the robot is.

    Raises:
        Refused: `stale`, `lost` or `not_converged`.
    """
    age = age_s(estimate, now_ns)
    if estimate is None or age is None:
        raise Refused(
            codes.STALE,
            "There is no pose yet: the localizer or the base is not running, or there is no map.",
        )
    if age > LIMITS.max_age_s:
        raise Refused(codes.STALE, f"The newest pose is {age:.1f} s old.", age=age)
    if estimate.state in ("lost", "searching") or estimate.pose is None or estimate.map is None:
        raise Refused(codes.LOST, state=estimate.state)
    check_spread(estimate.covariance)
    return estimate


def check_spread(covariance: list[float] | None) -> None:
    """Refuse an estimate that is too uncertain.

    Args:
        covariance: 3 x 3 row-major over x, y [m], yaw [rad].

    Raises:
        Refused: `not_converged`, with the standard deviations as details.
    """
    if covariance is None:
        raise Refused(codes.NOT_CONVERGED)
    xx, xy, yy = covariance[0], 0.5 * (covariance[1] + covariance[3]), covariance[4]
    # The larger eigenvalue of the position's block: the long half axis of its ellipse, squared.
    largest = 0.5 * (xx + yy) + math.hypot(0.5 * (xx - yy), xy)
    std_m, std_rad = math.sqrt(max(0.0, largest)), math.sqrt(max(0.0, covariance[8]))
    if not (std_m <= LIMITS.max_std_m and std_rad <= LIMITS.max_std_rad):
        raise Refused(
            codes.NOT_CONVERGED,
            f"The pose is only certain to {std_m:.2f} m and {math.degrees(std_rad):.0f} degrees; "
            f"{LIMITS.max_std_m:.2f} m and {math.degrees(LIMITS.max_std_rad):.0f} degrees are "
            "needed. Drive a little or set the pose.",
            std_m=std_m,
            std_deg=math.degrees(std_rad),
        )


def check_standing(twist: Twist2D) -> None:
    """Refuse a robot that moves.

    Raises:
        Refused: `moving`.
    """
    if twist.speed > LIMITS.standing_mps or abs(twist.wz) > LIMITS.standing_radps:
        raise Refused(codes.MOVING)


def check_sure(estimate: PoseEstimate) -> None:
    """Refuse an estimate that is unsure: what fits the map, or is certain, may still be wrong.

    Raises:
        Refused: `not_converged`.
    """
    if estimate.state == "unsure":
        raise Refused(codes.NOT_CONVERGED)


class PoseAverage:
    """The mean of 2 to 5 estimates of a standing robot within 1.5 s."""

    def __init__(self) -> None:
        self._estimates: list[PoseEstimate] = []

    def add(self, estimate: PoseEstimate) -> bool:
        """Add an estimate that was checked; True when there are enough.

        One that lies more than 1.5 s (robot time) after the first does not count, and ends it.
        """
        if self._estimates:
            first, last = self._estimates[0], self._estimates[-1]
            if estimate.stamp_ns <= last.stamp_ns:
                return False
            if (estimate.stamp_ns - first.stamp_ns) * 1e-9 > LIMITS.window_s:
                return True
            if estimate.map != first.map:
                raise Refused(codes.NOT_CONVERGED, "The map changed meanwhile.")
        self._estimates.append(estimate)
        return len(self._estimates) >= LIMITS.max_estimates

    def mean(self) -> tuple[PoseEstimate, Pose2D, list[float]]:
        """The newest estimate, the mean pose, and its covariance.

        The covariance is the mean of the estimates' plus their scatter: they come from the same
        walls, so averaging does not make them as certain as independent ones would be.

        Raises:
            Refused: There are too few, or they do not agree.
        """
        number = len(self._estimates)
        poses = [one.pose for one in self._estimates if one.pose is not None]
        if number < LIMITS.min_estimates:
            raise Refused(codes.STALE, "The localizer gave too few poses to save one.")
        x = math.fsum(pose.x for pose in poses) / number
        y = math.fsum(pose.y for pose in poses) / number
        sin = math.fsum(math.sin(pose.yaw) for pose in poses)
        cos = math.fsum(math.cos(pose.yaw) for pose in poses)
        mean = Pose2D(x, y, math.atan2(sin, cos)).wrapped()
        total = [0.0] * 9
        for estimate, pose in zip(self._estimates, poses, strict=True):
            off = (pose.x - x, pose.y - y, angle_difference(pose.yaw, mean.yaw))
            for index, own in enumerate(estimate.covariance or []):
                total[index] += (own + off[index // 3] * off[index % 3]) / number
        check_spread(total)
        return self._estimates[-1], mean, total
