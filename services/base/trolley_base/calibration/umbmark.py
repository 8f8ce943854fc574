"""UMBmark: how far from its start a robot ends that drove a square, both ways round.

Errors of the track turn both ways alike too far, unequal wheels bend one way in and the other way
out; so the centres of gravity of where it ends, clockwise and counter-clockwise, tell them apart.

Source:
    Borenstein, Feng, UMBmark: A Benchmark Test for Measuring Odometry Errors in Mobile Robots
    (1995), sections 3 and 4. x is the direction of the first side, y left of it.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D

Direction = Literal["ccw", "cw"]
WORSE_SHARE, WORSE_M = 1.1, 0.01
"""Two results of one drive that differ by less are as good as each other; by hand."""


@dataclass(frozen=True, slots=True)
class Return:
    """One square: where the robot ended, seen from where it began.

    Attributes:
        direction: counter-clockwise or clockwise.
        measured: start_T_end as measured from outside.
        odometry: start_T_end by odometry.
    """

    direction: Direction
    measured: Pose2D
    odometry: Pose2D

    @property
    def error(self) -> tuple[float, float]:
        """Return measured less odometry, x, y [m]."""
        return self.measured.x - self.odometry.x, self.measured.y - self.odometry.y


@dataclass(frozen=True, slots=True)
class Benchmark:
    """The figures of UMBmark.

    Attributes:
        centre_ccw: mean error of the counter-clockwise squares, x, y [m].
        centre_cw: the same clockwise.
        largest_m: E_max,syst: the larger distance of the two from zero [m].
        alpha_rad: what a quarter turn falls short of, by the track (type A) [rad].
        beta_rad: what a side bends to the left, by unequal wheels (type B) [rad].
    """

    centre_ccw: tuple[float, float]
    centre_cw: tuple[float, float]
    largest_m: float
    alpha_rad: float
    beta_rad: float

    def is_worse_than(self, other: "Benchmark") -> bool:
        """Say whether odometry misses the ends by more than chance makes of the same drive."""
        return self.largest_m > WORSE_SHARE * other.largest_m + WORSE_M

    @property
    def track_ratio(self) -> float:
        """E_b: the effective track over the one that the board assumes."""
        return 0.5 * math.pi / (0.5 * math.pi - self.alpha_rad)

    def wheel_ratio(self, side_m: float, track_m: float) -> float:
        """E_d: the right wheel's diameter over the left one's."""
        if self.beta_rad == 0.0:
            return 1.0
        radius = 0.5 * side_m / math.sin(0.5 * self.beta_rad)
        return (radius + 0.5 * track_m) / (radius - 0.5 * track_m)


def benchmark(returns: Sequence[Return], side_m: float) -> Benchmark:
    """Return the figures of squares with sides of `side_m`.

    Raises:
        ValueError: not at least one square each way round.
    """
    ccw, cw = (_centre(returns, direction) for direction in ("ccw", "cw"))
    # Each from x and from y, and the mean of both.
    alphas = (cw[0] + ccw[0]) / (-4.0 * side_m), (cw[1] - ccw[1]) / (-4.0 * side_m)
    betas = (cw[0] - ccw[0]) / (-4.0 * side_m), (cw[1] + ccw[1]) / (-4.0 * side_m)
    return Benchmark(
        centre_ccw=(float(ccw[0]), float(ccw[1])),
        centre_cw=(float(cw[0]), float(cw[1])),
        largest_m=max(math.hypot(*ccw), math.hypot(*cw)),
        alpha_rad=float(np.mean(alphas)),
        beta_rad=float(np.mean(betas)),
    )


def _centre(returns: Sequence[Return], direction: Direction) -> NDArray[np.float64]:
    errors = [one.error for one in returns if one.direction == direction]
    if not errors:
        raise ValueError(f"UMBmark needs squares both ways round; there is none {direction}")
    return np.mean(errors, axis=0)
