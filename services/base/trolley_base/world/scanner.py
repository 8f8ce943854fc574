"""The simulated lidar: when which beam is measured, from where, and with which errors.

The robot drives on while the sensor turns, so each beam is cast from where the robot is at that
moment: a step of the world casts the beams that fall into it.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D
from trolley.jit import kernel
from trolley_base.drivers.interface import LidarScan
from trolley_base.units import NS_PER_S
from trolley_base.world.lidar_faults import FaultyLidar
from trolley_base.world.rays import Scene, beam_range
from trolley_base.world.spec import LidarSpec, Sun


class Sweep(NamedTuple):
    """The beams of one step, as the kernel wants them.

    Attributes:
        first: number of the first beam of the step and of the one behind its last, as fired.
        clockwise: whether beams are fired from the highest angle down.
        timing: parts of the step until the first beam is fired, and between two beams.
        poses: (2, 3) map_T_laser x, y, yaw at the start and the end of the step.
        limits: (2,) nearest and farthest range [m].
        noise: (2,) standard deviation of a range: constant [m], and per metre.
    """

    first: tuple[int, int]
    clockwise: bool
    timing: tuple[float, float]
    poses: NDArray[np.float64]
    limits: NDArray[np.float64]
    noise: NDArray[np.float64]


@kernel
def cast_beams_into(
    out_ranges: NDArray[np.float32],
    sweep: Sweep,
    scene: Scene,
    draws: NDArray[np.float64],
) -> None:
    """Write the ranges of the beams of one step.

    Args:
        out_ranges: (beams,) [m] by angle, ascending; only the fired beams are written. No echo or
            beyond reach +inf; nearer than the sensor can measure, or unusable, 0.
        sweep: which beams, from where.
        scene: what they can meet.
        draws: (3, beams) of this revolution by angle: standard normal for the range, uniform 0...1
            for mirrors and glass, and +inf or 0 for beams that fail, NaN for the others.
    """
    beams = out_ranges.shape[0]
    ray = np.empty(4)
    start, end = sweep.poses[0], sweep.poses[1]
    turn = end[2] - start[2]
    turn -= 2.0 * math.pi * math.floor(turn / (2.0 * math.pi) + 0.5)
    for fired in range(sweep.first[0], sweep.first[1]):
        i = beams - 1 - fired if sweep.clockwise else fired
        if not math.isnan(draws[2, i]):
            out_ranges[i] = draws[2, i]
            continue
        part = sweep.timing[0] + (fired - sweep.first[0]) * sweep.timing[1]
        angle = start[2] + part * turn - math.pi + i * (2.0 * math.pi / beams)
        ray[0] = start[0] + part * (end[0] - start[0])
        ray[1] = start[1] + part * (end[1] - start[1])
        ray[2], ray[3] = math.cos(angle), math.sin(angle)
        distance = beam_range(scene, ray, sweep.limits[1], draws[1, i])
        if distance < math.inf:
            distance += draws[0, i] * (sweep.noise[0] + sweep.noise[1] * distance)
        if distance > sweep.limits[1]:
            distance = math.inf
        out_ranges[i] = distance if distance >= sweep.limits[0] else 0.0


class Shots(NamedTuple):
    """Beams of any sensor that were fired within one step of the world.

    Attributes:
        parts: (n,) when each was fired, as part of the step, 0...1.
        bearings: (n,) direction in frame `laser`, counter-clockwise [rad].
        draws: (n,) uniform 0...1, decides what mirrors and panes do to the beam.
        reach: longest range [m].
    """

    parts: NDArray[np.float64]
    bearings: NDArray[np.float64]
    draws: NDArray[np.float64]
    reach: float


@kernel
def cast_shots_into(
    out_ranges: NDArray[np.float64], shots: Shots, poses: NDArray[np.float64], scene: Scene
) -> None:
    """Write the exact ranges of the shots of one step; +inf without an echo within reach.

    Args:
        out_ranges: (n,) [m], overwritten.
        shots: which beams.
        poses: (2, 3) map_T_laser x, y, yaw at the start and the end of the step.
        scene: what they can meet.
    """
    ray = np.empty(4)
    start, end = poses[0], poses[1]
    turn = end[2] - start[2]
    turn -= 2.0 * math.pi * math.floor(turn / (2.0 * math.pi) + 0.5)
    for i in range(out_ranges.shape[0]):
        part = shots.parts[i]
        angle = start[2] + part * turn + shots.bearings[i]
        ray[0] = start[0] + part * (end[0] - start[0])
        ray[1] = start[1] + part * (end[1] - start[1])
        ray[2], ray[3] = math.cos(angle), math.sin(angle)
        out_ranges[i] = beam_range(scene, ray, shots.reach, shots.draws[i])


class Scanner:
    """Turns steps of the world into revolutions.

    Args:
        spec: the sensor.
        rng: source of all errors of beams.
        faults_rng: source of what is done to a revolution afterwards.
    """

    def __init__(
        self, spec: LidarSpec, rng: np.random.Generator, faults_rng: np.random.Generator
    ) -> None:
        self._faults = FaultyLidar(spec.faults, faults_rng)
        self._spec = spec
        self._rng = rng
        self._turn_beams = round(spec.beams * 2.0 * math.pi / spec.field_of_view)
        first = (self._turn_beams - spec.beams) // 2
        self._seen = slice(first, first + spec.beams)
        self._beams_per_s = self._turn_beams * spec.rate_hz
        self._fired = 0
        self._ranges = np.zeros(self._turn_beams, dtype=np.float32)
        self._draws = self._new_draws()
        self._poses = np.empty((2, 3))
        self._limits = np.array([spec.range_min_m, spec.range_max_m])
        self._noise = np.array([spec.noise_m, spec.noise_share])

    def step(
        self,
        from_ns: int,
        to_ns: int,
        laser: tuple[Pose2D, Pose2D],
        scene: Scene,
        sun: Sun | None = None,
    ) -> list[LidarScan]:
        """Measure the beams of one step and return the revolutions that it completes.

        Args:
            from_ns: start of the step, where the step before ended [ns].
            to_ns: its end [ns].
            laser: map_T_laser at both times.
            scene: what there is now.
            sun: that shines on the robot, if one does.
        """
        for row, pose in enumerate(laser):
            self._poses[row] = pose.x, pose.y, pose.yaw
        until = math.ceil(to_ns * self._beams_per_s / NS_PER_S)
        seconds = (to_ns - from_ns) / NS_PER_S
        between = 1.0 / (self._beams_per_s * seconds)
        scans: list[LidarScan] = []
        while self._fired < until:
            turn, first = divmod(self._fired, self._turn_beams)
            count = min(until - self._fired, self._turn_beams - first)
            begin = (self._fired / self._beams_per_s - from_ns / NS_PER_S) / seconds
            sweep = Sweep(
                (first, first + count), self._spec.clockwise, (begin, between),
                self._poses, self._limits, self._noise,
            )  # fmt: skip
            cast_beams_into(self._ranges, sweep, scene, self._draws)
            self._fired += count
            if first + count == self._turn_beams:
                sent = self._faults.spoil(self._finish(turn), laser[1].yaw, sun)
                scans += [] if sent is None else [sent]
        return scans

    def _finish(self, turn: int) -> LidarScan:
        spec = self._spec
        first, count = self._seen.start, self._turn_beams
        between, increment = 1.0 / self._beams_per_s, 2.0 * math.pi / count
        before = count - 1 - first if spec.clockwise else first
        scan = LidarScan(
            stamp_ns=round(turn / spec.rate_hz * NS_PER_S) + round(before * between * NS_PER_S),
            angle_min=-math.pi + first * increment,
            angle_increment=increment,
            time_increment=-between if spec.clockwise else between,
            range_min=spec.range_min_m,
            range_max=spec.range_max_m,
            ranges=self._ranges[self._seen].copy(),
        )
        self._draws = self._new_draws()
        return scan

    def _new_draws(self) -> NDArray[np.float64]:
        spec = self._spec
        draws = np.empty((3, self._turn_beams))
        self._rng.standard_normal(out=draws[0])
        self._rng.random(out=draws[1])
        fate = self._rng.random(self._turn_beams)
        draws[2] = 0.0  # where it is blind no beam is cast
        draws[2, self._seen] = np.nan
        draws[2, fate < spec.drop_out + spec.invalid] = 0.0
        draws[2, fate < spec.drop_out] = np.inf
        return draws
