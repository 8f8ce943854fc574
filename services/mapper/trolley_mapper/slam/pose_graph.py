"""The pose graph: keyframes as nodes, measured relative poses as edges, and its optimisation.

Source:
    Grisetti, Kümmerle, Stachniss, Burgard, A Tutorial on Graph-Based SLAM (2010); Agarwal, Tipaldi,
    Spinello, Stachniss, Burgard, Robust Map Optimization using Dynamic Covariance Scaling (2013);
    Yang, Antonante, Tzoumas, Carlone, Graduated Non-Convexity for Robust Spatial Perception (2020).
"""

import importlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import wrap_angles
from trolley.slices import Slices

# SciPy ships no types.
_sparse: Any = importlib.import_module("scipy.sparse")
_solvers: Any = importlib.import_module("scipy.sparse.linalg")

ODOMETRY = 0
"""Kind of an edge to the next keyframe: odometry and scan match together."""
SCAN_MATCH = 1
"""Kind of an edge to a keyframe that was matched at the same time."""
LOOP = 2
"""Kind of an edge that closes a loop."""


@dataclass(frozen=True, slots=True)
class PoseGraphParams:
    """How the graph is optimised."""

    phi: float = 10.0
    """Squared error beyond which a loop begins to count less (Agarwal 2013, Phi), set by hand."""
    max_iterations: int = 30
    """Number of damped Gauss-Newton steps at most."""
    min_damping: float = 1e-6
    """Share of the diagonal that is added to it as damping (Levenberg, Marquardt)."""
    inlier: float = 25.0
    """Squared error up to which a loop may hold when loops contradict each other."""
    sharpening: float = 1.6
    """Growth of the non-convexity from step to step (Yang 2020, mu)."""
    max_information: float = 2.5e5
    """Greatest information that averaging gives: a deviation of 2 mm or mrad."""


PARAMS = PoseGraphParams()


class Edge(NamedTuple):
    """A measured relative pose.

    Attributes:
        first: number of the keyframe it starts from.
        second: number of the keyframe it leads to.
        step: (3,) first_T_second, x, y [m], yaw [rad].
        information: (3, 3) inverse covariance, in the frame of `second`.
        kind: ODOMETRY, SCAN_MATCH or LOOP.
        scale: of the odometry's distances, as it was known then.
        stretch: (3,) by how much the step grows with the scale as it is known later, None where it
            does not.
    """

    first: int
    second: int
    step: NDArray[np.float64]
    information: NDArray[np.float64]
    kind: int
    scale: float = 1.0
    stretch: NDArray[np.float64] | None = None

    def step_at(self, scale: float) -> NDArray[np.float64]:
        """Return the step as it is with a scale of the odometry's distances."""
        if self.stretch is None:
            return self.step
        return self.step + (scale - self.scale) * self.stretch

    def settled(self, scale: float) -> "Edge":
        """Return the edge as it is with a scale, for good."""
        return self._replace(step=self.step_at(scale), scale=1.0, stretch=None)


