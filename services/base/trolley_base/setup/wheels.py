"""Wheels in the air: do they turn, which way round, which is left, and do both encoders count up.

The robot cannot see its own wheels. A person says how they turned, once when told to go ahead and
once when told to turn to the left; the counts say what the encoders made of it.
"""

import math
from collections.abc import Generator, Sequence
from dataclasses import dataclass
from typing import Literal

from trolley.geometry import Pose2D, Twist2D
from trolley_base.drivers import LidarScan, MotionSample
from trolley_base.setup.motion import LidarTrack
from trolley_base.setup.record import SetupRefused, refuse_silence
from trolley_base.setup.sight import moving_share

Seen = Literal["both forward", "both back", "left forward", "right forward", "not both"]
"""How the wheels turned: with one of them forward the other went back; or one of them stood."""
DIRECTIONS: dict[Seen, tuple[int, int]] = {
    "both forward": (1, 1),
    "both back": (-1, -1),
    "left forward": (1, -1),
    "right forward": (-1, 1),
}


@dataclass(frozen=True, slots=True)
class WheelParams:
    """How the wheels are tried; set by hand."""

    speed_mps: float = 0.12
    """Speed of each wheel [m/s]."""
    turning_s: float = 2.0
    """How long they turn [s]."""
    resting_s: float = 1.0
    """How long is waited before and after [s]."""
    least_share: float = 0.3
    """A wheel that counts less than this share of what was told does not count."""
    most_share: float = 3.0
    """A wheel that counts more than so many times what was told runs away."""
    moved_share: float = 0.3
    """Share of the lidar's beams that change when the robot moves, and is not in the air."""
    moved_m: float = 0.08
    """A robot in the air does not move farther than this by what the lidar sees [m]."""
    moved_rad: float = 0.15
    """Nor does it turn farther than this [rad]."""


PARAMS = WheelParams()


@dataclass(frozen=True, slots=True)
class Counted:
    """What both wheels counted while they turned, over what they were told to."""

    left: float
    right: float


class WheelTrial:
    """Turns both wheels in the air for a moment: readings in, a velocity out.

    Args:
        way: ahead, or on the spot to the left.
        half_track_m: half of the track that the board calculates with [m].
    """

    def __init__(self, way: Literal["ahead", "left"], half_track_m: float) -> None:
        self.problem: str | None = None
        self.counted: Counted | None = None
        """Once it has ended well."""
        self._half_track_m = half_track_m
        speed = PARAMS.speed_mps
        self._told = Twist2D(speed, 0.0, 0.0)
        if way == "left":
            self._told = Twist2D(0.0, 0.0, speed / half_track_m)
        self._lidar = LidarTrack()
        self._first: list[LidarScan] = []
        self._start = Pose2D.identity()
        self._way = self._turn = 0.0
        self._now_ns, self._heard_ns = 0, 0
        self._course = self._try()

    @property
    def has_ended(self) -> bool:
        """Whether it is over."""
        return self.problem is not None or self.counted is not None

    def give_up(self, problem: str) -> None:
        """End it, with the reason."""
        self.problem = self.problem or problem

    def step(
        self, now_ns: int, motions: Sequence[MotionSample], scans: Sequence[LidarScan]
    ) -> Twist2D:
        """Take what the devices said, and return the velocity until the next step."""
        self._heard_ns = now_ns if motions or not self._heard_ns else self._heard_ns
        self._now_ns = now_ns
        if self.has_ended:
            return Twist2D.zero()
        for motion in motions:
            self._way += motion.previous_T_base.x
            self._turn += motion.previous_T_base.yaw
        try:
            for scan in scans:
                if self._lidar.take(scan):
                    self._lidar.follow(scan, ())
            refuse_silence("motor board", self._heard_ns, now_ns)
            return next(self._course)
        except StopIteration:
            return Twist2D.zero()
        except SetupRefused as refusal:
            self.give_up(str(refusal))
            return Twist2D.zero()

    def _try(self) -> Generator[Twist2D]:
        yield from self._for(PARAMS.resting_s, Twist2D.zero())
        self._first, self._start = self._lidar.scans[-6:], self._lidar.pose
        self._way = self._turn = 0.0
        yield from self._for(PARAMS.turning_s, self._told)
        yield from self._for(PARAMS.resting_s, Twist2D.zero())
        outward = self._half_track_m * self._turn
        told_left = self._told.vx - self._half_track_m * self._told.wz
        told_right = self._told.vx + self._half_track_m * self._told.wz
        self.counted = Counted(
            (self._way - outward) / (told_left * PARAMS.turning_s),
            (self._way + outward) / (told_right * PARAMS.turning_s),
        )

    def _for(self, seconds: float, twist: Twist2D) -> Generator[Twist2D]:
        until_ns = self._now_ns + round(seconds * 1e9)
        while self._now_ns < until_ns:
            if not twist.is_zero:
                self._watch_robot()
            yield twist

    def _watch_robot(self) -> None:
        """Refuse a robot that moves, or whose wheels run away."""
        most = PARAMS.most_share * PARAMS.speed_mps * PARAMS.turning_s
        if max(abs(self._way), self._half_track_m * abs(self._turn)) > most:
            raise SetupRefused(
                "The wheels turn much faster than told: an encoder counts backwards or is dead, so "
                "that the board drives its wheel harder and harder."
            )
        beams, scans = self._lidar.beams, self._lidar.scans
        if beams is None or len(self._first) < 2 or len(scans) < 4:
            return
        moved = self._start.inverse() @ self._lidar.pose
        is_away = math.hypot(moved.x, moved.y) > PARAMS.moved_m
        is_moved = is_away or abs(moved.yaw) > PARAMS.moved_rad
        if is_moved or moving_share(beams, [*self._first[:2], *scans[-2:]]) > PARAMS.moved_share:
            raise SetupRefused(
                "The robot moves, or what is around it does. Lift it, so that its wheels turn "
                "freely in the air and the rest of it stands still."
            )


