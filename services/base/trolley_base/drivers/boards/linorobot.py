"""A board with linorobot's firmware: rosserial to a Teensy or Arduino, unchanged.

The firmware waits for a topic request, announces its topics, and then reports its velocity
(`raw_vel`) and its inertial sensor (`raw_imu`) 20 times a second. It stops its motors 0.4 s after
the last `cmd_vel`, and reports nothing more when 11 s passed without an answer to its time
requests.

Counts, below `chassis/`: `bad_checksum`, `skipped_bytes`, `unknown_topics`, `bad_messages` (a
payload that is not what its topic carries, or holds what no robot can do), `gaps` (a velocity
without a usable interval before it, so that no motion came of it).

Source:
    linorobot, teensy/firmware/src/firmware.ino; rosserial_client, ros/node_handle.h.
"""

from trolley.config.hardware import ChassisConfig
from trolley.drivers import API
from trolley.geometry import Twist2D
from trolley_base.drivers.boards import rosserial_answer
from trolley_base.drivers.boards.command_pace import CommandPace
from trolley_base.drivers.boards.last_heard import LastHeard
from trolley_base.drivers.boards.lino_messages import (
    CMD_VEL,
    PID,
    RAW_IMU,
    RAW_VEL,
    encode_pid,
    encode_twist,
    parse_imu,
    parse_velocities,
)
from trolley_base.drivers.boards.models import (
    BoardDriver,
    BoardFacts,
    BoardQuestion,
    FollowUp,
)
from trolley_base.drivers.boards.negotiation import Negotiation
from trolley_base.drivers.boards.report import Report
from trolley_base.drivers.boards.rosserial import (
    LOG,
    PUBLISHER,
    STOP_REQUEST,
    SUBSCRIBER,
    TIME,
    TOPIC_REQUEST,
    Frame,
    FrameDecoder,
    encode,
    parse_log,
    parse_topic_info,
    time_reply,
)
from trolley_base.drivers.boards.velocities import NO_SPEED, VelocityIntegrator
from trolley_base.drivers.dialogue import Line, Status
from trolley_base.drivers.interface import ChassisReading

PERIOD_NS = 50_000_000
"""The pace of `raw_vel`."""
NO_TIME_REQUEST_NS = 15_000_000_000
"""rosserial's own rule: a board asks for the time every 2.5 s, or it has forgotten its host."""
STALL_NS = 500_000_000
"""Base looks every 20 ms; after this long without a look much may have been lost."""
MOST_TIME_REQUESTS = 8
"""Each answer waits for one call of `outgoing`; a board that asks this often is broken."""
WARNING, ERROR = 2, 3


