"""What the emulated lidars share: a head that turns, and beams cast as it turns.

Angles are the sensor's own, in degrees, growing as the head turns; 0 is the sensor's front. Most
heads turn clockwise as seen from above. A triangulating sensor looks a little to the side of where
its head points, by an angle that depends on the distance.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D, wrap_angles
from trolley_base.emulators.device import Device
from trolley_base.units import NS_PER_S
from trolley_base.world import LidarSpec, Shots, Simulation

SPEED_STD = 0.003
"""Spread of the motor's speed from turn to turn, as a share."""
BASELINE_MM, FOCUS_MM = 21.8, 155.3
"""Constants of the triangulating sensors [mm]: YDLIDAR's of the X4."""

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class LidarFacts:
    """The properties of a model.

    Attributes:
        baud: speed of its line.
        turns_hz: revolutions per second of its head.
        range_min_m: nearest distance.
        range_max_m: farthest distance.
        sample_s: time between two samples; None: a sample at each of `steps`.
        steps: of a turn at which a sample is taken, where its time is not fixed.
        clockwise: its head turns clockwise, as seen from above.
    """

    baud: int
    turns_hz: float
    range_min_m: float
    range_max_m: float
    sample_s: float | None = None
    clockwise: bool = True
    steps: int = 360


@dataclass(frozen=True, slots=True)
class Mount:
    """How a lidar sits on the robot.

    Attributes:
        base_T_laser: its pose; x points along the sensor's angle 0.
        reversed: it turns the other way, or is mounted upside down.
    """

    base_T_laser: Pose2D
    reversed: bool = False


@dataclass(frozen=True, slots=True)
class BadView:
    """Faults of a view.

    Attributes:
        blind: angle ahead of the robot into which it finds nothing [rad].
        failing: share of the beams that find nothing.
        is_covered: all beams end at the nearest range.
    """

    blind: float = 0.0
    failing: float = 0.0
    is_covered: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """The measurements of one step, in order.

    Attributes:
        times_ns: (n,) when.
        heads_deg: (n,) where the head pointed, 0...360.
        ranges_m: (n,) what was found; 0: nothing, too near, too far, or failed.
        hz: turns per second, as the sensor measures it.
    """

    times_ns: NDArray[np.int64]
    heads_deg: Floats
    ranges_m: Floats
    hz: float

    @property
    def ranges_mm(self) -> NDArray[np.int64]:
        """Ranges in whole millimetres."""
        return np.rint(self.ranges_m * 1000.0).astype(np.int64)


class Head:
    """Times the samples, and says where the head points at each.

    Args:
        facts: the model.
        rng: source of the motor's unsteadiness.
        start_ns: when it begins, at angle 0.
    """

    def __init__(self, facts: LidarFacts, rng: np.random.Generator, start_ns: int) -> None:
        self._facts = facts
        self._rng = rng
        self._next_ns = float(start_ns)
        self._angle_deg = 0.0
        self.hz = facts.turns_hz

    def turn(self, until_ns: int, *, is_stuck: bool = False) -> tuple[NDArray[np.int64], Floats]:
        """Return times (n,) [ns] and angles (n,) [deg] of the samples before `until_ns`."""
        if self._facts.sample_s is None:
            steps = self._facts.steps
            by_deg, period_ns = 360.0 / steps, NS_PER_S / (steps * self.hz)
        else:
            by_deg, period_ns = (
                360.0 * self.hz * self._facts.sample_s,
                self._facts.sample_s * NS_PER_S,
            )
        if is_stuck:
            by_deg = 0.0
        index = np.arange(max(0, math.ceil((until_ns - self._next_ns) / period_ns)))
        times_ns = self._next_ns + index * period_ns
        angles_deg = (self._angle_deg + index * by_deg) % 360.0
        self._next_ns += len(index) * period_ns
        end_deg = self._angle_deg + len(index) * by_deg
        self._angle_deg = end_deg % 360.0
        if end_deg >= 360.0:
            unsteady = SPEED_STD * float(np.clip(self._rng.standard_normal(), -3.0, 3.0))
            self.hz = self._facts.turns_hz * (1.0 + unsteady)
        return times_ns.astype(np.int64), angles_deg.astype(np.float64)


