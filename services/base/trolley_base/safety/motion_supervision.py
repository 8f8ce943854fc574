"""Whether the robot does as it is told: what is commanded against what wheels and gyro report.

A lawful base does what it is told a moment later, not exactly, and brakes no slower than its
limits say. From the commands of the last moments this makes bounds within which it must move; what
it goes beyond them adds up, and what stays inside takes away again (a CUSUM test: Page, Continuous
Inspection Schemes, Biometrika 41, 1954). So a single wrong reading, a coarse encoder and noise
accuse nobody, and a robot that drives on after a zero is found out within half a second.

Told to stand, speed and turn rate must fall. Told to move, each side of the robot must go roughly
as fast as told: two sides in place of speed and turn rate, since what breaks is one motor or one
encoder.
"""

import math
from collections import deque
from dataclasses import dataclass, field
from typing import NamedTuple

from trolley.geometry import Twist2D, log_pose
from trolley_base.drivers import MotionSample
from trolley_base.safety.motion_diagnosis import (
    MOVES_UNTOLD,
    Fault,
    Finding,
    drives_otherwise,
    sides_of,
)
from trolley_base.safety.motion_limits import MotionLimits


@dataclass(frozen=True, slots=True)
class MotionSupervisionParams:
    """What a lawful base may do; set by hand, for hobby robots and their simulation."""

    delay_ns: int = 250_000_000
    """A zero acts on the motors and shows in the odometry after this long [ns]. The excess that is
    allowed makes up for 0.3 s."""
    braking_share: float = 0.6
    """It brakes with at least this share of the configured deceleration."""
    turn_braking_share: float = 0.5
    """The same for its turn rate, whose braking nobody measures."""
    standing_speed: float = 0.015
    """Slower than this is standing, with what encoders and backlash make of it [m/s]."""
    standing_wz: float = 0.05
    """The same for turning [rad/s]."""
    braking_excess_m: float = 0.01
    """So much farther than any lawful braking: it does not brake [m]."""
    braking_excess_rad: float = 0.04
    """The same for turning [rad]."""
    uneven: float = 0.3
    """One wheel may brake later than the other: this share of the speed shows as a turn, and of
    the turn as speed."""
    following_ns: int = 400_000_000
    """A command, or the end of one, shows in the odometry within this time [ns]."""
    fastest_share: float = 1.4
    """A side goes at most this many times as fast as told ..."""
    slowest_share: float = 0.5
    """... and at least this share of it ..."""
    fast_slack: float = 0.04
    """... with this on top, for a side that is the faster one [m/s] ..."""
    slow_slack: float = 0.025
    """... and this, which friction and a dead band eat, for one that is the slower one [m/s]."""
    following_excess_m: float = 0.04
    """So much farther, or less far, than a side may go: it drives otherwise than told [m]."""
    rested_ns: int = 500_000_000
    """It stood for this long: what moves it now is no braking any more [ns]."""
    steady_ns: int = 500_000_000
    """Motors hold a speed for this long, a hand does not ..."""
    steady_share: float = 0.15
    """... within this share of it."""
    steady_speed: float = 0.05
    """Slower than that nothing is judged to be steady [m/s]."""
    longest_push_ns: int = 3_000_000_000
    """A hand lets go sooner, or it is taken for a motor [ns]."""
    kept_ns: int = 1_000_000_000
    """Commands and motions are kept for this long [ns]."""
    longest_gap_ns: int = 500_000_000
    """After a longer time without commands or reports nothing is known of what was before [ns]."""
    gyro_wz: float = 0.1
    """A faster turn by the gyro is moving, whatever the wheels say [rad/s]."""
    shown_ns: int = 250_000_000
    """Whether it moves is judged by the mean over this time [ns]."""


PARAMS = MotionSupervisionParams()


class _Moved(NamedTuple):
    """What was measured of one interval."""

    stamp_ns: int
    seconds: float
    twist: Twist2D
    gyro: float | None


@dataclass(slots=True)
class _Excess:
    """How far something went beyond its bounds."""

    most: float
    since_ns: int = 0
    """When it began."""
    _value: float = 0.0

    def add(self, rate: float, moved: "_Moved") -> bool:
        """Add what goes beyond, or take away what stays inside; whether it has become too much."""
        if self._value == 0.0:
            self.since_ns = moved.stamp_ns - round(moved.seconds * 1e9)
        # One reading alone proves nothing.
        beyond = self._value + min(rate * moved.seconds, 0.5 * self.most)
        self._value = min(self.most, max(0.0, beyond))
        return self._value >= self.most

    def clear(self) -> None:
        """Begin anew."""
        self._value = 0.0


