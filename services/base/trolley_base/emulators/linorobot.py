"""A board with the firmware of linorobot (Teensy, ROS 1), as it ships.

Two driven wheels, GY-85 inertial unit, `DEBUG 1`. It is silent until the host asks for its topics,
stops publishing if the time that it requests every 2.5 s has not come for 11 s, and stops the
wheels after 400 ms without a command. Its log lines need no session.

Source:
    linorobot teensy/firmware/src/firmware.ino, lib/encoder, lib/kinematics; lino_msgs.
"""

import math
import struct
from dataclasses import dataclass

import numpy as np

from trolley.geometry import Twist2D
from trolley_base.differential import sides_of
from trolley_base.emulators import rosserial
from trolley_base.emulators.device import Board
from trolley_base.emulators.inertial import InertialUnit
from trolley_base.emulators.rosserial import Message, Receiver, encode, encode_string
from trolley_base.emulators.surroundings import EmulatedBoard
from trolley_base.units import NS_PER_MS
from trolley_base.world import STEP_NS, Simulation

TEENSY_BAUD = 57600
PID, CMD_VEL, RAW_VEL, RAW_IMU = 100, 101, 125, 126
TYPES = {
    RAW_VEL: ("raw_vel", "lino_msgs/Velocities", "0ee8ad4cb7809be2d5a0a76352fea86a"),
    RAW_IMU: ("raw_imu", "lino_msgs/Imu", "275110405f08e1b7c0c0f1aba3e19c67"),
    PID: ("pid", "lino_msgs/PID", "a559df187bdf63f426d5f304b6b28bb4"),
    CMD_VEL: ("cmd_vel", "geometry_msgs/Twist", "9f195f881246fdfa2798d1d3eebca84a"),
}
"""Topics in the order in which they are announced: name, type, md5."""
WRONG_MD5 = "0" * 32
CONTROL_NS, DEBUG_NS = 50 * NS_PER_MS, 200 * NS_PER_MS
WATCHDOG_NS = 400 * NS_PER_MS
SYNC_NS, SYNC_LOST_NS = 2_500 * NS_PER_MS, 11_000 * NS_PER_MS
INFO, FATAL = 1, 4
WHEEL_M, TRACK_M, TICKS = 0.10, 0.235, 1550
"""lino_base_config.h: wheel diameter, distance between the wheels, ticks per revolution."""
LEAP_RPM, LEAP_NS = 1800, 1_000 * NS_PER_MS
"""Speed that a leap of one wheel reports [rpm], which the firmware does not check, and its period
[ns]."""
GYRO_BIAS_STD, GYRO_NOISE = 0.01, 0.003
"""Zero-rate error of this unit, and noise of each reading [rad/s]."""
FIELD_T = (20e-6, -45e-6)
"""The earth's magnetic field: towards north (+x of the map) and up."""


@dataclass(frozen=True, slots=True)
class LinorobotOptions:
    """How the firmware was built.

    Attributes:
        truncates: its wheel speeds are whole revolutions per minute, as shipped.
        debug: it logs its four encoders five times a second, as shipped.
        has_imu: an inertial unit answers; without one it complains 20 times a second.
    """

    truncates: bool = True
    debug: bool = True
    has_imu: bool = True


