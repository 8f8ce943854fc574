"""Samples in the order in which they were measured become revolutions, one scan each.

What distances mean in a scan: a sensor's 0 (nothing came back, too near, too dark) and its invalid
mark are 0, "invalid", for none of them says that the way is free; so is what is nearer than
`range_min`, and what is masked. An echo beyond `range_max` is +inf, "nothing in reach".

Counts: `lidar/short_revolutions`, revolutions with less than 80 % of their samples, or more than
there can be, which are dropped.
"""

import math
from collections import Counter, deque
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.config.hardware import LidarConfig
from trolley.geometry import wrap_angle
from trolley_base.drivers.interface import LidarScan
from trolley_base.drivers.lidars.models import LidarFacts
from trolley_base.drivers.lidars.sample_clock import SampleClock
from trolley_base.drivers.lidars.scan_grid import Floats, Grid, fit_grid, place
from trolley_base.drivers.lidars.speckles import speckles
from trolley_base.units import NS_PER_S

SHORT_REVOLUTIONS = "lidar/short_revolutions"
ENOUGH, TOO_MUCH = 0.8, 1.2
MOST_SAMPLES = 8192
MOST_SCANS = 16
"""At most this many scans wait to be read; the oldest are dropped."""
SLOWEST_DPS, FASTEST_DPS = 180.0, 14_400.0
"""Rates that no lidar has are not believed [deg/s]."""
STEP_BACK_DEG = 30.0
"""A step back by less than this is a frame that came twice, a longer one a new turn [deg]."""
BELIEVED = 0.1
"""Robot time and the sensor's time may differ by this share over a turn."""


class Samples(NamedTuple):
    """Samples in the order in which they were measured; all (n,), intensity may be (0,).

    Attributes:
        angle_deg: where the head pointed, growing from about 0 to 360 in each revolution.
        shift_deg: to add to it, for where the beam looked.
        elapsed_s: since the sample before, by the sensor's own time.
        begins: whether it is the first of a revolution.
        range_m: distance, 0 invalid.
        intensity: of the echo.
    """

    angle_deg: Floats
    shift_deg: Floats
    elapsed_s: Floats
    begins: NDArray[np.bool_]
    range_m: Floats
    intensity: Floats


class Rotation:
    """Follows the angle of a head from sample to sample.

    Args:
        usual_hz: taken where a reported rate cannot be.
    """

    def __init__(self, usual_hz: float) -> None:
        self._usual_dps = 360.0 * usual_hz
        # Of the last sample and of the farthest, in the turn of the farthest.
        self._last_deg: float | None = None
        self._farthest_deg = 0.0

    def follow(
        self, angle_deg: Floats, rate_dps: Floats
    ) -> tuple[Floats, Floats, NDArray[np.bool_]]:
        """Place samples in their revolutions.

        Args:
            angle_deg: (n,) 0...360.
            rate_dps: (n,) how fast the head turned, degrees per second.

        Returns:
            (n,) angles in the revolution, less than 0 where a frame came twice about its
            beginning; (n,) times since the sample before [s]; (n,) whether a revolution begins.
        """
        if self._last_deg is None:
            self._last_deg = self._farthest_deg = float(angle_deg[0])
        step = _steps(angle_deg, self._last_deg)
        # Whole turns, so that no sum of many angles drifts.
        turns = np.cumsum(-np.floor((step + STEP_BACK_DEG) / 360.0))
        unwrapped = angle_deg + 360.0 * turns
        farthest = np.maximum.accumulate(np.maximum(unwrapped, self._farthest_deg))
        advance = _steps(farthest, self._farthest_deg)
        turn = np.floor(farthest / 360.0)
        self._last_deg = float(unwrapped[-1] - 360.0 * turn[-1])
        self._farthest_deg = float(farthest[-1] - 360.0 * turn[-1])
        is_known = (rate_dps >= SLOWEST_DPS) & (rate_dps <= FASTEST_DPS)
        elapsed_s = advance / np.where(is_known, rate_dps, self._usual_dps)
        return unwrapped - 360.0 * turn, elapsed_s, _steps(turn, 0.0) > 0.0


def _steps(values: Floats, before: float) -> Floats:
    """Return the difference of each value from the one before, as `np.diff`, but sooner."""
    steps = np.empty_like(values)
    steps[0] = values[0] - before
    np.subtract(values[1:], values[:-1], out=steps[1:])
    return steps


class _Crossing(NamedTuple):
    """The first sample of a revolution: its time by the sensor and by the robot."""

    sensor_s: float
    robot_ns: int


