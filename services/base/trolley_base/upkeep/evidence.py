"""Whether wheels and lidar still are as robot.toml says, told from ordinary driving.

The localizer's poses are those of the lidar, brought to `base_link` by the pose that robot.toml
gives it. With D = base_T_laser, true, @ base_T_laser^-1, as written, it sees the base move by
D^-1 @ B @ D where it moves by B: a lidar that was turned makes the robot drive aside. B is what the
wheels count, with their scales. Stretch after stretch goes into one linear least-squares problem
whose older evidence fades, so that it costs the same after a minute and after a year.

Source:
    Censi, Franchi, Marchionni, Oriolo, Simultaneous Calibration of Odometry and Sensor Parameters
    for Mobile Robots (2013), for the model; Jazwinski, Stochastic Processes and Filtering Theory
    (1970), section 8.11, for the fading memory.
"""

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D
from trolley_base.upkeep.correction import Correction
from trolley_base.upkeep.legs import Leg

Floats = NDArray[np.float64]
LINEAR, ANGULAR, BEND, YAW, X, Y = range(6)


@dataclass(frozen=True, slots=True)
class UpkeepParams:
    """How evidence is weighed; set by hand."""

    memory: float = 80.0
    """Number of stretches over which older evidence fades to a third."""
    least_legs: int = 30
    """Number of stretches without which nothing is said."""
    prior: tuple[float, float, float, float, float, float] = (0.05, 0.08, 0.2, 0.2, 0.03, 0.03)
    """Standard deviations of what may have changed: scales, bend [rad/m], lidar [rad, m, m]."""
    huber: float = 2.0
    """A stretch that misses by more, in deviations, counts less."""
    difference: float = 1e-5
    """Step of the numeric derivatives."""
    loose_memory: float = 12.0
    """The same as `memory`, for how badly stretches fit at present."""
    loose: float = 4.0
    """Stretches that miss by so many deviations, whatever is corrected, are counted wrongly."""
    most_miss: float = 8.0
    """No single stretch counts for more in that."""
    outlier: float = 12.0
    """A stretch that misses by so many deviations, as where the robot scraped along something or
    its pose leapt, says nothing of scales and lidar."""


PARAMS = UpkeepParams()
PRIOR = np.diag(np.array(PARAMS.prior) ** -2.0)


@dataclass(frozen=True, slots=True)
class Errors:
    """What is wrong with robot.toml, each with its standard deviation.

    Attributes:
        values: (6,) true metres per metre and radians per radian, less 1; bend [rad/m]; by how much
            the lidar is turned [rad], and by how much moved in `base_link`, x, y [m].
        covariance: (6, 6).
        num_legs: number of stretches that count.
        misfit: by how many deviations stretches miss at present, whatever is corrected.
    """

    values: Floats
    covariance: Floats
    num_legs: float
    misfit: float

    def combined(self, *weights: tuple[int, float]) -> tuple[float, float]:
        """Return a sum of some of them, each with a weight, and its standard deviation."""
        gradient = np.zeros(6)
        for index, weight in weights:
            gradient[index] = weight
        variance = float(gradient @ self.covariance @ gradient)
        return float(gradient @ self.values), math.sqrt(max(0.0, variance))


@dataclass(slots=True)
class Upkeep:
    """The evidence so far; what it consists of can be saved.

    Attributes:
        base_T_laser: where the lidar sits by robot.toml.
        information: (6, 6).
        gradient: (6,).
        squares: weighted squares of the misses, and how many stretches they are of; both fade.
        misfit: by how many deviations stretches miss at present.
    """

    base_T_laser: Pose2D
    information: Floats = field(default_factory=lambda: np.zeros((6, 6)))
    gradient: Floats = field(default_factory=lambda: np.zeros(6))
    squares: float = 0.0
    num_legs: float = 0.0
    misfit: float = 1.0

    def update(self, leg: Leg) -> None:
        """Take a stretch."""
        misses, slopes = _linearize(leg, self.base_T_laser)
        after = misses + slopes @ self._values()
        size = float(np.sqrt(np.mean(after**2)))
        excess = self._excess
        weight = min(1.0, PARAMS.huber * math.sqrt(excess) / max(size, 1e-9))
        fading = 1.0 - 1.0 / PARAMS.memory
        now = min(size, PARAMS.most_miss)
        self.misfit += (now - self.misfit) / PARAMS.loose_memory
        if size > PARAMS.outlier:
            return
        self.information = fading * self.information + weight * slopes.T @ slopes
        self.gradient = fading * self.gradient - weight * slopes.T @ misses
        self.squares = fading * self.squares + weight * size**2
        self.num_legs = fading * self.num_legs + 1.0

    def errors(self) -> Errors | None:
        """Return what is wrong, None while too little was driven."""
        if self.num_legs < PARAMS.least_legs:
            return None
        spread = np.linalg.inv(self.information + PRIOR)
        covariance = np.asarray(self._excess * spread, np.float64)
        return Errors(self._values(), covariance, self.num_legs, self.misfit)

    @property
    def _excess(self) -> float:
        """How much larger the squares of the misses are than expected, at least 1."""
        return max(1.0, self.squares / max(self.num_legs, 1.0))

    def _values(self) -> Floats:
        return np.asarray(np.linalg.solve(self.information + PRIOR, self.gradient), np.float64)


def _linearize(leg: Leg, base_T_laser: Pose2D) -> tuple[Floats, Floats]:
    """Return the misses (3,) in deviations as the settings are, and their derivative (3, 6)."""
    zero = np.zeros(6)
    columns: list[Floats] = []
    for index in range(6):
        step = np.zeros(6)
        step[index] = PARAMS.difference
        change = _misses(leg, base_T_laser, step) - _misses(leg, base_T_laser, -step)
        columns.append(change / (2.0 * PARAMS.difference))
    return _misses(leg, base_T_laser, zero), np.column_stack(columns)


def _misses(leg: Leg, base_T_laser: Pose2D, values: Floats) -> Floats:
    linear, angular, bend, yaw, x, y = values.tolist()
    mount = base_T_laser
    true = Pose2D(mount.x + x, mount.y + y, mount.yaw + yaw)
    correction = Correction(1.0 + linear, 1.0 + angular, bend)
    misses = leg.error_of(correction, true @ mount.inverse())
    return np.array(misses) / np.array(leg.deviations)
