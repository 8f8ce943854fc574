"""A low battery: how low it is, and when a robot that drives is to go home because of it."""

from typing import Literal

from trolley.messages import BaseState

LOW_FOR_NS = 10_000_000_000
"""A motor that starts pulls the voltage down for a moment; that is no empty battery."""
RECOVERED_SHARE = 0.1
"""This much above the limit it is no longer low."""
URGENT_PART = 0.5
"""Below this part of the limit the present drive is not finished."""
STAY_NS = 30_000_000_000
"""How long a robot that was sent somewhere stays there before it goes home."""

Doing = Literal["driving", "between", "arrived", "held"]
"""On its way or staying at a stop; between two stops; where it was sent to; held by a person."""


class Limit:
    """Whether the charge is below a limit, for long enough to be believed."""

    def __init__(self, share: float) -> None:
        self.is_passed = False
        self._share = share
        self._since_ns: int | None = None

    def hear(self, charge: float, stamp_ns: int) -> None:
        """Take a measurement."""
        if charge >= self._share:
            self._since_ns = None
            self.is_passed &= charge < min(1.0, self._share + RECOVERED_SHARE)
        else:
            self._since_ns = stamp_ns if self._since_ns is None else self._since_ns
            self.is_passed |= stamp_ns - self._since_ns >= LOW_FOR_NS


class Gauge:
    """What the battery says.

    Args:
        low: The share of the charge below which it is low, 0 never.
    """

    def __init__(self, low: float) -> None:
        self.charge: float | None = None
        """The newest; None while unknown."""
        self._low, self._urgent = Limit(low), Limit(low * URGENT_PART)

    def hear(self, state: BaseState) -> None:
        """Take the state of the base; one that says nothing of the charge changes nothing."""
        battery = state.battery
        if battery is None or battery.fraction is None:
            return
        self.charge = battery.fraction
        # One that is being charged counts as full: the robot is where it should be.
        counted = 1.0 if battery.charging else battery.fraction
        for limit in (self._low, self._urgent):
            limit.hear(counted, state.stamp_ns)

    @property
    def is_low(self) -> bool:
        """Whether it is to be charged soon."""
        return self._low.is_passed

    @property
    def is_urgent(self) -> bool:
        """Whether it is to be charged now."""
        return self._urgent.is_passed


class WayHome:
    """When to set off home: only ever at the end of a drive that a person wanted."""

    def __init__(self) -> None:
        self._is_due = False
        self._arrived_ns: int | None = None

    def is_time(self, gauge: Gauge, doing: Doing, now_ns: int) -> bool:
        """Whether to set off now (asked a few times a second)."""
        arrived_ns, self._arrived_ns = self._arrived_ns, None
        if not gauge.is_low or doing == "held":
            self._is_due = False
        elif doing == "driving":
            self._is_due = True
            return gauge.is_urgent
        elif self._is_due and doing == "arrived":
            self._arrived_ns = now_ns if arrived_ns is None else arrived_ns
            return now_ns - self._arrived_ns >= STAY_NS
        return self._is_due
