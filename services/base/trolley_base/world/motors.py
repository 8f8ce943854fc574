"""What lies between a command and the wheels' motion: delay, dead band, uneven motors, sag.

And between the wheels' motion and the robot's: backlash and the castor. SI.
"""

import math
from collections import deque

import numpy as np

from trolley.geometry import Twist2D
from trolley_base.differential import sides_of, twist_of
from trolley_base.world.spec import DriveLimits, Motors

SETTLED = 1e-4
"""A wheel this close to its speed has reached it [m/s]."""
CASTOR_TURNS_M = 0.02
"""A castor has come round once the robot has driven this far one way [m]."""


class CommandLine:
    """Commands on their way to the motors.

    Args:
        motors: delay and jitter.
        rng: draws the jitter, once a command.
    """

    def __init__(self, motors: Motors, rng: np.random.Generator) -> None:
        self._motors = motors
        self._rng = rng
        self._now_s = 0.0
        self._acts = Twist2D.zero()
        self._last = Twist2D.zero()
        self._under_way: deque[tuple[float, Twist2D]] = deque()

    def step(self, command: Twist2D, dt: float) -> Twist2D:
        """Send a command, and return the one that acts for the next `dt` seconds."""
        if self._motors.delay_s == 0.0 and self._motors.jitter_s == 0.0:
            return command
        if command != self._last:
            delay_s = self._motors.delay_s + self._motors.jitter_s * float(self._rng.random())
            acts_s = self._now_s + delay_s
            if self._under_way:  # none overtakes another
                acts_s = max(acts_s, self._under_way[-1][0])
            self._under_way.append((acts_s, command))
            self._last = command
        while self._under_way and self._under_way[0][0] <= self._now_s:
            self._acts = self._under_way.popleft()[1]
        self._now_s += dt
        return self._acts


class Actuator:
    """Two motors that follow a command.

    Args:
        motors: how far they are from ideal ones.
        limits: what they can do with a full battery.
        track_m: distance between the wheels.
        rng: draws the jitter of commands.
    """

    def __init__(
        self, motors: Motors, limits: DriveLimits, track_m: float, rng: np.random.Generator
    ) -> None:
        self._motors = motors
        self._limits = limits
        self._half_track_m = 0.5 * track_m
        self._line = CommandLine(motors, rng)
        self._driven_s = 0.0
        self.twist = Twist2D.zero()
        """Velocity as the wheels turn [m/s, rad/s]."""

    def step(self, command: Twist2D, dt: float) -> None:
        """Follow a command for `dt` seconds; sideways is not possible and left out."""
        limits, motors = self._limits, self._motors
        acts = self._line.step(command, dt)
        self._driven_s += dt
        power = 1.0 - motors.sag * min(1.0, self._driven_s / (60.0 * motors.sag_minutes))
        wanted = Twist2D(
            _clamp(acts.vx, power * limits.max_speed_mps), 0.0, _clamp(acts.wz, limits.max_wz_radps)
        )
        if motors.dead_band_mps > 0.0:
            wanted = self._without_dead_band(wanted)
        v = _approach(
            self.twist.vx,
            wanted.vx,
            power * limits.acceleration_mps2 * dt,
            limits.deceleration_mps2 * dt,
        )
        wz = _approach(
            self.twist.wz,
            wanted.wz,
            limits.angular_acceleration_radps2 * dt,
            limits.angular_deceleration_radps2 * dt,
        )
        following = Twist2D(v, 0.0, wz)
        self.twist = self._unevenly(following) if motors.uneven > 0.0 else following

    def _without_dead_band(self, wanted: Twist2D) -> Twist2D:
        """Return what is left where each wheel stands that should turn very slowly."""
        left, right = (
            0.0 if abs(one) < self._motors.dead_band_mps else one
            for one in sides_of(wanted, self._half_track_m)
        )
        return twist_of(left, right, self._half_track_m)

    def _unevenly(self, following: Twist2D) -> Twist2D:
        """Return what becomes of the next velocity where the right motor follows later."""
        left, wanted = sides_of(following, self._half_track_m)
        _, right = sides_of(self.twist, self._half_track_m)
        change = wanted - right
        right = wanted if abs(change) < SETTLED else right + (1.0 - self._motors.uneven) * change
        return twist_of(left, right, self._half_track_m)


class Backlash:
    """Play between a wheel's encoder and its tread.

    Args:
        play_m: how far the wheel turns, when its direction changes, before it moves the robot.
    """

    def __init__(self, play_m: float) -> None:
        self._play_m = play_m
        self._at_m = 0.0

    def drive(self, speed: float, dt: float) -> float:
        """Return the speed of the tread [m/s] when the motor turns with a speed."""
        if self._play_m == 0.0:
            return speed
        at_m = self._at_m + speed * dt
        self._at_m = min(self._play_m, max(0.0, at_m))
        return (at_m - self._at_m) / dt


class Castor:
    """A castor that swings round when the robot turns back, and pushes it aside.

    Args:
        motors: how far it can push.
        rng: draws how far it does, each time.
    """

    def __init__(self, motors: Motors, rng: np.random.Generator) -> None:
        self._kick_rad = motors.castor_kick_rad
        self._within_m = motors.castor_m
        self._rng = rng
        self._way = 0.0  # driven one way, signed; at most so far that the castor has come round
        self._trails = 0.0  # its sign when the castor last came round
        self._left_m = 0.0
        self._per_m = 0.0

    def drive(self, speed: float, dt: float) -> float:
        """Return the turn rate that the castor adds [rad/s]."""
        if self._kick_rad == 0.0:
            return 0.0
        step = speed * dt
        self._way = max(-CASTOR_TURNS_M, min(CASTOR_TURNS_M, self._way + step))
        before = self._trails
        self._trails = math.copysign(1.0, self._way) if self._way else before
        if before * self._trails < 0.0:
            self._per_m = self._kick_rad * float(self._rng.uniform(-1.0, 1.0)) / self._within_m
            self._left_m = self._within_m
        if self._left_m <= 0.0:
            return 0.0
        self._left_m -= abs(step)
        return self._per_m * abs(speed)


def _clamp(value: float, limit: float) -> float:
    """Return the nearest value within the limit; NaN counts as standing still."""
    return max(-limit, min(limit, value)) if math.isfinite(value) else 0.0


def _approach(now: float, wanted: float, faster: float, slower: float) -> float:
    """Return the next velocity: at most `faster` away from zero, `slower` towards it, per step."""
    if now * wanted < 0.0:
        wanted = 0.0
    limit = faster if abs(wanted) > abs(now) else slower
    return now + max(-limit, min(limit, wanted - now))
