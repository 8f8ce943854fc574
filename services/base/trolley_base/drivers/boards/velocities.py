"""Motions from the velocities that a board reports, with or without stamps."""

from collections.abc import Callable

from trolley.geometry import Twist2D, exp_twist
from trolley_base.drivers.boards.arrival_clock import ArrivalClock
from trolley_base.drivers.interface import MotionSample

LONGEST_NS = 500_000_000
"""After a longer interval nobody knows what the wheels did."""
NO_SPEED = (
    "The motor board reports speeds that no robot can have; they are not used. Restart it, and "
    "look at its encoders' cables."
)


class VelocityIntegrator:
    """Makes motions of velocities, each of which holds since the one before.

    Args:
        period_ns: how far apart the board reports, nominally.
        count: adds to a counter: `gaps`, velocities without a usable interval before them.
    """

    def __init__(self, period_ns: int, count: Callable[[str, int], None]) -> None:
        self._clock = ArrivalClock(period_ns)
        self._count = count
        self._stamp_ns: int | None = None
        self._left_ns = 0

    def reset(self) -> None:
        """Forget the board: the next velocity only begins an interval."""
        self._clock.reset()
        self._stamp_ns = None

    def add(self, twist: Twist2D, left_ns: int) -> MotionSample | None:
        """Return the motion along an arc since the velocity before, None if there is none.

        Args:
            twist: mean velocity since the report before.
            left_ns: robot time at which the report seems to have left the board.
        """
        if self._stamp_ns is not None and left_ns - self._left_ns > LONGEST_NS:
            self._count("gaps", 1)
            self.reset()
        before_ns = self._stamp_ns
        # Over USB bytes come faster than the baud rate, by which their times are calculated.
        self._left_ns = left_ns if before_ns is None else max(left_ns, self._left_ns)
        self._stamp_ns = self._clock.stamp(self._left_ns)
        if before_ns is None:
            return None
        if self._stamp_ns <= before_ns:
            self._count("gaps", 1)
            return None
        motion = exp_twist(twist, (self._stamp_ns - before_ns) * 1e-9)
        return MotionSample(self._stamp_ns, motion, twist)


class StampedVelocities:
    """Makes motions of velocities with stamps, each of which holds since the one before.

    Args:
        longest_ns: for how long a board knows what its wheels did.
        count: adds to a counter: `gaps`, velocities without a usable interval before them.
    """

    def __init__(self, longest_ns: int, count: Callable[[str, int], None]) -> None:
        self._longest_ns = longest_ns
        self._count = count
        self._stamp_ns: int | None = None

    def reset(self) -> None:
        """Forget the board: the next velocity only begins an interval."""
        self._stamp_ns = None

    def add(self, twist: Twist2D, stamp_ns: int) -> MotionSample | None:
        """Return the motion along an arc since the velocity before, None if there is none.

        Args:
            twist: mean velocity since the report before.
            stamp_ns: robot time of the measurement.
        """
        before_ns = self._stamp_ns
        if before_ns is not None and not 0 < stamp_ns - before_ns <= self._longest_ns:
            self._count("gaps", 1)
            self._stamp_ns = stamp_ns if stamp_ns > before_ns else before_ns
            return None
        self._stamp_ns = stamp_ns
        if before_ns is None:
            return None
        motion = exp_twist(twist, (stamp_ns - before_ns) * 1e-9)
        return MotionSample(stamp_ns, motion, twist)
