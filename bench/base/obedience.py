"""How soon base finds out that its motor board does not obey, and how often it is wrong about it.

python -m bench.base.obedience [--runs 200] [--seconds 60] [--first 0] [--measured]

Judged on motors that share nothing with the supervision or the simulated world: two wheels as
second-order systems behind a delay of up to 0.3 s with jitter, with overshoot, dead band, uneven
gains, play in the gears and encoders of 0.1 to 8 mm per tick that report 10 to 50 times a second.
Robots in order are driven at random, by ramps and abrupt stops: each finding is a false alarm. Then
each robot is broken while it drives, and the time to the finding is measured.
"""

import argparse
import math
import time
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from trolley.geometry import Twist2D, exp_twist
from trolley_base.drivers import MotionSample
from trolley_base.safety.motion_bounds import PARAMS
from trolley_base.safety.motion_diagnosis import Finding
from trolley_base.safety.motion_limits import MotionLimits, ramp
from trolley_base.safety.motion_supervision import MotionSupervision

LIMITS = MotionLimits(0.5, 1.5, 0.8, 1.0, 4.0)
STEP_S, CONTROL_STEPS = 0.005, 4
BROKEN_AT_S = 8.0
OFTEN_S = 0.05
"""Boards that report at least so often are judged sooner [s]."""


@dataclass(frozen=True)
class Robot:
    """One robot of the workshop, drawn at random within what is lawful."""

    delay_s: float
    jitter_s: float
    frequency: float
    """Of the speed control [rad/s]."""
    damping: float
    gains: tuple[float, float]
    dead_band: float
    """A wheel that is told less stands [m/s]."""
    braking: tuple[float, float]
    """Each wheel slows down no faster than this [m/s^2]."""
    half_track_m: float
    guessed_half_track_m: float
    tick_m: float
    play_m: float
    period_s: float
    late_s: float

    @property
    def longest_delay_s(self) -> float:
        """From a command until odometry shows that the wheels follow it."""
        return self.delay_s + self.jitter_s + self.late_s


def draw(rng: np.random.Generator) -> Robot:
    """Return a robot in order."""
    half_track_m = float(rng.uniform(0.06, 0.2))
    uneven = float(rng.uniform(0.0, 0.1))
    return Robot(
        delay_s=float(rng.uniform(0.02, 0.25)),
        jitter_s=float(rng.uniform(0.0, 0.05)),
        frequency=float(rng.uniform(15.0, 40.0)),
        damping=float(rng.uniform(0.5, 1.2)),
        gains=(1.0 - uneven, 1.0 + uneven),
        dead_band=float(rng.uniform(0.0, 0.03)),
        braking=(float(rng.uniform(1.0, 3.0)), float(rng.uniform(1.0, 3.0))),
        half_track_m=half_track_m,
        guessed_half_track_m=half_track_m * float(rng.uniform(0.9, 1.4)),
        tick_m=float(10.0 ** rng.uniform(-4.0, -2.1)),
        play_m=float(rng.uniform(0.0, 0.003)),
        period_s=float(rng.choice([0.02, 0.033, 0.05, 0.1])),
        late_s=float(rng.uniform(0.0, 0.03)),
    )


class Wheel:
    """A driven wheel with its encoder."""

    def __init__(self, robot: Robot, side: int) -> None:
        self._robot = robot
        self._gain, self._braking = robot.gains[side], robot.braking[side]
        self.speed = self._change = self._motor_m = 0.0
        self._wheel_m = 0.0
        self.is_dead = self.is_stuck = False
        self._frozen = 0

    def step(self, told: float) -> None:
        """Turn for one step."""
        robot = self._robot
        target = 0.0 if self.is_dead or abs(told) < robot.dead_band else self._gain * told
        pull = robot.frequency**2 * (target - self.speed)
        self._change += (pull - 2.0 * robot.damping * robot.frequency * self._change) * STEP_S
        if self._change * self.speed < 0.0:
            self._change = max(-self._braking, min(self._braking, self._change))
        self.speed += self._change * STEP_S
        self._motor_m += self.speed * STEP_S
        # The gear's play lies between the motor, which has the encoder, and the floor.
        half = 0.5 * robot.play_m
        self._wheel_m = max(self._motor_m - half, min(self._motor_m + half, self._wheel_m))
        if not self.is_stuck:
            self._frozen = math.floor(self._wheel_m / robot.tick_m)

    @property
    def count(self) -> int:
        """What the encoder reads."""
        return self._frozen


