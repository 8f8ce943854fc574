"""A board with the firmware of linorobot2 (micro-ROS), as it ships.

Two driven wheels, an inertial unit, a battery; a sonar where one is wired. It looks for an agent
twice a second, and creates its objects one after the other. It gives up where one is not answered
within a second: it blinks until its hardware watchdog, if the firmware was built with one, restarts
it. Then it controls its
wheels and reports 50 times a second, or as fast as each report is acknowledged. It stops its wheels
200 ms after the last command; but where a ping is not answered within 100 ms it gives its session
up, and the wheels go on until it has an agent again.

Source:
    linorobot2_hardware, firmware/src/firmware.cpp (7f78317) and firmware.ino (040820d, of 2021);
    lib/odometry, lib/imu, lib/battery, lib/range.
"""

import math
from collections.abc import Generator
from dataclasses import dataclass

import numpy as np

from trolley.geometry import Pose2D, Twist2D
from trolley_base.differential import sides_of
from trolley_base.emulators import micro_ros
from trolley_base.emulators.device import Board
from trolley_base.emulators.inertial import InertialUnit
from trolley_base.emulators.micro_ros import Cdr, MicroRosClient, Publisher, Sleep, object_id
from trolley_base.emulators.sonar import nearest_m
from trolley_base.emulators.surroundings import EmulatedBoard
from trolley_base.units import NS_PER_MS
from trolley_base.world import STEP_NS, Simulation

BAUD, FAST_BAUD = 115200, 921600
BOOT_NS = 3_000 * NS_PER_MS
"""It calibrates its gyro for 2 s, standing."""
WHEEL_M, TRACK_M, TICKS = 0.10, 0.235, 1550
CONTROL_NS, REPORT_2021_NS, BATTERY_NS = 20 * NS_PER_MS, 50 * NS_PER_MS, 2_000 * NS_PER_MS
WATCHDOG_NS = 200 * NS_PER_MS
SEARCH_NS, PING_NS, PING_WAIT_NS = 500 * NS_PER_MS, 200 * NS_PER_MS, 100 * NS_PER_MS
PING_2021_NS, PING_WAIT_2021_NS = 100 * NS_PER_MS, 50 * NS_PER_MS
NEVER = 1 << 62
WDT_NS = 10_000 * NS_PER_MS
"""WDT_TIMEOUT, here shorter than the 60 s of an ESP32's configurations."""
LEAP_MPS, LEAP_NS = 11.0, 1_000 * NS_PER_MS
GYRO_BIAS_STD, GYRO_NOISE, GYRO_DEAD = 0.003, 0.002, 0.01
"""What is left of its zero-rate error, noise, and what it reports as 0 [rad/s]."""
VOLTS = 11.8
SONAR_MOUNT, SONAR_NS = Pose2D(0.15, 0.0, 0.0), 100 * NS_PER_MS
SONAR_CONE, SONAR_MIN_M, SONAR_MAX_M = 15 * 0.0174533, 0.02, 0.00034 * 5000 / 2 * 0.95
SENSOR, NAV, GEOMETRY = "sensor_msgs", "nav_msgs", "geometry_msgs"


@dataclass(frozen=True, slots=True)
class Linorobot2Options:
    """How the firmware was built.

    Attributes:
        is_uart: an ESP32 behind a serial adapter at 115200 baud, else a board on native USB.
        is_fast: that adapter at 921600 baud.
        stops: it stops its motors when it has lost its agent, as hippo5329's fork does.
        is_of_2021: the first version: reports 20 times a second without acknowledgement, stops when
            it has lost its agent.
        has_wdt: built with WDT_TIMEOUT: it restarts when it has given up.
        has_sonar: built with TRIG_PIN; without one it reports zeros all the same.
    """

    is_uart: bool = False
    is_fast: bool = False
    stops: bool = False
    is_of_2021: bool = False
    has_wdt: bool = True
    has_sonar: bool = False


