"""The simulated world: a room with walls, mirrors, glass, people, and a robot that drives in it.

The pure core: no files, no clock, no wire. `drivers/simulated.py` puts it behind the interfaces
of the hardware, `worlds/README.md` says how a world is written down.
"""

from trolley_base.world.contacts import Contact
from trolley_base.world.scanner import Shots
from trolley_base.world.simulation import (
    STEP_NS,
    OtherRobot,
    RobotBody,
    Simulation,
    TrueState,
)
from trolley_base.world.spec import DriveLimits, LidarSpec, WorldError, WorldSpec, decode_world

__all__ = [
    "STEP_NS",
    "Contact",
    "DriveLimits",
    "LidarSpec",
    "OtherRobot",
    "RobotBody",
    "Shots",
    "Simulation",
    "TrueState",
    "WorldError",
    "WorldSpec",
    "decode_world",
]
