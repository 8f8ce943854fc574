"""Decides what is driven: the arbiter's choice, within limits, past echoes, as far as it sees."""

import enum
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley import codes
from trolley.geometry import Twist2D
from trolley.messages import VelocityCommand
from trolley_base.safety.arbiter import Arbiter, Choice, Reject
from trolley_base.safety.motion_limits import MotionLimits, ramp, within
from trolley_base.safety.observed_space import ALL_SEEN, Unseen
from trolley_base.safety.sight_distance import SightDistance
from trolley_base.safety.stop_field import StopField

Mode = Literal["ok", "stopped", "held", "fault"]


@dataclass(frozen=True, slots=True)
class VelocityLimiterParams:
    """How the velocity limiter judges what it does; set by hand."""

    max_dt: float = 0.1
    """Longest time between two decisions that counts: no leap in speed after a pause [s]."""
    standing_speed: float = 0.02
    """Speed below which the robot stands, for the stop field as a reason [m/s]."""
    standing_wz: float = 0.05
    """Turn rate below which the robot stands, for the stop field as a reason [rad/s]."""
    blocked_ns: int = 200_000_000
    """Time for which something must hinder the robot to be named [ns]."""
    lost_shown_ns: int = 5_000_000_000
    """How long a loss of commands is shown if none comes [ns]."""
    late_shown_ns: int = 1_000_000_000
    """How long it is shown that a command came too late [ns]."""
    by_hand: str = "teleop"
    """The source behind which a person looks where the robot drives."""


PARAMS = VelocityLimiterParams()


class Block(enum.Enum):
    """How much is forbidden for a reason other than echoes."""

    NOTHING = enum.auto()
    ALL = enum.auto()
    ALL_BUT_BACK = enum.auto()  # something was touched, or there is no floor ahead


@dataclass(frozen=True, slots=True)
class Restriction:
    """Why the robot may not drive, or not freely."""

    block: Block
    mode: Mode
    reason: str
    message: str


@dataclass(frozen=True, slots=True)
class Decision:
    """What is driven now, and what `base` says about it."""

    twist: Twist2D
    source: str | None
    scan_ns: int
    mode: Mode
    reason: str = ""
    message: str = ""


class _Around(NamedTuple):
    """What is known about the floor around the robot, and who drives there."""

    echoes: NDArray[np.float64]
    unseen: Unseen
    by_hand: bool


class _Hindrance(NamedTuple):
    """Why the robot does not drive as fast as was commanded, and whether it stands for it."""

    mode: Mode
    reason: str
    message: str


