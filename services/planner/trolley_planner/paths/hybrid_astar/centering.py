"""A maneuver bent to the middle of the narrow places that it leads through.

The search counts cells, and where a door is hardly wider than the robot each way through it costs
the same, straight or askew. Here the exact outline is tried: what stands within
`CenteringParams.reach_m` of it pushes, all along it, so that one echo that errs counts little, and
the maneuver resists being bent. Both ends of each drive stay where they are.

Source:
    Quinlan, Khatib, Elastic Bands: Connecting Path Planning and Control (1993): external forces
    from what is near, internal ones from the path's own bending. Deviations: the path is moved
    sideways by B-splines along it, and the heading follows, since the robot cannot move sideways.
"""

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.gridmap.kernels import interpolate
from trolley.jit import kernel, lean_kernel
from trolley_planner.costmap.fine_grid import FineGrid
from trolley_planner.costmap.footprint import Body, Field
from trolley_planner.paths.hybrid_astar.curves import LEAST_RADIUS_M
from trolley_planner.paths.hybrid_astar.motion_primitives import FORWARDS, TURNING, Maneuver


class CenteringParams(NamedTuple):
    """How a maneuver is bent; all by hand."""

    reach_m: float = 0.06
    """Distance from the outline below which obstacles push it."""
    knots_m: tuple[float, ...] = (0.24, 0.12)
    """Distances along the path between two of the splines that bend it: wide ones straighten it
    through a place that narrow ones would only lead it into and out of."""
    stiffness_m: float = 0.5
    """Cost of a metre with a curvature of 1 / m, in points of the outline that touch something."""
    nearest: float = 12.0
    """How many more points of the outline the nearest one counts as."""
    steps_m: tuple[float, ...] = (0.03, 0.015, 0.0075)
    """How far a spline is moved to either side at a time."""
    rounds: int = 4
    """Most times that all splines are tried with each step."""
    kept_m: float = 0.02
    """Bending takes no clearance below this, or below what the drive had if that was less [m]."""


CENTERING = CenteringParams()
Layers = tuple[NDArray[np.float32], NDArray[np.uint8], float]
"""(rows, cols) distance to the nearest obstacle [m], and how floor is known; edge of a cell [m]."""
SPLINE_KNOTS = 4
"""A cubic B-spline covers so many pieces between knots."""


class Drive(NamedTuple):
    """A drive and how it is bent."""

    poses: NDArray[np.float64]
    """(n, 3) unbent."""
    along: NDArray[np.float64]
    """(n,) from its beginning [m]."""
    aside: NDArray[np.float64]
    """(n,) how far the poses are moved to the robot's left [m]."""
    slope: NDArray[np.float64]
    """(n,) the derivative of that along the drive."""
    sense: int


def centered(maneuver: Maneuver, grid: FineGrid, unseen: NDArray[np.uint8], body: Body) -> Maneuver:
    """Return a maneuver with more clearance where it has little, the same if none can be had.

    Args:
        maneuver: in the frame of `grid`'s corner.
        grid: what stands around.
        unseen: (rows, cols) of `grid`, set where the robot must not back or should not.
        body: the robot's outline.
    """
    corner = np.array([grid.x, grid.y, 0.0])
    poses = maneuver.poses - corner
    changes = np.flatnonzero(np.diff(maneuver.motions[1:])) + 1
    ends = [0, *changes.tolist(), len(poses) - 1]
    for first, last in pairwise(ends):
        sense = int(maneuver.motions[last])
        if sense != TURNING:
            bend(poses[first : last + 1], sense, (grid.distance_m, unseen, grid.fine_m), body)
    return Maneuver(poses + corner, maneuver.motions)