class LinorobotDialogue:
    """Talks to the firmware.

    Args:
        baud: bits per second; a board on native USB ignores it.
        can_drive_sideways: it has mecanum wheels.
    """

    def __init__(self, config: ChassisConfig, baud: int, *, can_drive_sideways: bool) -> None:
        self._config = config
        self._baud = baud
        self._can_drive_sideways = can_drive_sideways
        self._report = Report()
        self._decoder = FrameDecoder(self._count_damage)
        self._topics = Negotiation(self._report.count)
        self._wheels = VelocityIntegrator(PERIOD_NS, self._report.count)
        self._pace = CommandPace()
        self.begin(0)

    @property
    def line(self) -> Line:
        """A Teensy does not reboot when its port is opened; a board that does is asked again."""
        return Line(self._baud)

    def begin(self, now_ns: int) -> None:
        """The port has been opened: ask for the topics, command nothing."""
        self._decoder.reset()
        self._topics.begin()
        self._wheels.reset()
        self._wanted = Twist2D.zero()
        self._pace.reset()
        self._heard = LastHeard(now_ns)
        self._looked_ns = self._time_request_ns = now_ns
        self._time_requests = 0
        self._owes_pid = False

    def _look(self, now_ns: int) -> None:
        """Notice that base itself stood still: nothing of that time speaks against the board."""
        if now_ns - self._looked_ns >= STALL_NS:
            self._heard.forgive_silence(now_ns)
            self._topics.note_stall(now_ns)
        self._looked_ns = now_ns

    def _count_damage(self, what: str, more: int) -> None:
        self._report.count(what, more)
        self._topics.note_damage()

    # What arrives.
    def receive(self, data: bytes, arrived_ns: int) -> None:
        """Take bytes."""
        if not data:
            return
        self._heard.hear(arrived_ns)
        for frame in self._decoder.feed(data):
            self._heard.take_frame()
            if not self._take_frame(frame, arrived_ns):
                self._report.count("bad_messages")

    def _take_frame(self, frame: Frame, arrived_ns: int) -> bool:
        """Take a frame; False if its payload is not what it should be."""
        topic_id, payload = frame.topic_id, frame.payload
        # When the board began to send it.
        left_ns = arrived_ns - frame.following * 10_000_000_000 // self._baud
        if topic_id in (PUBLISHER, SUBSCRIBER):
            info = parse_topic_info(payload)
            if info is not None:
                self._topics.add_topic(info, arrived_ns, is_published=topic_id == PUBLISHER)
            return info is not None
        if topic_id == TIME:
            self._time_request_ns = arrived_ns
            self._time_requests = min(self._time_requests + 1, MOST_TIME_REQUESTS)
            return True
        if topic_id == LOG:
            return self._take_log(payload)
        if topic_id == self._topics.id_of(RAW_VEL):
            return self._take_velocities(payload, left_ns, arrived_ns)
        if topic_id == self._topics.id_of(RAW_IMU):
            imu = parse_imu(payload, self._config.imu_axes, left_ns)
            if imu is not None:
                self._report.add_imu(imu)
            return imu is not None
        self._topics.meet_unknown(topic_id, arrived_ns)
        return True

    def _take_log(self, payload: bytes) -> bool:
        line = parse_log(payload)
        if line is None:
            return False
        # What the firmware calls fatal, a missing inertial sensor, costs accuracy only.
        if line.level >= ERROR and not line.text.startswith("IMU"):
            self._report.note("error", line.text)
        else:
            self._report.note("warning" if line.level >= WARNING else "info", line.text)
        return True

    def _take_velocities(self, payload: bytes, left_ns: int, arrived_ns: int) -> bool:
        twist = parse_velocities(payload)
        if twist is None:
            self._report.note("warning", NO_SPEED)
            self._heard.take_nonsense(arrived_ns)
            return False
        self._heard.take_report(arrived_ns)
        if not self._can_drive_sideways:
            twist = Twist2D(twist.vx, 0.0, twist.wz)
        motion = self._wheels.add(twist, left_ns)
        if motion is not None:
            self._report.add_motion(motion)
        return True

    # What is sent.
    def drive(self, twist: Twist2D) -> None:
        """Set the wanted velocity."""
        self._wanted = twist

    def outgoing(self, now_ns: int) -> bytes:
        """Return a command if one is due, then answers and questions; less than 20 ms of bytes."""
        self._look(now_ns)
        self._judge(now_ns)
        parts: list[bytes] = []
        command_id, pid_id = self._topics.id_of(CMD_VEL), self._topics.id_of(PID)
        if command_id is not None:
            parts.append(self._command(command_id, now_ns))
        if self._time_requests:
            self._time_requests -= 1
            parts.append(time_reply(now_ns))
        pid = self._config.pid
        if self._owes_pid and pid is not None and pid_id is not None:
            self._owes_pid = False
            parts.append(encode(pid_id, encode_pid(pid.p, pid.i, pid.d)))
        if self._topics.should_ask(now_ns, is_forgotten=self._has_forgotten_us(now_ns)):
            self._topics.note_request(now_ns)
            self._owes_pid = True
            parts.append(TOPIC_REQUEST)
        return b"".join(parts)

    def _command(self, command_id: int, now_ns: int) -> bytes:
        """Return a command: stops and starts at once, zeros too, so that its watchdog rests."""
        wanted = self._wanted if self._is_reporting(now_ns) else Twist2D.zero()
        # Some commands hold for one control period only, and then a zero.
        if not self._pace.is_due(now_ns, stands=wanted.is_zero):
            return b""
        self._pace.note(now_ns, stands=wanted.is_zero)
        vy = wanted.vy if self._can_drive_sideways else 0.0
        return encode(command_id, encode_twist(Twist2D(wanted.vx, vy, wanted.wz)))

    def _judge(self, now_ns: int) -> None:
        """Say what a board lacks that can be driven without."""
        missing = self._topics.judge(now_ns)
        if RAW_IMU in missing and self._config.use_imu:
            self._report.note("info", "The motor board announces no raw_imu: no gyro is used.")
        if PID in missing and self._config.pid is not None:
            self._report.note(
                "warning", "The motor board takes no PID gains; [base.chassis.pid] has no effect."
            )

    def goodbye(self) -> tuple[bytes, ...]:
        """Stop the wheels, then the reports."""
        command_id = self._topics.id_of(CMD_VEL)
        if command_id is None:
            return ()
        return encode(command_id, encode_twist(Twist2D.zero())), STOP_REQUEST

    # How it goes.
    def _is_reporting(self, now_ns: int) -> bool:
        return self._topics.is_usable and self._heard.is_reporting(now_ns)

    def _has_forgotten_us(self, now_ns: int) -> bool:
        """Whether a board that announced its topics must be asked again, as after a reboot."""
        is_unpunctual = now_ns - self._time_request_ns >= NO_TIME_REQUEST_NS
        return is_unpunctual or not self._is_reporting(now_ns)

    def status(self, now_ns: int) -> Status:
        """Say how it goes."""
        if self._heard.is_silent(now_ns):
            return Status(
                "down",
                "The motor board is silent. Is it powered, and does it run linorobot's firmware?",
                reopen=True,
            )
        if self._topics.fault:
            return Status("down", self._topics.fault)
        if self._is_reporting(now_ns):
            return Status("up")
        if self._heard.is_talking_nonsense(now_ns):
            return Status("down", NO_SPEED)
        if self._heard.has_reported:
            return Status("down", "The motor board has stopped reporting; it is asked again.")
        if self._heard.speaks_otherwise:
            return Status(
                "searching",
                "What arrives is not rosserial: is this the motor board's port, and does it run "
                f"linorobot's firmware at {self._baud} baud?",
            )
        return Status("searching", "The motor board is being asked for its topics.")

    def take(self, now_ns: int) -> ChassisReading:
        """Hand over what was reported."""
        self._look(now_ns)
        return self._report.take(self.status(now_ns))


FACTS = BoardFacts(rosserial_answer.TITLE, 57600, 0.4, has_imu=True, drives_sideways=True)
QUESTION = BoardQuestion(
    FACTS.baud,
    (TOPIC_REQUEST,),
    rosserial_answer.recognise,
    leave=STOP_REQUEST,
    wait_s=0.35,
    boots=True,
    follow_up=FollowUp(0.5, rosserial_answer.is_complete, rosserial_answer.describe),
)
DRIVERS = {
    "linorobot": BoardDriver(
        FACTS,
        lambda config, baud, drive: LinorobotDialogue(
            config, baud, can_drive_sideways=drive == "mecanum"
        ),
        (QUESTION,),
        api=API,
        page="linorobot.md",
        emulator="trolley_base.emulators.linorobot:BOARDS",
    )
}