class SpeedControl:
    """The wheels as the firmware drives and counts them, and the watchdog over them.

    Args:
        is_of_2021: it takes no notice of the first command after a silence.
        now_ns: when it begins, standing.
    """

    def __init__(self, is_of_2021: bool, now_ns: int) -> None:
        self._skips_first = is_of_2021
        self.applied = Twist2D.zero()
        """What the wheels were last told."""
        self.velocities = (0.0, 0.0)
        """What they were last counted to do [m/s, rad/s]."""
        self._requested = Twist2D.zero()
        self._commanded_ns = now_ns - WATCHDOG_NS
        self._is_first = False
        self._travel_m = [0.0, 0.0]
        self._counted = [0, 0]
        self._counted_ns = self._leapt_ns = now_ns

    def turn(self, twist: Twist2D) -> None:
        """Turn the wheels by one step of the world."""
        for wheel, speed in enumerate(sides_of(twist, 0.5 * TRACK_M)):
            self._travel_m[wheel] += speed * STEP_NS * 1e-9

    def command(self, twist: Twist2D, now_ns: int) -> None:
        """Take a command."""
        self._is_first = now_ns - self._commanded_ns >= WATCHDOG_NS
        self._requested, self._commanded_ns = twist, now_ns

    def stop(self) -> None:
        """Stop the wheels until the next command."""
        self._requested = self.applied = Twist2D.zero()

    def run(self, now_ns: int, *, leaps: bool) -> None:
        """Apply the newest command, if it is not too old, and count.

        Args:
            now_ns: the board's time.
            leaps: the count of one wheel leaps once a second.
        """
        is_late = now_ns - self._commanded_ns >= WATCHDOG_NS
        if is_late or (self._skips_first and self._is_first):
            self._requested = Twist2D.zero()
        self._is_first = False
        self.applied = self._requested
        seconds = (now_ns - self._counted_ns) * 1e-9
        if seconds <= 0.0:
            return
        self._counted_ns = now_ns
        speeds: list[float] = []
        for wheel, travel_m in enumerate(self._travel_m):
            count = math.floor(travel_m / (math.pi * WHEEL_M) * TICKS)
            turns = (count - self._counted[wheel]) / TICKS
            self._counted[wheel] = count
            speeds.append(turns * math.pi * WHEEL_M / seconds)
        left, right = speeds
        if leaps and now_ns - self._leapt_ns >= LEAP_NS:
            self._leapt_ns = now_ns
            right += LEAP_MPS
        self.velocities = (0.5 * (left + right), (right - left) / TRACK_M)


