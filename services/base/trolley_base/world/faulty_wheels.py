"""Motors, wheels and encoders that may be broken, between a board and the world it drives in.

Nothing is wrong until a `Trouble` is set. The two sides of the robot have a motor and an encoder
each: what is told to the board becomes what the motors do, and what the wheels turn becomes what
the encoders count.
"""

import math
from dataclasses import dataclass

from trolley.geometry import Twist2D
from trolley_base.differential import sides_of, twist_of

Sides = frozenset[str]
LEFT, RIGHT = "left", "right"
NONE: Sides = frozenset()
BOTH: Sides = frozenset((LEFT, RIGHT))
SHOVE_S, PAUSE_S = 0.9, 0.5
"""A hand pushes for this long, then takes a new hold [s]."""


@dataclass(frozen=True, slots=True)
class Trouble:
    """What is wrong.

    Attributes:
        goes_on: no command is heeded any more: the wheels turn on as they did.
        drives: the wheels turn by themselves, both at this speed [m/s]; None: they do not.
        factor: the wheels turn this many times as fast as told.
        dead_motors: sides whose wheel stands whatever is told.
        stuck_encoders: sides whose encoder does not count.
        swapped_encoders: each side's encoder is counted for the other side.
        lifted: the wheels turn in the air.
        pushed: somebody pushes the robot to and fro, at most so fast [m/s]; None: nobody.
    """

    goes_on: bool = False
    drives: float | None = None
    factor: float = 1.0
    dead_motors: Sides = NONE
    stuck_encoders: Sides = NONE
    swapped_encoders: bool = False
    lifted: bool = False
    pushed: float | None = None


WELL = Trouble()


class FaultyWheels:
    """The wheels of a robot, with what is wrong with them.

    Args:
        half_track_m: half of the distance between left and right wheels [m].
    """

    def __init__(self, half_track_m: float) -> None:
        self._half_track_m = half_track_m
        self._trouble = WELL
        self._turned = Twist2D.zero()
        self._since_s = 0.0

    @property
    def trouble(self) -> Trouble:
        """What is wrong now."""
        return self._trouble

    @trouble.setter
    def trouble(self, trouble: Trouble) -> None:
        self._trouble, self._since_s = trouble, 0.0

    def stand(self) -> None:
        """Stop turning: the board has restarted."""
        self._turned = Twist2D.zero()

    def driven(self, told: Twist2D, dt: float) -> Twist2D:
        """Return what moves the robot in the next `dt` seconds [m/s, rad/s]."""
        trouble = self._trouble
        self._since_s += dt
        if trouble.pushed is not None:
            self._turned = Twist2D(self._push(trouble.pushed), 0.0, 0.0)
        elif trouble.drives is not None:
            self._turned = Twist2D(trouble.drives, 0.0, 0.0)
        elif not trouble.goes_on:
            left, right = sides_of(told.scaled(trouble.factor), self._half_track_m)
            dead = trouble.dead_motors
            self._turned = twist_of(
                0.0 if LEFT in dead else left, 0.0 if RIGHT in dead else right, self._half_track_m
            )
        return Twist2D.zero() if trouble.lifted else self._turned

    def counted(self, turned: Twist2D) -> Twist2D:
        """Return what the encoders make of how the wheels turn [m/s, rad/s]."""
        trouble = self._trouble
        if trouble is WELL:
            return turned
        left, right = sides_of(self._turned if trouble.lifted else turned, self._half_track_m)
        if trouble.swapped_encoders:
            left, right = right, left
        stuck = trouble.stuck_encoders
        return twist_of(
            0.0 if LEFT in stuck else left, 0.0 if RIGHT in stuck else right, self._half_track_m
        )

    def _push(self, speed: float) -> float:
        """A hand: it gathers speed, lets go, takes a new hold, pulls back; no two alike."""
        number, at_s = divmod(self._since_s, SHOVE_S + PAUSE_S)
        strength = (1.0, -0.6, 0.8)[int(number) % 3]
        return speed * strength * math.sin(math.pi * min(1.0, at_s / SHOVE_S)) ** 2
