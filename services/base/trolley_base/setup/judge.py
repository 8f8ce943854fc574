"""What is wrong with a drive while it goes on: lidar and wheels that see it differently."""

import math
from dataclasses import dataclass

import numpy as np

from trolley.geometry import Pose2D, Twist2D
from trolley_base.setup.clearance import Mount
from trolley_base.setup.motion import LidarTrack, WheelCount
from trolley_base.setup.record import Record, SetupRefused


@dataclass(frozen=True, slots=True)
class JudgeParams:
    """When it is wrong; set by hand unless stated otherwise."""

    too_fast: float = 1.8
    """A robot that moves so many times as fast as told is stopped."""
    num_fast: int = 3
    """Number of scans in a row that must say so."""
    follows_s: float = 1.5
    """The robot may follow a command for so long after the next one [s]: it is late, and brakes."""
    plain_rad: float = 2.0
    """Turn over which it may see one wall only at each stand [rad]: one turn where the lidar sees
    far round, or two of a lidar that sees half of that."""
    most_plain: int = 1
    """Number of stands in a row at which it may see one wall only once it drives."""
    differ: float = 0.3
    """Share by which lidar and wheels may differ before anything is measured."""
    differ_m: float = 0.05
    """Added to that for ways [m]."""
    differ_rad: float = 0.12
    """Added to that for turns [rad]."""
    differ_bend: float = 1.3
    """Added to that for ways [rad/m]: two wheels of 0.1 m on a narrow track may differ so much."""
    differ_turning: float = 0.4
    """Added to that for ways on which it turns [m/rad]."""
    most_turn_rad: float = 0.4
    """On a larger turn, ways are not compared [rad]."""
    trial_turned_rad: float = 0.125
    """Wheels that count less of the first turn count nothing, if they count no way either [rad]."""
    trial_way_m: float = 0.02
    """Such a way [m]."""
    unseen_m: float = 0.25
    """Way that wheels may count while the lidar sees no motion [m]: it is late, and the robot
    drives blindly."""
    unseen_rad: float = 0.8
    """The same of a turn [rad]."""
    seen_m: float = 0.05
    """Motion that the lidar sees [m] ..."""
    seen_rad: float = 0.08
    """... or that [rad]."""
    one_sided: float = 0.5
    """Share of a turn that shows as a way of the robot when one encoder does not count."""


PARAMS = JudgeParams()
UNSEEN = (
    "the wheels turn, but the lidar sees no motion. The wheels slip or are not on the floor, or "
    "the lidar shows one picture again and again."
)


