"""A base of one's own in place of Trolley's: wheels and a lidar whose program speaks the wire.

Run the others without it, and this beside them:

    trolley up --without base
    python examples/own_base.py

No other service can stop the robot now. The limits, the stop field, the latch of a stop, and
standing still once commands or scans cease are this program's duty; what Trolley's base does beyond
them is in docs/own-base.md. Wheels and lidar are imaginary: put yours in the place of
`ImaginaryRobot`, which drives without errors between the walls of the map that robot.toml names.
"""

import math

import numpy as np
from msgspec import Struct, structs
from numpy.typing import NDArray

from trolley import codes, requests, topics
from trolley.config import ConfigError, RobotConfig
from trolley.geometry import Pose2D, Twist2D, footprint_from_radius, integrate_twist
from trolley.gridmap import MapError, cast_rays, load_map
from trolley.messages import BaseState, Clock, Odometry, Robot, Scan, Transform, VelocityCommand
from trolley.messages.request_params import Nothing
from trolley.messages.types import floats_to_bytes
from trolley.runtime.service import Later, Service, answers, every, on

CONTROL_S, SAVE_S = 0.02, 60.0
"""Periods of control and odometry, and of saving robot time [s]."""
LONGEST_RAMP_S = 0.1
"""After a pause of the program the speed may leap by no more than in this time [s]."""
LONGEST_VALID_NS = OLDEST_NS = 500_000_000
"""No command holds for longer, and one that took longer to arrive does not count [ns]."""
FARTHEST_AHEAD_NS = 200_000_000
"""Nor does one whose stamp is ahead by more [ns]."""
SCAN_SILENCE_NS = 500_000_000
"""The robot stands when the newest scan is older [ns]."""
REACTION_S = 0.2
"""How long the robot drives on before it brakes: a scan's period, and what the wheels take [s]."""
BESIDE_M = 0.02
"""It drives past what is farther than this beside it [m]; the margin ahead is robot.toml's."""
BEAMS, RANGE_MAX, LASER = 360, 8.0, Pose2D(0.0, 0.0, 0.0)
"""The lidar: its beams, its reach [m], and base_T_laser."""
STATE_FILE = "own_base.toml"
STOPPED = "Stopped. `trolley resume` lets it drive."


class Saved(Struct, frozen=True, kw_only=True):
    """What outlives the program: robot time, which never goes back, and a stop."""

    stamp_ns: int
    stopped: bool


class ImaginaryRobot:
    """What the hardware would be: wheels that obey at once, and a lidar."""

    def __init__(self, config: RobotConfig) -> None:
        file, start = config.map.file, config.start.pose
        if file is None or start is None or isinstance(start, str):
            raise ConfigError("This robot drives on the map: give [map] file and [start] pose.")
        try:
            grid = load_map(config.path(file))
        except MapError as error:
            raise ConfigError(f"[map] {error}") from error
        self._walls, self._cell_m = grid.occupied_mask(), grid.resolution
        self._grid_T_base = grid.origin.inverse() @ start.as_pose()
        self.odom_T_base, self.twist = Pose2D(0.0, 0.0, 0.0), Twist2D.zero()

    def command(self, twist: Twist2D) -> None:
        """Let the wheels turn so from now on."""
        self.twist = twist

    def read_encoders(self, seconds: float) -> None:
        """Follow how far the wheels have turned in the time since they were read last."""
        self._grid_T_base = integrate_twist(self._grid_T_base, self.twist, seconds)
        self.odom_T_base = integrate_twist(self.odom_T_base, self.twist, seconds)

    def read_lidar(self) -> NDArray[np.float32] | None:
        """Return its newest revolution [m], counter-clockwise from ahead; None if none came."""
        laser = self._grid_T_base @ LASER
        angles = laser.yaw + np.arange(BEAMS) * (2.0 * math.pi / BEAMS)
        return cast_rays(self._walls, self._cell_m, (laser.x, laser.y), angles, RANGE_MAX)


class RobotTime:
    """Robot time, the clock of all stamps: it goes on from `epoch` with the monotonic clock."""

    epoch, rate = 0, 1.0
    _began_ns: int | None = None

    def begin(self, epoch_ns: int, monotonic_ns: int) -> None:
        """Begin a run."""
        self.epoch, self._began_ns = epoch_ns, monotonic_ns

    def now(self, monotonic_ns: int) -> int | None:
        """Return robot time [ns], None before the run has begun."""
        return None if self._began_ns is None else self.epoch + monotonic_ns - self._began_ns


