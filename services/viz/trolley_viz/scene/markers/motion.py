"""How markers that move by themselves move: jumps, and turns about their axes."""

import math

from trolley.messages import Marker
from trolley_viz.scene.markers.solids import Placed

JUMP_S = 1.0
TURN_S = 3.0
JUMP_HEIGHT = 0.8
"""Height of a jump, as a share of the marker's own height."""


def is_moving(marker: Marker, age_s: float) -> bool:
    """Whether a marker that came so long ago moves by itself now."""
    return marker.motion != "none" and (marker.motion != "jump_once" or age_s < JUMP_S)


def placed(marker: Marker, age_s: float) -> Placed:
    """Where a marker that came so long ago is in its motion."""
    match marker.motion:
        case "none":
            return Placed(marker)
        case "jump" | "jump_once":
            if not is_moving(marker, age_s):
                return Placed(marker)
            phase = (age_s % JUMP_S) / JUMP_S
            return Placed(marker, lift=JUMP_HEIGHT * marker.size[2] * 4.0 * phase * (1.0 - phase))
        case "rotate_x" | "rotate_y" | "rotate_z":
            half = math.pi * (age_s % TURN_S) / TURN_S
            axis = "xyz".index(marker.motion[-1])
            turn = [math.cos(half), 0.0, 0.0, 0.0]
            turn[1 + axis] = math.sin(half)
            return Placed(marker, turn=(turn[0], turn[1], turn[2], turn[3]))
