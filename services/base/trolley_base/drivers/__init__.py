"""What base drives and senses with: real devices, the simulated world, or a recorded drive."""

from trolley_base.drivers.interface import (
    CallSoon,
    Chassis,
    ChassisReading,
    Contact,
    DriverError,
    Hardware,
    Lidar,
    LidarReading,
    LidarScan,
    MotionSample,
    Note,
)

__all__ = [
    "CallSoon",
    "Chassis",
    "ChassisReading",
    "Contact",
    "DriverError",
    "Hardware",
    "Lidar",
    "LidarReading",
    "LidarScan",
    "MotionSample",
    "Note",
]
