"""What a sonar measured, as the scan of an extra sensor: the same range all across its cone."""

import math

import numpy as np

from trolley.drivers import BoardSensor
from trolley.messages import Scan, floats_to_bytes

BEAM_RAD = math.radians(5.0)
"""Beams of a cone lie about this far apart [rad]; there are three at least."""


def sonar_sensor(name: str, what: str) -> BoardSensor:
    """Return a sonar for robot.toml: only its owner knows where it sits.

    Args:
        name: of its table `[base.scans.NAME]`.
        what: which sonar that is.
    """
    return BoardSensor(
        name=name,
        meaning=f"{what}. Fill in where it sits and looks to, in metres and radians from the "
        "middle between the driven wheels.",
        settings={"pose": {"x": 0.0, "y": 0.0, "yaw": 0.0}, "z_m": 0.1},
        is_usual=False,
    )


def sonar_scan(
    name: str, stamp_ns: int, range_m: float, *, cone_rad: float, range_min: float, range_max: float
) -> Scan:
    """Return a scan in the frame `name`.

    Args:
        name: of the sensor's table `[base.scans.NAME]`.
        stamp_ns: robot time.
        range_m: beyond `range_max`: nothing is there; 0, or what is no number: it does not know.
        cone_rad: the cone's whole angle.
        range_min: [m].
        range_max: [m].
    """
    count = max(3, 1 + math.ceil(cone_rad / BEAM_RAD))
    # Comparisons with NaN are false.
    known = range_m if range_m > 0.0 else 0.0
    told = math.inf if known > range_max else known
    return Scan(
        stamp_ns=stamp_ns,
        frame=name,
        angle_min=-0.5 * cone_rad,
        angle_increment=cone_rad / (count - 1),
        time_increment=0.0,
        range_min=range_min,
        range_max=range_max,
        ranges=floats_to_bytes(np.full(count, told, np.float32)),
    )
