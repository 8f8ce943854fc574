"""How fast a sound robot may be, and how fast it must be, by what it was told lately.

A sound robot follows its commands a moment later, roughly, and brakes at least as hard as its
limits say. Its latest commands therefore give bounds for its motion. What exceeds them adds up;
what stays within them is subtracted again (a CUSUM test: Page, Continuous Inspection Schemes,
Biometrika 41, 1954). So a single wrong reading, a coarse encoder or noise exceeds nothing.
"""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Generic, NamedTuple, TypeVar

from trolley.geometry import Twist2D
from trolley_base.differential import sides_of
from trolley_base.safety.motion_diagnosis import WRONG_TRACK
from trolley_base.safety.motion_limits import MotionLimits


@dataclass(frozen=True, slots=True)
class MotionSupervisionParams:
    """Bounds for a sound base: the tightest without a false alarm in `bench.base.obedience`."""

    delay_ns: int = 220_000_000
    """Time until a zero acts on the motors and shows in the odometry, if it has not been measured
    [ns]. The allowed excess makes up for 0.3 s."""
    least_delay_ns: int = 100_000_000
    """Shortest delay that is believed, however short the measured one [ns]."""
    braking_share: float = 0.7
    """Least share of the configured deceleration with which the robot brakes."""
    turn_braking_share: float = 0.6
    """Least share of the configured angular deceleration, which nobody measures."""
    standing_speed: float = 0.015
    """Speed below which the robot counts as standing, given encoders and backlash [m/s]."""
    standing_wz: float = 0.05
    """Turn rate below which the robot counts as standing, given encoders and backlash [rad/s]."""
    braking_excess_m: float = 0.004
    """Distance beyond the braking distance from which on the robot does not brake [m]."""
    braking_excess_rad: float = 0.02
    """Turn beyond the braking distance from which on the robot does not brake [rad]."""
    smooth_ns: int = 100_000_000
    """Time over which the mean speed at a command to brake is taken [ns]."""
    uneven: float = 0.5
    """Share of the speed that may show as a turn, and of the turn as speed: one wheel may brake
    later than the other."""
    following_ns: int = 180_000_000
    """Time after the delay within which a side follows a new command [ns]."""
    fastest_share: float = 1.4
    """Greatest multiple of its commanded speed at which a side may move, `fast_slack` apart."""
    fast_slack: float = 0.04
    """Added to the highest allowed speed, for what the other side contributes [m/s]."""
    slowest_share: float = 0.5
    """Least share of its commanded speed at which a side must move, `slow_slack` apart."""
    slow_slack: float = 0.015
    """Subtracted from the lowest allowed speed, for friction and a dead band [m/s]."""
    fast_excess_m: float = 0.04
    """Distance beyond what it may cover from which on a side drives otherwise than commanded [m].
    """
    slow_excess_m: float = 0.025
    """Distance short of what it must cover from which on a side drives otherwise than commanded
    [m]."""
    still_share: float = 0.5
    """Share of the commanded distance, to and fro, that a side must cover, `still_slack` apart."""
    still_slack: float = 0.03
    """Subtracted from the commanded speed, for a dead band [m/s]."""
    still_excess_m: float = 0.05
    """Lag from which on a side does not turn: commands may go to and fro so fast that no single one
    can be held against it [m]."""
    dead_share: float = 0.1
    """Share of the commanded distance that a side must cover, less `still_slack` and what a wrong
    track makes of the other side."""
    dead_excess_m: float = 0.015
    """Lag from which on a side does not turn at all [m]."""
    ticks: float = 1.5
    """Encoder ticks by which each excess grows, for coarse encoders."""
    least_tick_m: float = 1e-6
    """Step below which differences are rounding of numbers, not ticks [m]."""
    rested_ns: int = 500_000_000
    """Time of standing after which a motion is not braking any more [ns]."""
    steady_ns: int = 500_000_000
    """Time for which motors hold a speed and a hand does not [ns]."""
    steady_share: float = 0.15
    """Share by which a speed that is held may vary."""
    steady_speed: float = 0.05
    """Speed below which a motion is never judged to be steady [m/s]."""
    longest_push_ns: int = 3_000_000_000
    """Duration above which a push counts as the motors' doing [ns]."""
    kept_ns: int = 1_000_000_000
    """Time for which commands and motions are kept [ns]."""
    longest_gap_ns: int = 500_000_000
    """Gap in commands or reports after which what came before is forgotten [ns]."""
    gyro_wz: float = 0.1
    """Turn rate by the gyro above which the robot is moving, whatever its wheels say [rad/s]."""
    shown_ns: int = 250_000_000
    """Time over which the mean motion is taken to judge whether the robot moves [ns]."""