class Plant:
    """The whole robot: commands in, motions out, each at its time."""

    def __init__(self, robot: Robot, rng: np.random.Generator) -> None:
        self.robot, self._rng = robot, rng
        self.wheels = Wheel(robot, 0), Wheel(robot, 1)
        self._told: deque[tuple[float, Twist2D]] = deque()
        self._now = Twist2D.zero()
        self._counts = (0, 0)
        self._reported_s = 0.0
        self._line: deque[tuple[float, MotionSample]] = deque()
        self.factor = 1.0
        """It drives this many times what it is told."""
        self.by_itself: Twist2D | None = None
        self.is_deaf = self.is_swapped = False

    def tell(self, at_s: float, twist: Twist2D) -> None:
        """Command it."""
        due_s = at_s + self.robot.delay_s + float(self._rng.uniform(0.0, self.robot.jitter_s))
        self._told.append((max(due_s, self._told[-1][0] if self._told else 0.0), twist))

    def step(self, at_s: float) -> None:
        """Live for one step."""
        while self._told and self._told[0][0] <= at_s:
            told = self._told.popleft()[1].scaled(self.factor)
            self._now = self._now if self.is_deaf else self.by_itself or told
        outward = self.robot.half_track_m * self._now.wz
        for wheel, sign in zip(self.wheels, (-1.0, 1.0), strict=True):
            wheel.step(self._now.vx + sign * outward)
        if at_s - self._reported_s >= self.robot.period_s - 1e-9:
            self._report(at_s)

    def _report(self, at_s: float) -> None:
        seconds, self._reported_s = at_s - self._reported_s, at_s
        left, right = (wheel.count for wheel in self.wheels)
        if self.is_swapped:
            left, right = right, left
        counts, self._counts = self._counts, (left, right)
        moved = [
            (new - old) * self.robot.tick_m for new, old in zip(self._counts, counts, strict=True)
        ]
        way = Twist2D(
            0.5 * (moved[0] + moved[1]), 0.0, 0.5 * (moved[1] - moved[0]) / self.robot.half_track_m
        )
        sample = MotionSample(round(at_s * 1e9), exp_twist(way), way.scaled(1.0 / seconds))
        self._line.append((at_s + self.robot.late_s, sample))

    def take(self, at_s: float) -> list[MotionSample]:
        """Return the motions that have arrived."""
        taken: list[MotionSample] = []
        while self._line and self._line[0][0] <= at_s:
            taken.append(self._line.popleft()[1])
        return taken


