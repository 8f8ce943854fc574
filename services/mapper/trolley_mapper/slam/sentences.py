"""Sentences for people about what is the matter with the pose or the map."""

from collections.abc import Sequence

BLIND = "the lidar sees too little"
PAUSED = "paused: the map does not grow"
LOST = (
    "this part is not joined to the map yet: drive on to a place that the map shows, "
    "or say where the robot is"
)
CUT = (
    "this part was joined to the map in a wrong place and is cut off again: "
    "drive on to a place that the map shows"
)
OTHER_FLOOR = (
    "the walls are not those of the map since the robot stood, as after a lift ride: "
    "what is seen now is mapped apart"
)
UNSURE = "checking the pose: drive on a little, then the map grows again"
SLIPS = "the wheels slip: they turn farther than the robot moves"


def doubtful(places: Sequence[tuple[float, float]]) -> str:
    """Say where a finished map may be wrong; empty if it is right as far as its scans tell.

    Args:
        places: x, y [m], the worst first.
    """
    if not places:
        return ""
    x, y = places[0]
    more = len(places) - 1
    elsewhere = f" and in {more} other places" if more > 1 else " and in 1 other place"
    return (
        f"At ({x:.1f}, {y:.1f}){elsewhere if more else ''} scans taken at different times "
        "contradict each other: look at the map there, it may be wrong."
    )