def compose(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Chain poses (..., 3)."""
    cos, sin = np.cos(a[..., 2]), np.sin(a[..., 2])
    return np.stack(
        [
            a[..., 0] + cos * b[..., 0] - sin * b[..., 1],
            a[..., 1] + sin * b[..., 0] + cos * b[..., 1],
            wrap_angles(a[..., 2] + b[..., 2]),
        ],
        axis=-1,
    )


def between(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a_T_b of poses (..., 3) given in one frame."""
    cos, sin = np.cos(a[..., 2]), np.sin(a[..., 2])
    dx, dy = b[..., 0] - a[..., 0], b[..., 1] - a[..., 1]
    return np.stack(
        [cos * dx + sin * dy, -sin * dx + cos * dy, wrap_angles(b[..., 2] - a[..., 2])], axis=-1
    )


def to_frame(information: NDArray[np.float64], yaw: float) -> NDArray[np.float64]:
    """Turn information (..., 3, 3) over x, y, yaw given in `map` into a frame with that yaw."""
    cos, sin = np.cos(yaw), np.sin(yaw)
    turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    return turn.T @ information @ turn


def turned(covariance: NDArray[np.float64], yaw: float) -> NDArray[np.float64]:
    """Return a covariance (3, 3) over x, y, yaw in a frame that was turned by `yaw` [rad]."""
    return to_frame(covariance, -yaw)


def inverse(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the inverse of a covariance or of information (3, 3)."""
    return np.asarray(np.linalg.inv(matrix), np.float64)


def inverted(edge: Edge) -> Edge:
    """Return the same measurement seen from its second keyframe."""
    back = between(edge.step, np.zeros(3))
    # An error d in the frame of `second` is one of -(turned d + lever) in that of `first`.
    carry = _lever(edge.step)
    information = inverse(carry @ inverse(edge.information) @ carry.T)
    return Edge(edge.second, edge.first, back, information, edge.kind)


def chained(one: Edge, other: Edge) -> Edge:
    """Return what two edges say together: `one` leads to where `other` begins."""
    carry = _lever(between(other.step, np.zeros(3)))
    covariance = carry @ inverse(one.information) @ carry.T
    information = inverse(covariance + inverse(other.information))
    kind = ODOMETRY if one.kind == other.kind == ODOMETRY else SCAN_MATCH
    return Edge(one.first, other.second, compose(one.step, other.step), information, kind)


def averaged(one: Edge, other: Edge) -> Edge:
    """Return the mean of two measurements of the same, by their information."""
    together = one.information + other.information
    away = between(one.step, other.step)
    step = compose(one.step, inverse(together) @ other.information @ away)
    largest = float(np.linalg.eigvalsh(together)[-1])
    return one._replace(
        step=step, information=together * min(1.0, PARAMS.max_information / largest)
    )


def _lever(step: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return how a small motion behind a pose, (3,) in its frame, looks in front of it."""
    cos, sin = np.cos(step[2]), np.sin(step[2])
    return np.array([[cos, -sin, step[1]], [sin, cos, -step[0]], [0.0, 0.0, 1.0]])


class Problem(NamedTuple):
    """Edges as arrays: first and second node (m,), steps (m, 3), information (m, 3, 3), kinds."""

    first: NDArray[np.int64]
    second: NDArray[np.int64]
    step: NDArray[np.float64]
    information: NDArray[np.float64]
    kind: NDArray[np.int64]


def make_problem(edges: Sequence[Edge], rows: dict[int, int], scale: float = 1.0) -> Problem:
    """Put edges into arrays; `rows` gives the row of each keyframe's pose.

    Args:
        edges: to put there.
        rows: of the poses of the keyframes.
        scale: of the odometry's distances, as far as it is known.
    """
    return Problem(
        np.array([rows[e.first] for e in edges], np.int64),
        np.array([rows[e.second] for e in edges], np.int64),
        np.array([e.step_at(scale) for e in edges]).reshape(-1, 3),
        np.array([e.information for e in edges]).reshape(-1, 3, 3),
        np.array([e.kind for e in edges], np.int64),
    )


def errors(poses: NDArray[np.float64], problem: Problem) -> NDArray[np.float64]:
    """Return by how much each edge is missed, (m, 3) in the frame of its second keyframe."""
    steps = between(poses[problem.first], poses[problem.second])
    return between(problem.step, steps)


def squared_errors(poses: NDArray[np.float64], problem: Problem) -> NDArray[np.float64]:
    """Return the squared Mahalanobis length (m,) of each edge's error."""
    error = errors(poses, problem)
    return np.einsum("ma,mab,mb->m", error, problem.information, error)


def scales(chi2: NDArray[np.float64], problem: Problem) -> NDArray[np.float64]:
    """Return the weight (m,) of each edge: less than 1 for loops that fit badly."""
    s = np.minimum(1.0, 2.0 * PARAMS.phi / (PARAMS.phi + chi2))
    return np.where(problem.kind == LOOP, s * s, 1.0)


def optimise(
    poses: NDArray[np.float64], problem: Problem, fixed: Sequence[int], robust: bool = True
) -> Slices[NDArray[np.float64]]:
    """Move poses to where the edges are missed least.

    Args:
        poses: (n, 3) start, x, y [m], yaw [rad].
        problem: the edges.
        fixed: rows of the poses that stay; at least one in each connected part.
        robust: let loops that contradict all the rest fade, after a first plain solution.

    Returns:
        (n, 3) the optimised poses.
    """
    free = np.ones(len(poses), bool)
    free[list(fixed)] = False
    if not free.any() or len(problem.first) == 0:
        return poses.copy()
    column = np.full(len(poses), -1, np.int64)
    column[free] = np.arange(int(free.sum()))
    found = yield from _descend(poses, problem, column, np.ones(len(problem.first)))
    if robust:
        found = yield from _descend(found, problem, column)
    return found


def contradicted(
    poses: NDArray[np.float64], problem: Problem, fixed: Sequence[int]
) -> Slices[NDArray[np.bool_]]:
    """Say which loops (m,) the others and the odometry vote down, by truncated least squares.

    Args:
        poses: (n, 3) start, x, y [m], yaw [rad].
        problem: the edges.
        fixed: rows of the poses that stay.
    """
    is_loop = problem.kind == LOOP
    free = np.ones(len(poses), bool)
    free[list(fixed)] = False
    column = np.full(len(poses), -1, np.int64)
    column[free] = np.arange(int(free.sum()))
    weights = np.ones(len(is_loop))
    poses = yield from _descend(poses, problem, column, weights)
    chi2 = squared_errors(poses, problem)
    worst = float(chi2[is_loop].max(initial=0.0))
    mu = PARAMS.inlier / max(2.0 * worst - PARAMS.inlier, 1e-9)
    while worst > PARAMS.inlier and mu < 1e3:
        low, high = (PARAMS.inlier * share for share in (mu / (mu + 1.0), (mu + 1.0) / mu))
        fading = np.sqrt(PARAMS.inlier * mu * (mu + 1.0) / np.maximum(chi2, 1e-9)) - mu
        fading = np.where(chi2 <= low, 1.0, np.where(chi2 >= high, 0.0, fading))
        weights = np.where(is_loop, fading, 1.0)
        poses = yield from _descend(poses, problem, column, weights)
        chi2 = squared_errors(poses, problem)
        mu *= PARAMS.sharpening
    return is_loop & (weights < 0.5)


def _descend(
    poses: NDArray[np.float64],
    problem: Problem,
    column: NDArray[np.int64],
    given: NDArray[np.float64] | None = None,
) -> Slices[NDArray[np.float64]]:
    """Take damped Gauss-Newton steps until nothing moves; loops fade where no weights are given."""
    damping = PARAMS.min_damping
    chi2 = squared_errors(poses, problem)
    for _ in range(PARAMS.max_iterations):
        weights = scales(chi2, problem) if given is None else given
        delta = _step(poses, problem, column, weights, damping)
        yield
        moved = poses.copy()
        moved[column >= 0] += delta
        moved[:, 2] = wrap_angles(moved[:, 2])
        moved_chi2 = squared_errors(moved, problem)
        if weights @ moved_chi2 > weights @ chi2 * (1.0 + 1e-9) and damping < 1e3:
            damping = max(damping * 100.0, 1e-4)
            continue
        poses, chi2 = moved, moved_chi2
        damping = max(damping * 0.1, PARAMS.min_damping)
        if np.abs(delta).max() < 1e-4:
            break
    return poses


def _step(
    poses: NDArray[np.float64],
    problem: Problem,
    column: NDArray[np.int64],
    weights: NDArray[np.float64],
    damping: float,
) -> NDArray[np.float64]:
    """Solve the normal equations for one step (free nodes, 3)."""
    error = errors(poses, problem)
    info = problem.information * weights[:, None, None]
    a, b = _jacobians(poses, problem)
    ia, ib = info @ a, info @ b
    pairs = [
        (problem.first, problem.first, np.swapaxes(a, 1, 2) @ ia),
        (problem.first, problem.second, np.swapaxes(a, 1, 2) @ ib),
        (problem.second, problem.first, np.swapaxes(b, 1, 2) @ ia),
        (problem.second, problem.second, np.swapaxes(b, 1, 2) @ ib),
    ]
    size = 3 * int(column.max() + 1)
    gradient = np.zeros((len(column), 3))
    np.add.at(gradient, problem.first, np.einsum("mba,mb->ma", ia, error))
    np.add.at(gradient, problem.second, np.einsum("mba,mb->ma", ib, error))
    rows: list[NDArray[np.int64]] = []
    cols: list[NDArray[np.int64]] = []
    values: list[NDArray[np.float64]] = []
    local = np.arange(3)
    for one, other, block in pairs:
        kept = (column[one] >= 0) & (column[other] >= 0)
        row = 3 * column[one[kept]][:, None, None] + local[None, :, None]
        col = 3 * column[other[kept]][:, None, None] + local[None, None, :]
        shape = block[kept].shape
        rows.append(np.broadcast_to(row, shape).ravel())
        cols.append(np.broadcast_to(col, shape).ravel())
        values.append(block[kept].ravel())
    hessian: Any = _sparse.csc_array(
        (np.concatenate(values), (np.concatenate(rows), np.concatenate(cols))), shape=(size, size)
    )
    hessian = hessian + damping * _sparse.diags_array(hessian.diagonal() + 1e-9, format="csc")
    factors: Any = _solvers.splu(
        hessian.tocsc(),
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )
    found = np.asarray(factors.solve(gradient[column >= 0].ravel()), np.float64)
    return -found.reshape(-1, 3)


def _jacobians(
    poses: NDArray[np.float64], problem: Problem
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the derivatives (m, 3, 3) of the errors after the first and the second pose."""
    first, second = poses[problem.first], poses[problem.second]
    yaw = first[:, 2] + problem.step[:, 2]
    cos, sin = np.cos(yaw), np.sin(yaw)
    dx, dy = second[:, 0] - first[:, 0], second[:, 1] - first[:, 1]
    a, b = np.zeros((len(yaw), 3, 3)), np.zeros((len(yaw), 3, 3))
    b[:, 0, 0], b[:, 0, 1], b[:, 1, 0], b[:, 1, 1] = cos, sin, -sin, cos
    b[:, 2, 2] = 1.0
    a[:, :2, :2] = -b[:, :2, :2]
    # The error's place is R(step)^T (R(first)^T (second - first) - step).
    a[:, 0, 2] = -sin * dx + cos * dy
    a[:, 1, 2] = -cos * dx - sin * dy
    a[:, 2, 2] = -1.0
    return a, b