class Driver:
    """Somebody who drives as people and planners do."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng
        self._until_s = 0.0
        self._wanted = self._now = Twist2D.zero()

    def next(self, at_s: float) -> Twist2D:
        """Return the command of this period."""
        if at_s >= self._until_s:
            self._until_s = at_s + float(self._rng.uniform(0.1, 3.0))
            self._wanted = self._choose()
            if self._rng.random() < 0.3:
                self._now = self._wanted = Twist2D.zero()  # a stop, at once
        self._now = ramp(self._now, self._wanted, LIMITS, 0.02)
        return self._now

    def _choose(self) -> Twist2D:
        vx, wz = (float(value) for value in self._rng.uniform([-0.5, -1.5], [0.5, 1.5]))
        kind = self._rng.integers(5)
        if kind == 0:
            return Twist2D.zero()
        slow = 0.1 if self._rng.random() < 0.2 else 1.0
        return Twist2D(slow * vx * (kind != 1), 0.0, slow * wz * (kind != 2))


@dataclass(frozen=True)
class Break:
    """Something that breaks while the robot drives.

    Attributes:
        told: what it is told until then.
        apply: breaks it.
        is_stopped: whether it is told to stand from that moment on.
    """

    told: Twist2D
    apply: Callable[[Plant], None]
    is_stopped: bool = False


def _set(**values: object) -> Callable[[Plant], None]:
    def apply(plant: Plant) -> None:
        for name, value in values.items():
            setattr(plant, name, value)

    return apply


def _kill_motor(plant: Plant) -> None:
    plant.wheels[0].is_dead = True


def _kill_motors(plant: Plant) -> None:
    for wheel in plant.wheels:
        wheel.is_dead = True


def _stick_encoder(plant: Plant) -> None:
    plant.wheels[1].is_stuck = True


AHEAD, TURN, STAND = Twist2D(0.3, 0.0, 0.0), Twist2D(0.0, 0.0, 1.0), Twist2D.zero()
BREAKS = {
    "ignores a stop at 0.5 m/s": Break(Twist2D(0.5, 0.0, 0.0), _set(is_deaf=True), True),
    "ignores a stop at 0.3 m/s": Break(AHEAD, _set(is_deaf=True), True),
    "ignores a stop at 0.1 m/s": Break(Twist2D(0.1, 0.0, 0.0), _set(is_deaf=True), True),
    "ignores a stop of a turn": Break(TURN, _set(is_deaf=True), True),
    "sets off by itself": Break(STAND, _set(by_itself=AHEAD)),
    "drives backwards": Break(AHEAD, _set(factor=-1.0)),
    "drives twice as fast": Break(Twist2D(0.2, 0.0, 0.0), _set(factor=2.0)),
    "motors without power": Break(AHEAD, _kill_motors),
    "left motor dead": Break(AHEAD, _kill_motor),
    "right encoder stuck": Break(AHEAD, _stick_encoder),
    "encoders swapped": Break(TURN, _set(is_swapped=True)),
}


def longest_s(robot: Robot, *, is_measured: bool) -> float:
    """Return within which time an ignored stop is found at the latest, as docs/obedience.md says.

    Args:
        robot: what is asked about.
        is_measured: whether base knows how late the robot follows.
    """
    delay_s = robot.longest_delay_s if is_measured else math.inf
    delay_s = max(min(delay_s, PARAMS.delay_ns * 1e-9), PARAMS.least_delay_ns * 1e-9)
    slower = PARAMS.braking_share * LIMITS.deceleration
    speed = PARAMS.standing_speed + robot.tick_m / (PARAMS.smooth_ns * 1e-9)
    way_m = PARAMS.braking_excess_m + PARAMS.ticks * robot.tick_m
    apart_s = (speed + math.sqrt(speed * speed + 2.0 * slower * way_m)) / slower
    # At 10 reports a second a slow robot has stopped braking before two of them say so.
    num_reports = 2.25 if robot.period_s <= OFTEN_S else 3.2
    return delay_s + apart_s + num_reports * robot.period_s + robot.late_s + 0.04


@dataclass(frozen=True)
class Found:
    """What was found, and how long after the break [s]."""

    after_s: float
    finding: Finding
    robot: Robot


def run(
    seed: int, seconds: float, broken: Break | None = None, *, is_measured: bool = False
) -> Found | None:
    """Drive a robot, and break it if asked for; return the first finding, None if there is none.

    Args:
        seed: of the robot and its driver.
        seconds: how long it drives.
        broken: what breaks.
        is_measured: whether base knows how late the robot follows.
    """
    rng = np.random.default_rng(seed)
    robot = draw(rng)
    plant, driver = Plant(robot, rng), Driver(rng)
    delay_s = robot.longest_delay_s if is_measured else math.inf
    supervision = MotionSupervision(LIMITS, robot.guessed_half_track_m, delay_s)
    told = Twist2D.zero()
    for index in range(round(seconds / STEP_S)):
        at_s = index * STEP_S
        if broken is not None and index == round(BROKEN_AT_S / STEP_S):
            broken.apply(plant)
        if index % CONTROL_STEPS == 0:
            for motion in plant.take(at_s):
                supervision.measure(motion)
            finding = supervision.take_finding()
            if finding is not None:
                return Found(at_s - BROKEN_AT_S, finding, robot)
            if broken is None:
                told = driver.next(at_s)
            elif broken.is_stopped and at_s >= BROKEN_AT_S:
                told = STAND
            else:
                told = ramp(told, broken.told if at_s > 1.0 else STAND, LIMITS, 0.02)
            supervision.command(round(at_s * 1e9), told)
            plant.tell(at_s, told)
        plant.step(at_s)
    return None


def main() -> None:
    """Print false alarms, then how soon each break is found."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=200)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--measured", action="store_true", help="base knows each robot's delay")
    options = parser.parse_args()
    began_s = time.monotonic()
    seeds = range(options.first, options.first + options.runs)
    num_false = 0
    for seed in seeds:
        found = run(seed, options.seconds, is_measured=options.measured)
        if found is not None:
            num_false += 1
            print(f"false alarm, seed {seed}: {found.finding.detail}\n    {found.robot}")
    hours = options.runs * options.seconds / 3600.0
    print(f"{num_false} false alarms of {options.runs} robots in {hours:.1f} h")
    for name, broken in BREAKS.items():
        times: list[float] = []
        others: Counter[str] = Counter()
        for seed in seeds:
            found = run(seed, BROKEN_AT_S + 5.0, broken, is_measured=options.measured)
            if found is None or found.after_s < 0.0:
                others["missed" if found is None else "too early"] += 1
            else:
                times.append(found.after_s)
                others[found.finding.fault.name.lower()] += 1
        median, most = np.percentile(times, [50, 100])
        kinds = ", ".join(f"{number} {kind}" for kind, number in others.most_common())
        print(f"{name:26s} median {median:.2f} s, at most {most:.2f} s; {kinds}", flush=True)
    print(f"took {time.monotonic() - began_s:.0f} s")


if __name__ == "__main__":
    main()