class Judge:
    """Compares what lidar and wheels say of each stretch, and refuses what cannot be.

    Args:
        half_track_m: half of the track that the board calculates with [m].
        lidar: where it is.
        wheels: what they count.
        mount: how the lidar sits, as far as it is known.
        record: of the drive.
    """

    def __init__(
        self,
        half_track_m: float,
        lidar: LidarTrack,
        wheels: WheelCount,
        mount: Mount,
        record: Record,
    ) -> None:
        self._half_track_m = half_track_m
        self._lidar, self._wheels = lidar, wheels
        self._mount, self._record = mount, record
        self._num_fast = self._num_plain = 0
        self._plain_rad = 0.0
        self._last_seen: tuple[Pose2D, float, float] | None = None
        """Where the lidar last saw motion, and what the wheels had counted by then."""

    @property
    def moved(self) -> Pose2D:
        """Motion of the lidar between the last two stands."""
        stands = self._record.stands
        return stands[-2].start_T_laser.inverse() @ stands[-1].start_T_laser

    def refuse_plain(self, turned_rad: float, *, is_plain: bool) -> None:
        """Refuse a place that is plain all round; a lidar that looks ahead may face one wall.

        Args:
            turned_rad: from the stand before to this one [rad].
            is_plain: the walls in sight tell too little here.
        """
        self._plain_rad = self._plain_rad + abs(turned_rad) if self._num_plain else 0.0
        self._num_plain = self._num_plain + 1 if is_plain else 0
        is_turning = self._mount.ahead is None
        is_long = self._num_plain > PARAMS.most_plain
        if is_long and (not is_turning or self._plain_rad > PARAMS.plain_rad):
            raise SetupRefused(
                "The lidar sees too few different walls here, as in a plain corridor, to tell how "
                "the robot moves. Choose a place with walls or furniture in several directions."
            )

    def learn_sense(self) -> None:
        """Learn from the first turn, to the left, which way round the lidar turns.

        Raises:
            SetupRefused: the wheels have not counted a turn to the left.
        """
        way, turn = self._wheels.between_stands()
        if abs(turn) < PARAMS.trial_turned_rad and abs(way) < PARAMS.trial_way_m:
            raise SetupRefused(
                "The robot turned, but the wheels counted nothing: look at the encoders' cables."
            )
        if turn < 0.0:
            raise SetupRefused(
                "The wheels counted a turn to the right when told to turn to the left: left and "
                "right are swapped, or both encoders count backwards."
            )
        one_sided = way / (self._half_track_m * turn)
        if abs(one_sided) > PARAMS.one_sided:
            side = "left" if one_sided > 0.0 else "right"
            raise SetupRefused(
                f"On a turn only one wheel counted: the encoder of the {side} wheel does not "
                "count, or that wheel does not turn."
            )
        self._mount.sign = math.copysign(1.0, self.moved.yaw)

    def refuse_odd(self) -> None:
        """Refuse a stretch, the last, that wheels and lidar saw quite differently."""
        (way, turn), moved = self._wheels.between_stands(), self.moved
        turned = self._mount.sign * moved.yaw
        off = abs(math.remainder(turned - turn, 2.0 * math.pi))
        if off > PARAMS.differ * abs(turn) + PARAMS.differ_rad + PARAMS.differ_bend * abs(way):
            raise SetupRefused(
                f"The wheels counted a turn by {math.degrees(turn):.0f}°, and the lidar saw "
                f"{math.degrees(turned):.0f}°: the wheels slip, a wheel's size or the track is "
                "far from what is set, or somebody moved the robot."
            )
        if abs(turn) > PARAMS.most_turn_rad:
            return
        seen_m = math.hypot(moved.x, moved.y)
        allowed_m = PARAMS.differ * abs(way) + PARAMS.differ_m + PARAMS.differ_turning * abs(turn)
        if abs(seen_m - abs(way)) > allowed_m:
            raise SetupRefused(
                f"The wheels counted {abs(way):.2f} m, and the lidar saw {seen_m:.2f} m: the "
                "wheels slip, their size is far from what is set, or somebody moved the robot."
            )

    def refuse_too_fast(self, twist: Twist2D, now_ns: int, speed_mps: float) -> None:
        """Refuse a robot that runs away.

        Args:
            twist: how fast the lidar moves.
            now_ns: robot time.
            speed_mps: the highest that may be commanded [m/s].
        """
        since_ns = now_ns - round(PARAMS.follows_s * 1e9)
        told = self._record.told_since(since_ns)
        told_v, told_wz = max(abs(one.vx) for one in told), max(abs(one.wz) for one in told)
        axle = self._mount.axle
        lever = 0.5 if axle is None else float(np.hypot(*axle)) + 0.05
        most_wz = PARAMS.too_fast * told_wz + PARAMS.differ_bend * told_v + 0.3
        # In a corridor the lidar does not see how fast it goes along it: that is told later.
        most_v = PARAMS.too_fast * speed_mps + lever * abs(twist.wz) + 0.1
        is_fast = abs(twist.wz) > most_wz or twist.speed > most_v
        self._num_fast = self._num_fast + 1 if is_fast else 0
        if self._num_fast >= PARAMS.num_fast:
            raise SetupRefused(
                "The robot moves much faster than told: an encoder may be dead or count backwards, "
                "so that the board drives its wheel harder and harder; or somebody carries it."
            )

    def refuse_unseen(self) -> None:
        """Refuse to go on while the wheels drive and the lidar sees one picture."""
        pose, way, turn = self._lidar.pose, self._wheels.way, self._wheels.turn
        if self._last_seen is not None:
            there, way_then, turn_then = self._last_seen
            moved = there.inverse() @ pose
            if math.hypot(moved.x, moved.y) < PARAMS.seen_m and abs(moved.yaw) < PARAMS.seen_rad:
                unseen = abs(way - way_then) / PARAMS.unseen_m
                unseen += abs(turn - turn_then) / PARAMS.unseen_rad
                if unseen > 1.0:
                    raise SetupRefused(f"The robot does not drive as told: {UNSEEN}")
                return
        self._last_seen = pose, way, turn

    def why_not(self, now_ns: int) -> str:
        """Say what wheels and lidar saw of the last command, which was not obeyed."""
        if not self._record.stands:
            return "the wheels or the lidar's picture never come to rest."
        last = self._record.stands[-1]
        wheels = self._record.wheel_motions()
        part = wheels.between(last.middle_ns, now_ns)
        turns = abs(float(np.sum(wheels.turn[part]))) > 0.1
        drives = abs(float(np.sum(wheels.way[part]))) > 0.03
        seen = self._lidar.since_stand
        moves = math.hypot(seen.x, seen.y) > 0.05 or abs(seen.yaw) > 0.1
        if not (turns or drives or moves):
            return (
                "the wheels do not turn. Is the motors' power on, and is the stop button released?"
            )
        if not moves:
            return UNSEEN
        if not (turns or drives):
            return "it moves, but the wheels count nothing. Look at the encoders' cables."
        return (
            "lidar and wheels see it move otherwise. One wheel may turn the wrong way round, or "
            "something holds the robot."
        )
