"""The base service: the hardware or the simulated world, and everything that may move it."""

from math import isfinite

import msgspec

from trolley import topics
from trolley.config import RobotConfig
from trolley.config.changeable_settings import all_keys
from trolley.extra_sensors import ExtraSensors
from trolley.messages import Transform
from trolley.runtime.service import Service, every
from trolley_base.board_sensors import BoardSensors
from trolley_base.description import describe_robot, footprint_of, half_track_of, limits_of
from trolley_base.device_factory import choose_device
from trolley_base.device_inputs import DeviceInputs
from trolley_base.drive_control import DriveControl
from trolley_base.drivers import Hardware
from trolley_base.motion_watch import MotionWatch
from trolley_base.odometry.wheel_scales import scales_of
from trolley_base.persistence import WORLD_FILE, SavedWorld
from trolley_base.safety.lidar_sight import LidarSight
from trolley_base.safety.lidar_view import LidarView
from trolley_base.safety.motion_supervision import MotionSupervision
from trolley_base.safety.near_echoes import NearEchoes
from trolley_base.safety.observed_space import ObservedSpace
from trolley_base.safety.sight_distance import SightDistance
from trolley_base.safety.stop_field import StopField
from trolley_base.safety.velocity_limiter import VelocityLimiter
from trolley_base.settings_keeper import SettingsKeeper
from trolley_base.simulation.shared_world import SharedWorld
from trolley_base.timekeeper import Timekeeper
from trolley_base.upkeep.findings import InForce
from trolley_base.upkeep_watch import UpkeepWatch

CONTROL_S = 0.02
"""One control period: read, decide, drive. It is two steps of a simulated world."""

AWAKE_S = 0.1
"""How often it is looked whether the computer has slept."""

LIDAR_BLUR_S = 0.35
"""Over up to so long a time the lidar of a robot without encoders tells the mean motion [s]."""


