"""The base service: the hardware or the simulated world, and everything that may move it."""

from collections.abc import Callable
from typing import TYPE_CHECKING

import msgspec
import numpy as np

from trolley import codes, requests, topics
from trolley.config import RobotConfig
from trolley.geometry import Twist2D
from trolley.messages import (
    BaseState,
    Battery,
    Clock,
    Link,
    Odometry,
    Scan,
    Transform,
    VelocityCommand,
    floats_to_bytes,
)
from trolley.messages.request_params import Nothing
from trolley.runtime.service import Later, Service, answers, every, gets, on
from trolley_base.description import footprint_of, limits_of, mesh_of, robot_message
from trolley_base.device_factory import choose_device
from trolley_base.device_log import DeviceNotes
from trolley_base.drivers import ChassisReading, LidarScan
from trolley_base.odometry.dead_reckoning import DeadReckoning
from trolley_base.odometry.wheel_scales import scales_of
from trolley_base.persistence import (
    LATCH_FILE,
    TIME_FILE,
    WORLD_FILE,
    SavedLatch,
    SavedTime,
    SavedWorld,
    first_stamp_ns,
)
from trolley_base.robot_clock import Beat, RobotClock
from trolley_base.safety.estop_latch import Latch
from trolley_base.safety.near_echoes import NearEchoes
from trolley_base.safety.safety_state import SCAN_SILENCE_NS, Condition, find_hindrance
from trolley_base.safety.stop_field import StopField
from trolley_base.safety.velocity_limiter import Decision, Governor

if TYPE_CHECKING:
    from trolley_base.simulation.shared_world import SharedWorld

# One period: read, decide, drive. It is two steps of a simulated world.
CONTROL_S = 0.02
CLOCK_S = 0.1
# Every other reading, and one with each scan: 25 to 35 Hz.
ODOMETRY_S = 0.04
COMMAND_S = 0.1
STATE_S = 1.0
SAVE_TIME_S = 60.0
SAVE_WORLD_S = 1.0
# A stop is answered after this long even where the disk is slower.
LONGEST_SAVE_NS = 1_000_000_000
SAVE_AGAIN_S = 5.0