class _Braking:
    """How fast one part of a velocity may still be, told to become slower.

    Args:
        rate: it slows down at least so fast [per s].
        standing: what counts as nothing.
        slack: what it may be faster than a share of what it is told.
        most: so much beyond is too much.
    """

    def __init__(self, rate: float, standing: float, slack: float, most: float) -> None:
        self._rate = rate
        self._standing, self._slack = standing, slack
        self._told: deque[tuple[int, float]] = deque()
        self._falls_since_ns = 0
        self.may_be = 0.0
        # Both directions apart: coarse encoders waver to both sides, and that adds up to nothing.
        self.excesses = _Excess(most), _Excess(most)

    def command(self, now_ns: int, told: float) -> None:
        """Take what is commanded from now on."""
        if not self._told or abs(told) > self._told[-1][1]:
            self._falls_since_ns = now_ns
        self._told.append((now_ns, abs(told)))
        # One that is older holds until the next.
        while len(self._told) > 1 and now_ns - self._told[1][0] > PARAMS.kept_ns:
            self._told.popleft()

    def excuse(self, now_ns: int) -> None:
        """Begin anew: however fast it is, it may brake from that."""
        self._falls_since_ns = now_ns
        for excess in self.excesses:
            excess.clear()

    def measure(self, moved: "_Moved", measured: float, from_other: float) -> list[_Excess]:
        """Return what has been too fast for too long.

        Args:
            moved: the interval.
            measured: how fast it was.
            from_other: what another part makes of this one, braking unevenly.
        """
        told = self._highest_told(moved.stamp_ns)
        if moved.stamp_ns - self._falls_since_ns <= PARAMS.delay_ns:
            # It may still be getting faster.
            self.may_be = max(self.may_be, abs(measured), told)
        else:
            self.may_be = max(told, self.may_be - self._rate * moved.seconds)
        follows = 0.0 if told == 0.0 else PARAMS.fastest_share * told + self._slack
        most = max(self.may_be, follows) + from_other + self._standing
        return [
            excess
            for excess, speed in zip(self.excesses, (measured, -measured), strict=True)
            if excess.add(speed - most, moved)
        ]

    def _highest_told(self, stamp_ns: int) -> float:
        since_ns = stamp_ns - PARAMS.delay_ns
        highest = 0.0
        for at_ns, told in reversed(self._told):
            if at_ns <= stamp_ns:
                highest = max(highest, told)
            if at_ns <= since_ns:
                break
        return highest


@dataclass(slots=True)
class _Untold:
    """A motion that began from rest without a command."""

    since_ns: int
    speeds: deque[tuple[int, float]] = field(default_factory=deque[tuple[int, float]])


