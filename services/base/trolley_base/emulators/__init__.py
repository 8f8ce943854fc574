"""Emulated motor boards and lidars: the real bytes of each, from the simulated world.

For tests, and for people without hardware: `trolley emulate`. They are written from the vendors'
protocols and share no code with the drivers, so that each checks the other.
"""

from trolley_base.emulators.device import DeviceError, ReceivedCommand
from trolley_base.emulators.faults import FaultError
from trolley_base.emulators.lidar import Mount
from trolley_base.emulators.robot import EmulatedRobot, RobotInWorld
from trolley_base.emulators.surroundings import WheelFacts

__all__ = [
    "DeviceError",
    "EmulatedRobot",
    "FaultError",
    "Mount",
    "ReceivedCommand",
    "RobotInWorld",
    "WheelFacts",
]
