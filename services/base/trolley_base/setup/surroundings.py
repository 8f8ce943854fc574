"""What the lidar sees around the robot before it drives: the robot itself, and how much room."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from trolley_base.setup.clearance import PARAMS as CLEARANCE
from trolley_base.setup.clearance import Body
from trolley_base.setup.record import SetupRefused, Stand
from trolley_base.setup.sight import Beams, Room, Sector, is_within, near_sectors, own_sectors

Floats = NDArray[np.float64]


class Surroundings:
    """The robot and the floor around it.

    Args:
        footprint: (n, 2) corners [m] in `base_link`.
        own: where a person has said that the lidar sees the robot itself.
    """

    def __init__(self, footprint: Floats, own: Sequence[Sector]) -> None:
        self.body = Body(footprint)
        self.own = list(own)
        """Where the lidar sees the robot itself; once it has turned round, measured."""

    def refuse_near(self, beams: Beams, ranges: NDArray[np.float32]) -> None:
        """Refuse what is near and what nobody has called a part of the robot."""
        reach_m = 2.0 * self.body.radius_m
        for sector in near_sectors(beams, ranges, reach_m + CLEARANCE.turn_margin_m):
            if not is_within(sector, self.own):
                first, last = map(math.degrees, sector)
                raise SetupRefused(
                    f"Something is nearer than {reach_m + CLEARANCE.turn_margin_m:.2f} m to the "
                    f"lidar, at its angles from {first:.0f}° to {last:.0f}°. Give the robot more "
                    "room."
                )

    def learn_own(self, beams: Beams, stands: Sequence[Stand]) -> None:
        """Learn what has turned with the robot."""
        found = own_sectors(beams, stands, 2.0 * self.body.radius_m)
        for sector in self.own:
            if not is_within(sector, found) and not any(is_within(one, [sector]) for one in found):
                first, last = map(math.degrees, sector)
                raise SetupRefused(
                    f"What the lidar saw near it, at its angles from {first:.0f}° to {last:.0f}°, "
                    "did not turn with the robot, so it is no part of it. Clear the floor."
                )
        self.own = found

    def find_room(
        self, beams: Beams, stands: Sequence[Stand], axle: Floats, half_m: tuple[float, float]
    ) -> float:
        """Return how far strokes may reach [m].

        Args:
            beams: of the stands.
            stands: from which the room was seen.
            axle: (2,) the middle of the axle in frame `laser` [m].
            half_m: how far they have to reach, and how far at most [m].

        Raises:
            SetupRefused: there is too little room, or nobody knows.
        """
        room = Room(stands[-1].start_T_laser.transform_points(axle[None])[0])
        keep = beams.outside(self.own)
        for stand in stands:
            room.add(stand.start_T_laser.transform_points(beams.points(stand.ranges, keep)))
        if room.blind:
            raise SetupRefused(
                "In some directions the lidar sees nothing at all, so nobody knows whether the "
                "floor is free there. Choose a place with walls around, away from glass and from "
                "what is black or shiny."
            )
        least_m, most_m = half_m
        found_m = min(most_m, room.free_m - self.body.radius_m - CLEARANCE.margin_m)
        if found_m < least_m:
            needed_m = least_m + self.body.radius_m + CLEARANCE.margin_m
            raise SetupRefused(
                f"The nearest thing is {room.free_m:.2f} m from the middle of the robot; it needs "
                f"{needed_m:.2f} m all round. Give it more room."
            )
        return found_m
