"""Sentences that the tour service says to people."""

import math

from trolley import codes
from trolley.messages import Stop

PAUSES: dict[str, str] = {
    codes.STOPPED: "The robot is stopped; resume the robot, then the tour.",
    codes.TAKEN_OVER: "Someone else is driving the robot; resume the tour to continue.",
    codes.OTHER_GOAL: codes.SENTENCES[codes.OTHER_GOAL],
    codes.RESTARTED: "The robot was restarted; resume the tour to continue.",
    codes.CANCELED: "The goal was canceled; resume the tour to continue.",
    codes.LOW_BATTERY: "The battery was low; charge it, then resume the tour to continue.",
    codes.PAUSED: "The tour is paused; resume it to continue.",
}
"""Why a trip is paused, and what to do about it."""


def stop_title(index: int, stop: Stop) -> str:
    """A stop as people count them: "stop 2 (kitchen)"."""
    return f"stop {index + 1}" + (f" ({stop.name})" if stop.name else "")


def about_stop(title: str, sentence: str, then: str = "") -> str:
    """A sentence about a stop: "Stop 2 (kitchen): the way is blocked; skipped."."""
    first = sentence[:1].lower() + sentence[1:]
    tail = f"; {then}" if then else ""
    return f"{title[:1].upper()}{title[1:]}: {first.rstrip('.')}{tail}."


def seconds(value: float) -> str:
    """A time span for people: "5 s", "2 min"."""
    return f"{value:.0f} s" if value < 120.0 else f"{value / 60.0:.0f} min"


def trip_done(reached: int, missed: int) -> str:
    """How a trip that came to its end turned out."""
    visits = reached + missed
    if missed == 0:
        return "The stop was reached." if visits == 1 else f"All {visits} stops were reached."
    return f"{reached} of {visits} stops were reached."


def battery_at(fraction: float) -> str:
    """A charge for people: "Battery at 18 %"."""
    return f"Battery at {math.floor(100.0 * fraction)} %"


def of(code: str) -> str:
    """The sentence of a code, the code itself where it has none."""
    return codes.SENTENCES.get(code, code) or "No reason was given."