@dataclass(frozen=True, slots=True)
class Wiring:
    """How the motors are wired: whether a wheel turns the wrong way round, or left is right."""

    left_is_reversed: bool
    right_is_reversed: bool
    is_swapped: bool

    @property
    def is_right(self) -> bool:
        """Whether nothing is wrong."""
        return not (self.left_is_reversed or self.right_is_reversed or self.is_swapped)


def judge_counts(counted: Counted) -> None:
    """Refuse encoders that do not count as the board drives its wheels.

    Raises:
        SetupRefused: with which of them, as the board has them, and what to do.
    """
    turns = (("left", counted.left), ("right", counted.right))
    dead = [name for name, share in turns if abs(share) < PARAMS.least_share]
    if len(dead) == 2:
        raise SetupRefused(
            "Both encoders count nothing. Do the wheels turn, is the motors' power on, and are the "
            "encoders' cables plugged in?"
        )
    if dead:
        raise SetupRefused(
            f"The encoder of the board's {dead[0]} wheel counts nothing, or that wheel does not "
            "turn: look at its motor's and its encoder's cables."
        )
    back = [name for name, share in turns if share < 0.0]
    if back:
        raise SetupRefused(
            f"The encoder of the board's {' and '.join(back)} wheel counts against what its motor "
            "is told: swap the A and B wires of that encoder."
        )


def judge_wiring(ahead: Seen, left: Seen) -> Wiring:
    """Say how the motors are wired from how the wheels were seen to turn.

    Args:
        ahead: when told to go ahead.
        left: when told to turn to the left.

    Raises:
        SetupRefused: the answers do not fit each other, or a wheel stood.
    """
    if ahead == "not both" or left == "not both":
        raise SetupRefused(
            "A wheel does not turn: look at its motor's cable, and whether it turns freely."
        )
    left_sign, right_sign = DIRECTIONS[ahead]
    seen = DIRECTIONS[left]
    wiring = {
        (-left_sign, right_sign): False,
        (left_sign, -right_sign): True,
    }
    if seen not in wiring:
        raise SetupRefused(
            f"The wheels cannot have turned so: {ahead} when told to go ahead, and {left} when "
            "told to turn to the left. Look again."
        )
    return Wiring(left_sign < 0, right_sign < 0, wiring[seen])