def recentered(drive: NDArray[np.float64], field: Field, body: Body) -> NDArray[np.float64]:
    """Return the rest of a drive forwards, bent once more on what is seen by now.

    Each scan errs in another way, and from nearby a passage is seen better. What lies out of the
    local costmap stays.

    Args:
        drive: (n, 3) poses in `grid`, the first near the robot.
        field: what stands around the robot.
        body: the robot's outline.
    """
    rows, cols = field.distance_m.shape
    corner = np.array([field.x, field.y, 0.0])
    poses = drive - corner
    most = np.array([cols, rows]) * field.fine_m - body.circumscribed_m
    is_out = ((poses[:, :2] < body.circumscribed_m) | (poses[:, :2] > most)).any(axis=1)
    end = max(int(np.argmax(is_out)), 1) if is_out.any() else len(poses)
    in_sight = np.zeros((rows, cols), np.uint8)  # Forwards it may drive over any floor.
    bend(poses[:end], FORWARDS, (field.distance_m, in_sight, field.fine_m), body)
    return poses + corner


@kernel
def bend(
    poses: NDArray[np.float64],
    sense: int,
    layers: Layers,
    body: Body,
) -> None:
    """Bend one drive (n, 3), changed in place, where that gives it more clearance.

    Args:
        poses: from the corner of the cells [m, rad]; the first and the last stay.
        sense: FORWARDS or BACKWARDS.
        layers: (rows, cols) distance to the nearest obstacle [m], and how floor is known; edge of a
            cell [m].
        body: the robot's outline.
    """
    count = poses.shape[0]
    along = np.zeros(count)
    for index in range(1, count):
        dx, dy = poses[index, 0] - poses[index - 1, 0], poses[index, 1] - poses[index - 1, 1]
        along[index] = along[index - 1] + math.hypot(dx, dy)
    if along[-1] < SPLINE_KNOTS * min(CENTERING.knots_m):
        return
    aside, slope = np.zeros(count), np.zeros(count)
    drive = Drive(poses, along, aside, slope, sense)
    least_m = energy(drive, layers, body, 1, count - 1)[1]
    if least_m >= CENTERING.reach_m:
        return
    is_bent = False
    for step_m in CENTERING.steps_m:
        for knot_m in CENTERING.knots_m:
            num_pieces = max(math.floor(along[-1] / knot_m), 1)
            for _ in range(CENTERING.rounds):
                if not bend_by(drive, layers, body, along[-1] / num_pieces, step_m):
                    break
                is_bent = True
    if is_bent and energy(drive, layers, body, 1, count - 1)[1] >= min(least_m, CENTERING.kept_m):
        bent = np.empty_like(poses)
        for index in range(count):
            bent[index] = pose_of(drive, index)
        poses[:] = bent


@lean_kernel
def bend_by(
    drive: Drive,
    layers: Layers,
    body: Body,
    knot_m: float,
    step_m: float,
) -> bool:
    """Move each spline to either side if that costs less; say whether any was moved."""
    along, is_better = drive.along, False
    last = along.shape[0] - 1
    for spline in range(round(float(along[last]) / knot_m) - SPLINE_KNOTS + 1):
        low, high = 1, last
        while along[low] <= spline * knot_m:
            low += 1
        while high > low and along[high - 1] >= (spline + SPLINE_KNOTS) * knot_m:
            high -= 1
        now = energy(drive, layers, body, low, high)[0]
        for by_m in (step_m, -step_m):
            move(drive, spline, knot_m, by_m)
            if energy(drive, layers, body, low, high)[0] < now:
                is_better = True
                break
            move(drive, spline, knot_m, -by_m)
    return is_better


@lean_kernel
def move(drive: Drive, spline: int, knot_m: float, by_m: float) -> None:
    """Add a B-spline to the places and slopes of a drive, changed in place."""
    for index in range(drive.along.shape[0]):
        at = drive.along[index] / knot_m - spline
        if at <= 0.0:
            continue
        if at >= SPLINE_KNOTS:
            break
        # Symmetric about its middle: two pieces on either side.
        side = 1.0 if at > 2.0 else -1.0
        off = abs(at - 2.0)
        if off < 1.0:
            value, rise = 2.0 / 3.0 - off**2 * (1.0 - 0.5 * off), off * (1.5 * off - 2.0)
        else:
            value, rise = (2.0 - off) ** 3 / 6.0, -0.5 * (2.0 - off) ** 2
        drive.aside[index] += by_m * value
        drive.slope[index] += by_m * side * rise / knot_m


