"""Finding the systematic errors of odometry: the drive, the estimate, and what is proposed.

Nothing here does I/O or knows a clock: `trolley_base.commands.calibrate` brings both.
"""

from trolley_base.calibration.course import Course, Place, find_obstacle, square, squares_both_ways
from trolley_base.calibration.drive import CalibrationDrive
from trolley_base.calibration.estimate import Estimate, estimate
from trolley_base.calibration.umbmark import Benchmark, Return, benchmark
from trolley_base.upkeep.comparison import Comparison
from trolley_base.upkeep.correction import Correction, combined
from trolley_base.upkeep.legs import Leg, OdometryLog

__all__ = [
    "Benchmark",
    "CalibrationDrive",
    "Comparison",
    "Correction",
    "Course",
    "Estimate",
    "Leg",
    "OdometryLog",
    "Place",
    "Return",
    "benchmark",
    "combined",
    "estimate",
    "find_obstacle",
    "square",
    "squares_both_ways",
]
