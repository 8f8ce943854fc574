"""The compiled half of the particle filter: move, scatter, weigh and resample particles."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.jit import kernel, loose_kernel
from trolley.scanning import Points
from trolley_localizer.kernels.elementary import exp_below_zero, sin_cos
from trolley_localizer.kernels.layout import Cloud
from trolley_localizer.kernels.matching import score_particles
from trolley_localizer.kernels.random import normal, random_bits

_ONE = np.uint64(1)
_TWO = np.uint64(2)
_THREE = np.uint64(3)
_FOUR = np.uint64(4)


@loose_kernel("contract")
def move_particles(
    cloud: Cloud,
    step: NDArray[np.float64],
    deviation: NDArray[np.float64],
    wide_every: int,
    wide_factor: float,
    counter: np.uint64,
) -> None:
    """Move each particle by a noisy copy of one odometry step, in place.

    Args:
        cloud: the particles.
        step: (3,) turn [rad], drive [cells], turn [rad].
        deviation: (4,) standard deviation of the three parts and of a slip to the left [cells].
        wide_every: every n-th particle gets `wide_factor` times the noise.
        wide_factor: see `wide_every`.
        counter: first random number; four are used for each particle.

    Source:
        Thrun, Burgard, Fox, Probabilistic Robotics (2005), table 5.6.
    """
    turn, drive, after = step[0], step[1], step[2]
    turn_dev, drive_dev, after_dev, slip_dev = (
        deviation[0],
        deviation[1],
        deviation[2],
        deviation[3],
    )
    for i in range(cloud.x.size):
        number = counter + _FOUR * np.uint64(i)
        share = i / wide_every
        scale = wide_factor if share == np.floor(share) else 1.0
        heading = cloud.yaw[i] + turn + scale * turn_dev * normal(number)
        way = drive + scale * drive_dev * normal(number + _ONE)
        slip = scale * slip_dev * normal(number + _THREE)
        sin, cos = sin_cos(heading)
        cloud.x[i] += way * cos - slip * sin
        cloud.y[i] += way * sin + slip * cos
        cloud.yaw[i] = heading + after + scale * after_dev * normal(number + _TWO)


@kernel
def scatter_particles(
    cloud: Cloud,
    first: int,
    every: int,
    mean: NDArray[np.float64],
    root: NDArray[np.float64],
    counter: np.uint64,
) -> None:
    """Draw particles from a normal distribution.

    Args:
        cloud: the particles `first`, `first + every` and so on are overwritten.
        first: index of the first.
        every: every n-th particle is drawn.
        mean: (3,) x, y [cells], yaw [rad] in `grid`.
        root: (3, 3) lower Cholesky factor of the covariance, same units.
        counter: first random number; three are used for each particle drawn.
    """
    for i in range(first, cloud.x.size, every):
        a = normal(counter)
        b = normal(counter + _ONE)
        c = normal(counter + _TWO)
        counter += _THREE
        cloud.x[i] = mean[0] + root[0, 0] * a
        cloud.y[i] = mean[1] + root[1, 0] * a + root[1, 1] * b
        cloud.yaw[i] = mean[2] + root[2, 0] * a + root[2, 1] * b + root[2, 2] * c


_TWO_PI = 2.0 * math.pi
_TURNS = 1.0 / _TWO_PI
_EMPTY = np.uint64(0)


@kernel
def weigh(weights: NDArray[np.float32], score: NDArray[np.int32], gain: float) -> None:
    """Multiply weights by exp(gain * score), up to a common factor.

    Args:
        weights: (n,), in place.
        score: (n,) sum of table values of each particle, from 0.
        gain: from the sum of table values to log likelihood, not negative.
    """
    best = np.int32(0)
    for i in range(score.size):
        best = max(best, score[i])
    for i in range(score.size):
        weights[i] *= exp_below_zero(gain * (score[i] - best))


@loose_kernel("contract", "reassoc")
def normalise(weights: NDArray[np.float32]) -> bool:
    """Make the sum of weights 1, in place; False, leaving them as they are, if the sum is 0."""
    total = 0.0
    for i in range(weights.size):
        total += weights[i]
    if not total > 1e-30:
        return False
    scale = 1.0 / total
    for i in range(weights.size):
        weights[i] *= scale
    return True


@kernel
def draw_systematic(
    out_index: NDArray[np.int32], weights: NDArray[np.float32], offset: float
) -> None:
    """Choose particles in proportion to their weight, with one random number for all.

    Args:
        out_index: (m,), overwritten: which particle each new one copies.
        weights: (n,), sum 1.
        offset: in [0, 1).

    Source:
        Thrun, Burgard, Fox, Probabilistic Robotics (2005), table 4.4.
    """
    count = out_index.size
    # Each particle marks the first place that is its own; then each place takes the mark before it.
    # Without a branch that depends on the weights, which no processor could foretell.
    out_index[:] = 0
    reached = 0.0
    for i in range(weights.size):
        first = int(reached * count + (1.0 - offset)) if i > 0 else 0
        if first < count:
            out_index[first] = i
        reached += weights[i]
    i = np.int32(0)
    for m in range(count):
        i = max(i, out_index[m])
        out_index[m] = i


@kernel
def gather(out: Cloud, cloud: Cloud, index: NDArray[np.int32]) -> None:
    """Copy the chosen particles."""
    for m in range(index.size):
        i = index[m]
        out.x[m] = cloud.x[i]
        out.y[m] = cloud.y[i]
        out.yaw[m] = cloud.yaw[i]


@kernel
def count_bins(
    table: NDArray[np.uint64],
    cloud: Cloud,
    index: NDArray[np.int32],
    bin_cells: float,
    bins_turn: int,
) -> int:
    """Count the bins of pose space that the chosen particles lie in.

    Args:
        table: scratch, its length a power of two above the number of particles; overwritten.
        cloud: the particles.
        index: (m,) which of them were chosen, equal ones next to each other.
        bin_cells: edge of a bin along x and y [cells].
        bins_turn: bins that a full turn is cut into.
    """
    table[:] = _EMPTY
    mask = np.uint64(table.size - 1)
    count = 0
    before = -1
    for m in range(index.size):
        i = index[m]
        if i == before:
            continue
        before = i
        share = cloud.yaw[i] / _TWO_PI
        turn = int((share - math.floor(share)) * bins_turn)
        col = math.floor(cloud.x[i] / bin_cells) + 1048576
        row = math.floor(cloud.y[i] / bin_cells) + 1048576
        key = (
            (np.uint64(turn) * np.uint64(2097152) + np.uint64(row)) * np.uint64(2097152)
            + np.uint64(col)
            + _ONE
        )
        slot = random_bits(key) & mask
        while table[slot] != _EMPTY and table[slot] != key:
            slot = (slot + _ONE) & mask
        if table[slot] == _EMPTY:
            table[slot] = key
            count += 1
    return count


@loose_kernel("contract", "reassoc")
def mean_near(
    out_mean: NDArray[np.float64],
    cloud: Cloud,
    weights: NDArray[np.float32],
    centre: NDArray[np.float64],
    reach: NDArray[np.float64],
) -> None:
    """Compute the mean of the particles about a pose.

    Args:
        out_mean: (3,) x, y [cells], yaw [rad] in `grid`, overwritten; `centre` if there are none.
        cloud: the particles.
        weights: (n,).
        centre: (3,) only particles within `reach` of it count; headings are unwrapped around it.
        reach: (2,) distance [cells] and angle [rad].
    """
    x, y, yaw = centre[0], centre[1], centre[2]
    far = reach[0] * reach[0]
    share = 0.0
    sum_x = 0.0
    sum_y = 0.0
    sum_yaw = 0.0
    for i in range(cloud.x.size):
        dx = cloud.x[i] - x
        dy = cloud.y[i] - y
        turn = cloud.yaw[i] - yaw
        turn -= _TWO_PI * np.floor(turn * _TURNS + 0.5)
        is_near = (dx * dx + dy * dy <= far) & (abs(turn) <= reach[1])
        weight = np.float64(weights[i]) if is_near else 0.0
        share += weight
        sum_x += weight * dx
        sum_y += weight * dy
        sum_yaw += weight * turn
    scale = 1.0 / share if share > 0.0 else 0.0
    out_mean[0] = x + scale * sum_x
    out_mean[1] = y + scale * sum_y
    out_mean[2] = yaw + scale * sum_yaw


@loose_kernel("contract", "reassoc")
def variance_of_place(cloud: Cloud, weights: NDArray[np.float32]) -> float:
    """Return the mean square distance of the particles from their mean [cells^2].

    Args:
        cloud: at least one particle.
        weights: (n,), sum above 0.
    """
    # About one of them, so that nothing is lost where all lie close together far from the origin.
    x, y = cloud.x[0], cloud.y[0]
    share = 0.0
    sum_x = 0.0
    sum_y = 0.0
    squares = 0.0
    for i in range(cloud.x.size):
        dx = cloud.x[i] - x
        dy = cloud.y[i] - y
        weight = np.float64(weights[i])
        share += weight
        sum_x += weight * dx
        sum_y += weight * dy
        squares += weight * (dx * dx + dy * dy)
    return max(0.0, squares / share - (sum_x * sum_x + sum_y * sum_y) / (share * share))


@kernel
def kld_number(bins: int, error: float, quantile: float) -> int:
    """Return how many particles keep the Kullback-Leibler error below a bound.

    Args:
        bins: bins with at least one particle.
        error: largest error (epsilon).
        quantile: of the standard normal distribution, for the confidence (z).

    Source:
        Fox (2003), equation 7 (Wilson and Hilferty's approximation).
    """
    if bins <= 1:
        return 1
    a = 2.0 / (9.0 * (bins - 1))
    return math.ceil((bins - 1) / (2.0 * error) * (1.0 - a + math.sqrt(a) * quantile) ** 3)


# A call from Python costs as much as the motion of 500 particles, and more with cold caches: so a
# cycle is two calls, before and after the estimate is refined.


class Move(NamedTuple):
    """An odometry step with its noise, see `move_particles`.

    Attributes:
        step: (3,).
        deviation: (4,).
        wide_every: int.
        wide_factor: float.
    """

    step: NDArray[np.float64]
    deviation: NDArray[np.float64]
    wide_every: int
    wide_factor: float


class Evidence(NamedTuple):
    """A scan and what it is compared with.

    Attributes:
        points: (beams,) end points in `base_link` [cells].
        table: the map, see `score_particles`.
        gain: from the sum of table values to log likelihood.
    """

    points: Points
    table: NDArray[np.uint16]
    gain: float


class Store(NamedTuple):
    """The arrays of a filter, each for the most particles that it may have.

    Attributes:
        cloud: the particles.
        spare: what the next ones are drawn into.
        weights: float32.
        chosen: int32, scratch.
        bins: uint64, scratch of `count_bins`.
    """

    cloud: Cloud
    spare: Cloud
    weights: NDArray[np.float32]
    chosen: NDArray[np.int32]
    bins: NDArray[np.uint64]


class Number(NamedTuple):
    """How many particles are drawn.

    Attributes:
        bin_cells: see `count_bins`.
        bins_turn: see `count_bins`.
        fewest: int.
        error: see `kld_number`.
        quantile: see `kld_number`.
    """

    bin_cells: float
    bins_turn: int
    fewest: int
    error: float
    quantile: float


class Renewal(NamedTuple):
    """A share that is drawn from elsewhere, see `scatter_particles`.

    Attributes:
        about: (3,) their mean.
        root: (3, 3).
        every: int.
        counter: first random number.
    """

    about: NDArray[np.float64]
    root: NDArray[np.float64]
    every: int
    counter: np.uint64


@kernel
def weigh_by_scan(
    weights: NDArray[np.float32], score: NDArray[np.int32], cloud: Cloud, evidence: Evidence
) -> None:
    """Multiply weights by the likelihood of a scan, and make their sum 1.

    Args:
        weights: (n,), in place.
        score: (n,) scratch.
        cloud: (n,) the particles.
        evidence: the scan.
    """
    score_particles(score, cloud, evidence.points, evidence.table)
    weigh(weights, score, evidence.gain)
    if not normalise(weights):
        # The old weights and the new evidence exclude each other: start from the evidence.
        weights[:] = np.float32(1.0)
        weigh(weights, score, evidence.gain)
        normalise(weights)


@kernel
def find_cluster(
    out_mean: NDArray[np.float64],
    cloud: Cloud,
    weights: NDArray[np.float32],
    reaches: NDArray[np.float64],
) -> None:
    """Find the mean pose about the heaviest place, from the heaviest particle, mean after mean.

    Args:
        out_mean: (3,) x, y [cells], yaw [rad] in `grid`, overwritten.
        cloud: the particles.
        weights: (n,).
        reaches: (k, 2) how far each mean looks [cells, rad].
    """
    best = 0
    for i in range(weights.size):
        if weights[i] > weights[best]:
            best = i
    out_mean[0], out_mean[1], out_mean[2] = cloud.x[best], cloud.y[best], cloud.yaw[best]
    for k in range(reaches.shape[0]):
        mean_near(out_mean, cloud, weights, out_mean, reaches[k])


@kernel
def observe(
    out_mean: NDArray[np.float64],
    cloud: Cloud,
    weights: NDArray[np.float32],
    score: NDArray[np.int32],
    move: Move,
    counter: np.uint64,
    evidence: Evidence,
    reaches: NDArray[np.float64],
) -> None:
    """Do the first half of a cycle: move and weigh the particles, and find the heaviest place.

    Args:
        out_mean: (3,) as for `find_cluster`.
        cloud: (n,) the particles, in place.
        weights: (n,) sum 1, in place.
        score: (n,) scratch.
        move: the odometry.
        counter: first random number; four are used for each particle.
        evidence: the scan.
        reaches: (k, 2) as for `find_cluster`.
    """
    move_particles(cloud, move.step, move.deviation, move.wide_every, move.wide_factor, counter)
    weigh_by_scan(weights, score, cloud, evidence)
    find_cluster(out_mean, cloud, weights, reaches)


@kernel
def redraw(
    store: Store, count: int, offset: float, number: Number, renewal: Renewal
) -> tuple[int, float]:
    """Do the second half of a cycle: draw equally weighted particles, as many as are needed.

    Args:
        store: `spare` is overwritten, `weights` belong to what is in it afterwards.
        count: how many particles there are.
        offset: in [0, 1), see `draw_systematic`.
        number: how many are drawn.
        renewal: which are drawn from elsewhere.

    Returns:
        How many there are, and the mean square distance from their mean [cells^2].
    """
    cloud, weights, chosen = store.cloud, store.weights, store.chosen
    draw_systematic(chosen[:count], weights[:count], offset)
    bins = count_bins(store.bins, cloud, chosen[:count], number.bin_cells, number.bins_turn)
    needed = max(kld_number(bins, number.error, number.quantile), number.fewest)
    drawn = min(needed, weights.size)
    if drawn != count:
        draw_systematic(chosen[:drawn], weights[:count], offset)
    spare = Cloud(store.spare.x[:drawn], store.spare.y[:drawn], store.spare.yaw[:drawn])
    gather(spare, cloud, chosen[:drawn])
    scatter_particles(spare, 0, renewal.every, renewal.about, renewal.root, renewal.counter)
    weights[:drawn] = np.float32(1.0 / drawn)
    return drawn, variance_of_place(spare, weights[:drawn])
