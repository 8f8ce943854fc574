"""A board with linorobot2's firmware, unchanged: micro-ROS over a serial line, or UDP.

The firmware pings until an agent answers. It then opens a session, creates its topics
(`odom/unfiltered`, `imu/data`, `battery`, `ultrasound`, `cmd_vel`), asks for the time, and reports
up to 50 times a second, as fast as each report is acknowledged. It stops its motors 0.2 s after the
last `cmd_vel` while it has an agent. **When an agent does not answer within 0.1 s, most versions
give the session up with their motors as they are**, and stop them only when they have one again. So
a ping is answered whatever else is wrong, and who leaves waits until the wheels stand.

Counts, below `chassis/`: `bad_checksum`, `skipped_bytes`, those of the agent, `gaps`, `sessions`
(opened after the first: the board has lost us, or restarted), `not_taken` (commands that found no
room, since the board acknowledges nothing), `sessions_given_up`.

Source:
    linorobot2_hardware 8a95745, 7f78317 and firmware/src/firmware.ino; hippo5329's fork, 26f553f.
"""

import math

import msgspec

from trolley.config.hardware import ChassisConfig
from trolley.drivers import API
from trolley.geometry import Twist2D
from trolley.network_ports import is_network
from trolley_base.drivers.boards import linorobot2_messages as messages
from trolley_base.drivers.boards.battery import BatteryGauge
from trolley_base.drivers.boards.command_pace import CommandPace
from trolley_base.drivers.boards.device_clock import DeviceClock
from trolley_base.drivers.boards.last_heard import LastHeard
from trolley_base.drivers.boards.linorobot2_messages import NoMessageError
from trolley_base.drivers.boards.models import (
    Answer,
    BoardDriver,
    BoardFacts,
    BoardQuestion,
    count_nothing,
)
from trolley_base.drivers.boards.report import SILENCE_NS, Report
from trolley_base.drivers.boards.sonar import sonar_scan, sonar_sensor
from trolley_base.drivers.boards.velocities import NO_SPEED, StampedVelocities
from trolley_base.drivers.boards.xrce_agent import Delivery, XrceAgent, matches
from trolley_base.drivers.boards.xrce_frames import FrameDecoder, MessageDatagrams, encode
from trolley_base.drivers.boards.xrce_messages import GET_INFO, KEYLESS, parse_header, submessages
from trolley_base.drivers.boards.xrce_pings import PingResponder
from trolley_base.drivers.dialogue import Line, Status
from trolley_base.drivers.interface import ChassisReading

CREATES_WITHIN_NS = 5_000_000_000
"""By then a board has created its topics: some twenty objects, one after the other."""
SENSELESS_NS = 6_000_000_000
"""A session in which the board sends but reports nothing for this long is given up, and the board
opens another: it has been told to stand meanwhile."""
COUNTS_FOR_NS = 3_000_000_000
"""While it waits for an acknowledgement, or for an agent, its encoders count on: the next speed is
the mean since the last one."""
PING_S = 0.75
"""A board that looks for an agent does so each 0.6 s."""
ENOUGH_MESSAGES = 3
FAST_BAUD = 921600
"""Of a fork."""
LEAST_VOLTAGE = 1.0
"""Firmware without a battery's pin reports less [V]."""
SILENT = (
    "The motor board is silent. Is it powered, and does it run linorobot2's firmware? "
    "If its LED blinks twice at a time it has given up: restart it."
)
ON_WIFI = (
    " Is it in your Wi-Fi, are AGENT_IP and AGENT_PORT in its configuration this computer's, and "
    "does no firewall close that port?"
)
STRANGER = (
    "The motor board talks in a session of another agent. It comes over within a second; if it "
    "does not, its firmware was built with USE_STAY_CONNECTED: restart it."
)
INCOMPATIBLE = (
    "The motor board's micro-ROS speaks another version of XRCE than 1: flash a firmware of "
    "linorobot2 for ROS 2 Humble or later."
)