@lean_kernel
def pose_of(drive: Drive, index: int) -> tuple[float, float, float]:
    """Return a pose of the bent drive."""
    x, y, yaw = drive.poses[index, 0], drive.poses[index, 1], drive.poses[index, 2]
    aside = drive.aside[index]
    if aside == 0.0 and drive.slope[index] == 0.0:
        return x, y, yaw
    first, last = max(index - 1, 0), min(index + 1, drive.along.shape[0] - 1)
    length = drive.along[last] - drive.along[first]
    bend = (drive.poses[last, 2] - drive.poses[first, 2]) / length if length > 0.0 else 0.0
    turn = math.atan2(drive.sense * drive.slope[index], 1.0 - drive.sense * aside * bend)
    return x - aside * math.sin(yaw), y + aside * math.cos(yaw), yaw + turn


@lean_kernel
def energy(
    drive: Drive,
    layers: Layers,
    body: Body,
    first: int,
    end: int,
) -> tuple[float, float]:
    """Return what the poses from `first` on before `end` cost, and the least distance there [m].

    The cost is +inf where the drive is too tight, or backs over floor known less well than that
    below the unbent one.
    """
    total, least_m = 0.0, math.inf
    before_x, before_y, before_yaw = pose_of(drive, first - 1)
    for index in range(first, min(end, drive.along.shape[0] - 1) + 1):
        pose = pose_of(drive, index)
        length = math.hypot(pose[0] - before_x, pose[1] - before_y)
        bend = abs(pose[2] - before_yaw) / max(length, 1e-6)
        own_m = max(drive.along[index] - drive.along[index - 1], 1e-6)
        own = abs(drive.poses[index, 2] - drive.poses[index - 1, 2]) / own_m
        if bend > max(1.0 / LEAST_RADIUS_M, own) + 1e-6:
            return math.inf, least_m
        if index < end:
            pushed, nearest_m, known = pushes(layers, body, pose)
            unbent = drive.poses[index, 0], drive.poses[index, 1], drive.poses[index, 2]
            if drive.sense < 0 and known > pushes(layers, body, unbent)[2]:
                return math.inf, least_m
            total += length * pushed
            least_m = min(least_m, nearest_m)
        total += length * CENTERING.stiffness_m * bend**2
        before_x, before_y, before_yaw = pose
    return total, least_m


@lean_kernel
def pushes(
    layers: Layers,
    body: Body,
    pose: tuple[float, float, float],
) -> tuple[float, float, int]:
    """Return how much is pushed at a pose, the least distance [m], and the least known floor."""
    distance_m, unseen, fine_m = layers
    rows, cols = distance_m.shape
    x, y = pose[0] / fine_m, pose[1] / fine_m
    cos, sin = math.cos(pose[2]) / fine_m, math.sin(pose[2]) / fine_m
    total, least_m, known = 0.0, math.inf, 0
    for index in range(body.edge_points.shape[0]):
        px, py = body.edge_points[index, 0], body.edge_points[index, 1]
        u, v = x + cos * px - sin * py, y + sin * px + cos * py
        away = interpolate(distance_m, u - 0.5, v - 0.5) - 0.5 * fine_m
        least_m = min(least_m, away)
        total += max(1.0 - away / CENTERING.reach_m, 0.0) ** 2
        row, col = min(max(math.floor(v), 0), rows - 1), min(max(math.floor(u), 0), cols - 1)
        known = max(known, int(unseen[row, col]))
    total += CENTERING.nearest * max(1.0 - least_m / CENTERING.reach_m, 0.0) ** 2
    return total, least_m, known
