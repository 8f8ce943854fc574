"""A real robot: a motor board and a lidar on serial ports, behind the interfaces of the hardware.

Everything here runs on the service's thread; the ports' own threads only store.
"""

import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from functools import partial

from trolley.geometry import Pose2D, Twist2D
from trolley.messages import Link
from trolley.messages.motion import CHASSIS
from trolley_base.drivers.dialogue import BoardDialogue, Dialogue, LidarDialogue
from trolley_base.drivers.imus.i2c_imu import I2cImu
from trolley_base.drivers.interface import (
    CallSoon,
    Chassis,
    ChassisReading,
    LidarReading,
    LidarScan,
    MotionSample,
)
from trolley_base.drivers.serial_device import SerialDevice
from trolley_base.drivers.serial_link import SerialLink
from trolley_base.units import NS_PER_S

STANDING_PERIOD_NS = 50_000_000
HEARD_WITHIN_NS = 100_000_000
"""What a lidar sends is heard within this time, whether a revolution can be complete or not."""
EARLIEST_TURN = 0.95
"""Share of its last revolution's time that a lidar's next takes at least."""
LEAVE_WITHIN_S, LEAVE_STEP_S = 2.0, 0.01
"""How long whoever leaves waits until the wheels stand, at most, and how often it looks."""
STANDING_MPS, STANDING_RADPS = 0.01, 0.02

Explain = Callable[[str, OSError], str]


class SerialChassis:
    """A motor board; made by `RealHardware`."""

    def __init__(self, conversation: SerialLink[BoardDialogue], start_ns: int) -> None:
        self._conversation = conversation
        self._now_ns = start_ns

    def drive(self, twist: Twist2D) -> None:
        """Send a velocity; a zero leaves at once, others as fast as the board can take them."""
        self._conversation.dialogue.drive(twist)
        self._conversation.speak(self._now_ns)

    def read(self) -> ChassisReading:
        """Hand over what the board reported since the last call."""
        reading = self._conversation.dialogue.take(self._now_ns)
        counts = self._conversation.counts(reading.counts)
        link, is_gone = self._conversation.link(self._now_ns), self._conversation.is_gone
        return replace(reading, link=link, counts=counts, is_gone=is_gone)

    def restart(self) -> bool:
        """Reopen the port, which restarts an Arduino; False for boards that do not notice."""
        return self._conversation.restart(self._now_ns)

    def advance(self, now_ns: int) -> None:
        """Hear what has arrived up to now."""
        self._now_ns = now_ns
        self._conversation.listen(now_ns)

    def respond(self, now_ns: int) -> None:
        """Hear what has arrived up to now, and go on with the dialogue."""
        self.advance(now_ns)
        self._conversation.speak(now_ns)

    def leave(self, clock: Callable[[], int]) -> None:
        """Stop the wheels, and wait until they stand where nothing would stop them later.

        Args:
            clock: robot time [ns].
        """
        self.drive(Twist2D.zero())
        if not self._conversation.dialogue.line.leaves_standing:
            return
        told_ns = self._now_ns
        until_s = time.monotonic() + LEAVE_WITHIN_S
        while time.monotonic() < until_s:
            reading = self.read()
            if reading.link.state != "up" or any(
                motion.stamp_ns > told_ns
                and motion.twist.speed < STANDING_MPS
                and abs(motion.twist.wz) < STANDING_RADPS
                for motion in reading.motions
            ):
                return
            time.sleep(LEAVE_STEP_S)
            self.respond(clock())


class NoChassis:
    """A lidar without wheels, on a table: it stands, and says so 20 times a second."""

    def __init__(self, start_ns: int) -> None:
        self._now_ns = self._read_ns = start_ns

    def drive(self, twist: Twist2D) -> None:
        """Do nothing: there are no wheels."""

    def restart(self) -> bool:
        """There is no board to restart."""
        return False

    def read(self) -> ChassisReading:
        """Report that it stands."""
        link = Link(name=CHASSIS, state="up", message="No motor board is set.")
        if self._now_ns - self._read_ns < STANDING_PERIOD_NS:
            return ChassisReading((), link)
        self._read_ns = self._now_ns
        return ChassisReading(
            (MotionSample(self._now_ns, Pose2D.identity(), Twist2D.zero()),), link
        )

    def advance(self, now_ns: int) -> None:
        """Let time pass."""
        self._now_ns = now_ns


class ChassisWithImu:
    """A chassis whose inertial readings come from a chip of this computer's own.

    Args:
        chassis: the rest of it.
        imu: the chip.
        robot_ns: turns local monotonic time into robot time [ns].
    """

    def __init__(self, chassis: Chassis, imu: I2cImu, robot_ns: Callable[[int], int]) -> None:
        self._chassis = chassis
        self._imu = imu
        self._robot_ns = robot_ns

    def drive(self, twist: Twist2D) -> None:
        """Send a velocity."""
        self._chassis.drive(twist)

    def restart(self) -> bool:
        """Restart the board."""
        return self._chassis.restart()

    def read(self) -> ChassisReading:
        """Hand over what board and chip reported since the last call."""
        reading = self._chassis.read()
        imu, notes, counts = self._imu.take(self._robot_ns)
        notes, counts = (*reading.notes, *notes), {**reading.counts, **counts}
        return replace(reading, imu=imu, notes=notes, counts=counts)


