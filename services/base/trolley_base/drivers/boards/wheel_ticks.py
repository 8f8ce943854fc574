"""Two wheels with encoders: from counts of ticks to motion, and from velocity to target ticks.

With dl and dr [m] of the left and right wheel, a robot of track b has driven (dl + dr) / 2 along an
arc and turned by (dr - dl) / b.

Source:
    Siegwart, Nourbakhsh, Introduction to Autonomous Mobile Robots (2004), section 3.2.3.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

from trolley.config.hardware import WheelsConfig
from trolley.geometry import Twist2D, exp_twist
from trolley_base.drivers.boards.arrival_clock import ArrivalClock
from trolley_base.drivers.interface import MotionSample

MOST_SPEED = 3.0
"""No wheel turns faster than this; a count that says so was misread [m/s]."""
NEAR_START_M = 0.1
"""A board whose counts lie within this of zero may just have started [m]: its robot rolls on."""
SHORTEST_RESTART_S = 0.15
"""A board is back after a restart no sooner than this [s]: at a brown-out the boot loader of an
Arduino does not wait and its sketch runs after 65 ms, but what it was asked meanwhile is lost."""
LEEWAY_M = 0.005
"""Counts that differ by so little from where the wheels were heading went on from there [m]."""
FRAME_S = 0.033
"""One round of the board's speed control [s]: 1000 / 30 ms as whole numbers."""
MOST_TARGET = 32767
"""The largest int of the boards."""


class Counts(NamedTuple):
    """What both encoders read [ticks], at a robot time [ns]."""

    left: int
    right: int
    stamp_ns: int


class WheelOdometry:
    """Makes motions of encoder counts, which wrap around at 32 bits.

    Attributes:
        has_restarted: the counts added last started over: the board has rebooted.
        has_jumped: the counts added last were farther from those before than wheels turn.

    Args:
        wheels: what a tick stands for.
        count: adds to a counter: `encoder_jumps`, counts farther from those before than wheels
            turn.
    """

    def __init__(self, wheels: WheelsConfig, count: Callable[[str, int], None]) -> None:
        self._wheels = wheels
        self._count = count
        self._ticks_per_m = ticks_per_m(wheels)
        self.has_restarted = self.has_jumped = False
        self._last: Counts | None = None
        self._before: Counts | None = None
        self._jumped: Counts | None = None

    def reset(self) -> None:
        """Start over: the next counts are where the motion begins."""
        self._last = self._before = self._jumped = None

    def continues(self, new: Counts) -> bool:
        """Whether these counts are about where the last motion leads, so nothing started over."""
        last, before = self._last, self._before
        if last is None or before is None:
            return False
        share = (new.stamp_ns - last.stamp_ns) / (last.stamp_ns - before.stamp_ns)
        leads = [share * wrapped(last[i] - before[i]) for i in (0, 1)]
        leeway = LEEWAY_M * self._ticks_per_m
        return all(
            abs(wrapped(new[i] - last[i]) - leads[i]) <= 0.5 * abs(leads[i]) + leeway
            for i in (0, 1)
        )

    def add(self, new: Counts) -> MotionSample | None:
        """Return the motion since the last counts; None if these are the first or are refused."""
        last = self._last
        self.has_jumped = False
        self.has_restarted = last is not None and self._is_restart(last, new)
        if last is None or self.has_restarted:
            self._last, self._before, self._jumped = new, None, None
            return None
        if new.stamp_ns <= last.stamp_ns:
            return None
        if self._is_possible(last, new):
            self._last, self._before, self._jumped = new, last, None
            return self._motion(last, new)
        self._count("encoder_jumps", 1)
        self.has_jumped = True
        # One that does not fit was misread; two that fit each other were counted from a new zero.
        self.has_restarted = self._jumped is not None and self._is_possible(self._jumped, new)
        if self.has_restarted:
            self._last, self._before, self._jumped = new, None, None
        else:
            self._jumped = new
        return None

    def _motion(self, last: Counts, new: Counts) -> MotionSample:
        left, right = wrapped(new.left - last.left), wrapped(new.right - last.right)
        left_m = (-left if self._wheels.reverse_left else left) / self._ticks_per_m
        right_m = (-right if self._wheels.reverse_right else right) / self._ticks_per_m
        turn = (right_m - left_m) / self._wheels.track_m
        way = Twist2D(0.5 * (left_m + right_m), 0.0, turn)
        seconds = (new.stamp_ns - last.stamp_ns) * 1e-9
        return MotionSample(new.stamp_ns, exp_twist(way), way.scaled(1.0 / seconds))

    def _is_possible(self, last: Counts, new: Counts) -> bool:
        seconds = (new.stamp_ns - last.stamp_ns) * 1e-9
        # Stamps that lie close together are inexact.
        most = MOST_SPEED * self._ticks_per_m * max(seconds, 0.05) + 1.0
        return all(abs(wrapped(new[i] - last[i])) <= most for i in (0, 1))

    def _is_restart(self, last: Counts, new: Counts) -> bool:
        if new.stamp_ns - last.stamp_ns < SHORTEST_RESTART_S * 1e9:
            return False
        if not self._is_near_start(new) or self._is_near_start(last):
            return False
        return not self.continues(new)

    def _is_near_start(self, counts: Counts) -> bool:
        return max(abs(counts.left), abs(counts.right)) <= NEAR_START_M * self._ticks_per_m