class Linorobot2(Board):
    """The board; see the module. On Wi-Fi it sends to its agent's port.

    Args:
        options: how the firmware was built.
        rng: the inertial unit's errors, and the sessions' keys.
    """

    calls_host = True

    def __init__(self, options: Linorobot2Options, rng: np.random.Generator) -> None:
        super().__init__(FAST_BAUD if options.is_fast else BAUD, 0.5 * TRACK_M)
        self.is_usb = not (options.is_uart or options.is_fast)
        self.inertial = InertialUnit(GYRO_BIAS_STD, GYRO_NOISE, rng)
        self.says_nan = False
        """Fault: its speeds are not numbers."""
        self.has_wrong_md5 = False
        """Fault: another firmware, whose `cmd_vel` has a stamp."""
        self._options = options
        self._rng = rng
        self._client = MicroRosClient(lambda data: self._send(self._client.now_ns, data))
        self._client.on_data = self._take_data
        self.restart(0)

    @property
    def stops_by_itself(self) -> bool:
        """Whether it stops its motors when it has lost its agent."""
        return self._options.stops or self._options.is_of_2021

    def restart(self, now_ns: int) -> None:
        """Boot: no session, wheels standing, encoders at zero."""
        self.motors.stand()
        self.inertial.restart()
        self._control = SpeedControl(self._options.is_of_2021, now_ns)
        self._arrived: Twist2D | None = None
        self._odometry = b""
        self._battery_ns = self._sonar_ns = now_ns
        self._ahead_m = math.inf
        self._client.now_ns = now_ns
        self._client.begin(0)
        self._must_restart = False
        self._sketch = self._run(BOOT_NS)
        self._wake_ns = now_ns

    def join_another_agent(self) -> None:
        """Fault: it is in a session with another agent, which has just ended."""
        self._client.begin(int(self._rng.integers(1, 1 << 31)))
        self._client.resume(int(self._rng.integers(1 << 16)), int(self._rng.integers(1 << 16)))
        self._sketch = self._run_connected()
        self._wake_ns = self._client.now_ns

    def wheels(self) -> Twist2D:
        """Return what the speed control was last told."""
        return self._control.applied

    def receive(self, data: bytes, now_ns: int) -> None:
        """Take what the host wrote."""
        self._client.now_ns = max(now_ns, self._client.now_ns)
        if self._client.receive(data):
            self._wake_ns = self._client.now_ns
            self._go_on()

    def step(self, simulation: Simulation, from_ns: int, to_ns: int) -> None:
        """Turn the wheels one step further, and run the sketch up to its end."""
        self._control.turn(self.motors.counted(simulation.take_motion().twist))
        self.inertial.move(simulation.truth(), (to_ns - from_ns) * 1e-9)
        if self._options.has_sonar:
            self._ahead_m = nearest_m(simulation, SONAR_MOUNT, SONAR_CONE, SONAR_MAX_M)
        self._client.now_ns = max(to_ns, self._client.now_ns)
        self._go_on()

    def _go_on(self) -> None:
        while self._wake_ns <= self._client.now_ns:
            self._wake_ns = next(self._sketch)
            if self._must_restart:
                self.restart(self._client.now_ns)

    # The sketch: what yields sleeps until then.
    def _run(self, boot_ns: int) -> Generator[int]:
        yield self._client.now_ns + boot_ns
        while True:
            waits_ns = PING_WAIT_2021_NS if self._options.is_of_2021 else PING_WAIT_NS
            if not (yield from self._client.ping(waits_ns, 1)):
                yield self._client.now_ns + SEARCH_NS
                continue
            self._client.begin(int(self._rng.integers(1, 1 << 31)))
            if not (yield from self._create_entities()):
                self._remarks.append("it has given up, since it was not answered within a second")
                yield self._client.now_ns + (WDT_NS if self._options.has_wdt else NEVER)
                self._remarks.append("its watchdog restarts it")
                self._must_restart = True
                yield NEVER
            self._remarks.append("it has an agent")
            yield from self._run_session()

    def _run_connected(self) -> Generator[int]:
        self._name_publishers()
        yield from self._run_session()
        yield from self._run(0)

    def _run_session(self) -> Generator[int]:
        """Control and report until a ping is not answered."""
        client, is_old = self._client, self._options.is_of_2021
        ping_ns, waits_ns, attempts = (
            (PING_2021_NS, PING_WAIT_2021_NS, 2) if is_old else (PING_NS, PING_WAIT_NS, 1)
        )
        report_ns = REPORT_2021_NS if is_old else CONTROL_NS
        next_ping_ns, next_control_ns = client.now_ns + ping_ns, client.now_ns
        next_report_ns = client.now_ns
        while True:
            yield from client.wait(0)
            if self._arrived is not None:
                self._control.command(self._arrived, client.now_ns)
                self._arrived = None
            if client.now_ns >= next_control_ns:
                next_control_ns = client.now_ns + CONTROL_NS
                self._control.run(client.now_ns, leaps=self.leaps)
                if client.now_ns >= next_report_ns:
                    next_report_ns = client.now_ns + report_ns
                    yield from self._publish_data()
            if client.now_ns >= next_ping_ns:
                if not (yield from client.ping(waits_ns, attempts)):
                    break
                next_ping_ns = client.now_ns + ping_ns
            yield max(client.now_ns, min(next_ping_ns, next_control_ns))
        self._remarks.append("it has lost its agent")
        if self.stops_by_itself:
            self._control.stop()
        client.close()

    def _name_publishers(self) -> None:
        is_reliable = not self._options.is_of_2021
        self._publishers = {
            name: Publisher(object_id(micro_ros.WRITER, number), is_reliable)
            for number, name in enumerate(self._published())
        }

    def _published(self) -> dict[str, str]:
        topics = {"odom/unfiltered": f"{NAV}::Odometry", "imu/data": f"{SENSOR}::Imu"}
        if not self._options.is_of_2021:
            topics |= {
                "imu/mag": f"{SENSOR}::MagneticField",
                "battery": f"{SENSOR}::BatteryState",
                "ultrasound": f"{SENSOR}::Range",
            }
        return topics

    def _create_entities(self) -> Sleep:
        client = self._client
        participant = object_id(micro_ros.PARTICIPANT, 0)
        if not (yield from client.open()):
            return False
        if not (yield from client.create(micro_ros.PARTICIPANT, 0, bytes(2), b"\0\0")):
            return False
        self._name_publishers()
        topics = self._published() | {"cmd_vel": f"{GEOMETRY}::Twist"}
        if self.has_wrong_md5:
            topics["cmd_vel"] = f"{GEOMETRY}::TwistStamped"
        for number, (name, kind) in enumerate(topics.items()):
            is_read = name == "cmd_vel"
            package, message = kind.split("::")
            # No type's reference, but its name.
            named = Cdr().text(f"rt/{name}").put("2B", 0, 1)
            named.text(f"{package}::msg::dds_::{message}_")
            topic = object_id(micro_ros.TOPIC, number)
            quality = topic + b"\1\0\0\0" + bytes(8)
            for kind_of, place, inner, parent in (
                (micro_ros.TOPIC, number, named.data, participant),
                (
                    micro_ros.SUBSCRIBER if is_read else micro_ros.PUBLISHER,
                    0 if is_read else number,
                    bytes(2),
                    participant,
                ),
                (
                    micro_ros.READER if is_read else micro_ros.WRITER,
                    0 if is_read else number,
                    quality,
                    object_id(micro_ros.SUBSCRIBER, 0)
                    if is_read
                    else object_id(micro_ros.PUBLISHER, number),
                ),
            ):
                if not (yield from client.create(kind_of, place, inner, parent)):
                    return False
        stream = micro_ros.BEST_EFFORT_STREAM
        if not self._options.is_of_2021:
            stream = micro_ros.RELIABLE_STREAM
        client.request_data(object_id(micro_ros.READER, 0), stream)
        return (yield from client.synchronize())

    def _take_data(self, reader: bytes, body: bytes) -> None:
        if reader != object_id(micro_ros.READER, 0) or len(body) < 48:
            self._remarks.append(f"the host sent {len(body)} bytes to reader {reader.hex()}")
            return
        vx, _, _, _, _, wz = np.frombuffer(body[:48], "<f8")
        self._arrived = Twist2D(float(vx), 0.0, float(wz))
        self._keep(self._client.now_ns, self._arrived)

    def _publish_data(self) -> Sleep:
        client = self._client
        if client.epoch_ns is None:
            client.epoch_ns = 0
        told_ns = client.now_ns + client.epoch_ns
        stamp = told_ns // NS_PER_MS * NS_PER_MS
        yield from client.publish(self._publishers["imu/data"], self._imu(stamp))
        if "imu/mag" in self._publishers:
            field = _header(stamp, "imu_link").put("12d", 2e-5, 0.0, -4.5e-5, *[0.0] * 9).data
            yield from client.publish(self._publishers["imu/mag"], field)
        if not self.is_stuck or not self._odometry:
            self._odometry = self._odometry_at(stamp)
        yield from client.publish(self._publishers["odom/unfiltered"], self._odometry)
        if "battery" in self._publishers and client.now_ns - self._battery_ns >= BATTERY_NS:
            self._battery_ns = client.now_ns
            yield from client.publish(self._publishers["battery"], _battery(stamp))
        if "ultrasound" in self._publishers and client.now_ns - self._sonar_ns >= SONAR_NS:
            self._sonar_ns = client.now_ns
            yield from client.publish(self._publishers["ultrasound"], self._range(stamp))
        return True

    def _odometry_at(self, stamp: int) -> bytes:
        vx, wz = self._control.velocities
        if self.says_nan:
            vx = math.nan
        pose, covariance = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0), [0.001] + [0.0] * 35
        told = _header(stamp, "odom").text("base_footprint")
        return told.put("85d", *pose, *covariance, vx, 0.0, 0.0, 0.0, 0.0, wz, *covariance).data

    def _range(self, stamp: int) -> bytes:
        if not self._options.has_sonar:
            return _header(stamp, "").put("B", 0).put("4f", 0.0, 0.0, 0.0, 0.0).data
        told = _header(stamp, "sonar_link").put("B", 0)
        return told.put("4f", SONAR_CONE, SONAR_MIN_M, SONAR_MAX_M, self._ahead_m).data

    def _imu(self, stamp: int) -> bytes:
        gyro, forces = self.inertial.read()
        rates = [0.0 if abs(rate) < GYRO_DEAD else float(rate) for rate in gyro]
        zeros = [0.0] * 9
        told = _header(stamp, "imu_link")
        return told.put("37d", 0.0, 0.0, 0.0, 1.0, *zeros, *rates, *zeros, *forces, *zeros).data