class Revolutions:
    """Gathers samples and makes a scan of each revolution.

    Args:
        config: how it is mounted and what of it counts.
        counts: what goes wrong is added here.
        drops_speckles: leave dim single echoes out.
    """

    def __init__(
        self,
        facts: LidarFacts,
        config: LidarConfig,
        counts: Counter[str],
        *,
        drops_speckles: bool = False,
    ) -> None:
        self.scans: deque[LidarScan] = deque(maxlen=MOST_SCANS)
        self.turns_hz: float | None = None
        """How fast the head turned in the last revolution."""
        self.finished = 0
        """How many scans have been made."""
        self.short_in_a_row = 0
        """How many revolutions have been dropped since the last scan."""
        turns_left = facts.clockwise == (config.upside_down != config.reversed)
        self._sense = 1.0 if turns_left else -1.0
        self._near_m = config.range_min_m or facts.range_min_m
        self._far_m = config.range_max_m or facts.range_max_m
        self._masks_deg = config.masks_deg
        self._drops_speckles = drops_speckles
        self._notes_silence = (config.no_echo or facts.no_echo) == "creep"
        self._counts = counts
        self._parts: list[NDArray[np.float64]] = []
        self._held = 0
        self._start: _Crossing | None = None

    def add(self, samples: Samples, sensor_s: Floats, clock: SampleClock) -> None:
        """Take samples, and the sensor's time of each (n,) [s]."""
        columns = [samples.angle_deg, samples.shift_deg, sensor_s, samples.range_m]
        if len(samples.intensity):
            columns.append(samples.intensity)
        rows = np.array(columns, np.float64)
        done = 0
        for edge in np.flatnonzero(samples.begins).tolist():
            self._keep(rows[:, done:edge])
            moment = float(sensor_s[edge])
            self._finish(_Crossing(moment, clock.at(moment)))
            done = edge
        self._keep(rows[:, done:])

    def abandon(self) -> None:
        """Drop the revolution that has begun: part of it is lost."""
        if self._start is not None:
            self._count_short()
        self._parts, self._held, self._start = [], 0, None

    def _count_short(self) -> None:
        self._counts[SHORT_REVOLUTIONS] += 1
        self.short_in_a_row += 1

    def _keep(self, rows: Floats) -> None:
        if self._held + rows.shape[1] > MOST_SAMPLES:
            self.abandon()
        if self._start is not None:
            self._parts.append(rows)
            self._held += rows.shape[1]

    def _finish(self, end: _Crossing) -> None:
        """Make a scan of what has been gathered, if it is enough; begin the next."""
        start, parts = self._start, self._parts
        self._start, self._parts, self._held = end, [], 0
        if start is None:
            return
        rows = np.concatenate(parts, axis=1) if parts else np.empty((4, 0))
        scan = self._scan(rows, start, end)
        if scan is None:
            self._count_short()
            return
        self.scans.append(scan)
        self.finished += 1
        self.short_in_a_row = 0

    def _scan(self, rows: Floats, start: _Crossing, end: _Crossing) -> LidarScan | None:
        turn_s = end.sensor_s - start.sensor_s
        if rows.shape[1] < 2 or turn_s <= 0.0:
            return None
        angle_deg, moment_s = rows[0] + rows[1], rows[2]
        between = np.diff(moment_s)
        usual = float(np.median(between))
        if usual <= 0.0:
            return None
        steps = np.rint(between / usual).astype(np.int64)
        count = np.concatenate([[0], np.cumsum(steps)])
        grid = fit_grid(count, angle_deg)
        if grid is None:
            return None
        fired = 1 + np.count_nonzero(steps)
        if fired < ENOUGH * 360.0 / grid.step_deg or count[-1] > TOO_MUCH * 360.0 / grid.step_deg:
            return None
        step_s = float(moment_s[-1] - moment_s[0]) / int(count[-1])
        self.turns_hz = grid.step_deg / (360.0 * step_s)
        # Robot time over the sensor's own.
        pace = (end.robot_ns - start.robot_ns) / NS_PER_S / turn_s
        pace = pace if abs(pace - 1.0) < BELIEVED else 1.0
        mean_beam = float(((angle_deg - grid.first_deg) / grid.step_deg).mean())
        first_s = float(moment_s.mean()) - step_s * mean_beam
        first_ns = end.robot_ns - round((end.sensor_s - first_s) * pace * NS_PER_S)
        return self._laid_out(grid, angle_deg, rows, (first_ns, step_s * pace))

    def _laid_out(
        self, grid: Grid, angle_deg: Floats, rows: Floats, timing: tuple[int, float]
    ) -> LidarScan:
        """Turn a revolution into the frame `laser`, where angles grow counter-clockwise.

        Args:
            grid: of the beams.
            angle_deg: (n,) where each sample looked.
            rows: the samples.
            timing: when beam 0 of the grid was measured [ns], and the time between beams [s].
        """
        range_m = np.where(rows[3] > self._far_m, math.inf, rows[3])
        range_m[(range_m < self._near_m) | self._is_masked(angle_deg)] = 0.0
        intensity = rows[4] if rows.shape[0] > 4 else np.empty(0)
        if self._drops_speckles:
            range_m[speckles(angle_deg, rows[3], intensity, grid.step_deg)] = 0.0
        ranges, intensities = place(grid, angle_deg, range_m, intensity)
        is_masked = self._is_masked(grid.angles_deg())
        ranges[is_masked] = 0.0
        silent = np.empty(0, np.bool_)
        if self._notes_silence:
            nothing = np.where(rows[3] == 0.0, 1.0, 0.0)
            said_nothing, _ = place(grid, angle_deg, nothing, np.empty(0))
            silent = (said_nothing > 0.0) & (ranges == 0.0) & ~is_masked
        first_ns, time_increment = timing
        first_deg = grid.first_deg
        if self._sense < 0.0:
            first_ns += round((grid.beams - 1) * time_increment * NS_PER_S)
            first_deg = -(grid.first_deg + (grid.beams - 1) * grid.step_deg)
            ranges, intensities = ranges[::-1].copy(), intensities[::-1].copy()
            silent = silent[::-1].copy()
        return LidarScan(
            stamp_ns=first_ns,
            angle_min=wrap_angle(math.radians(first_deg)),
            angle_increment=math.radians(grid.step_deg),
            time_increment=self._sense * time_increment,
            range_min=self._near_m,
            range_max=self._far_m,
            ranges=ranges,
            intensities=intensities,
            silent=silent,
        )

    def _is_masked(self, angle_deg: Floats) -> NDArray[np.bool_]:
        laser_deg = self._sense * angle_deg
        masked = np.zeros(len(angle_deg), np.bool_)
        for low, high in self._masks_deg:
            width = high - low if high - low >= 360.0 else (high - low) % 360.0
            masked |= (laser_deg - low) % 360.0 <= width
        return masked