class Linorobot(Board):
    """The board; see the module.

    Args:
        options: how the firmware was built.
        rng: the inertial unit's errors.
    """

    def __init__(self, options: LinorobotOptions, rng: np.random.Generator) -> None:
        super().__init__(TEENSY_BAUD, 0.5 * TRACK_M)
        self.inertial = InertialUnit(GYRO_BIAS_STD, GYRO_NOISE, rng)
        self.says_nan = False
        """Fault: its speeds are not numbers."""
        self.has_wrong_md5 = False
        """Fault: another firmware, whose `raw_vel` has another layout."""
        self._options = options
        self.restart(0)

    def restart(self, now_ns: int) -> None:
        """Boot: no session, wheels standing, encoders at zero."""
        self.motors.stand()
        self._receiver = Receiver()
        self._configured = self._was_connected = False
        self._asked_ns = self._answered_ns = now_ns
        self._requested = self._applied = Twist2D.zero()
        self._commanded_ns = now_ns
        self._control_ns = self._debug_ns = now_ns
        self._leapt_ns = now_ns
        self._travel_m = [0.0, 0.0]
        self._counted = [0.0, 0.0]
        self.inertial.restart()
        self._raw_vel = self._raw_imu = b""

    def wheels(self) -> Twist2D:
        """Return what the speed control was last told."""
        return self._applied

    def receive(self, data: bytes, now_ns: int) -> None:
        """Take what the host wrote; frames must be whole within 20 ms."""
        for message in self._receiver.take(data, now_ns):
            self._take(message, now_ns)
        if self._receiver.too_long:
            self._receiver.too_long = 0
            self._remarks.append(
                f"the host sent a frame of over {rosserial.BUFFER_BYTES} bytes: a real board's "
                "memory is overwritten"
            )

    def _take(self, message: Message, now_ns: int) -> None:
        match message.topic:
            case rosserial.PUBLISHER:
                self._negotiate(now_ns)
            case rosserial.TIME:
                self._answered_ns = now_ns
            case rosserial.STOP:
                self._configured = False
                self._remarks.append("the host ended the session")
            case _ if message.topic == CMD_VEL and len(message.payload) == 48:
                vx, _, _, _, _, wz = struct.unpack("<6d", message.payload)
                self._requested, self._commanded_ns = Twist2D(vx, 0.0, wz), now_ns
                self._keep(now_ns, self._requested)
            case _ if message.topic == PID and len(message.payload) == 12:
                p, d, i = struct.unpack("<3f", message.payload)
                self._remarks.append(f"gains p = {p:g}, i = {i:g}, d = {d:g}")
            case _:
                self._remarks.append(
                    f"the host sent {len(message.payload)} bytes to topic {message.topic}, which "
                    "was not announced so: a real board crashes"
                )

    def _negotiate(self, now_ns: int) -> None:
        self._ask_time(now_ns)
        for topic, (name, kind, md5) in TYPES.items():
            channel = rosserial.PUBLISHER if topic >= RAW_VEL else rosserial.SUBSCRIBER
            sent_md5 = WRONG_MD5 if self.has_wrong_md5 and topic == RAW_VEL else md5
            self._send(now_ns, encode(channel, rosserial.topic_info(topic, name, kind, sent_md5)))
        self._configured = True
        self._answered_ns = now_ns
        self._remarks.append("the host asked for the topics")
        if not self._was_connected:
            self._was_connected = True
            self._log(now_ns, INFO, "LINOBASE CONNECTED")

    def _ask_time(self, now_ns: int) -> None:
        self._send(now_ns, encode(rosserial.TIME, bytes(8)))
        self._asked_ns = now_ns

    def _log(self, now_ns: int, level: int, text: str) -> None:
        self._send(now_ns, encode(rosserial.LOG, bytes([level]) + encode_string(text)))

    def step(self, simulation: Simulation, from_ns: int, to_ns: int) -> None:
        """Turn the wheels one step further; every 50 ms control, report, and log."""
        twist = self.motors.counted(simulation.take_motion().twist)
        for wheel, speed in enumerate(sides_of(twist, 0.5 * TRACK_M)):
            self._travel_m[wheel] += speed * STEP_NS * 1e-9
        if not self._was_connected:
            return
        if self._configured and to_ns - self._answered_ns > SYNC_LOST_NS:
            self._configured = False
            self._remarks.append("no time from the host for 11 s: the session has ended")
        if to_ns - self._control_ns >= CONTROL_NS:
            elapsed_ns, self._control_ns = to_ns - self._control_ns, to_ns
            self._control(simulation, elapsed_ns, to_ns)
        if self._options.debug and to_ns - self._debug_ns >= DEBUG_NS:
            self._debug_ns = to_ns
            self._log_encoders(to_ns)
        if self._configured and to_ns - self._asked_ns > SYNC_NS:
            self._ask_time(to_ns)

    def _control(self, simulation: Simulation, elapsed_ns: int, now_ns: int) -> None:
        if now_ns - self._commanded_ns >= WATCHDOG_NS:
            self._requested = Twist2D.zero()
        self._applied = self._requested
        velocities = self._velocities(elapsed_ns)
        reading = self._inertial(simulation, elapsed_ns) if self._options.has_imu else b""
        if not self.is_stuck or not self._raw_vel:
            self._raw_vel, self._raw_imu = velocities, reading
        if self._configured:
            self._send(now_ns, encode(RAW_VEL, self._raw_vel))
        if not self._options.has_imu:
            self._log(now_ns, FATAL, "IMU failed to initialize. Check your IMU connection.")
        elif self._configured:
            self._send(now_ns, encode(RAW_IMU, self._raw_imu))

    def _velocities(self, elapsed_ns: int) -> bytes:
        """Count ticks, make whole revolutions per minute of them, and velocities of these."""
        rpm = [0.0, 0.0]
        for wheel, travel_m in enumerate(self._travel_m):
            turns = travel_m / (math.pi * WHEEL_M)
            count = math.floor(turns * TICKS) / TICKS if self._options.truncates else turns
            rpm[wheel] = (count - self._counted[wheel]) / (elapsed_ns / 60e9)
            if self.leaps and self._leap_due():
                rpm[wheel] += LEAP_RPM
            if self._options.truncates:
                rpm[wheel] = math.trunc(rpm[wheel])
            self._counted[wheel] = count
        metres_per_turn = math.pi * WHEEL_M / (2 * 60)
        vx = metres_per_turn * (rpm[1] + rpm[0])
        wz = metres_per_turn * (rpm[1] - rpm[0]) / (0.5 * TRACK_M)
        if self.says_nan:
            return struct.pack("<3f", math.nan, 0.0, wz)
        return struct.pack("<3f", vx, 0.0, wz)

    def _leap_due(self) -> bool:
        """Whether a second has passed since the last leap."""
        is_due = self._control_ns - self._leapt_ns >= LEAP_NS
        if is_due:
            self._leapt_ns = self._control_ns
        return is_due

    def _inertial(self, simulation: Simulation, elapsed_ns: int) -> bytes:
        """Read the inertial unit and the compass."""
        state = simulation.truth()
        self.inertial.move(state, elapsed_ns * 1e-9)
        gyro, acceleration = self.inertial.read()
        yaw = state.pose.yaw
        field = (FIELD_T[0] * math.cos(yaw), -FIELD_T[0] * math.sin(yaw), FIELD_T[1])
        return struct.pack("<9d", *acceleration, *gyro, *field)

    def _log_encoders(self, now_ns: int) -> None:
        left, right = (math.floor(turns * TICKS) for turns in self._counted)
        counts = {"FrontLeft ": left, "FrontRight": right, "RearLeft  ": 0, "RearRight ": 0}
        for place, count in counts.items():
            self._log(now_ns, INFO, f"Encoder {place} : {count}")


BOARDS = {
    "linorobot": EmulatedBoard(
        lambda options, _, rng: Linorobot(
            LinorobotOptions(
                truncates="exact" not in options,
                debug="quiet" not in options,
                has_imu="no-imu" not in options,
            ),
            rng,
        ),
        {
            "exact": "its wheel speeds are not rounded to whole revolutions per minute",
            "quiet": "built without DEBUG: no log lines",
            "no-imu": "no inertial unit answers",
        },
    )
}
