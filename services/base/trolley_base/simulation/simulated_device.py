"""`[base] driver = "simulated"`: a world, and a run of the robot in it."""

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trolley import worlds
from trolley.config import ConfigError, RobotConfig
from trolley.geometry import Pose2D, Twist2D
from trolley.messages import Truth
from trolley_base.drivers import CallSoon
from trolley_base.drivers.device import Opened
from trolley_base.persistence import SavedWorld
from trolley_base.simulation.simulated_hardware import SimulatedBattery, SimulatedHardware
from trolley_base.world import OtherRobot, RobotBody, Simulation, WorldError
from trolley_base.world.world_file import load_world


class SimulatedDevice:
    """The world of the configuration, with a robot that fits into it."""

    cannot_drive = ""
    is_stepped = True
    watchdog_s = 0.5

    def __init__(self, config: RobotConfig, footprint: NDArray[np.float64]) -> None:
        settings = config.base.simulated
        self.base_T_laser = config.base.lidar.pose.as_pose()
        self.rate = settings.rate
        self._seed = settings.seed
        self._battery = settings.battery
        self._start = None if settings.start is None else settings.start.as_pose()
        self._body = RobotBody(footprint, self.base_T_laser)
        name = settings.world if settings.world.endswith(".toml") else f"{settings.world}.toml"
        try:
            self._world = load_world(worlds.find(name, beside=Path(config.folder)))
            self._refuse_outside(self._start or self._world.spec.start.as_pose())
            # A step of a world that nobody sees compiles all kernels, or loads them.
            self._simulate(self._start).step(Twist2D.zero())
        except (FileNotFoundError, WorldError) as error:
            raise ConfigError(f"[base.simulated] {error}") from error
        self.world: str | None = self._world.name
        motors = self._world.spec.motors
        self.delay_s = motors.delay_s + motors.jitter_s
        self.usual_delay_s = motors.delay_s + 0.5 * motors.jitter_s

    def open(
        self,
        start_ns: int,
        saved: SavedWorld | None,
        robot_ns: Callable[[int], int],
        call_soon: CallSoon,
    ) -> Opened:
        """Put the robot into its world."""
        del robot_ns, call_soon
        start = self._start
        # Where somebody has named another start since, that is where the robot is meant to be.
        if saved is not None and saved.world == self.world and saved.start == self._start:
            start = saved.pose
        try:
            simulation = self._simulate(start)
        except WorldError:  # the world has been changed, and there is a wall now
            simulation = self._simulate(self._start)
        battery = None if self._battery is None else SimulatedBattery(self._battery)
        hardware = SimulatedHardware(simulation, start_ns, battery=battery)
        return Opened(hardware, SimulatedRun(hardware, self._world.name, self._start))

    def _refuse_outside(self, start: Pose2D) -> None:
        if not self._world.grid.contains(start.as_array()[None, :2])[0]:
            raise WorldError(
                f"the start at x = {start.x:g}, y = {start.y:g} lies outside of the map "
                f"{self._world.map_file}; choose another"
            )

    def _simulate(self, start: Pose2D | None) -> Simulation:
        return Simulation(self._world.spec, self._world.grid, self._body, self._seed, start)


class SimulatedRun:
    """What only a simulation knows.

    Args:
        hardware: the robot in its world.
        start: what the configuration says about the start.
    """

    def __init__(self, hardware: SimulatedHardware, world: str, start: Pose2D | None) -> None:
        self._hardware = hardware
        self._world = world
        self._start = start

    def truth(self) -> Truth:
        """Return where the robot really is."""
        state = self._hardware.truth()
        return Truth(
            stamp_ns=state.stamp_ns,
            world=self._world,
            pose=state.pose,
            twist=state.twist,
            collisions=state.collisions,
            clearance=state.clearance,
        )

    def to_save(self) -> SavedWorld:
        """Return what lets a later run continue where this one stands."""
        pose = self._hardware.truth().pose
        return SavedWorld(world=self._world, pose=pose, start=self._start)

    def set_others(self, outlines: Mapping[str, NDArray[np.float64]]) -> None:
        """Put other robots into the world: their names and outlines (n, 2) [m] in `map`."""
        others = [OtherRobot(name, outline) for name, outline in sorted(outlines.items())]
        self._hardware.set_others(others)