class Commands:
    """The newest command of each source, and which of them counts."""

    def __init__(self, priorities: dict[str, int]) -> None:
        self._priorities = priorities
        self._newest: dict[str, tuple[VelocityCommand, int]] = {}
        """With robot time until which it holds [ns]."""

    def offer(self, source: str, command: VelocityCommand, now_ns: int) -> str:
        """Take a command that has arrived; return why it does not count, "" if it does."""
        if source not in self._priorities:
            return "unknown_source"
        if not (command.twist.is_finite() and 0.0 < command.valid_for < math.inf):
            return "not_valid"
        if command.stamp_ns < now_ns - OLDEST_NS:
            return "old"
        if command.stamp_ns > now_ns + FARTHEST_AHEAD_NS:
            return "ahead"
        if source in self._newest and command.stamp_ns <= self._newest[source][0].stamp_ns:
            return "out_of_order"
        valid_ns = round(min(command.valid_for * 1e9, LONGEST_VALID_NS))
        self._newest[source] = command, now_ns + max(valid_ns, round(CONTROL_S * 1e9))
        return ""

    def best(self, now_ns: int) -> tuple[str | None, Twist2D]:
        """Return who drives now, and how: without a command that holds, nobody, and zero."""
        holding = [one for one, (_, until_ns) in self._newest.items() if now_ns < until_ns]
        if not holding:
            return None, Twist2D.zero()
        source = max(holding, key=self._priorities.__getitem__)
        return source, self._newest[source][0].twist

    def end_all(self) -> None:
        """Let none hold any more; only what is stamped later can drive again."""
        self._newest = {source: (one, 0) for source, (one, _) in self._newest.items()}


