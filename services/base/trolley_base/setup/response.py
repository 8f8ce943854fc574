"""How soon and how hard the motors follow: delay, acceleration, braking, stopping distance.

Everything is taken from what the wheels count after a step of the command. The speed between two
reports is that of the middle between them, so it does not matter how a board filters what it
calls its speed.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley_base.setup.geometry import Estimate
from trolley_base.setup.record import Record, SetupRefused, WheelMotions

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class ResponseParams:
    """How steps are read; set by hand."""

    low: float = 0.2
    """Share of the change from which on a ramp is fitted."""
    high: float = 0.8
    """Share of the change up to which it is fitted."""
    longest_s: float = 2.5
    """A step is over after this time [s]."""
    least_steps: int = 4
    """Number of steps without which nothing is said."""
    least_mps: float = 0.15
    """Steps to or from slower speeds are not read [m/s]."""
    outlier: float = 5.0
    """A step that differs by so many standard deviations from the others is left out."""
    uneven: float = 0.1
    """Share of a speed by which it may change in the moment before the robot is to stop: a stroke
    too short for its speed tells no delay."""
    still_mps: float = 0.005
    """A robot that is slower stands [m/s]."""
    same: float = 0.95
    """Stops from so large a share of the highest speed are taken to be from the same speed."""


PARAMS = ResponseParams()


@dataclass(frozen=True, slots=True)
class WheelWorth:
    """What the counts of the wheels are worth.

    Attributes:
        left, right: true metres per metre that the wheel counts.
        half_track_m: half of the track that the board calculates with [m].
        std: standard deviation of both, together.
        slip_m: standard deviation of how far the wheels slip in a metre, a random walk [m].
    """

    left: float
    right: float
    half_track_m: float
    std: float = 0.0
    slip_m: float = 0.0

    def metres(self, way: float, turn: float) -> float:
        """Return how far the robot went [m] by what its wheels count [m, rad].

        On an arc that depends on the side: with wheels of two sizes the outer one counts more.
        """
        outward = self.half_track_m * turn
        return 0.5 * (self.left * (way - outward) + self.right * (way + outward))

    def of(self, counted: Estimate) -> Estimate:
        """Return an estimate that was made with this scale, with the error of the scale in it."""
        return Estimate(counted.value, math.hypot(counted.std, self.std * counted.value))


@dataclass(frozen=True, slots=True)
class Step:
    """What one step of the command brought, in true metres.

    Attributes:
        delay_s: until the speed begins to change [s].
        rate: of its change after that [m/s^2].
        way_m: what was driven from the command until the robot stood [m]; 0 when it sets off.
        speed: that it went with, before it braked or after it set off [m/s].
    """

    delay_s: float
    rate: float
    way_m: float
    speed: float


@dataclass(frozen=True, slots=True)
class Response:
    """How the motors follow.

    Attributes:
        delay: usual time from a command until the wheels follow it [s].
        longest_delay_s: of all steps, with what may be beyond [s].
        acceleration, braking: of what the wheels count, in true metres [m/s^2].
        stopping: distance from the command to stop until the robot stands [m], at `speed`. Wheels
            do not count how far they slide, so its deviation has that in it.
        speed: at which the robot mostly drove when that was measured; other stops are converted
            [m/s].
    """

    delay: Estimate
    longest_delay_s: float
    acceleration: Estimate
    braking: Estimate
    stopping: Estimate
    speed: float

    def stopping_from(self, speed: float) -> float:
        """Return the distance from the command to stop until it stands [m], from a speed [m/s]."""
        return speed * self.delay.value + speed**2 / (2.0 * self.braking.value)


def measure(record: Record, worth: WheelWorth) -> Response:
    """Read the starts and stops of strokes and circles.

    Args:
        record: the drive.
        worth: what the wheels' counts are worth.

    Raises:
        SetupRefused: there are too few of them.
    """
    wheels = record.wheel_motions()
    starts: list[Step] = []
    stops: list[Step] = []
    changes = _changes(record)
    for index in range(1, len(changes)):
        (_, before), (at_ns, now) = changes[index - 1], changes[index]
        if (before == 0.0) is (now == 0.0) or abs(before - now) < PARAMS.least_mps:
            continue
        end_ns = changes[index + 1][0] if index + 1 < len(changes) else None
        step = _read(wheels, worth, (before, now), at_ns, end_ns)
        if step is not None:
            (stops if now == 0.0 else starts).append(step)
    if len(starts) < PARAMS.least_steps or len(stops) < PARAMS.least_steps:
        raise SetupRefused(
            "The wheels did not follow the commands evenly enough to say how soon they obey."
        )
    delays = [step.delay_s for step in (*starts, *stops)]
    delay = _mean(delays)
    usual = _usual(delays)
    spread = float(np.std(usual, ddof=1))
    braking = _mean([step.rate for step in stops])
    speeds = np.array([step.speed for step in stops])
    speed = float(np.mean(speeds[speeds > PARAMS.same * speeds.max()]))

    def from_speed(step: Step) -> float:
        """Return how far it would have been from the usual speed [m]."""
        before_s = delay.value + 0.5 * (speed + step.speed) / braking.value
        return step.way_m + (speed - step.speed) * before_s

    stopping = _mean([from_speed(step) for step in stops])
    slides_m = worth.slip_m * math.sqrt(max(0.0, stopping.value) / len(stops))
    stopping = Estimate(stopping.value, math.hypot(stopping.std, slides_m))
    return Response(
        delay=delay,
        longest_delay_s=max(float(usual.max()), delay.value + 2.0 * spread),
        acceleration=worth.of(_mean([step.rate for step in starts])),
        braking=worth.of(braking),
        stopping=worth.of(stopping),
        speed=speed,
    )


def _changes(record: Record) -> list[tuple[int, float]]:
    """Return when which speed ahead was commanded from [ns, m/s]; turns count as 0."""
    found = [(0, 0.0)]
    for command in record.commands:
        if command.twist.vx != found[-1][1]:
            found.append((command.stamp_ns, command.twist.vx))
    return found


def _read(
    wheels: WheelMotions,
    worth: WheelWorth,
    speeds_mps: tuple[float, float],
    at_ns: int,
    end_ns: int | None,
) -> Step | None:
    """Read one step of the command between two speeds [m/s], one of which is 0."""
    before, now = speeds_mps
    until_ns = at_ns + round(PARAMS.longest_s * 1e9)
    if end_ns is not None:
        until_ns = min(until_ns, end_ns)
    part = wheels.between(at_ns - 400_000_000, until_ns)
    if part.start < 1 or part.stop - part.start < 8:
        return None
    stamps = wheels.stamps_ns[part.start - 1 : part.stop]
    seconds = np.diff(stamps) * 1e-9
    times = (stamps[:-1] - at_ns) * 1e-9 + 0.5 * seconds
    full = abs(before - now)
    speeds = wheels.way[part] / seconds * math.copysign(1.0, before + now)
    is_settled = times < 0.0 if now == 0.0 else np.arange(len(times)) >= len(times) - 3
    settled = speeds[is_settled]
    if len(settled) < 3 or abs(float(np.mean(settled)) - full) > 0.25 * full:
        return None
    full = float(np.mean(settled))
    if now == 0.0 and float(np.ptp(settled)) > PARAMS.uneven * full:
        return None
    changed = (full - speeds if now == 0.0 else speeds) / full
    ramp = _ramp(times, changed)
    if ramp is None:
        return None
    delay, rate = ramp
    way_m = 0.0
    if now == 0.0:
        if abs(float(speeds[-1])) > PARAMS.still_mps:
            return None
        way_m = float(np.sum(np.where(times > 0.0, speeds * seconds, 0.0)))
        # The report in which the command fell counts in part.
        first = int(np.argmax(times > 0.0))
        over = times[first] - 0.5 * seconds[first]
        way_m += float(full * over) if over > 0.0 else float(over * speeds[first])
    way, turn = (
        float(wheels.way[part][is_settled].sum()),
        float(wheels.turn[part][is_settled].sum()),
    )
    scale = worth.metres(way, turn) / way
    return Step(delay, scale * rate * full, scale * way_m, scale * full)


def _ramp(times: Floats, changed: Floats) -> tuple[float, float] | None:
    """Return when a change begins [s] and how fast it is [1/s], by a line through its middle."""
    late = np.flatnonzero((times > 0.0) & (changed > PARAMS.high))
    if len(late) == 0:
        return None
    early = np.flatnonzero(changed[: late[0]] < PARAMS.low)
    if len(early) == 0:
        return None
    first, last = int(early[-1]), int(late[0])
    inside = slice(first, last + 1)
    if last - first < 3:
        # Steeper than the reports come: the change lies between two of them.
        slope = (changed[last] - changed[first]) / (times[last] - times[first])
        return float(times[first] - changed[first] / slope), float(slope)
    inside = slice(first + 1, last)
    if last - first - 1 < 2:
        inside = slice(first, last + 1)
    slope, offset = np.polyfit(times[inside], changed[inside], 1)
    if slope <= 0.0:
        return None
    return float(-offset / slope), float(slope)


def _mean(values: Sequence[float]) -> Estimate:
    kept = _usual(values)
    spread = float(np.std(kept, ddof=1))
    return Estimate(float(np.mean(kept)), spread / math.sqrt(len(kept)))


def _usual(values: Sequence[float]) -> Floats:
    """Return the values without those far off the others: a link that has stumbled."""
    array = np.array(values)
    off = np.abs(array - np.median(array))
    kept = array[off <= PARAMS.outlier * 1.48 * np.median(off) + 1e-9]
    return kept if len(kept) >= 2 else array
