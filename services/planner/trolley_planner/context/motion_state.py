"""Where the robot is, how it moves and what it may do: the input of every command."""

from dataclasses import dataclass

from trolley import codes
from trolley.codes import Refused
from trolley.config import PlannerConfig
from trolley.geometry import Pose2D, Twist2D
from trolley_planner.context.costmap_manager import Surroundings
from trolley_planner.control.controller import Motion, limits_of
from trolley_planner.control.rollout import Limits
from trolley_planner.sensing.inputs import Senses

UNSURE_SPEED = 0.15
MAX_ELAPSED_S = 0.1
TURNING_SPEED = 0.15
DIFFERS_MPS, DIFFERS_RADPS = 0.15, 0.5
"""Wheels that differ by more than this from the last command do not follow it."""


@dataclass(frozen=True, slots=True)
class Situation:
    """What a command is computed from.

    Attributes:
        now_ns: robot time.
        motion: in `grid`, with the velocity that was commanded last.
        steady: the pose in `grid` without the noise of the localizer, for the final approach.
        odom_T_base: by the wheels alone.
        limits: of the robot at the moment.
        elapsed_s: since the last command.
    """

    now_ns: int
    motion: Motion
    steady: Pose2D
    odom_T_base: Pose2D
    limits: Limits
    elapsed_s: float


class Helm:
    """Puts senses and the last command together.

    Args:
        config: of the planner.
        senses: the newest messages.
        surroundings: tells where frame `grid` lies.
    """

    def __init__(self, config: PlannerConfig, senses: Senses, surroundings: Surroundings) -> None:
        self._config = config
        self._senses = senses
        self._surroundings = surroundings
        self._last_twist = Twist2D.zero()
        self._commanded_ns: int | None = None

    @property
    def commanded_ns(self) -> int:
        """Robot time of the last command, 0 while there is none."""
        return self._commanded_ns or 0

    def note_command(self, twist: Twist2D | None, now_ns: int) -> None:
        """Take what was commanded, None for silence."""
        self._commanded_ns = None if twist is None else now_ns
        self._last_twist = Twist2D.zero() if twist is None else twist

    def elapsed_s(self, now_ns: int) -> float:
        """Return the time since the last command [s], as far as it matters."""
        if self._commanded_ns is None:
            return MAX_ELAPSED_S
        return min(max((now_ns - self._commanded_ns) * 1e-9, 0.0), MAX_ELAPSED_S)

    def motion(self) -> Motion | None:
        """Return pose and velocity in `grid`, None while they are not known."""
        here, rig = self._senses.base_pose(), self._surroundings.rig
        if here is None or rig is None:
            return None
        return Motion(rig.costmap.to_grid(here), self._velocity())

    def situation(
        self, goal_speed: float | None, now_ns: int, elapsed_s: float
    ) -> Situation | None:
        """Return what a command is computed from, None while something of it is not known."""
        motion, steady = self.motion(), self._senses.base_pose(steady=True)
        rig, odometry = self._surroundings.rig, self._senses.odometry
        if motion is None or steady is None or rig is None or odometry is None:
            return None
        return Situation(
            now_ns,
            motion,
            rig.costmap.to_grid(steady),
            odometry.pose,
            self.limits(goal_speed),
            elapsed_s,
        )

    def limits(self, goal_speed: float | None) -> Limits:
        """Return what the robot may do now: the least of all limits but those of the place.

        Raises:
            Refused: the robot itself is not known.
        """
        config, robot = self._config, self._senses.robot
        if robot is None:
            raise Refused(codes.NOT_READY)
        speed = min(config.max_speed_mps, robot.max_speed)
        if goal_speed is not None:
            speed = min(speed, goal_speed)
        if self._senses.is_unsure:
            speed = min(speed, UNSURE_SPEED)
        return limits_of(config, speed, robot.max_wz, robot.deceleration)

    def turn_limits(self) -> Limits | None:
        """Return what the robot may do while it turns in place, None while it is not known."""
        is_known = self._senses.robot is not None and self._surroundings.rig is not None
        return self.limits(TURNING_SPEED) if is_known else None

    def _velocity(self) -> Twist2D:
        """Return the velocity to start from: the last command, or the wheels' where they differ."""
        measured, last = self._senses.twist(), self._last_twist
        return Twist2D(
            last.vx if abs(measured.vx - last.vx) < DIFFERS_MPS else measured.vx,
            0.0,
            last.wz if abs(measured.wz - last.wz) < DIFFERS_RADPS else measured.wz,
        )
