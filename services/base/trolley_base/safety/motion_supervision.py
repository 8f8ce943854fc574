"""Whether the robot does as it is told: commands compared with what wheels and gyro report.

What a sound robot does by its latest commands lies within bounds (`motion_bounds`). What exceeds
them adds up, so a single wrong reading, a coarse encoder or noise raises no alarm, and a robot that
drives on after a zero is detected within half a second.

If it is told to stand, speed and turn rate must fall. If it is told to move, each side of the robot
must move roughly as fast as told: the two sides are judged, not speed and turn rate, since what
breaks is one motor or one encoder.
"""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

from trolley.geometry import Twist2D, log_pose
from trolley_base.differential import sides_of
from trolley_base.drivers import MotionSample
from trolley_base.safety.held_up import HeldUp
from trolley_base.safety.motion_bounds import PARAMS, MotionBounds, Moved, Recent
from trolley_base.safety.motion_diagnosis import (
    MOVES_UNTOLD,
    Fault,
    Finding,
    drives_otherwise,
    is_standing,
)
from trolley_base.safety.motion_limits import MotionLimits

Measurement = tuple[MotionSample, float | None]
"""What the wheels measured, and the mean turn rate by the gyro [rad/s]."""


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
        delay_s: longest time from a command until odometry shows that the wheels follow it.
        blur_s: longest time over which one motion is the mean [s]; wheels report so often that it
            does not matter.
    """

    def __init__(
        self,
        limits: MotionLimits,
        half_track_m: float,
        delay_s: float = math.inf,
        blur_s: float = 0.0,
    ) -> None:
        self._limits = limits
        self._half_track_m = half_track_m
        measured_ns = round(min(delay_s * 1e9, PARAMS.delay_ns))
        self._delay_ns = max(measured_ns, PARAMS.least_delay_ns) + round(blur_s * 1e9)
        self._held_up = HeldUp()
        self.forget()

    def forget(self) -> None:
        """Start over: what the robot does now is taken for what it did before."""
        self._commands: deque[tuple[int, Twist2D]] = deque()
        self._moved: deque[Moved] = deque()
        self._seconds = Recent()
        self._last_ns: int | None = None
        self._zero_ns: int | None = None
        self._rest_ns: int | None = None
        self._untold: _Untold | None = None
        self._has_rested = False
        self._bounds = MotionBounds(self._limits, self._half_track_m, self._delay_ns)
        self._found: Finding | None = None

    def command(self, now_ns: int, twist: Twist2D) -> None:
        """Take what is commanded from now on [m/s, rad/s]."""
        if self._commands and now_ns - self._commands[-1][0] > PARAMS.longest_gap_ns:
            self.forget()
        if not twist.is_zero:
            self._zero_ns = None
        elif self._zero_ns is None:
            self._zero_ns, self._has_rested = now_ns, False
        self._bounds.command(now_ns, twist)
        self._commands.append((now_ns, twist))
        while now_ns - self._commands[0][0] > PARAMS.kept_ns:
            self._commands.popleft()

    def take(self, now_ns: int, motions: Sequence[Measurement], *, judges: bool = True) -> None:
        """Take all that was measured since the call before.

        Args:
            now_ns: robot time of base's period [ns].
            motions: with the mean turn rate by the gyro over each.
            judges: what comes late proves nothing and is left out; False: nothing is.
        """
        if self._held_up.update(now_ns, len(motions)) and judges:
            at_rest = self._zero_ns, self._has_rested
            self.forget()
            self._zero_ns, self._has_rested = at_rest  # it came to rest before, and is told to rest
            return
        for motion, gyro in motions:
            self.measure(motion, gyro)
        found = self._found
        if found and found.fault is Fault.OTHERWISE and self._held_up.proves_little(now_ns):
            self._found = None

    def measure(self, motion: MotionSample, gyro: float | None = None) -> None:
        """Take what the wheels measured, and the mean turn rate by the gyro if it has one.

        Args:
            motion: in the units of the commands; the next after the one before.
            gyro: over the same interval, without bias [rad/s].
        """
        last_ns, self._last_ns = self._last_ns, motion.stamp_ns
        if last_ns is None or not self._commands:
            self._bounds.excuse(motion.stamp_ns)
            return
        if motion.stamp_ns - last_ns > PARAMS.longest_gap_ns:
            self.forget()
            return
        if motion.stamp_ns <= last_ns:
            self._last_ns = last_ns
            return
        seconds = (motion.stamp_ns - last_ns) * 1e-9
        twist = log_pose(motion.previous_T_base).scaled(1.0 / seconds)
        began_ns = motion.stamp_ns - round(seconds * 1e9)
        self._seconds.add(motion.stamp_ns, seconds, motion.stamp_ns - PARAMS.smooth_ns + 1)
        lately_s = math.fsum(self._seconds.values)
        moved = Moved(motion.stamp_ns, began_ns, seconds, lately_s, twist, gyro)
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
            self._bounds.clear()
            self._bounds.excuse(moved.stamp_ns)

    def take_finding(self) -> Finding | None:
        """Return what was detected since the last call, None while the robot does as it is told."""
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

    def _began_ns(self, moved: Moved) -> int | None:
        """Return since when it has not done as it was told, None if it does."""
        braking, following = self._bounds.measure(moved, self._commands[0][1])
        # A robot that is told to stand has only to brake.
        beyond = braking if self._zero_ns is not None else [*braking, *following]
        return min((excess.since_ns for excess in beyond), default=None)

    def _note_rest(self, moved: Moved) -> None:
        twist = moved.twist
        if twist.speed > PARAMS.standing_speed or abs(twist.wz) > PARAMS.standing_wz:
            self._rest_ns = None
            return
        if self._rest_ns is None:
            self._rest_ns = moved.stamp_ns
        if self._zero_ns is not None and self.rest_ns >= PARAMS.rested_ns:
            self._has_rested = True
            self._untold = None
            self._bounds.clear()

    def _find_untold(self, moved: Moved) -> Finding:
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
            return Finding(Fault.DRIVES, f"it keeps driving by itself, now at {speed}")
        return MOVES_UNTOLD

    def _is_steady(self, untold: _Untold, now_ns: int) -> bool:
        if now_ns - untold.since_ns < PARAMS.steady_ns:
            return False
        speeds = [speed for _, speed in untold.speeds]
        mean = math.fsum(speeds) / len(speeds)
        spread = max(speeds) - min(speeds)
        return mean >= PARAMS.steady_speed and spread <= PARAMS.steady_share * mean

    def _diagnose(self, since_ns: int, now_ns: int) -> Finding:
        """Say what is wrong with a robot that drives otherwise than told."""
        # The second half: what comes to light is no longer what was before.
        since_ns = (since_ns + now_ns) // 2
        recent = self._since(since_ns)
        told = [twist for at_ns, twist in self._commands if since_ns <= at_ns <= now_ns]
        told = told or [self._commands[-1][1]]
        return drives_otherwise(
            _mean_command(told),
            _mean(recent),
            _mean_gyro(recent),
            self._half_track_m,
            still=self._which_stand(told, [moved.twist for moved in recent]),
        )

    def _which_stand(self, told: list[Twist2D], moved: list[Twist2D]) -> tuple[bool, ...]:
        """Say of left and right whether they stand, who are known not to turn as far as told.

        To and fro, since what is told that way is nothing in the mean; at half the speed a side
        does not stand.
        """
        turned, wanted = self._paces(moved), self._paces(told)
        return tuple(
            is_still and is_standing(turned[side], wanted[side])
            for side, is_still in enumerate(self._bounds.still)
        )

    def _paces(self, twists: list[Twist2D]) -> list[float]:
        """Return how fast left and right go in the mean, to or fro [m/s]."""
        sides = [sides_of(twist, self._half_track_m) for twist in twists]
        return [math.fsum(map(abs, speeds)) / len(sides) for speeds in zip(*sides, strict=True)]

    def _since(self, since_ns: int) -> list[Moved]:
        return [moved for moved in self._moved if moved.stamp_ns > since_ns]


def _mean(moved: list[Moved]) -> Twist2D:
    """Return the mean of at least one motion."""
    seconds = math.fsum(one.seconds for one in moved)
    return Twist2D(
        math.fsum(one.twist.vx * one.seconds for one in moved) / seconds,
        math.fsum(one.twist.vy * one.seconds for one in moved) / seconds,
        math.fsum(one.twist.wz * one.seconds for one in moved) / seconds,
    )


def _mean_gyro(moved: list[Moved]) -> float | None:
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
