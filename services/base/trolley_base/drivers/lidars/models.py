"""What there is to know of each lidar model, for drivers, `trolley detect` and people.

Sources:
    SLAMTEC RPLIDAR A1 datasheet; YDLIDAR X4 data sheet; LDROBOT LD19 development manual;
    xv_11_laser_driver and the getSurreal XV Lidar Controller; ROBOTIS LDS-01 manual.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from trolley.config.hardware import LidarModel


@dataclass(frozen=True, slots=True)
class LidarFacts:
    """A lidar model as it is delivered.

    Attributes:
        title: its name for people.
        baud: of its line, 8N1.
        range_min_m: nearest distance that it measures.
        range_max_m: farthest.
        turns_hz: slowest and fastest turning at which it measures.
        usual_hz: how fast it usually turns.
        clockwise: its head turns clockwise as seen from above.
        speed_hint: what to do about a wrong speed.
    """

    title: str
    baud: int
    range_min_m: float
    range_max_m: float
    turns_hz: tuple[float, float]
    usual_hz: float
    clockwise: bool = True
    speed_hint: str = "Is its head free to turn, and its 5 V supply strong enough?"


MODELS: Mapping[LidarModel, LidarFacts] = {
    "rplidar_a1": LidarFacts("RPLIDAR A1", 115200, 0.15, 12.0, (2.0, 10.0), 5.5),
    "ydlidar_x4": LidarFacts("YDLIDAR X4", 128000, 0.12, 10.0, (6.0, 12.0), 7.0),
    "ld19": LidarFacts(
        "LD19",
        230400,
        0.02,
        12.0,
        (5.0, 13.0),
        10.0,
        speed_hint="Its PWM wire must be tied to ground for it to keep its speed by itself.",
    ),
    "xv11": LidarFacts(
        "XV11",
        115200,
        0.06,
        5.0,
        (180.0 / 60.0, 349.0 / 60.0),
        5.0,
        clockwise=False,
        speed_hint="Its motor needs a controller outside of the sensor: is that set to 300 rpm?",
    ),
    "lds01": LidarFacts("LDS-01", 230400, 0.12, 3.5, (4.5, 5.5), 5.0),
}
"""By the name in `[base.lidar] model`."""