class SerialLidar:
    """A scanner; made by `RealHardware`.

    To decode takes about as long for much as for little, so nothing is decoded while no revolution
    can be complete; meanwhile there is nothing to hand over, and its link is what it was.
    """

    def __init__(self, conversation: SerialLink[LidarDialogue], start_ns: int) -> None:
        self._conversation = conversation
        self._now_ns = self._heard_ns = start_ns
        self._complete_ns = float(start_ns)
        self._link: Link | None = None

    def read(self) -> LidarReading:
        """Hand over the revolutions completed since the last call."""
        is_gone = self._conversation.is_gone
        if self._link is not None and self._heard_ns < self._now_ns:
            return LidarReading((), self._link, is_gone=is_gone)
        reading = self._conversation.dialogue.take(self._now_ns)
        if reading.scans:
            self._complete_ns = earliest_end_ns(reading.scans[-1])
        self._link = self._conversation.link(self._now_ns)
        counts = self._conversation.counts(reading.counts)
        return replace(reading, link=self._link, counts=counts, is_gone=is_gone)

    def advance(self, now_ns: int) -> None:
        """Hear what has arrived up to now, and answer."""
        self._now_ns = now_ns
        if now_ns >= min(self._heard_ns + HEARD_WITHIN_NS, self._complete_ns):
            self._heard_ns = now_ns
            self._conversation.listen(now_ns)
        self._conversation.speak(now_ns)


def earliest_end_ns(scan: LidarScan) -> float:
    """Return when the revolution after a scan is complete, at the earliest [ns]."""
    turn_ns = len(scan.ranges) * abs(scan.time_increment) * NS_PER_S
    began_ns = scan.stamp_ns - (turn_ns if scan.time_increment < 0.0 else 0.0)
    return began_ns + (1.0 + EARLIEST_TURN) * turn_ns


class RealHardware:
    """A robot of metal.

    Args:
        board: the motor board's dialogue and port, None for a lidar alone.
        lidar: the lidar's.
        start_ns: robot time now.
        robot_ns: turns local monotonic time into robot time [ns].
        call_soon: calls a function on the service's thread.
        explain: turns an error of a port into a sentence.
        imu: an inertial unit of this computer's own; started here.
    """

    def __init__(
        self,
        board: tuple[BoardDialogue, str] | None,
        lidar: tuple[LidarDialogue, str],
        start_ns: int,
        robot_ns: Callable[[int], int],
        call_soon: CallSoon,
        explain: Explain,
        imu: I2cImu | None = None,
    ) -> None:
        self._conversations: list[SerialLink[BoardDialogue] | SerialLink[LidarDialogue]] = []

        def open_port(dialogue: Dialogue, path: str) -> SerialDevice:
            wake = partial(call_soon, self._respond)
            device = SerialDevice(path, dialogue.line, explain, wake, robot_ns)
            device.start()
            return device

        self._chassis: SerialChassis | NoChassis = NoChassis(start_ns)
        if board is not None:
            talk = SerialLink(CHASSIS, board[0], open_port(*board), robot_ns)
            self._conversations.append(talk)
            self._chassis = SerialChassis(talk, start_ns)
        self._robot_ns = robot_ns
        seeing = SerialLink("lidar", lidar[0], open_port(*lidar), robot_ns, is_stream=True)
        self._conversations.append(seeing)
        self._lidar = SerialLidar(seeing, start_ns)
        self._imu = imu
        self._whole_chassis: Chassis = self._chassis
        if imu is not None:
            imu.start()
            self._whole_chassis = ChassisWithImu(self._chassis, imu, robot_ns)

    has_ended = False

    @property
    def chassis(self) -> Chassis:
        """The wheels."""
        return self._whole_chassis

    @property
    def lidar(self) -> SerialLidar:
        """The scanner."""
        return self._lidar

    def advance(self, now_ns: int) -> None:
        """Hear what the devices said up to now."""
        self._chassis.advance(now_ns)
        self._lidar.advance(now_ns)

    def _respond(self) -> None:
        """Go on with a board that has answered; the lidars need no such haste."""
        if isinstance(self._chassis, SerialChassis) and self._conversations:
            self._chassis.respond(self._robot_ns(time.monotonic_ns()))

    def close(self) -> None:
        """Stop the wheels and the lidar, and let go of the ports; may be called more than once.

        A driver that fails meanwhile keeps nobody from saying goodbye.
        """
        conversations, self._conversations = self._conversations, []
        with ExitStack() as last:
            if self._imu is not None:
                last.callback(self._imu.close)
            for conversation in reversed(conversations):
                last.callback(conversation.close)
            if conversations and isinstance(self._chassis, SerialChassis):
                self._chassis.leave(lambda: self._robot_ns(time.monotonic_ns()))
