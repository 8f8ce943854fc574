"""Watches over the motor board: what it does against what it is told."""

from trolley import codes
from trolley.geometry import Twist2D
from trolley.runtime.service import Service
from trolley_base.drivers import Hardware
from trolley_base.odometry.dead_reckoning import Measured
from trolley_base.safety.motion_diagnosis import JUMPS, Fault, Finding, sentence
from trolley_base.safety.motion_supervision import MotionSupervision
from trolley_base.safety.velocity_limiter import Block, Restriction

RESET_EVERY_NS = 1_000_000_000
"""A board that does not stop is restarted at most this often [ns]."""
CALM_NS = 1_000_000_000
"""Who was pushed by hand may drive again after standing for so long [ns]."""
MOST_JUMPS, JUMPS_WITHIN_NS = 3, 2_000_000_000
"""One leap of the odometry was misread; this many within this time were not [ns]."""


class MotionWatch:
    """Keeps what was detected until somebody resumes the robot, and restarts the board.

    Args:
        supervision: compares commands with motions.
        can_drive: whether commands reach any motors.
    """

    def __init__(
        self, service: Service, supervision: MotionSupervision, *, can_drive: bool
    ) -> None:
        self._service = service
        self._supervision = supervision
        self._can_drive = can_drive
        self._finding: Finding | None = None
        self._is_moving = False
        self._reset_ns: int | None = None
        self._jumps_ns: list[int] = []

    def begin(self, hardware: Hardware) -> None:
        """Begin a run with devices that have been opened."""
        self._chassis = hardware.chassis

    @property
    def is_latched(self) -> bool:
        """Whether a fault was detected that only `base/resume` ends."""
        return self._finding is not None and self._finding.fault is not Fault.MOVES

    @property
    def not_stopped(self) -> bool:
        """Whether the robot moves although told to stand, or nobody knows whether it stands."""
        return self._finding is not None and self._is_moving

    @property
    def restriction(self) -> Restriction | None:
        """Why the robot may not drive, None while it does as it is told."""
        if self._finding is None:
            return None
        message = sentence(self._finding, is_moving=self._is_moving)
        return Restriction(Block.ALL, "fault", codes.DOES_NOT_OBEY, message)

    def update(self, now_ns: int, measured: Measured) -> None:
        """Take what was measured since the last call."""
        if not self._can_drive:
            return
        self._supervision.take(now_ns, measured.motions, judges=self._finding is None)
        self._note(self._supervision.take_finding())
        if measured.num_jumps:
            self._note_jumps(now_ns, measured.num_jumps)
        if self._finding is None:
            return
        is_moving = self._supervision.is_moving(now_ns)
        self._is_moving = self._is_moving if is_moving is None else is_moving
        if self._finding.fault is Fault.MOVES and self._supervision.rest_ns >= CALM_NS:
            self._service.log.info("The robot was pushed by hand, or has moved by itself")
            self._finding = None
        elif self._finding.fault >= Fault.DRIVES and is_moving:
            self._reset(now_ns)

    def command(self, now_ns: int, twist: Twist2D, *, is_heard: bool) -> None:
        """Take what is driven from now on; a board that does not hear it is not judged by it."""
        if not is_heard:
            self._supervision.forget()
        elif self._can_drive:
            self._supervision.command(now_ns, twist)

    def clear(self) -> None:
        """Forget what was detected, unless the robot still moves."""
        if not self.not_stopped:
            self._finding = None

    def _note(self, found: Finding | None) -> None:
        if found is None or (self._finding is not None and found.fault <= self._finding.fault):
            return
        self._finding, self._is_moving = found, True
        self._service.count(f"motion/{found.fault.name.lower()}")
        self._service.log.error("The motor board does not obey", why=found.detail)

    def _note_jumps(self, now_ns: int, number: int) -> None:
        since_ns = now_ns - JUMPS_WITHIN_NS
        self._jumps_ns = [at_ns for at_ns in self._jumps_ns if at_ns > since_ns] + [now_ns] * number
        if len(self._jumps_ns) >= MOST_JUMPS:
            self._note(JUMPS)

    def _reset(self, now_ns: int) -> None:
        if self._reset_ns is None or now_ns - self._reset_ns >= RESET_EVERY_NS:
            self._reset_ns = now_ns
            if self._chassis.restart():
                self._service.count("motion/board_restarts")
                self._service.log.warning("The motor board is restarted: it does not stop")