PARAMS = MotionSupervisionParams()

T = TypeVar("T")


class Moved(NamedTuple):
    """What was measured of one interval.

    Attributes:
        stamp_ns: when it ended.
        since_ns: when it began.
        seconds: how long it was.
        lately_s: how long it was together with those just before, within `PARAMS.smooth_ns`.
        twist: the mean velocity.
        gyro: the mean turn rate by the gyro, without bias [rad/s].
    """

    stamp_ns: int
    since_ns: int
    seconds: float
    lately_s: float
    twist: Twist2D
    gyro: float | None


@dataclass(slots=True)
class Excess:
    """How far something went beyond its bounds."""

    most: float
    since_ns: int = 0
    """When it began."""
    _value: float = 0.0

    def add(self, rate: float, moved: Moved, tick: float) -> bool:
        """Add what goes beyond, or subtract what stays inside; whether it is too much now.

        Args:
            rate: how fast it goes beyond, below zero inside.
            moved: the interval.
            tick: what one tick of an encoder amounts to.
        """
        if self._value == 0.0:
            self.since_ns = moved.since_ns
        most = self.most + PARAMS.ticks * tick
        # One reading alone proves nothing.
        beyond = self._value + min(rate * moved.seconds, 0.5 * most)
        self._value = min(most, max(0.0, beyond))
        return self._value >= most

    def clear(self) -> None:
        """Start over."""
        self._value = 0.0


@dataclass(frozen=True, slots=True)
class _Braking:
    """How one part of a velocity decreases while braking.

    Attributes:
        delay_ns: it begins within this time.
        rate: it slows down at least so fast [per s].
        standing: what counts as nothing.
        slack: what it may be faster than a share of what it is told.
        excess: so much beyond is too much.
    """

    delay_ns: int
    rate: float
    standing: float
    slack: float
    excess: float


class _InForce(Generic[T]):
    """Recent commands, each in force until the next."""

    def __init__(self) -> None:
        self._told: deque[tuple[int, T]] = deque()

    def tell(self, now_ns: int, told: T) -> None:
        """Take what is told from now on."""
        if self._told and self._told[-1][1] == told:
            return
        self._told.append((now_ns, told))
        while len(self._told) > 1 and now_ns - self._told[1][0] > PARAMS.kept_ns:
            self._told.popleft()

    def between(self, since_ns: int, until_ns: int) -> list[T]:
        """Return all that was in force in a time, the newest first."""
        found: list[T] = []
        for at_ns, told in reversed(self._told):
            if at_ns <= until_ns:
                found.append(told)
            if at_ns <= since_ns:
                break
        return found


class Recent:
    """Numbers of the last moments."""

    def __init__(self) -> None:
        self._stamps_ns: deque[int] = deque()
        self.values: deque[float] = deque()

    def add(self, stamp_ns: int, value: float, oldest_ns: int) -> None:
        """Add the newest, and drop all before `oldest_ns`."""
        self._stamps_ns.append(stamp_ns)
        self.values.append(value)
        while self._stamps_ns[0] < oldest_ns:
            self._stamps_ns.popleft()
            self.values.popleft()


class _Ceiling:
    """How fast one part of a velocity may be in one direction."""

    def __init__(self, braking: _Braking) -> None:
        self._braking = braking
        self.may_be = 0.0
        self.excess = Excess(braking.excess)

    def update(self, seconds: float, peak: float, told: float, *, excused: bool) -> float:
        """Return how fast it may be by now.

        Args:
            seconds: since the call before.
            peak: how fast it was at most of late.
            told: the most that it was told lately, not below zero.
            excused: however fast it is, it may brake from that.
        """
        braking = self._braking
        follows = 0.0 if told == 0.0 else PARAMS.fastest_share * told + braking.slack
        if excused:
            self.may_be = max(self.may_be, peak)
        # It brakes from how fast it was, not from how fast it might have been.
        slower = min(self.may_be - braking.rate * seconds, peak)
        self.may_be = max(follows, slower, 0.0)
        return self.may_be


@dataclass(slots=True)
class _Floor:
    """How slow a side may be that is told to go in one direction."""

    excess: Excess

    def measure(self, moved: Moved, measured: float, told: float, tick: float) -> bool:
        """Say whether it has been too slow for too long.

        Args:
            moved: the interval.
            measured: how fast it was, below zero in the other direction.
            told: the least that it was told lately.
            tick: what one tick of an encoder amounts to.
        """
        least = max(0.0, PARAMS.slowest_share * told - PARAMS.slow_slack)
        # Told to stand, or to go the other way, it cannot be too slow; nor does that excuse it.
        behind = least - measured if least > 0.0 else 0.0
        return self.excess.add(behind, moved, tick)