class BaseService(Service):
    """Owns the hardware, odometry and robot time, and decides which command is driven."""

    name = "base"

    def __init__(self, config: RobotConfig) -> None:
        """Read what the configuration names.

        Raises:
            ConfigError: a world, recording, mesh, footprint or wheel ratio cannot be used.
        """
        self._config = config
        self._footprint = footprint_of(config)
        self._mesh = mesh_of(config)
        self._scales = scales_of(config)
        self._device = choose_device(config, self._footprint)
        limits = self._limits = limits_of(config, self._device.watchdog_s)
        margin, reaction_s = config.base.stop_margin_m, self._device.reaction_s
        field = StopField(self._footprint, limits, margin, reaction_s)
        self._governor = Governor(config.base.sources, limits, field)
        self._echoes = NearEchoes(self._device.base_T_laser, field.reach)
        self._clock = self.own_time = RobotClock()
        self._world: SharedWorld | None = None
        self._published_state: BaseState | None = None
        self._scan_arrived_ns: int | None = None
        self._chassis_reading = ChassisReading((), Link(name="chassis", state="searching"))
        self._lidar_link = Link(name="lidar", state="searching")
        self._battery: Battery | None = None
        self._decision = Decision(Twist2D.zero(), None, 0, "ok")
        self._has_moved = True
        self._odometry_beat, self._command_beat = Beat(ODOMETRY_S), Beat(COMMAND_S)
        self._state_beat, self._time_beat = Beat(STATE_S), Beat(SAVE_TIME_S)
        self._stops: list[tuple[int, Later[BaseState], BaseState]] = []
        self._latch = Latch(self._write_latch)

    def start(self) -> None:
        """Begin a run: the latch, robot time, the hardware."""
        was_saved = (self.state.path / LATCH_FILE).exists()
        latch = self.state.read(LATCH_FILE, SavedLatch)
        # A file that says nothing readable may have said that the robot is stopped.
        is_stopped = was_saved if latch is None else latch.stopped
        self._latch.begin(is_set=is_stopped, is_saved=latch is not None or not was_saved)
        epoch_ns = first_stamp_ns(self.unix_ns, self.state.read(TIME_FILE, SavedTime))
        saved_world = self.state.read(WORLD_FILE, SavedWorld)
        self._notes = DeviceNotes(self.log, self.count)
        opened = self._device.open(epoch_ns, saved_world, self._robot_ns, self.call_soon)
        self._hardware = opened.hardware
        self._simulated, self._recorded = opened.simulated, opened.recorded
        self._reckoning = DeadReckoning(self._config, self._scales, epoch_ns)
        self._track = self._reckoning.track
        is_real = self._simulated is None and self._recorded is None
        step_ns = None if is_real else round(CONTROL_S * 1e9)
        self._clock.begin(epoch_ns, self.monotonic_ns, self._device.rate, step_ns)
        self._introduce(epoch_ns)
        if self._limits.speed < self._config.base.limits.max_speed_mps:
            self.log.warning(
                f"At most {self._limits.speed} m/s: without base the motor board stops only "
                f"after {self._device.watchdog_s:g} s; see [base.chassis] watchdog_s"
            )
        if self._simulated is not None and self._device.world is not None:
            from trolley_base.simulation.shared_world import SharedWorld

            self._world = SharedWorld(self, self._simulated, self._device.world, self._save)

    def _robot_ns(self, monotonic_ns: int) -> int:
        return self._clock.now(monotonic_ns) or 0

    def stop(self) -> None:
        """Stand, say so, and keep what must outlive the process."""
        if self.now_ns is None:  # it could not start
            return
        self._hardware.chassis.drive(Twist2D.zero())
        self._hardware.close()
        sentence = codes.SENTENCES[codes.SHUTDOWN]
        self._decision = Decision(Twist2D.zero(), None, 0, "held", codes.SHUTDOWN, sentence)
        now_ns = self.stamp_ns
        self._publish_command(now_ns)
        self._publish_state(now_ns)
        self._save(TIME_FILE, SavedTime(stamp_ns=now_ns))
        self.save_world()

    # Control.
    @every(CONTROL_S)
    def control(self) -> None:
        """Bring the hardware to now, read it, and decide what it does until the next time."""
        now_ns = self.stamp_ns
        self._hardware.advance(now_ns)
        self._read_chassis(now_ns)
        self._read_lidar(now_ns)
        self._decide(now_ns)
        self._report(now_ns)
        if self._clock.reached(now_ns, self.monotonic_ns):
            self.publish_clock()

    def _decide(self, now_ns: int) -> None:
        arrived_ns = self._scan_arrived_ns
        hindrance = find_hindrance(
            Condition(
                cannot_drive=self._device.cannot_drive,
                is_stopped=self._latch.is_set,
                chassis=self._chassis_reading,
                lidar=self._lidar_link,
                scan_age_ns=None if arrived_ns is None else now_ns - arrived_ns,
            )
        )
        echoes = self._echoes.points(self._track.odom_T_base)
        self._decision = self._governor.decide(now_ns, echoes, hindrance)
        self._hardware.chassis.drive(self._scales.reported_twist(self._decision.twist))

    @on(topics.COMMAND)
    def take_command(self, command: VelocityCommand, source: str) -> None:
        """Keep a source's wish until the next decision, or drop it and count why."""
        arrived_ns = self._clock.now(self.arrived_ns) or 0
        rejected = self._governor.offer(source, command, arrived_ns, self.stamp_ns)
        if rejected is not None:
            self.count(f"cmd_vel/{rejected.value}")
            self.log.limited(
                f"cmd_vel/{rejected.value}", "Command dropped", source=source, why=rejected.value
            )

    @answers(requests.BASE_STOP)
    def latch(self, _: Nothing) -> Later[BaseState]:
        """Stand now and until resumed; answer when no crash can undo it any more."""
        later: Later[BaseState] = self.later()
        state = self._obey(is_stopped=True)
        self._stops.append((self.monotonic_ns + LONGEST_SAVE_NS, later, state))
        self._latch.set(is_set=True, then=lambda: later.reply(state))
        return later

    @answers(requests.BASE_RESUME)
    def unlatch(self, _: Nothing) -> BaseState:
        """Let commands that arrive from now on drive again."""
        state = self._obey(is_stopped=False)
        self._latch.set(is_set=False)
        return state

    def _obey(self, *, is_stopped: bool) -> BaseState:
        """Stand, or let drive again, at once; what changes nothing is not published."""
        now_ns = self.stamp_ns
        if is_stopped == self._latch.is_set:
            self._decide(now_ns)
            return self._state_at(now_ns)
        self.log.info("Stopped" if is_stopped else "Resumed")
        self._latch.is_set = is_stopped
        self._governor.forget()
        self._decide(now_ns)
        return self._publish_state(now_ns)

    def _write_latch(self, is_stopped: bool, done: Callable[[bool], None]) -> None:
        self._save(LATCH_FILE, SavedLatch(stopped=is_stopped), done)

    @every(CLOCK_S, clock="local")
    def answer_stops(self) -> None:
        """Answer a stop whose saving takes long: the robot stands all the same."""
        for until_ns, later, state in self._stops:
            if self.monotonic_ns >= until_ns:
                later.reply(state)
        self._stops = [stop for stop in self._stops if stop[1].is_open]

    @every(SAVE_AGAIN_S, clock="local")
    def save_latch_again(self) -> None:
        """Try again what the disk did not take: it may have room by now."""
        self._latch.save()

    # Reading.
    def _read_chassis(self, now_ns: int) -> None:
        reading = self._reckoning.take(self._hardware.chassis.read())
        self._chassis_reading = reading
        self._has_moved = self._has_moved or bool(reading.motions)
        for imu in reading.imu:
            self.publish(topics.IMU, imu)
        self._battery = reading.battery or self._battery
        self._notes.hear(now_ns, reading.link, reading.notes, reading.counts)
        if codes.BUTTON in reading.alarms and not self._latch.is_set:
            self._obey(is_stopped=True)
            self._latch.set(is_set=True)

    def _read_lidar(self, now_ns: int) -> None:
        reading = self._hardware.lidar.read()
        self._lidar_link = reading.link
        self._notes.hear(now_ns, reading.link, reading.notes, reading.counts)
        # With each scan the odometry up to its last beam, so that nobody has to wait for it.
        if self._has_moved and (self._odometry_beat.is_due(now_ns) or reading.scans):
            self._has_moved = False
            self._publish_odometry()
        for scan in reading.scans:
            self._publish_scan(scan)
            # A lidar that is covered measures nothing valid: as good as silent.
            if np.any(scan.ranges > 0.0):
                self._echoes.see(scan, self._track)
                self._scan_arrived_ns = now_ns

    # Reporting.
    @every(CLOCK_S, clock="local")
    def publish_clock(self) -> None:
        """Publish robot time, for everybody to follow."""
        clock = self._clock
        self.publish(
            topics.CLOCK, Clock(stamp_ns=self.stamp_ns, rate=clock.rate, epoch=clock.epoch)
        )

    @gets(topics.TF, "base_link")
    def odometry_frame(self, _: dict[str, str]) -> dict[tuple[str, ...], Transform]:
        """Answer `get tf/base_link` from the odometry."""
        frame = Transform(
            stamp_ns=self._track.stamp_ns,
            parent="odom",
            child="base_link",
            pose=self._track.odom_T_base,
        )
        return {("base_link",): frame}

    def _introduce(self, now_ns: int) -> None:
        """Publish what does not change during a run."""
        simulated = self._simulated is not None
        robot = robot_message(
            self._config, self._footprint, self._limits, self._mesh, now_ns, simulated=simulated
        )
        self.publish(topics.ROBOT, robot)
        laser = Transform(
            stamp_ns=now_ns,
            parent="base_link",
            child="laser",
            pose=self._device.base_T_laser,
            z=self._config.base.lidar.z_m,
        )
        self.publish(topics.TF, laser, "laser")

    def _report(self, now_ns: int) -> None:
        if self._command_beat.is_due(now_ns):
            self._publish_command(now_ns)
        if self._state_beat.is_due(now_ns) or self._state_has_changed(now_ns):
            self._publish_state(now_ns)
        if self._world is not None:
            self._world.tell(now_ns)
        if self._time_beat.is_due(now_ns):
            self._save(TIME_FILE, SavedTime(stamp_ns=now_ns))

    def _publish_odometry(self) -> None:
        track = self._track
        self.publish(
            topics.ODOM,
            Odometry(stamp_ns=track.stamp_ns, pose=track.odom_T_base, twist=track.twist),
        )

    def _publish_scan(self, scan: LidarScan) -> None:
        message = Scan(
            stamp_ns=scan.stamp_ns,
            frame="laser",
            angle_min=scan.angle_min,
            angle_increment=scan.angle_increment,
            time_increment=scan.time_increment,
            range_min=scan.range_min,
            range_max=scan.range_max,
            ranges=floats_to_bytes(scan.ranges),
            intensities=floats_to_bytes(scan.intensities),
        )
        self.publish(topics.SCAN, message)

    def _publish_command(self, now_ns: int) -> None:
        decision = self._decision
        command = VelocityCommand(
            stamp_ns=now_ns, twist=decision.twist, valid_for=COMMAND_S, scan_ns=decision.scan_ns
        )
        self.publish(topics.CMD_VEL, command)

    def _state_at(self, now_ns: int) -> BaseState:
        decision = self._decision
        return BaseState(
            stamp_ns=now_ns,
            mode=decision.mode,
            source=decision.source,
            reason=decision.reason,
            message=decision.message,
            links=[self._chassis_reading.link, self._lidar_link],
            battery=self._battery,
        )

    def _state_has_changed(self, now_ns: int) -> bool:
        """Whether there is something new to say; the charge alone waits for the next second."""
        last = self._published_state
        state = self._state_at(now_ns)
        return last is None or state != msgspec.structs.replace(
            last, stamp_ns=now_ns, battery=state.battery
        )

    def _publish_state(self, now_ns: int) -> BaseState:
        state = self._published_state = self._state_at(now_ns)
        self.publish(topics.BASE, state)
        self._tell_health(now_ns)
        return state

    def _tell_health(self, now_ns: int) -> None:
        decision = self._decision
        # The first scan takes a revolution, which is no trouble yet.
        has_begun = now_ns - self._clock.epoch > SCAN_SILENCE_NS
        troubles = (codes.SCAN_LOST, codes.LINK_LOST)
        if decision.mode == "fault" or (has_begun and decision.reason in troubles):
            self.set_health("degraded", decision.message)
        elif self._clock.is_slowed:
            self.set_health(
                "degraded",
                f"This machine is too slow for the wanted rate; it runs at {self._clock.rate:.2g}.",
            )
        elif self._recorded is not None and self._recorded.has_ended:
            self.set_health("ok", "The recording has ended; the robot stands where it ended.")
        else:
            self.set_health("ok")

    @every(SAVE_WORLD_S, clock="local")
    def save_world(self) -> None:
        """Keep where a simulated robot stands."""
        if self._world is not None:
            self._world.save()

    # Saving.
    def _save(
        self, name: str, value: msgspec.Struct, then: Callable[[bool], None] = lambda _: None
    ) -> None:
        folder = self.state

        def write() -> str | None:
            try:
                folder.write(name, value)
            except OSError as error:
                return f"{folder.path / name}: {error.strerror}"
            return None

        def written(problem: str | None) -> None:
            if problem is not None:
                self.count("state/not_saved")
                self.log.limited("not_saved", codes.SENTENCES[codes.NOT_SAVED], why=problem)
            then(problem is None)

        self.work(write, written)