class VelocityLimiter:
    """Turns wishes into a velocity, one decision at each control period.

    All times are robot time by base's own clock.

    Args:
        priorities: of each source.
        limits: of the motion.
        field: the stop field.
        sight: keeps the robot from what was not seen.
    """

    def __init__(
        self,
        priorities: Mapping[str, int],
        limits: MotionLimits,
        field: StopField,
        sight: SightDistance,
    ) -> None:
        self._arbiter = Arbiter(priorities)
        self.limits = limits
        """How fast it may drive and speed up; the others know what it can brake with."""
        self._field = field
        self._sight = sight
        self._twist = Twist2D.zero()
        self._turns_clear = False
        self._decided_ns: int | None = None
        self._blocked_since_ns: int | None = None
        self._lost_ns: int | None = None
        self._late_ns: int | None = None

    def offer(
        self, source: str, command: VelocityCommand, arrived_ns: int, foremost_ns: int
    ) -> Reject | None:
        """Take a command of a source, or say why not."""
        rejected = self._arbiter.offer(source, command, arrived_ns, foremost_ns)
        if rejected is Reject.OLD:
            self._late_ns = arrived_ns
        return rejected

    def forget(self) -> None:
        """Stop, and let only commands that arrive from now on move the robot."""
        self._arbiter.forget()
        self._twist = Twist2D.zero()
        self._lost_ns = None

    def decide(
        self,
        now_ns: int,
        echoes: NDArray[np.float64],
        restriction: Restriction | None = None,
        unseen: Unseen = ALL_SEEN,
    ) -> Decision:
        """Decide what is driven until the next call.

        Args:
            now_ns: now.
            echoes: (n, 2) what the lidar saw [m] in `base_link`.
            restriction: what else forbids to drive.
            unseen: what the lidar has not seen, in `base_link`.
        """
        since_ns = 0 if self._decided_ns is None else now_ns - self._decided_ns
        self._decided_ns = now_ns
        choice = self._arbiter.choose(now_ns)
        self._note_loss(choice, now_ns)
        block = Block.NOTHING if restriction is None else restriction.block
        if choice.source is None or block is Block.ALL:
            # At once and not along a ramp: the motors brake as hard as they can.
            self._twist = Twist2D.zero()
            self._field.follow(self._twist, since_ns * 1e-9)
            return self._report(choice, restriction, now_ns, None)
        wanted = within(choice.twist, self.limits)
        if block is Block.ALL_BUT_BACK:
            wanted = Twist2D(min(0.0, wanted.vx), 0.0, 0.0)
            # Not along a ramp either: that were half a second more into what was touched.
            self._twist = Twist2D(min(0.0, self._twist.vx), 0.0, 0.0)
        around = _Around(echoes, unseen, choice.source == PARAMS.by_hand)
        self._twist = self._allowed(wanted, min(since_ns * 1e-9, PARAMS.max_dt), around)
        self._field.follow(self._twist, since_ns * 1e-9)
        return self._report(choice, restriction, now_ns, self._find_hindrance(wanted, around))

    def _allowed(self, wanted: Twist2D, dt: float, around: _Around) -> Twist2D:
        """Return the next velocity towards `wanted` that may be driven there."""
        following = ramp(self._twist, wanted, self.limits, dt)
        scale = self._scale(following, around)
        if scale == 1.0 and not self._turns_clear:
            return following
        # Where the wanted arc is blocked, its turn may still lead clear of what blocks it.
        possible_speed = wanted.speed * self._scale(wanted, around)
        self._turns_clear = wanted.wz != 0.0 and possible_speed <= PARAMS.standing_speed
        if self._turns_clear:
            following = ramp(self._twist, Twist2D(0.0, 0.0, wanted.wz), self.limits, dt)
            scale = self._scale(following, around)
        return following.scaled(scale)

    def _scale(self, twist: Twist2D, around: _Around) -> float:
        """Return what part of a velocity the echoes and the sight allow."""
        sight = self._sight.look(twist, around.unseen, by_hand=around.by_hand)
        return min(sight.scale, self._field.scale(twist, around.echoes))

    def _find_hindrance(self, wanted: Twist2D, around: _Around) -> _Hindrance | None:
        """Say what keeps the robot from moving as wanted, None while it is on its ramp."""
        is_standing = _stands(self._twist)
        # A program creeps, or lets a side come softly to where something stood, for the moment only
        # in which its robot swings round; a person wonders.
        creeps = around.by_hand and self._sight.is_creeping(self._twist)
        if _stands(wanted) or not (is_standing or creeps):
            return None
        sight = self._sight.look(wanted, around.unseen, by_hand=around.by_hand)
        free = self._field.scale(wanted, around.echoes)
        if sight.scale < free:
            if not around.by_hand and self._sight.is_coming_softly(self._twist):
                return None
            ending = "so it does not move there" if is_standing else "so it creeps there"
            message = f"The lidar sees nothing {sight.where}, {ending}."
            return _Hindrance("held" if is_standing else "ok", codes.BLIND, message)
        if is_standing and free < 1.0:
            return _Hindrance("held", codes.STOP_FIELD, codes.SENTENCES[codes.STOP_FIELD])
        return None

    def _note_loss(self, choice: Choice, now_ns: int) -> None:
        if choice.source is not None:
            self._lost_ns = None
        elif choice.lost and self._lost_ns is None:
            self._lost_ns = now_ns

    def _report(
        self,
        choice: Choice,
        restriction: Restriction | None,
        now_ns: int,
        hindrance: _Hindrance | None,
    ) -> Decision:
        if hindrance is None:
            self._blocked_since_ns = None
        elif self._blocked_since_ns is None:
            self._blocked_since_ns = now_ns
        source, since_ns = choice.source, self._blocked_since_ns
        if restriction is not None:
            source = None if restriction.block is Block.ALL else source
            mode, reason, message = restriction.mode, restriction.reason, restriction.message
        elif (
            hindrance is not None
            and since_ns is not None
            and now_ns - since_ns >= PARAMS.blocked_ns
        ):
            mode, reason, message = hindrance
        elif (
            source is None
            and self._late_ns is not None
            and now_ns - self._late_ns < PARAMS.late_shown_ns
        ):
            mode, reason = "held", codes.COMMAND_LATE
            message = codes.SENTENCES[reason]
        elif self._lost_ns is not None and now_ns - self._lost_ns < PARAMS.lost_shown_ns:
            mode, reason = "held", codes.COMMAND_LOST
            message = codes.SENTENCES[reason]
        else:
            mode, reason, message = "ok", "", ""
        return Decision(self._twist, source, choice.scan_ns, mode, reason, message)


def _stands(twist: Twist2D) -> bool:
    return twist.speed < PARAMS.standing_speed and abs(twist.wz) < PARAMS.standing_wz
