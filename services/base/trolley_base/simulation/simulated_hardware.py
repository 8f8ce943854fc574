"""The simulated world behind the interfaces of the hardware.

Chassis and lidar share one `Simulation`; `advance` steps it up to the robot time that base keeps.
"""

import math
from dataclasses import replace

from trolley.config.base import BatteryConfig
from trolley.geometry import Pose2D, Twist2D, exp_twist
from trolley.messages import Battery, Link
from trolley.messages.motion import CHASSIS
from trolley_base.drivers.interface import ChassisReading, LidarReading, LidarScan, MotionSample
from trolley_base.world import STEP_NS, OtherRobot, Simulation, TrueState
from trolley_base.world.faulty_wheels import WELL, FaultyWheels
from trolley_base.world.simulation import STEP_S

WATCHDOG_NS = 500_000_000
"""A board whose host has fallen silent stops by itself after this long, as real ones do [ns]."""
HALF_TRACK_M = 0.1
"""Half the track of wheels that can be broken: what one of them alone makes of the robot [m]."""
CHARGER_REACH_M = 0.3
CHARGING_RATE = 4.0


class SimulatedBattery:
    """A battery that empties with time, and is charged at one place."""

    def __init__(self, config: BatteryConfig) -> None:
        self._drain_per_ns = 1.0 / (config.minutes * 60e9)
        self._charger = None if config.charger is None else config.charger.as_pose()
        self._fraction = config.fraction
        self._is_charging = False

    def step(self, pose: Pose2D, step_ns: int) -> None:
        """Let time pass for a robot at this pose."""
        charger = self._charger
        self._is_charging = charger is not None and (
            math.hypot(pose.x - charger.x, pose.y - charger.y) <= CHARGER_REACH_M
        )
        gain = CHARGING_RATE if self._is_charging else -1.0
        charge = self._fraction + gain * self._drain_per_ns * step_ns
        self._fraction = min(1.0, max(0.0, charge))

    def read(self) -> Battery:
        """Its charge now."""
        return Battery(fraction=self._fraction, charging=self._is_charging)


class SimulatedChassis:
    """Wheels in a simulated world; made by `SimulatedHardware`."""

    def __init__(self, battery: SimulatedBattery | None) -> None:
        self._battery = battery
        self._command = Twist2D.zero()
        self._silent_ns = 0
        self._motions: list[MotionSample] = []
        self.wheels = FaultyWheels(HALF_TRACK_M)
        """Where a test breaks motors and encoders."""

    def drive(self, twist: Twist2D) -> None:
        """Drive with this velocity until the next call, or until 0.5 s have passed without one."""
        self._command, self._silent_ns = twist, 0

    def read(self) -> ChassisReading:
        """Hand over what the wheels measured since the last call."""
        motions, self._motions = tuple(self._motions), []
        battery = None if self._battery is None else self._battery.read()
        return ChassisReading(motions, Link(name=CHASSIS, state="up"), battery=battery)

    def restart(self) -> bool:
        """There is no board to restart."""
        return False

    def take_command(self) -> Twist2D:
        """Return what the motors do for one more step."""
        self._silent_ns += STEP_NS
        told = self._command if self._silent_ns <= WATCHDOG_NS else Twist2D.zero()
        return self.wheels.driven(told, STEP_S)

    def store(self, motion: MotionSample, seconds: float) -> None:
        """Keep what the wheels measured in the last seconds for the next `read`."""
        if self.wheels.trouble is not WELL:
            twist = self.wheels.counted(motion.twist)
            motion = MotionSample(motion.stamp_ns, exp_twist(twist, seconds), twist)
        self._motions.append(motion)


class SimulatedLidar:
    """A scanner in a simulated world; made by `SimulatedHardware`."""

    def __init__(self) -> None:
        self._scans: list[LidarScan] = []

    def read(self) -> LidarReading:
        """Hand over the revolutions completed since the last call."""
        scans, self._scans = tuple(self._scans), []
        return LidarReading(scans, Link(name="lidar", state="up"))

    def store(self, scan: LidarScan) -> None:
        """Keep a revolution for the next `read`."""
        self._scans.append(scan)


class SimulatedHardware:
    """A robot that drives in a simulated world.

    Args:
        simulation: the world with the robot in it, at its time zero.
        start_ns: robot time at which it begins.
        odometry_steps: steps of 10 ms between two reports of the wheels.
        battery: its battery, if it is to have one.
    """

    def __init__(
        self,
        simulation: Simulation,
        start_ns: int,
        odometry_steps: int = 2,
        battery: SimulatedBattery | None = None,
    ) -> None:
        self.simulation = simulation
        self._start_ns = start_ns
        self._odometry_steps = odometry_steps
        self._steps = 0
        self._battery = battery
        self._chassis = SimulatedChassis(battery)
        self._lidar = SimulatedLidar()

    has_ended = False

    @property
    def chassis(self) -> SimulatedChassis:
        """The wheels."""
        return self._chassis

    @property
    def lidar(self) -> SimulatedLidar:
        """The scanner."""
        return self._lidar

    def advance(self, now_ns: int) -> None:
        """Step the world up to robot time `now_ns`, in whole steps, never beyond."""
        while self._start_ns + self.simulation.now_ns + STEP_NS <= now_ns:
            self.simulation.step(self._chassis.take_command())
            self._steps += 1
            if self._battery is not None:
                self._battery.step(self.simulation.truth().pose, STEP_NS)
            if self._steps % self._odometry_steps == 0:
                motion = self.simulation.take_motion()
                self._chassis.store(
                    replace(motion, stamp_ns=self._start_ns + motion.stamp_ns),
                    self._odometry_steps * STEP_S,
                )
            for scan in self.simulation.take_scans():
                self._lidar.store(replace(scan, stamp_ns=self._start_ns + scan.stamp_ns))

    def truth(self) -> TrueState:
        """Return what is really so, stamped in robot time."""
        state = self.simulation.truth()
        return replace(state, stamp_ns=self._start_ns + state.stamp_ns)

    def set_others(self, others: list[OtherRobot]) -> None:
        """Say where the other robots of this world are."""
        self.simulation.set_others(others)

    def close(self) -> None:
        """Stop the wheels."""
        self._chassis.drive(Twist2D.zero())