class StreamedOdometry:
    """Makes motions of counts that a board sends by itself at an even pace, without stamps.

    Attributes:
        wheels: what makes motions of counts and times.

    Args:
        wheels: what a tick stands for.
        period_ns: how far apart the counts are, nominally.
        count: as in `WheelOdometry`.
    """

    def __init__(
        self, wheels: WheelsConfig, period_ns: int, count: Callable[[str, int], None]
    ) -> None:
        self.wheels = WheelOdometry(wheels, count)
        self._clock = ArrivalClock(period_ns)
        self._left_ns = 0

    def reset(self) -> None:
        """Start over: the next counts are where the motion begins."""
        self.wheels.reset()
        self.miss()

    def miss(self) -> None:
        """Something that was sent has not arrived whole, so the pace begins anew."""
        self._clock.reset()

    def add(self, left: int, right: int, left_ns: int) -> MotionSample | None:
        """Return the motion since the last counts; None if these are the first or are refused.

        Args:
            left: counts of the left wheel.
            right: of the right one.
            left_ns: robot time at which they seem to have left the board.
        """
        # Over USB bytes come faster than the baud rate, by which their times are calculated.
        self._left_ns = max(left_ns, self._left_ns)
        return self.wheels.add(Counts(left, right, self._clock.stamp(self._left_ns)))


class TickTargets:
    """Turns velocities into target ticks per frame, whole numbers, without losing the rest.

    What rounding leaves over is added to the next target, so that a slow wheel turns at the right
    speed on average.
    """

    def __init__(self, wheels: WheelsConfig) -> None:
        self._wheels = wheels
        self._ticks_per_m = ticks_per_m(wheels)
        self._rest = (0.0, 0.0)

    def of(self, twist: Twist2D) -> tuple[int, int]:
        """Return the targets of the left and the right wheel [ticks per frame]."""
        if twist.is_zero:
            self._rest = (0.0, 0.0)
            return 0, 0
        outward = 0.5 * self._wheels.track_m * twist.wz
        left = (twist.vx - outward) * self._ticks_per_m * FRAME_S
        right = (twist.vx + outward) * self._ticks_per_m * FRAME_S
        # Beyond what the board can take: slower on the same arc.
        scale = min(1.0, (MOST_TARGET - 1) / max(abs(left), abs(right), 1.0))
        exact = scale * left + self._rest[0], scale * right + self._rest[1]
        whole = round(exact[0]), round(exact[1])
        self._rest = exact[0] - whole[0], exact[1] - whole[1]
        return (
            -whole[0] if self._wheels.reverse_left else whole[0],
            -whole[1] if self._wheels.reverse_right else whole[1],
        )


def ticks_per_m(wheels: WheelsConfig) -> float:
    """Return how many ticks a metre has."""
    return wheels.ticks_per_revolution / (math.pi * wheels.diameter_m)


def wrapped(ticks: int) -> int:
    """Return a difference of 32-bit counts as the shorter way round."""
    return (ticks + 2**31) % 2**32 - 2**31