class Linorobot2Dialogue:
    """Talks to the firmware: it is the agent that the firmware looks for.

    Args:
        baud: bits per second; a board on native USB ignores it.
        can_drive_sideways: it has mecanum wheels.
    """

    def __init__(self, config: ChassisConfig, baud: int, *, can_drive_sideways: bool) -> None:
        self._config = config
        self._baud = baud
        self._can_drive_sideways = can_drive_sideways
        self._is_on_wifi = is_network(config.port)
        self._report = Report()
        self._decoder = FrameDecoder(self._report.count)
        self._agent = XrceAgent(self._report.count)
        self._pings = PingResponder()
        self._clock = DeviceClock()
        self._wheels = StampedVelocities(COUNTS_FOR_NS, self._report.count)
        self._gauge = BatteryGauge(config.inputs)
        self._pace = CommandPace()
        self.begin(0)

    @property
    def line(self) -> Line:
        """The board waits for answers; who leaves it waits until it stands."""
        return Line(
            self._baud,
            is_prompt=True,
            leaves_standing=True,
            responder=self._pings.respond,
            datagrams=MessageDatagrams(),
        )

    def begin(self, now_ns: int) -> None:
        """The port has been opened: wait for the board, command nothing."""
        self._decoder.reset()
        self._agent.reset()
        self._set_pings()
        self._clock.reset()
        self._wheels.reset()
        self._gauge.reset()
        self._pace.reset()
        self._wanted = Twist2D.zero()
        self._address = 0
        self._heard = LastHeard(now_ns)
        self._session_ns = now_ns
        self._num_sessions = self._num_synchronized = 0

    # What arrives.
    def receive(self, data: bytes, arrived_ns: int) -> None:
        """Take bytes."""
        if not data:
            return
        self._heard.hear(arrived_ns)
        for frame in self._decoder.feed(data):
            self._heard.take_frame()
            self._address = frame.source
            deliveries = self._agent.take(frame.message, arrived_ns)
            self._set_pings()
            self._note_session(arrived_ns)
            for delivery in deliveries:
                try:
                    self._take(delivery, arrived_ns)
                except NoMessageError:
                    self._report.count("bad_messages")

    def _set_pings(self) -> None:
        self._pings.has_session = self._agent.has_session
        self._pings.is_silent = self._agent.is_estranged

    def _note_session(self, now_ns: int) -> None:
        """Notice that the board has opened a session, or set its clock."""
        if self._agent.num_sessions != self._num_sessions:
            if self._num_sessions:
                self._report.count("sessions")
            self._num_sessions = self._agent.num_sessions
            self._session_ns = now_ns
            self._heard.forget_reports()
            self._pace.reset()
        if self._agent.num_synchronized != self._num_synchronized:
            self._num_synchronized = self._agent.num_synchronized
            self._clock.note_set()

    def _take(self, delivery: Delivery, arrived_ns: int) -> None:
        name = self._known(delivery.topic.name)
        if name == messages.ODOMETRY:
            self._take_odometry(delivery.body, arrived_ns)
        elif name in (messages.IMU, messages.RAW_IMU):
            imu = messages.parse_imu(delivery.body, self._config.imu_axes)
            stamp_ns = self._clock.stamp(imu.stamp_ns, arrived_ns)
            self._report.add_imu(msgspec.structs.replace(imu, stamp_ns=stamp_ns))
        elif name == messages.BATTERY:
            voltage = messages.parse_voltage(delivery.body)
            if voltage >= LEAST_VOLTAGE:
                self._gauge.take_voltage(voltage, arrived_ns)
        elif name == messages.ULTRASOUND:
            self._take_range(delivery.body, arrived_ns)

    def _take_range(self, body: bytes, arrived_ns: int) -> None:
        found = messages.parse_range(body)
        if found is None:
            return
        scan = sonar_scan(
            messages.ULTRASOUND,
            self._clock.stamp(found.stamp_ns, arrived_ns),
            found.range_m,
            cone_rad=found.cone_rad,
            range_min=found.range_min,
            range_max=found.range_max,
        )
        self._report.add_range(scan)

    def _take_odometry(self, body: bytes, arrived_ns: int) -> None:
        try:
            odometry = messages.parse_odometry(body)
        except NoMessageError:
            self._report.note("warning", NO_SPEED)
            self._heard.take_nonsense(arrived_ns)
            raise
        self._heard.take_report(arrived_ns)
        twist = odometry.twist
        if not self._can_drive_sideways:
            twist = Twist2D(twist.vx, 0.0, twist.wz)
        motion = self._wheels.add(twist, self._clock.stamp(odometry.stamp_ns, arrived_ns))
        if motion is not None:
            self._report.add_motion(motion)

    @staticmethod
    def _known(topic: str) -> str | None:
        return next((name for name in messages.TYPES if matches(topic, name)), None)

    # What is sent.
    def drive(self, twist: Twist2D) -> None:
        """Set the wanted velocity."""
        self._wanted = twist

    def outgoing(self, now_ns: int) -> bytes:
        """Return answers to the board, and a command if one is due."""
        if self._is_senseless(now_ns) and not self._fault(now_ns):
            self._report.count("sessions_given_up")
            self._agent.give_up()
            self._set_pings()
        self._command(now_ns)
        return b"".join(encode(one, self._address) for one in self._agent.outgoing(now_ns))

    def _is_senseless(self, now_ns: int) -> bool:
        """Whether the board's streams and ours have come apart, as with two agents on a port."""
        heard = self._heard
        sensible_ns = max(self._session_ns, heard.report_ns or 0, heard.nonsense_ns or 0)
        is_sending = now_ns - heard.heard_ns <= SILENCE_NS
        has_reader = self._agent.reader_of(messages.CMD_VEL) is not None
        return has_reader and is_sending and now_ns - sensible_ns > SENSELESS_NS

    def _command(self, now_ns: int) -> None:
        """Send a command: stops and starts at once, zeros too, so that its watchdog rests."""
        reader = self._agent.reader_of(messages.CMD_VEL)
        if reader is None or self._fault(now_ns):
            return
        wanted = self._wanted if self._heard.is_reporting(now_ns) else Twist2D.zero()
        if not self._pace.is_due(now_ns, stands=wanted.is_zero):
            return
        vy = wanted.vy if self._can_drive_sideways else 0.0
        body = messages.encode_twist(Twist2D(wanted.vx, vy, wanted.wz))
        if self._agent.send(reader, body, now_ns):
            self._pace.note(now_ns, stands=wanted.is_zero)
        else:
            self._report.count("not_taken")

    def goodbye(self) -> tuple[bytes, ...]:
        """Stop the wheels; `Line.leaves_standing` has seen to it that they stand."""
        reader = self._agent.reader_of(messages.CMD_VEL)
        if reader is None:
            return ()
        self._agent.send(reader, messages.encode_twist(Twist2D.zero()), self._heard.heard_ns)
        last = self._agent.outgoing(self._heard.heard_ns)
        return (b"".join(encode(one, self._address) for one in last),)

    # How it goes.
    def _fault(self, now_ns: int) -> str:
        """Say why this is no firmware that can be driven, "" where it may be."""
        if self._agent.is_incompatible:
            return INCOMPATIBLE
        topics = {self._known(topic.name): topic for topic in self._agent.topics}
        for name in (messages.ODOMETRY, messages.CMD_VEL):
            topic = topics.get(name)
            if topic is not None and topic.type_name not in ("", messages.TYPES[name]):
                return (
                    f"The motor board has {name} as {topic.type_name}, not as "
                    f"{messages.TYPES[name]}: flash linorobot2's firmware unchanged."
                )
            is_late = now_ns - self._session_ns > CREATES_WITHIN_NS
            if topic is None and self._agent.has_session and is_late:
                return (
                    f"The motor board speaks micro-ROS but has no {name}: does it run "
                    "linorobot2's firmware?"
                )
        return ""

    def status(self, now_ns: int) -> Status:
        """Say how it goes."""
        if self._heard.is_silent(now_ns):
            return Status("down", SILENT + (ON_WIFI if self._is_on_wifi else ""), reopen=True)
        if fault := self._fault(now_ns):
            return Status("down", fault)
        if self._agent.is_estranged:
            return Status("down", STRANGER)
        if self._heard.is_reporting(now_ns) and self._agent.reader_of(messages.CMD_VEL) is not None:
            return Status("up")
        if self._heard.is_talking_nonsense(now_ns):
            return Status("down", NO_SPEED)
        if self._heard.has_reported:
            return Status("down", "The motor board has stopped reporting; it is waited for.")
        if self._heard.speaks_otherwise:
            return Status(
                "searching",
                "What arrives is not micro-ROS: is this the motor board's port, does it run "
                f"linorobot2's firmware, and is {self._baud} its baud rate (115200 or 921600)?",
            )
        if self._agent.has_session:
            return Status("searching", "The motor board is creating its topics.")
        return Status("searching", "The motor board is being waited for: it pings twice a second.")

    def take(self, now_ns: int) -> ChassisReading:
        """Hand over what was reported."""
        return self._report.take(self.status(now_ns), self._gauge.alarms(), self._gauge.battery)