class BaseService(Service):
    """Owns the hardware, odometry and robot time, and decides which command is driven."""

    name = "base"
    hears_apart = True

    def __init__(self, config: RobotConfig) -> None:
        """Read what the configuration names.

        Raises:
            ConfigError: a world, recording, mesh, footprint or wheel ratio cannot be used.
        """
        footprint = footprint_of(config)
        self._config = config
        self._scales = scales_of(config)
        self._device = device = choose_device(config, footprint)
        limits = limits_of(config, device.watchdog_s)
        is_simulated = device.world is not None
        self._robot = describe_robot(
            config, footprint, limits, device.usual_delay_s, is_simulated=is_simulated
        )
        field = StopField(footprint, limits, config.base.stop_margin_m, device.delay_s)
        sight = SightDistance(footprint, limits, device.delay_s)
        limiter = self._limiter = VelocityLimiter(config.base.sources, limits, field, sight)
        self._time = Timekeeper(self)
        clock = self.own_time = self._time.clock
        mount = device.base_T_laser
        self._inputs = DeviceInputs(
            self,
            LidarSight(
                NearEchoes(mount, field.reach),
                ObservedSpace(footprint, mount, sight.reach),
                LidarView(footprint, mount),
            ),
            mount,
            ExtraSensors(config.base.scans, "stop"),
            BoardSensors(config.base.scans, footprint),
        )
        blur_s = LIDAR_BLUR_S if config.base.odometry.source == "lidar" else 0.0
        half_track_m = half_track_of(config, footprint)
        supervision = MotionSupervision(limits, half_track_m, device.delay_s, blur_s)
        watch = MotionWatch(self, supervision, can_drive=not device.cannot_drive)
        self._drive = DriveControl(
            self,
            clock,
            device.cannot_drive,
            limiter,
            self._scales,
            self._inputs,
            watch,
        )
        self._settings = SettingsKeeper(self, config, self._use)
        self._world = None if device.world is None else SharedWorld(self, device.world)
        shared = () if self._world is None else (self._world,)
        in_force = InForce(device.base_T_laser, self._scales, half_track_m)
        # Without wheels there is nothing to compare, and people move a recorded robot.
        has_wheels = config.base.odometry.source != "lidar" and not device.cannot_drive
        self._upkeep = UpkeepWatch(self, in_force) if has_wheels else None
        upkeep = () if self._upkeep is None else (self._upkeep,)
        own = (*self._drive.parts, self._time, self._inputs, self._settings)
        self.parts = (*own, *shared, *upkeep)

    def prepare(self) -> None:
        """Read what there is to say about the settings, and compile what scans call.

        Either takes longer than a period.
        """
        all_keys()
        if self._config.base.odometry.source != "wheels":
            from trolley_base.odometry.warmup import warm_up

            warm_up()

    @property
    def hardware(self) -> Hardware:
        """The devices of this run."""
        return self._hardware

    def start(self) -> None:
        """Begin a run: robot time, the hardware, and who the robot is."""
        epoch_ns = self._time.next_epoch_ns()
        saved_world = self.state.read(WORLD_FILE, SavedWorld)
        opened = self._device.open(epoch_ns, saved_world, self._time.robot_ns, self.call_soon)
        self._hardware = opened.hardware
        self._inputs.begin(self._hardware, self._config, self._scales, epoch_ns)
        self._drive.begin(self._hardware)
        step_ns = round(CONTROL_S * 1e9) if self._device.is_stepped else None
        self._time.begin(epoch_ns, self._device.rate, step_ns)
        self._introduce(epoch_ns)
        self._settings.start()
        if self._upkeep is not None:
            self._upkeep.begin()
        if self._world is not None and opened.world is not None:
            self._world.begin(opened.world)

    def stop(self) -> None:
        """Stop the motors, say so, and save what must outlive the process."""
        if self.now_ns is None:  # it could not start
            return
        now_ns = self.stamp_ns
        try:
            self._drive.end()
        finally:
            self._hardware.close()
        self._drive.reporter.publish_command(self._drive.decision, now_ns)
        self._drive.reporter.publish_state(self._drive.decision, now_ns)
        self._time.save(now_ns)
        if self._upkeep is not None:
            self._upkeep.save()
        if self._world is not None:
            self._world.save()

    @every(CONTROL_S)
    def control(self) -> None:
        """Read the devices, decide, drive, and report."""
        now_ns = self.stamp_ns
        self._inputs.update(now_ns)
        if self._upkeep is not None:
            self._upkeep.add(self._inputs.measured.motions)
        self._drive.update(now_ns)
        self._drive.reporter.publish_due(self._drive.decision, now_ns)
        if self._world is not None:
            self._world.update(now_ns)
        self._time.finish_period(now_ns)

    @every(AWAKE_S, clock="local")
    def begin_anew_after_sleep(self) -> None:
        """Begin anew once the computer has slept.

        Whoever let the robot drive may have gone meanwhile, and it may have been carried off.
        """
        if not self._device.cannot_drive and self._time.has_slept():
            self.is_spent = True

    def _use(self, config: RobotConfig) -> None:
        """Heed other limits from the next period on; the brakes are what they were."""
        limits = limits_of(config, self._device.watchdog_s)
        self._limiter.limits = limits
        robot = msgspec.structs.replace(self._robot, max_speed=limits.speed, max_wz=limits.wz)
        if robot != self._robot:
            self._robot = robot
            self.publish(topics.ROBOT, msgspec.structs.replace(robot, stamp_ns=self.stamp_ns))

    def _introduce(self, now_ns: int) -> None:
        """Publish what does not change during a run."""
        self.publish(topics.ROBOT, msgspec.structs.replace(self._robot, stamp_ns=now_ns))
        laser = Transform(
            stamp_ns=now_ns,
            parent="base_link",
            child="laser",
            pose=self._device.base_T_laser,
            z=self._config.base.lidar.z_m,
        )
        self.publish(topics.TF, laser, "laser")
        for name, sensor in self._config.base.scans.items():
            mount = Transform(
                stamp_ns=now_ns,
                parent="base_link",
                child=name,
                pose=sensor.pose.as_pose(),
                z=sensor.z_m,
            )
            self.publish(topics.TF, mount, name)
        if self._robot.max_speed < self._config.base.limits.max_speed_mps:
            watchdog_s = self._device.watchdog_s
            stops = f"stops only after {watchdog_s:g} s" if isfinite(watchdog_s) else "drives on"
            self.log.warning(
                f"At most {self._robot.max_speed} m/s: if base ends, the motor board {stops}; see "
                "[base.chassis] watchdog_s"
            )
