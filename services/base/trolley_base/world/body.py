"""The robot's body among solid things: how far it gets in a step, and what it touches."""

import math

import numpy as np
from numpy.typing import NDArray

from trolley.jit import kernel
from trolley_base.world.gaps import Things, Walls, gaps_into, place_outline_into

# The body is stopped this far from what it meets, so that distances keep a direction [m].
SKIN_M = 0.0005
# The place where the body is stopped is found by halving the step this often: 0.04 mm at 0.5 m/s.
HALVINGS = 7


@kernel
def arc_end(
    pose: NDArray[np.float64], v: float, wz: float, dt: float
) -> tuple[float, float, float]:
    """Return x, y, yaw after `dt` seconds of constant velocity from a pose (3,): an exact arc."""
    turn = wz * dt
    half = 0.5 * turn
    chord = v * dt * (math.sin(half) / half if half != 0.0 else 1.0)
    heading = pose[2] + half
    return (
        pose[0] + chord * math.cos(heading),
        pose[1] + chord * math.sin(heading),
        pose[2] + turn,
    )


@kernel
def _gaps_at(
    out: tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]],
    footprint: NDArray[np.float64],
    circle: NDArray[np.float64],
    at: tuple[float, float, float],
    solids: tuple[Walls, Things],
    reach: float,
) -> float:
    """Write gaps, touches and outline of the body standing at x, y, yaw; return the clearance."""
    place_outline_into(out[2], footprint, at[0], at[1], at[2])
    cos, sin = math.cos(at[2]), math.sin(at[2])
    around = np.empty(3)
    around[0] = at[0] + cos * circle[0] - sin * circle[1]
    around[1] = at[1] + sin * circle[0] + cos * circle[1]
    around[2] = circle[2]
    return gaps_into(out[0], out[1], out[2], around, solids[0], solids[1], reach)


@kernel
def _is_free(gaps: NDArray[np.float64], before: NDArray[np.float64]) -> bool:
    """Say whether no body is met that was farther away before."""
    for body in range(gaps.shape[0]):
        if gaps[body] < SKIN_M and gaps[body] < before[body]:
            return False
    return True


@kernel
def move_into(
    pose: NDArray[np.float64],
    out: tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]],
    out_towards: NDArray[np.float64],
    motion: tuple[tuple[float, float], tuple[float, float], float],
    footprint: tuple[NDArray[np.float64], NDArray[np.float64]],
    solids: tuple[Walls, Things],
    reach: float,
) -> tuple[float, float]:
    """Move the body along an arc until something stops it.

    Args:
        pose: (3,) x, y, yaw, map_T_base, moved.
        out: gaps (bodies,), touches (bodies, 4) and outline (n, 2) at the end, overwritten.
        out_towards: (bodies,) NaN, but for bodies that stopped the motion: the body's own speed
            towards the contact [m/s].
        motion: v [m/s] and wz [rad/s] that move it, the same without slip, and duration [s].
        footprint: corners (n, 2) in `base_link`, and centre and radius (3,) of a circle around.
        solids: what there is.
        reach: farthest gap of interest [m].

    Returns:
        The part of the motion that was made, 0...1, and the clearance at the end [m].
    """
    (v, wz), own, dt = motion
    corners, circle = footprint
    out_towards[:] = math.nan
    _gaps_at(out, corners, circle, (pose[0], pose[1], pose[2]), solids, reach)
    before = out[0].copy()
    end = arc_end(pose, v, wz, dt)
    clearance = _gaps_at(out, corners, circle, end, solids, reach)
    part = 1.0
    if not _is_free(out[0], before):
        low, high = 0.0, 1.0
        at_high = out[0].copy()
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            _gaps_at(out, corners, circle, arc_end(pose, v, wz, middle * dt), solids, reach)
            if _is_free(out[0], before):
                low = middle
            else:
                high = middle
                at_high[:] = out[0]
        part = low
        end = arc_end(pose, v, wz, low * dt)
        clearance = _gaps_at(out, corners, circle, end, solids, reach)
        for body in range(at_high.shape[0]):
            if at_high[body] < SKIN_M and at_high[body] < before[body]:
                touch = out[1][body]
                out_towards[body] = _speed_towards(touch, end, own[0], own[1])
    pose[0], pose[1], pose[2] = end
    return part, clearance


@kernel
def _speed_towards(
    touch: NDArray[np.float64], at: tuple[float, float, float], v: float, wz: float
) -> float:
    """Return how fast the body's nearest point moves towards the other thing's [m/s]."""
    nx, ny = touch[2] - touch[0], touch[3] - touch[1]
    length = math.hypot(nx, ny)
    if length == 0.0:
        return abs(v)
    vx = v * math.cos(at[2]) - wz * (touch[1] - at[1])
    vy = v * math.sin(at[2]) + wz * (touch[0] - at[0])
    return (vx * nx + vy * ny) / length