class MotionSupervision:
    """Compares commands with motions, in the order in which they come.

    Args:
        limits: of the motion.
        half_track_m: half of the distance between left and right wheels, roughly [m].
    """

    def __init__(self, limits: MotionLimits, half_track_m: float) -> None:
        self._limits = limits
        self._half_track_m = half_track_m
        self.forget()

    def forget(self) -> None:
        """Begin anew: what the robot does now is taken for what it did before."""
        self._commands: deque[tuple[int, Twist2D]] = deque()
        self._moved: deque[_Moved] = deque()
        self._last_ns: int | None = None
        self._zero_ns: int | None = None
        self._rest_ns: int | None = None
        self._untold: _Untold | None = None
        self._has_rested = False
        braking = PARAMS.braking_share * self._limits.deceleration
        turn_braking = PARAMS.turn_braking_share * self._limits.angular_acceleration
        ahead = braking, PARAMS.standing_speed, PARAMS.fast_slack, PARAMS.braking_excess_m
        self._ahead, self._sideways = _Braking(*ahead), _Braking(*ahead)
        self._turn = _Braking(
            turn_braking,
            PARAMS.standing_wz,
            PARAMS.fast_slack / self._half_track_m,
            PARAMS.braking_excess_rad,
        )
        most = PARAMS.following_excess_m
        # Of each side: too far ahead, too far behind.
        self._side_excess = tuple((_Excess(most), _Excess(most)) for _ in ("left", "right"))
        self._found: Finding | None = None

    def command(self, now_ns: int, twist: Twist2D) -> None:
        """Take what is commanded from now on [m/s, rad/s]."""
        if self._commands and now_ns - self._commands[-1][0] > PARAMS.longest_gap_ns:
            self.forget()
        if not twist.is_zero:
            self._zero_ns = None
        elif self._zero_ns is None:
            self._zero_ns, self._has_rested = now_ns, False
        self._ahead.command(now_ns, twist.vx)
        self._sideways.command(now_ns, twist.vy)
        self._turn.command(now_ns, twist.wz)
        self._commands.append((now_ns, twist))
        while now_ns - self._commands[0][0] > PARAMS.kept_ns:
            self._commands.popleft()

    def measure(self, motion: MotionSample, gyro: float | None = None) -> None:
        """Take what the wheels measured, and the mean turn rate by the gyro if it has one.

        Args:
            motion: in the units of the commands; the next after the one before.
            gyro: over the same interval, without bias [rad/s].
        """
        last_ns, self._last_ns = self._last_ns, motion.stamp_ns
        if last_ns is None or not self._commands:
            return
        if motion.stamp_ns - last_ns > PARAMS.longest_gap_ns:
            self.forget()
            return
        if motion.stamp_ns <= last_ns:
            self._last_ns = last_ns
            return
        seconds = (motion.stamp_ns - last_ns) * 1e-9
        twist = log_pose(motion.previous_T_base).scaled(1.0 / seconds)
        moved = _Moved(motion.stamp_ns, seconds, twist, gyro)
        self._moved.append(moved)
        while motion.stamp_ns - self._moved[0].stamp_ns > PARAMS.kept_ns:
            self._moved.popleft()
        self._note_rest(moved)
        since_ns = self._began_ns(moved)
        if since_ns is None:
            return
        if self._zero_ns is not None:
            self._found = self._find_untold(moved)
        else:
            self._found = self._diagnose(since_ns, moved.stamp_ns)
            for part in (self._ahead, self._sideways, self._turn):
                part.excuse(moved.stamp_ns)

    def take_finding(self) -> Finding | None:
        """Return what was found out since the last call, None while it does as it is told."""
        found, self._found = self._found, None
        return found

    @property
    def rest_ns(self) -> int:
        """For how long it has stood by now [ns]."""
        if self._rest_ns is None or self._last_ns is None:
            return 0
        return self._last_ns - self._rest_ns

    def is_moving(self, now_ns: int) -> bool | None:
        """Whether it moves, by wheels and gyro; None where nothing was reported lately."""
        if self._last_ns is None or now_ns - self._last_ns > PARAMS.longest_gap_ns:
            return None
        recent = self._since(self._last_ns - PARAMS.shown_ns)
        if not recent:
            return None
        twist, gyro = _mean(recent), _mean_gyro(recent)
        turns = abs(twist.wz) > PARAMS.standing_wz
        return twist.speed > PARAMS.standing_speed or turns or abs(gyro or 0.0) > PARAMS.gyro_wz

    def _began_ns(self, moved: _Moved) -> int | None:
        """Return since when it has not done as it was told, None if it does."""
        braking, sides = self._brakings_beyond(moved), self._sides_beyond(moved)
        # A robot that is told to stand has only to brake.
        beyond = braking if self._zero_ns is not None else [*braking, *sides]
        return min((excess.since_ns for excess in beyond), default=None)

    @property
    def _excesses(self) -> tuple[_Excess, ...]:
        parts = (self._ahead, self._sideways, self._turn)
        braking = [excess for part in parts for excess in part.excesses]
        return (*braking, *(excess for side in self._side_excess for excess in side))

    # Told to become slower, or to stand.
    def _brakings_beyond(self, moved: _Moved) -> list[_Excess]:
        """Return what is too fast."""
        by_turn = PARAMS.uneven * self._half_track_m * self._turn.may_be
        by_speed = PARAMS.uneven * self._ahead.may_be / self._half_track_m
        return [
            *self._ahead.measure(moved, moved.twist.vx, by_turn),
            *self._sideways.measure(moved, moved.twist.vy, by_turn),
            *self._turn.measure(moved, moved.twist.wz, by_speed),
        ]

    def _note_rest(self, moved: _Moved) -> None:
        twist = moved.twist
        if twist.speed > PARAMS.standing_speed or abs(twist.wz) > PARAMS.standing_wz:
            self._rest_ns = None
            return
        if self._rest_ns is None:
            self._rest_ns = moved.stamp_ns
        if self._zero_ns is not None and self.rest_ns >= PARAMS.rested_ns:
            self._has_rested = True
            self._untold = None
            for excess in self._excesses:
                excess.clear()

    def _find_untold(self, moved: _Moved) -> Finding:
        """Tell a board that goes on from one that sets off, and that from a hand."""
        speed = _in_words(moved.twist)
        if not self._has_rested:
            return Finding(Fault.GOES_ON, f"told to stand, it goes on at {speed}")
        if self._untold is None:
            self._untold = _Untold(moved.stamp_ns)
        untold, sides = self._untold, sides_of(moved.twist, self._half_track_m)
        untold.speeds.append((moved.stamp_ns, max(map(abs, sides))))
        while moved.stamp_ns - untold.speeds[0][0] > PARAMS.steady_ns:
            untold.speeds.popleft()
        if self._is_steady(untold, moved.stamp_ns):
            return Finding(Fault.DRIVES, f"it drives by itself at {speed}")
        if moved.stamp_ns - untold.since_ns > PARAMS.longest_push_ns:
            return Finding(Fault.DRIVES, f"it goes on and on untold, now at {speed}")
        return MOVES_UNTOLD

    def _is_steady(self, untold: _Untold, now_ns: int) -> bool:
        if now_ns - untold.since_ns < PARAMS.steady_ns:
            return False
        speeds = [speed for _, speed in untold.speeds]
        mean = math.fsum(speeds) / len(speeds)
        spread = max(speeds) - min(speeds)
        return mean >= PARAMS.steady_speed and spread <= PARAMS.steady_share * mean

    # Told to move.
    def _sides_beyond(self, moved: _Moved) -> list[_Excess]:
        """Return what goes much faster, slower or the other way than told."""
        told = [sides_of(twist, self._half_track_m) for twist in self._told(moved.stamp_ns)]
        beyond: list[_Excess] = []
        for side, speed in enumerate(sides_of(moved.twist, self._half_track_m)):
            low, high = min(one[side] for one in told), max(one[side] for one in told)
            fast, slow = self._side_excess[side]
            if fast.add(speed - _highest(high), moved):
                beyond.append(fast)
            if slow.add(-_highest(-low) - speed, moved):
                beyond.append(slow)
        return beyond

    def _told(self, stamp_ns: int) -> list[Twist2D]:
        """Return the commands that a motion up to `stamp_ns` may follow."""
        since_ns = stamp_ns - PARAMS.following_ns
        told = [twist for at_ns, twist in self._commands if since_ns <= at_ns <= stamp_ns]
        before = [twist for at_ns, twist in self._commands if at_ns < since_ns]
        return [*before[-1:], *told] or [self._commands[0][1]]

    def _diagnose(self, since_ns: int, now_ns: int) -> Finding:
        """Say what is wrong with a robot that drives otherwise than told."""
        # The second half: what comes to light is no longer what was before.
        since_ns = (since_ns + now_ns) // 2
        recent = self._since(since_ns)
        told = [twist for at_ns, twist in self._commands if since_ns <= at_ns <= now_ns]
        return drives_otherwise(
            _mean_command(told or [self._commands[-1][1]]),
            _mean(recent),
            _mean_gyro(recent),
            self._half_track_m,
        )

    def _since(self, since_ns: int) -> list[_Moved]:
        return [moved for moved in self._moved if moved.stamp_ns > since_ns]


