"""Driving by hand: what the keyboard and the joystick on the screen have in common.

A hand that is held sends a command twenty times a second, each good for a quarter of a second. One
that lets go sends zero for a moment and then nothing, so that a lower source may drive again.
"""

from trolley.geometry import Twist2D

SOURCE = "teleop"
"""The command source, as in `cmd_vel/teleop`."""
PERIOD_S = 0.05
VALID_S = 0.25
"""How long a command is good for [s]: the robot stands when the next ones do not come."""
ZERO_NS = 300_000_000
"""How long zero is sent after the hand let go."""
SPEED_MPS = 0.25
TURN_RADPS = 0.8


class Hand:
    """What a hand sends: what it wants while it holds, then zero for a moment, then nothing."""

    def __init__(self) -> None:
        self._held_ns: int | None = None

    def step(self, wanted: Twist2D | None, now_ns: int) -> Twist2D | None:
        """Return the command to send now, None for silence.

        Args:
            wanted: what the hand wants, None where it holds nothing.
            now_ns: local monotonic time.
        """
        if wanted is not None:
            self._held_ns = now_ns
            return wanted
        if self._held_ns is not None and now_ns - self._held_ns > ZERO_NS:
            self._held_ns = None
        return None if self._held_ns is None else Twist2D.zero()


def twist_words(twist: Twist2D) -> str:
    """Say a velocity in words: "forward 0.25 m/s, turning left 0.80 rad/s"."""
    parts = [
        f"{positive if value > 0.0 else negative} {abs(value):.2f} {unit}"
        for value, positive, negative, unit in (
            (twist.vx, "forward", "back", "m/s"),
            (twist.vy, "sideways left", "sideways right", "m/s"),
            (twist.wz, "turning left", "turning right", "rad/s"),
        )
        if abs(value) >= 0.005
    ]
    return ", ".join(parts) or "standing"
