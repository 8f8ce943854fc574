"""An ultrasonic sensor on a robot's front: the nearest echo within its cone."""

import math

import numpy as np

from trolley.geometry import Pose2D
from trolley_base.world import Shots, Simulation

BEAMS = 9


def nearest_m(simulation: Simulation, mount: Pose2D, cone_rad: float, reach_m: float) -> float:
    """Return what is nearest within the cone, at the lidar's height [m]; +inf for nothing.

    Args:
        simulation: just stepped.
        mount: base_T_sonar.
        cone_rad: its whole angle.
        reach_m: beyond it there is no echo.
    """
    bearings = np.linspace(-0.5 * cone_rad, 0.5 * cone_rad, BEAMS)
    now, plain = np.ones(BEAMS), np.zeros(BEAMS)
    found = float(simulation.measure(mount, Shots(now, bearings, plain, reach_m)).min())
    return found if found <= reach_m else math.inf