def _highest(told: float) -> float:
    """Return how fast a side may go at most that is told to go at most at `told` [m/s]."""
    if told > 0.0:
        return PARAMS.fastest_share * told + PARAMS.fast_slack
    backward = PARAMS.slowest_share * told + PARAMS.slow_slack
    return backward if backward < 0.0 else PARAMS.fast_slack


def _mean(moved: list[_Moved]) -> Twist2D:
    """Return the mean of at least one motion."""
    seconds = math.fsum(one.seconds for one in moved)
    return Twist2D(
        math.fsum(one.twist.vx * one.seconds for one in moved) / seconds,
        math.fsum(one.twist.vy * one.seconds for one in moved) / seconds,
        math.fsum(one.twist.wz * one.seconds for one in moved) / seconds,
    )


def _mean_gyro(moved: list[_Moved]) -> float | None:
    """Return the gyro's mean turn rate, None where it was silent in between."""
    rates = [one.gyro for one in moved if one.gyro is not None]
    return math.fsum(rates) / len(rates) if rates and len(rates) == len(moved) else None


def _mean_command(twists: list[Twist2D]) -> Twist2D:
    count = len(twists)
    return Twist2D(
        math.fsum(twist.vx for twist in twists) / count,
        math.fsum(twist.vy for twist in twists) / count,
        math.fsum(twist.wz for twist in twists) / count,
    )


def _in_words(twist: Twist2D) -> str:
    """Say how fast something goes that does not stand."""
    if twist.speed > PARAMS.standing_speed:
        return f"{twist.speed:.2f} m/s"
    return f"{abs(twist.wz):.2f} rad/s"
