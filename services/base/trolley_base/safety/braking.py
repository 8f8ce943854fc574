"""Where a robot may get to before it stops. Frame `base_link` as odometry shows it now, SI.

Commands reach the wheels with a delay, so the latest ones are still under way and will be driven,
whatever is decided now. Then the robot brakes at least as hard as its limits say, but speed and
turn rate may fall at different rates, so it leaves its arc to an unknown side. The motion until it
stops is therefore a family of paths, sampled as poses.
"""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Twist2D
from trolley_base.safety.motion_limits import MotionLimits

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class BrakingParams:
    """Which braking is allowed for, and how finely its paths are sampled.

    Set by hand, and judged by bench/base/braking.py.
    """

    harder: tuple[tuple[float, float], ...] = ((1.0, 1.0), (1.0, 3.0), (1.0, 50.0), (50.0, 1.0))
    """How many times harder than surely speed and turn rate may brake, each pair a path: both as
    little as possible, the turn ending sooner or at once, the speed ending at once."""
    delays: tuple[float, ...] = (1.0, 0.6, 0.25)
    """Shares of the longest delay that are allowed for where the robot does not drive evenly: a
    turn that is under way with the one has been driven with the other."""
    period_s: float = 0.02
    """How long a command is driven before the next one can end it [s]."""
    turn_rad: float = 0.12
    """Greatest turn between two poses of a path; corners swing less than a millimetre beyond."""
    of_radius: float = 0.5
    """Greatest distance between two poses of a path, as a share of the circle inside the footprint.
    """
    straight_rad: float = 0.02
    """A robot that turns by less than this while it brakes has but one path."""


PARAMS = BrakingParams()


class CommandsUnderWay:
    """Recent commands that the wheels have only just begun to follow.

    Some wheels brake at once, others as slowly as the limits allow; a robot that was told to turn
    back may drive either way.

    Args:
        delay_s: longest time from a command until odometry shows that the wheels follow it.
        limits: what the robot surely brakes with.
    """

    def __init__(self, delay_s: float, limits: MotionLimits) -> None:
        self._delay_s = delay_s
        self._limits = limits
        self._pieces: deque[tuple[float, tuple[float, ...]]] = deque()
        self._slow = (0.0, 0.0, 0.0)

    @property
    def is_standing(self) -> bool:
        """Whether the robot surely stands, and nothing is under way."""
        return not self._pieces

    @property
    def speed(self) -> float:
        """How fast the robot may be when all of it has been driven [m/s]."""
        return math.hypot(self._slow[0], self._slow[1])

    def range_with(self, twist: Twist2D) -> tuple[Floats, Floats]:
        """Return the least and the greatest velocity (3,) of a command and all under way."""
        known = [(*self._slow, twist.vx, twist.vy, twist.wz)]
        both = np.array([*known, *(both for _, both in self._pieces)]).reshape(-1, 3)
        return both.min(axis=0), both.max(axis=0)

    def add(self, twist: Twist2D, seconds: float) -> None:
        """Add what is commanded now, after `seconds` of the command before."""
        if twist.is_zero and not self._pieces and not any(self._slow):
            return  # it stands, and goes on standing
        prompt = (twist.vx, twist.vy, twist.wz)
        self._slow = self._slowest(prompt, seconds)
        both = (*self._slow, *prompt)
        self._pieces.append((min(seconds, self._delay_s), both))
        excess = sum(seconds for seconds, _ in self._pieces) - self._delay_s
        while self._pieces and excess >= self._pieces[0][0]:
            excess -= self._pieces.popleft()[0]
        if not any(any(both) for _, both in self._pieces):
            self._pieces.clear()

    def at_slowest(self, wanted: Floats, seconds: float) -> Floats:
        """Return velocities (n, 3) after so long on the way to wanted ones (n, 3), at the slowest.

        Wheels may gain speed at once; they lose it as slowly as the limits allow.
        """
        return np.array([self._slowest(one, seconds) for one in wanted.tolist()])

    def _slowest(self, wanted: Sequence[float], seconds: float) -> tuple[float, float, float]:
        """Return the same of one velocity; numpy would take ten times as long for it."""
        (vx, vy, wz), (now_vx, now_vy, now_wz) = wanted, self._slow
        dx, dy = vx - now_vx, vy - now_vy
        change = math.hypot(dx, dy)
        slower = self._limits.downhill_deceleration * seconds
        if change > slower and vx * now_vx + vy * now_vy < now_vx * now_vx + now_vy * now_vy:
            share = slower / change
            vx, vy = now_vx + dx * share, now_vy + dy * share
        turn = self._limits.angular_acceleration * seconds
        less = wz - now_wz
        if abs(less) > turn and wz * now_wz < now_wz * now_wz:
            wz = now_wz + math.copysign(turn, less)
        return vx, vy, wz

    def paths(self, spacing: float) -> tuple[Floats, NDArray[np.bool_]]:
        """Return where the robot comes, and whose brakes that is.

        Args:
            spacing: way between two poses that is near enough [m].

        Returns:
            (k, n, 4) x, y [m], yaw [rad] and the way there [m], the last where what is decided now
            begins to act; the first path is that of the longest delay and the slowest brakes. (k,)
            whether the brakes are the slowest.
        """
        if not self._pieces:
            return np.zeros((1, 1, 4)), np.ones(1, dtype=np.bool_)
        seconds = np.array([seconds for seconds, _ in self._pieces])
        both = np.array([both for _, both in self._pieces]).reshape(-1, 2, 3)
        both = both[:, : 1 if np.array_equal(both[:, 0], both[:, 1]) else 2]
        shares = np.array(
            PARAMS.delays[: 1 if _is_even(both.reshape(-1, 3), self._delay_s) else None]
        )
        # What a shorter delay has left behind already is not driven any more.
        left = np.cumsum(seconds[::-1])[::-1] - 0.5 * seconds <= shares[:, None] * self._delay_s
        steps = both.swapaxes(0, 1) * seconds[:, None] * left[:, None, :, None]
        poses = along(np.zeros((1, 4)), steps.reshape(-1, len(seconds), 3))
        longest = np.abs(both * seconds[:, None, None]).max(axis=(0, 1))
        way, turn = math.hypot(longest[0], longest[1]), float(longest[2])
        stride = int(1.0 / max(way / spacing, turn / PARAMS.turn_rad, 1.0 / len(seconds)))
        slowest = np.array([brakes == 0 for _ in shares for brakes in range(both.shape[1])])
        return poses[:, ::-1][:, :: max(1, stride)][:, ::-1], slowest