class SpinningLidar(Device):
    """A lidar; subclasses make packets of its samples.

    Args:
        facts: the model.
        mount: how it sits on the robot.
        errors: of the world's lidar: noise, drop-outs, failures.
        rng: source of all its errors.
    """

    def __init__(
        self, facts: LidarFacts, mount: Mount, errors: LidarSpec, rng: np.random.Generator
    ) -> None:
        super().__init__(facts.baud)
        self.facts = facts
        self.bad_view = BadView()
        """What is wrong with its view; set by faults."""
        self._mount = mount
        self._errors = errors
        self._rng = rng
        self._head: Head | None = None
        self._last_m = 2.0
        # Angles of frame `laser` grow counter-clockwise.
        self._sense = -1.0 if facts.clockwise is not mount.reversed else 1.0

    def restart(self, now_ns: int) -> None:
        """Start from scratch: spinning, at angle 0."""
        self._spin(now_ns)

    def step(self, simulation: Simulation, from_ns: int, to_ns: int) -> None:
        """Measure while the head turns, and send full packets."""
        if self._head is not None:
            times_ns, heads_deg = self._head.turn(to_ns, is_stuck=self.is_stuck)
            parts = np.clip((times_ns - from_ns) / (to_ns - from_ns), 0.0, 1.0)
            ranges_m = self._measure(simulation, parts, heads_deg)
            self._emit(Samples(times_ns, heads_deg, ranges_m, self._head.hz))

    def _spin(self, now_ns: int, facts: LidarFacts | None = None) -> None:
        """Start measuring at angle 0, possibly at another rate than the model's usual one."""
        self._head = Head(facts or self.facts, self._rng, now_ns)

    def _halt(self) -> None:
        self._head = None

    def _emit(self, samples: Samples) -> None:
        """Make packets; each leaves when its last sample has been taken."""
        raise NotImplementedError

    def _offset_deg(self, ranges_m: Floats) -> Floats:
        """Return the angle between head and beam at these measured distances [deg]."""
        return np.zeros_like(ranges_m)

    def _measure(self, simulation: Simulation, parts: Floats, heads_deg: Floats) -> Floats:
        """Cast the beams and add the sensor's errors; 0 where there is no range.

        The direction of a triangulating sensor depends on the range: guess, cast, correct.
        """
        num = len(heads_deg)
        draws = self._rng.random(num)
        exact_m, guess_m = np.empty(0), np.full(num, self._last_m)
        beside_deg = self._offset_deg(guess_m)
        bearings = np.empty(0)
        for _ in range(3):
            bearings = self._sense * np.radians(heads_deg + beside_deg)
            shots = Shots(parts, bearings, draws, self.facts.range_max_m)
            exact_m = simulation.measure(self._mount.base_T_laser, shots)
            found = self._offset_deg(np.minimum(exact_m, self.facts.range_max_m))
            if np.allclose(found, beside_deg, rtol=0.0, atol=0.01):
                break
            beside_deg = found
        if num:
            self._last_m = float(min(exact_m[-1], self.facts.range_max_m))
        return self._hide(self._spoil(exact_m), bearings)

    def _hide(self, ranges_m: Floats, bearings: Floats) -> Floats:
        """Apply what is wrong with the view; bearings (n,) in frame `laser` [rad]."""
        bad = self.bad_view
        if bad.is_covered:
            return np.full_like(ranges_m, self.facts.range_min_m)
        ahead = wrap_angles(bearings + self._mount.base_T_laser.yaw)
        fails = np.abs(ahead) < 0.5 * bad.blind
        if bad.failing > 0.0:  # else the errors stay as they are without the fault
            fails |= self._rng.random(len(ranges_m)) < bad.failing
        return np.where(fails, 0.0, ranges_m)

    def _spoil(self, exact_m: Floats) -> Floats:
        errors, facts = self._errors, self.facts
        none = ~np.isfinite(exact_m)
        exact_m = np.where(none, 0.0, exact_m)
        spread = errors.noise_m + errors.noise_share * exact_m
        noisy = exact_m + spread * self._rng.standard_normal(len(exact_m))
        none |= (noisy < facts.range_min_m) | (noisy > facts.range_max_m)
        none |= self._rng.random(len(exact_m)) < errors.drop_out + errors.invalid
        return np.where(none, 0.0, noisy)


def triangulation_deg(ranges_m: Floats) -> Floats:
    """YDLIDAR's correction: the angle between the head and a triangulating sensor's beam.

    Args:
        ranges_m: (n,) distances found, > 0.

    Returns:
        (n,) degrees to add to the head's angle; about -8 far away, 0 at 155 mm.

    Source:
        YDLIDAR X4 development manual, second-level angle analysis.
    """
    millimetres = np.maximum(ranges_m, 0.001) * 1000.0
    offset = BASELINE_MM * (FOCUS_MM - millimetres) / (FOCUS_MM * millimetres)
    return np.degrees(np.arctan(offset)).astype(np.float64)


MakeLidar = Callable[[Mount, LidarSpec, np.random.Generator], SpinningLidar]
