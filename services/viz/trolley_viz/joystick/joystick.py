"""Who holds the joystick, and what it wants: it drives only while a browser keeps saying so."""

from dataclasses import dataclass
from typing import Annotated

from msgspec import Meta, Struct

from trolley.geometry import Twist2D
from trolley.messages import Robot
from trolley.teleop import SPEED_MPS, TURN_RADPS

SILENCE_NS = 300_000_000
"""A browser that has not said that it holds for this long has let go."""
LATE_MS = 250.0
"""A message delayed by this much more than usual is out of date."""
DRIFT = 1e-3
"""The drift allowed between two computers' clocks."""
DEAD_ZONE = 0.12
"""Nearer to the middle the robot stands still: a thumb is never exactly centred."""

Deflection = Annotated[float, Meta(ge=-1.0, le=1.0)]


class Grip(Struct, frozen=True, kw_only=True):
    """What a browser sends ten times a second while the pad is held, and once when it is let go.

    `x` to the right and `y` up, as shares of the pad's radius; `speed` [m/s] at its rim; `sent_ms`
    by the browser's own clock.
    """

    x: Deflection
    y: Deflection
    held: bool
    speed: Annotated[float, Meta(ge=0.0, le=100.0)]
    sent_ms: Annotated[float, Meta(ge=0.0, le=1e15)]


@dataclass
class _Delay:
    """The shortest delay of a browser's messages, as the difference of two clocks."""

    offset_ms: float
    heard_ns: int


class Joystick:
    """The one joystick of a robot: whoever presses first holds it."""

    def __init__(self) -> None:
        self.holder: int | None = None
        """The browser that holds it."""
        self._grip: Grip | None = None
        self._heard_ns = 0
        self._delays: dict[int, _Delay] = {}
        self._barred: set[int] = set()
        """Browsers that must let go first: nobody gets hold of a robot without a new press."""

    def hear(self, who: int, grip: Grip, now_ns: int) -> None:
        """Handle a message of a browser at local monotonic `now_ns`."""
        is_late = self._is_late(who, grip, now_ns)
        if not grip.held:
            self._barred.discard(who)
            if self.holder == who:
                self.holder = None
        elif not is_late and who not in self._barred:
            self._let_go_of_silent(now_ns)
            if self.holder not in (None, who):
                self._barred.add(who)
                return
            self.holder, self._grip, self._heard_ns = who, grip, now_ns

    def leave(self, who: int) -> None:
        """Forget a browser that is gone."""
        if self.holder == who:
            self.holder = None
        self._barred.discard(who)
        self._delays.pop(who, None)

    def bar(self, who: int) -> None:
        """Make a browser let go and press again before it holds."""
        if self.holder == who:
            self.holder = None
        self._barred.add(who)

    def drop(self) -> None:
        """Make whoever holds it let go and press again."""
        if self.holder is not None:
            self.bar(self.holder)

    def wanted(self, robot: Robot, now_ns: int) -> Twist2D | None:
        """Return the velocity wanted of a robot, None where nobody holds the joystick."""
        self._let_go_of_silent(now_ns)
        if self.holder is None or self._grip is None:
            return None
        return twist_of(self._grip, robot)

    def _let_go_of_silent(self, now_ns: int) -> None:
        if now_ns - self._heard_ns > SILENCE_NS:
            self.holder = None

    def _is_late(self, who: int, grip: Grip, now_ns: int) -> bool:
        """Whether a message was delayed, as by a connection that hung for a while."""
        offset_ms = now_ns * 1e-6 - grip.sent_ms
        delay = self._delays.setdefault(who, _Delay(offset_ms, now_ns))
        shortest_ms = delay.offset_ms + DRIFT * (now_ns - delay.heard_ns) * 1e-6
        self._delays[who] = _Delay(min(shortest_ms, offset_ms), now_ns)
        return offset_ms - shortest_ms > LATE_MS


def twist_of(grip: Grip, robot: Robot) -> Twist2D:
    """Return the velocity that a grip wants, within the robot's limits.

    Up is forward, right is a turn to the right; slow driving turns slowly, too.
    """
    if grip.x**2 + grip.y**2 < DEAD_ZONE**2:
        return Twist2D.zero()
    speed = min(grip.speed, robot.max_speed)
    turn = min(TURN_RADPS * min(1.0, grip.speed / SPEED_MPS), robot.max_wz)
    return Twist2D(grip.y * speed, 0.0, -grip.x * turn)
