"""Sentences for people about exploring."""

from trolley import codes

BEGINS = "The robot is exploring."
GOES_HOME = "It is driving back to where it began."
AT_HOME = "It is back where it began."
TOO_LONG = "It took too long."
STOOD = "It did not get on, although the map shows nothing in its way."
_GO_ON = "`trolley map explore` continues it."
SHUT_IN = (
    "Exploring is paused: the lidar shows no room to drive anywhere from here; drive the robot by "
    f"hand to a more open place, then {_GO_ON}"
)
PAUSES = {
    codes.STOPPED: "Exploring is paused: the robot was stopped; resume it, then exploring.",
    codes.TAKEN_OVER: f"Exploring is paused: somebody else is driving the robot; {_GO_ON}",
    codes.RESTARTED: f"Exploring is paused: the robot was restarted; {_GO_ON}",
    codes.OTHER_GOAL: f"Exploring is paused: somebody sent the robot elsewhere; {_GO_ON}",
    codes.CANCELED: f"Exploring is paused: its goal was canceled; {_GO_ON}",
    codes.PAUSED: f"Exploring is paused; {_GO_ON}",
    codes.LOST: "Exploring is paused: the robot does not know where it is on the new map.",
    codes.NOT_CONVERGED: "Exploring is paused: the robot is not sure where it is on the new map.",
}
"""Why exploring was paused, by its code."""


def exploring(area_m2: float, num_frontiers: int) -> str:
    """Say what it is doing."""
    return f"{BEGINS[:-1]}: {area_m2:.0f} m² so far, {_places(num_frontiers)} left to look at."


def found(area_m2: float, num_missed: int, num_left_out: int = 0, is_enough: bool = False) -> str:
    """Say what was explored, without a full stop; `is_enough` if no more was allowed."""
    enough = ", all that [mapper] explore_area_m2 allows" if is_enough else ""
    missed = f", {_places(num_missed)} could not be reached" if num_missed else ""
    corners = "corner" if num_left_out == 1 else "corners"
    left_out = f", {num_left_out} small {corners} left out" if num_left_out else ""
    return f"Explored: {area_m2:.0f} m²{enough}{missed}{left_out}"


def not_home(why: str) -> str:
    """Say why it is not back."""
    return f"It could not drive back to where it began: {_lowered(why)}"


def stuck(why: str) -> str:
    """Say why it gave up for now."""
    return f"Exploring is paused: the robot cannot get anywhere. {why}".rstrip()


def paused(why: str) -> str:
    """Say why it does not go on."""
    return f"Exploring is paused: {_lowered(why)}"


def _places(count: int) -> str:
    return "1 place" if count == 1 else f"{count} places"


def _lowered(sentence: str) -> str:
    return sentence[:1].lower() + sentence[1:]
