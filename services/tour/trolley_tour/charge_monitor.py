"""How low the battery is, and when a robot that drives is to go home because of it."""

import dataclasses
from typing import Literal

from trolley.messages import BaseState

Activity = Literal["driving", "between_goals", "arrived", "held"]
"""What the robot is doing, as far as its way home is concerned.

On its way or staying at a stop; between two goals of a trip; where it was sent; or held: stopped,
driven by a person, idle or going home already.
"""


@dataclasses.dataclass(frozen=True, slots=True)
class BatteryParams:
    """When a battery is low. All by hand; the first can be configured."""

    low: float
    """Share of the charge below which it is low, 0 never."""
    low_for_s: float = 10.0
    """A motor that starts pulls the voltage down for a moment; that is not an empty battery."""
    recovered_above: float = 0.1
    """It is no longer low once the charge is this much above the limit."""
    urgent_part: float = 0.5
    """Below this part of the limit the present drive is not finished."""
    stay_s: float = 30.0
    """How long a robot that was sent somewhere stays there before it goes home."""


class ChargeThreshold:
    """Whether the charge is below a limit, for long enough to be believed."""

    def __init__(self, limit: float, params: BatteryParams) -> None:
        self.is_passed = False
        self._limit = limit
        self._params = params
        self._since_ns: int | None = None

    def set_limit(self, limit: float) -> None:
        """Judge anew by another limit."""
        if limit != self._limit:
            self._limit, self.is_passed, self._since_ns = limit, False, None

    def update(self, fraction: float, stamp_ns: int) -> None:
        """Take a measurement of the charge."""
        if fraction >= self._limit:
            self._since_ns = None
            self.is_passed &= fraction < min(1.0, self._limit + self._params.recovered_above)
        else:
            self._since_ns = stamp_ns if self._since_ns is None else self._since_ns
            self.is_passed |= stamp_ns - self._since_ns >= int(self._params.low_for_s * 1e9)


class ChargeMonitor:
    """Decides from the battery's readings whether it is low or charging."""

    def __init__(self, params: BatteryParams) -> None:
        self._params = params
        self.fraction = 0.0
        """The newest charge as a share; 0 while unknown."""
        self._low = ChargeThreshold(params.low, params)
        self._urgent = ChargeThreshold(params.low * params.urgent_part, params)

    def set_low(self, low: float) -> None:
        """Let another charge count as low, and the same part of it as before as urgent."""
        self._low.set_limit(low)
        self._urgent.set_limit(low * self._params.urgent_part)

    def update(self, state: BaseState) -> None:
        """Take the state of the base; one that says nothing of the charge changes nothing."""
        battery = state.battery
        if battery is None or battery.fraction is None:
            return
        self.fraction = battery.fraction
        # One that is being charged counts as full: the robot is where it should be.
        counted = 1.0 if battery.charging else battery.fraction
        for threshold in (self._low, self._urgent):
            threshold.update(counted, state.stamp_ns)

    @property
    def is_low(self) -> bool:
        """Whether it is to be charged soon."""
        return self._low.is_passed

    @property
    def is_urgent(self) -> bool:
        """Whether it is to be charged now."""
        return self._urgent.is_passed


class ReturnDecision:
    """When to set off home: only ever at the end of a drive that a person wanted."""

    def __init__(self, params: BatteryParams) -> None:
        self._stay_ns = int(params.stay_s * 1e9)
        self._is_due = False
        self._arrived_ns: int | None = None

    def is_time(self, charge: ChargeMonitor, activity: Activity, now_ns: int) -> bool:
        """Whether to set off now (asked a few times a second)."""
        arrived_ns, self._arrived_ns = self._arrived_ns, None
        if not charge.is_low or activity == "held":
            self._is_due = False
        elif activity == "driving":
            self._is_due = True
            return charge.is_urgent
        elif self._is_due and activity == "arrived":
            self._arrived_ns = now_ns if arrived_ns is None else arrived_ns
            return now_ns - self._arrived_ns >= self._stay_ns
        return self._is_due

    def set_off(self) -> None:
        """Start over once the robot was sent home."""
        self._is_due, self._arrived_ns = False, None