def _header(stamp_ns: int, frame: str) -> Cdr:
    seconds, rest = divmod(stamp_ns, 1_000_000_000)
    return Cdr().put("i", seconds).put("I", rest).text(frame)


def _battery(stamp_ns: int) -> bytes:
    told = _header(stamp_ns, "").put("7f", VOLTS, math.nan, *[math.nan] * 4, math.nan)
    return told.put("4B", 0, 0, 0, 1).put("I", 0).put("I", 0).text("").text("").data


BOARDS = {
    "linorobot2": EmulatedBoard(
        lambda options, _, rng: Linorobot2(
            Linorobot2Options(
                is_uart="uart" in options,
                is_fast="fast" in options,
                stops="stops" in options,
                is_of_2021="2021" in options,
                has_wdt="no-wdt" not in options,
                has_sonar="sonar" in options,
            ),
            rng,
        ),
        {
            "uart": "an ESP32 behind a serial adapter at 115200 baud; else on USB of its own",
            "fast": "the same at 921600 baud, as a fork has it",
            "stops": "it stops its motors when it has lost its agent, as a fork does",
            "no-wdt": "nothing restarts it when it has given up",
            "sonar": "with a sonar at its front",
            "2021": "the first version, whose reports are not acknowledged",
        },
    )
}