class OwnBase(Service):
    """Owns wheels, lidar and robot time; its name makes it the base for all others."""

    name = "base"
    hears_apart = True  # so that a flood of commands cannot delay a stop

    def __init__(self, config: RobotConfig) -> None:
        radius_m = config.robot.footprint.radius_m
        if radius_m is None:
            raise ConfigError("This robot is round: give [robot] footprint = { radius_m = ... }.")
        self._config, self._limits, self._radius_m = config, config.base.limits, radius_m
        self.hardware = ImaginaryRobot(config)
        self.own_time = self._time = RobotTime()
        self._commands = Commands(config.base.sources)
        self._echoes: NDArray[np.float64] | None = None
        self._scan_ns = self._read_ns = 0
        self._is_stopped = False
        self._state = BaseState(stamp_ns=0, mode="held", reason=codes.SCAN_LOST)

    def prepare(self) -> None:
        """Compile what casts the rays."""
        self.hardware.read_lidar()

    def start(self) -> None:
        """Begin a run after all earlier ones, stopped if the last one was; say who this is."""
        saved = self.state.read(STATE_FILE, Saved)
        # Two minutes, since the saved value may be up to one minute old.
        earliest_ns = 0 if saved is None else saved.stamp_ns + round(2e9 * SAVE_S)
        self._time.begin(max(self.unix_ns, earliest_ns), self.monotonic_ns)
        # A file that cannot be read may have said so.
        self._is_stopped = STATE_FILE in self.state.problems if saved is None else saved.stopped
        self._read_ns = self.stamp_ns
        robot = Robot(
            stamp_ns=self.stamp_ns,
            name=self.robot,
            title=self._config.robot.title or self.robot,
            footprint=[(float(x), float(y)) for x, y in footprint_from_radius(self._radius_m)],
            drive="differential",
            max_speed=self._limits.max_speed_mps,
            max_wz=self._limits.max_wz_radps,
            deceleration=self._limits.deceleration_mps2,
        )
        mount = Transform(
            stamp_ns=self.stamp_ns, parent="base_link", child="laser", pose=LASER, z=0.2
        )
        self.publish_time()
        self.publish(topics.ROBOT, robot)
        self.publish(topics.TF, mount, "laser")
        self.see()
        self.control()
        self.publish_state()

    def stop(self) -> None:
        """Stop the wheels and say that base ends."""
        self.hardware.command(Twist2D.zero())
        self._state = self._say("held", codes.SHUTDOWN)
        self.publish_state()
        self.save_time()

    # Time.

    @every(0.1, clock="local")
    def publish_time(self) -> None:
        """Publish robot time."""
        clock = Clock(stamp_ns=self.stamp_ns, rate=self._time.rate, epoch=self._time.epoch)
        self.publish(topics.CLOCK, clock)

    @every(SAVE_S)
    def save_time(self) -> None:
        """Save robot time, so that the next run begins after this one."""
        self.save(STATE_FILE, Saved(stamp_ns=self.stamp_ns, stopped=self._is_stopped))

    # Commands and stops.

    @on(topics.COMMAND)
    def take_command(self, command: VelocityCommand, source: str) -> None:
        """Keep a command for the next period, or count why it is dropped."""
        why = self._commands.offer(source, command, self._time.now(self.arrived_ns) or 0)
        if why:
            self.count(f"cmd_vel/{why}")

    @answers(requests.BASE_STOP)
    def stop_robot(self, _: Nothing) -> Later[BaseState]:
        """Stop at once; answer when no crash can undo it any more."""
        later: Later[BaseState] = self.later()
        self._switch(is_stopped=True)
        state, saved = self._state, Saved(stamp_ns=self.stamp_ns, stopped=True)

        def answer(error: OSError | None) -> None:
            if error is not None:
                self.count("state/not_saved")
            later.reply(state)

        self.save(STATE_FILE, saved, answer)
        return later

    @answers(requests.BASE_RESUME)
    def resume_robot(self, _: Nothing) -> BaseState:
        """Let commands that come from now on drive again."""
        self._switch(is_stopped=False)
        self.save_time()
        return self._state

    def _switch(self, *, is_stopped: bool) -> None:
        self._is_stopped = is_stopped
        self._commands.end_all()
        self.control()

    # Driving.

    @every(CONTROL_S)
    def control(self) -> None:
        """Read the encoders, command the wheels, and publish both."""
        now_ns, hardware, before = self.stamp_ns, self.hardware, self._state
        seconds, self._read_ns = (now_ns - self._read_ns) * 1e-9, now_ns
        hardware.read_encoders(seconds)
        twist, self._state = self._decide(now_ns, min(seconds, LONGEST_RAMP_S))
        hardware.command(twist)
        odometry = Odometry(stamp_ns=now_ns, pose=hardware.odom_T_base, twist=twist)
        self.publish(topics.ODOM, odometry)
        if structs.replace(before, stamp_ns=self._state.stamp_ns) != self._state:
            self.publish_state()

    def _decide(self, now_ns: int, seconds: float) -> tuple[Twist2D, BaseState]:
        """Return the velocity until the next period, and what to say of it."""
        if self._is_stopped:
            return Twist2D.zero(), self._say("stopped", codes.BUTTON)
        echoes = self._echoes
        if echoes is None or now_ns - self._scan_ns > SCAN_SILENCE_NS:
            return Twist2D.zero(), self._say("held", codes.SCAN_LOST)
        source, twist = self._commands.best(now_ns)
        if source is None:
            return Twist2D.zero(), self._say("ok")
        limits = self._limits
        # Too fast is driven slower on the same arc.
        excess = max(1.0, abs(twist.vx) / limits.max_speed_mps, abs(twist.wz) / limits.max_wz_radps)
        step = seconds * limits.acceleration_mps2
        turn_step = seconds * limits.angular_acceleration_radps2
        vx = _towards(self.hardware.twist.vx, twist.vx / excess, step)
        wz = _towards(self.hardware.twist.wz, twist.wz / excess, turn_step)
        most = self._safe_speed(echoes, math.copysign(1.0, vx))
        twist = Twist2D(max(-most, min(most, vx)), 0.0, wz)
        if vx != 0.0 and most == 0.0:
            return twist, self._say("held", codes.STOP_FIELD, source)
        return twist, self._say("ok", source=source)

    def _safe_speed(self, echoes: NDArray[np.float64], direction: float) -> float:
        """Return the speed from which the robot stands before what is in its way [m/s].

        It looks only straight ahead or behind, hardly wider than the robot is.
        """
        reach = self._radius_m + BESIDE_M
        along, aside = direction * echoes[:, 0], np.abs(echoes[:, 1])
        in_way = (along > 0.0) & (aside < reach)
        free = along[in_way] - np.sqrt(reach**2 - aside[in_way] ** 2)  # until a circle touches it
        margin = self._config.base.stop_margin_m
        distance = max(0.0, float(free.min(initial=RANGE_MAX)) - margin)
        brake = self._limits.deceleration_mps2
        return math.sqrt((brake * REACTION_S) ** 2 + 2.0 * brake * distance) - brake * REACTION_S

    @every(0.1)
    def see(self) -> None:
        """Publish the velocity that is driven, and what the lidar saw."""
        now_ns, ranges = self.stamp_ns, self.hardware.read_lidar()
        driven = VelocityCommand(stamp_ns=now_ns, twist=self.hardware.twist, valid_for=0.1)
        self.publish(topics.CMD_VEL, driven)
        if ranges is None:
            return
        angles = np.arange(BEAMS) * (2.0 * math.pi / BEAMS)
        seen = np.isfinite(ranges) & (ranges > 0.0)
        ends = ranges[seen, None] * np.column_stack([np.cos(angles[seen]), np.sin(angles[seen])])
        self._echoes, self._scan_ns = LASER.transform_points(ends), now_ns
        scan = Scan(
            stamp_ns=now_ns,
            frame="laser",
            angle_min=0.0,
            angle_increment=2.0 * math.pi / BEAMS,
            time_increment=0.0,  # an imaginary lidar measures all at once
            range_min=0.05,
            range_max=RANGE_MAX,
            ranges=floats_to_bytes(ranges),
        )
        self.publish(topics.SCAN, scan)

    # What it says.

    @every(1.0)
    def publish_state(self) -> None:
        """Publish what base does; whoever joins later asks for it."""
        self.publish(topics.BASE, self._state)

    def _say(self, mode: str, reason: str = "", source: str | None = None) -> BaseState:
        sentence = codes.SENTENCES[reason] if reason else ""
        return BaseState(
            stamp_ns=self.stamp_ns,
            mode=mode,  # pyrefly: ignore[bad-argument-type]
            source=source,
            reason=reason,
            message=STOPPED if mode == "stopped" else sentence,
        )


def _towards(now: float, wanted: float, step: float) -> float:
    """Return the next value on the way, no farther than a step."""
    return now + max(-step, min(step, wanted - now))


if __name__ == "__main__":
    from trolley.runtime.process import main

    main(OwnBase)