class _Standing:
    """Whether a side turns at all, to and fro: it may be slow, or stand for a short distance."""

    def __init__(self) -> None:
        self.excesses = Excess(PARAMS.still_excess_m), Excess(PARAMS.dead_excess_m)

    def measure(
        self,
        moved: Moved,
        measured: float,
        other: float,
        told: Sequence[float],
        other_told: Sequence[float],
        tick: float,
    ) -> list[Excess]:
        """Return what says that it does not turn.

        Args:
            moved: the interval.
            measured: how fast it was.
            other: how fast the other side was.
            told: how fast it was told to be of late, the newest first.
            other_told: the same of the other side.
            tick: what one tick of an encoder amounts to.
        """
        # What was told a moment ago, and still is: a robot follows late, and stops late.
        slowest = min(abs(told[0]), abs(told[-1]))
        # It may follow now whatever was told in between, and be told less than is thought.
        surely_told = min(
            abs(one) - WRONG_TRACK * abs(another)
            for one, another in zip(told, other_told, strict=True)
        )
        surely_turned = max(0.0, abs(measured) - WRONG_TRACK * abs(other))
        rates = (
            slowest - PARAMS.still_slack - abs(measured) / PARAMS.still_share,
            surely_told - PARAMS.still_slack - surely_turned / PARAMS.dead_share,
        )
        return [
            excess
            for excess, rate in zip(self.excesses, rates, strict=True)
            if excess.add(rate, moved, tick)
        ]


class _Part:
    """One part of a velocity, which may be too fast in both directions."""

    def __init__(self, braking: _Braking) -> None:
        self._braking = braking
        self._forward, self._backward = _Ceiling(braking), _Ceiling(braking)
        self._told = _InForce[float]()
        self._ways, self._means = Recent(), Recent()
        self._excused_ns: int | None = None

    @property
    def may_be(self) -> float:
        """How fast it may be, in one direction or the other."""
        return max(self._forward.may_be, self._backward.may_be)

    @property
    def excesses(self) -> tuple[Excess, ...]:
        """How far it went beyond."""
        return self._forward.excess, self._backward.excess

    def command(self, now_ns: int, told: float) -> None:
        """Take what is commanded from now on."""
        self._told.tell(now_ns, told)

    def excuse(self, now_ns: int) -> None:
        """Start over: however fast it is, it may brake from that."""
        self._excused_ns = now_ns
        for excess in self.excesses:
            excess.clear()

    def measure(
        self, moved: Moved, measured: float, tick: float, from_other: float = 0.0
    ) -> list[Excess]:
        """Return what has been too fast for too long.

        Args:
            moved: the interval.
            measured: how fast it was.
            tick: what one tick of an encoder amounts to.
            from_other: what another part makes of this one, braking unevenly.
        """
        now_ns, delay_ns = moved.stamp_ns, self._braking.delay_ns
        means = self._mean_lately(moved, measured)
        told = self._told.between(now_ns - delay_ns, now_ns)
        excused = self._excused_ns is not None and now_ns - self._excused_ns <= delay_ns
        ways = (
            (self._forward, measured, max(means), max(told, default=0.0)),
            (self._backward, -measured, -min(means), -min(told, default=0.0)),
        )
        beyond: list[Excess] = []
        for ceiling, speed, peak, highest in ways:
            may_be = ceiling.update(moved.seconds, peak, max(0.0, highest), excused=excused)
            most = may_be + from_other + self._braking.standing
            if ceiling.excess.add(speed - most, moved, tick):
                beyond.append(ceiling.excess)
        return beyond

    def _mean_lately(self, moved: Moved, measured: float) -> deque[float]:
        """Return how fast it was of late, each time the mean over a while."""
        now_ns = moved.stamp_ns
        self._ways.add(now_ns, measured * moved.seconds, now_ns - PARAMS.smooth_ns + 1)
        mean = math.fsum(self._ways.values) / moved.lately_s
        self._means.add(now_ns, mean, now_ns - self._braking.delay_ns)
        return self._means.values