def recognise(data: bytes) -> Answer | None:
    """Find a ping of a board that looks for an agent, or that it talks to one that has gone."""
    messages = [frame.message for frame in FrameDecoder(count_nothing).feed(data)]
    num_pings = sum(map(_is_ping, messages))
    if num_pings:
        return Answer(("looks for an agent",))
    if len(messages) < ENOUGH_MESSAGES:
        return None
    return Answer(
        ("talks to an agent",),
        (
            "It talks to an agent that has gone, and may be one that never looks for another: "
            "restart it if it is not driven.",
        ),
    )


def _is_ping(message: bytes) -> bool:
    parsed = parse_header(message)
    if parsed is None or parsed[0].session & ~KEYLESS:
        return False
    return any(part.kind == GET_INFO for part in submessages(message, parsed[1]))


FACTS = BoardFacts("linorobot2 (micro-ROS)", 115200, math.inf, has_imu=True, drives_sideways=True)
DRIVERS = {
    "linorobot2": BoardDriver(
        FACTS,
        lambda config, baud, drive: Linorobot2Dialogue(
            config, baud, can_drive_sideways=drive == "mecanum"
        ),
        # It looks for an agent at one of two speeds; it is listened to for long enough.
        tuple(
            BoardQuestion(baud, (), recognise, wait_s=PING_S, datagrams=MessageDatagrams())
            for baud in (FACTS.baud, FAST_BAUD)
        ),
        api=API,
        sensors=(
            sonar_sensor(
                messages.ULTRASOUND, "the sonar of a firmware that was built with TRIG_PIN"
            ),
        ),
        page="linorobot2.md",
        emulator="trolley_base.emulators.linorobot2:BOARDS",
    )
}