def _is_even(velocities: Floats, seconds: float) -> bool:
    """Say whether velocities (n, 3) that are driven for so long lie on one arc, one way."""
    vx, vy, wz = velocities.T
    if vx.min() * vx.max() < 0.0 or wz.min() * wz.max() < 0.0 or np.ptp(vy) > 0.0:
        return False
    most = int(np.argmax(np.abs(vx) + np.abs(wz)))
    off = float(np.max(np.abs(vx * wz[most] - vx[most] * wz))) * seconds
    return off <= PARAMS.straight_rad * float(np.max(np.abs(vx)))


def along(start: Floats, steps: Floats) -> Floats:
    """Return poses (k, n, 4) of k paths, each as x, y, yaw and the way there.

    Args:
        start: (k, 4) or (1, 4) where they begin.
        steps: (k, n, 3) forwards, sideways [m] and turn [rad] of each step, along an arc.
    """
    yaw = start[:, None, 2] + np.cumsum(steps[..., 2], axis=1)
    middle = yaw - 0.5 * steps[..., 2]
    cos, sin = np.cos(middle), np.sin(middle)
    poses = np.empty((*yaw.shape, 4))
    poses[..., 0] = cos * steps[..., 0] - sin * steps[..., 1]
    poses[..., 1] = sin * steps[..., 0] + cos * steps[..., 1]
    poses[..., 3] = np.hypot(steps[..., 0], steps[..., 1])
    poses[..., 2] = 0.0
    poses = start[:, None] + np.cumsum(poses, axis=1)
    poses[..., 2] = yaw
    return poses


def braking_steps(velocities: Floats, limits: MotionLimits, spacing: float) -> Floats:
    """Return the steps of all paths to standing, (n, paths, steps, 3), as `along` takes them.

    Args:
        velocities: (n, 3) vx, vy [m/s], wz [rad/s] when it begins.
        limits: what the robot surely brakes with.
        spacing: way between two poses [m].
    """
    speed = np.hypot(velocities[:, 0], velocities[:, 1])
    turning = np.abs(velocities[:, 2])
    harder = np.array(PARAMS.harder)
    surely_s = float(turning.max()) / limits.angular_acceleration
    if float(turning.max()) * (PARAMS.period_s + 0.5 * surely_s) < PARAMS.straight_rad:
        harder = harder[:1]
    # (n, paths) until speed and turn rate are zero.
    stop_s = speed[:, None] / (limits.downhill_deceleration * harder[:, 0])
    unturn_s = turning[:, None] / (limits.angular_acceleration * harder[:, 1])
    way, turn = 0.5 * float(speed.max()), 0.5 * float(turning.max())
    count = 1 + math.ceil(
        max(way * float(stop_s.max()) / spacing, turn * float(unturn_s.max()) / PARAMS.turn_rad)
    )
    # Evenly in what is left of the speed and not in time, so that the poses lie evenly.
    part = 1.0 - np.sqrt(np.linspace(1.0, 0.0, count + 1))
    longest_s = np.maximum(stop_s, unturn_s)[..., None]
    seconds = PARAMS.period_s + longest_s * part
    ways = _covered(seconds, stop_s)
    turns = _covered(seconds, unturn_s)
    steps = np.empty((*ways.shape, 3))
    steps[..., 0] = ways * velocities[:, None, None, 0]
    steps[..., 1] = ways * velocities[:, None, None, 1]
    steps[..., 2] = turns * velocities[:, None, None, 2]
    steps[..., 1:, :] -= steps[..., :-1, :].copy()
    return steps


def _covered(seconds: Floats, stop_s: Floats) -> Floats:
    """Return for how long the first velocity would have been driven to come as far [s].

    Args:
        seconds: (n, paths, steps) since the command began to act.
        stop_s: (n, paths) how long braking takes, after one period.
    """
    braking = np.minimum(seconds - PARAMS.period_s, stop_s[..., None])
    with np.errstate(divide="ignore", invalid="ignore"):
        lost = np.where(stop_s[..., None] > 0.0, 0.5 * braking * braking / stop_s[..., None], 0.0)
    return PARAMS.period_s + braking - lost