class MotionBounds:
    """The bounds of speed and turn rate, and of each side.

    Args:
        limits: of the motion.
        half_track_m: half of the distance between left and right wheels, roughly [m].
        delay_ns: time until a command shows in the odometry [ns].
    """

    def __init__(self, limits: MotionLimits, half_track_m: float, delay_ns: int) -> None:
        ahead = _Braking(
            delay_ns,
            PARAMS.braking_share * limits.deceleration,
            PARAMS.standing_speed,
            PARAMS.fast_slack,
            PARAMS.braking_excess_m,
        )
        turn = _Braking(
            delay_ns,
            PARAMS.turn_braking_share * limits.angular_acceleration,
            PARAMS.standing_wz,
            PARAMS.fast_slack / half_track_m,
            PARAMS.braking_excess_rad,
        )
        side = _Braking(
            delay_ns + PARAMS.following_ns,
            min(ahead.rate, half_track_m * turn.rate),
            PARAMS.standing_speed,
            PARAMS.fast_slack,
            PARAMS.fast_excess_m,
        )
        self._half_track_m = half_track_m
        self._following_ns = side.delay_ns
        self._told_sides = _InForce[tuple[float, float]]()
        self._ahead, self._sideways, self._turn = _Part(ahead), _Part(ahead), _Part(turn)
        self._sides = _Part(side), _Part(side)
        most = PARAMS.slow_excess_m
        self._floors = tuple((_Floor(Excess(most)), _Floor(Excess(most))) for _ in self._sides)
        self._stands = tuple(_Standing() for _ in self._sides)
        self._tick_m = 0.0
        self.still: tuple[bool, ...] = ()
        """Of left and right: whether it does not turn as far as it was told."""

    def command(self, now_ns: int, twist: Twist2D) -> None:
        """Take what is commanded from now on [m/s, rad/s]."""
        self._ahead.command(now_ns, twist.vx)
        self._sideways.command(now_ns, twist.vy)
        self._turn.command(now_ns, twist.wz)
        sides = sides_of(twist, self._half_track_m)
        self._told_sides.tell(now_ns, sides)
        for side, told in zip(self._sides, sides, strict=True):
            side.command(now_ns, told)

    def measure(self, moved: Moved, oldest: Twist2D) -> tuple[list[Excess], list[Excess]]:
        """Return what does not become slower as told, and the sides that do not do as told.

        Args:
            moved: the interval.
            oldest: the oldest command that is kept.
        """
        self._learn_tick(abs(moved.twist.vx) * moved.seconds)
        return self._too_fast(moved), self._otherwise(moved, oldest)

    def excuse(self, now_ns: int) -> None:
        """Start over: however fast it is, it may brake from that."""
        for part in self._parts:
            part.excuse(now_ns)

    def clear(self) -> None:
        """Forget how far anything went beyond its bounds."""
        parts = [excess for part in self._parts for excess in part.excesses]
        floors = [floor.excess for floors in self._floors for floor in floors]
        stands = [excess for one in self._stands for excess in one.excesses]
        for excess in (*parts, *stands, *floors):
            excess.clear()

    @property
    def _parts(self) -> tuple[_Part, ...]:
        return (self._ahead, self._sideways, self._turn, *self._sides)

    def _learn_tick(self, way_m: float) -> None:
        """One tick of one encoder moves the middle of the robot by half of it."""
        if way_m > PARAMS.least_tick_m and (self._tick_m == 0.0 or 2.0 * way_m < self._tick_m):
            self._tick_m = 2.0 * way_m

    def _too_fast(self, moved: Moved) -> list[Excess]:
        """Return what does not become slower as told."""
        twist, tick = moved.twist, self._tick_m
        by_turn = PARAMS.uneven * self._half_track_m * self._turn.may_be
        by_speed = PARAMS.uneven * self._ahead.may_be / self._half_track_m
        return [
            *self._ahead.measure(moved, twist.vx, tick, by_turn),
            *self._sideways.measure(moved, twist.vy, tick, by_turn),
            *self._turn.measure(moved, twist.wz, tick / self._half_track_m, by_speed),
        ]

    def _otherwise(self, moved: Moved, oldest: Twist2D) -> list[Excess]:
        """Return the sides that go much faster, slower or the other way than told."""
        now_ns, tick = moved.stamp_ns, self._tick_m
        told = self._told_sides.between(now_ns - self._following_ns - 1, now_ns)
        told = told or [sides_of(oldest, self._half_track_m)]
        of_sides = tuple(zip(*told, strict=True))
        speeds = sides_of(moved.twist, self._half_track_m)
        beyond: list[Excess] = []
        for index, speed in enumerate(speeds):
            beyond += self._sides[index].measure(moved, speed, tick)
            forward, backward = self._floors[index]
            if forward.measure(moved, speed, min(of_sides[index]), tick):
                beyond.append(forward.excess)
            if backward.measure(moved, -speed, -max(of_sides[index]), tick):
                beyond.append(backward.excess)
        stands = [
            standing.measure(
                moved,
                speeds[side],
                speeds[1 - side],
                of_sides[side],
                of_sides[1 - side],
                tick,
            )
            for side, standing in enumerate(self._stands)
        ]
        self.still = tuple(bool(found) for found in stands)
        return [*beyond, *(excess for found in stands for excess in found)]
