"""Where the robot is, how it moves and what it may do: the input of each command."""

from dataclasses import dataclass

from trolley import codes
from trolley.codes import Refused
from trolley.config import PlannerConfig
from trolley.geometry import Pose2D, Twist2D
from trolley_planner.context.commanded_velocity import VELOCITY, CommandedVelocity
from trolley_planner.context.planning_context import CostmapManager
from trolley_planner.control.controller import Motion, limits_of
from trolley_planner.control.robot_motion import Limits
from trolley_planner.sensing.inputs import Inputs


@dataclass(frozen=True, slots=True)
class MotionStateParams:
    """Where commands start from; by hand."""

    most_elapsed_s: float = 0.1
    """Longest time between two commands that is reckoned with; longer gaps count as this."""
    spinning_mps: float = 0.15
    """Highest speed at which a turn still counts as a spin."""


MOTION = MotionStateParams()


@dataclass(frozen=True, slots=True)
class ControlInput:
    """What a command is computed from.

    Attributes:
        now_ns: robot time.
        obeyed_ns: robot time when it obeys this command.
        motion: in `grid`, then, with the velocity that was commanded last.
        steady: the same pose without the noise of the localizer, for the final approach.
        odom_T_base: by the wheels alone.
        limits: of the robot at the moment.
        elapsed_s: since the last command.
    """

    now_ns: int
    obeyed_ns: int
    motion: Motion
    steady: Pose2D
    odom_T_base: Pose2D
    limits: Limits
    elapsed_s: float


class MotionState:
    """Combines the inputs with the last command.

    Args:
        config: of the planner.
        inputs: the newest messages.
        costmap_manager: knows where frame `grid` lies.
    """

    def __init__(
        self, config: PlannerConfig, inputs: Inputs, costmap_manager: CostmapManager
    ) -> None:
        self._config = config
        self._inputs = inputs
        self._costmap_manager = costmap_manager
        self._commanded = CommandedVelocity()
        self._commanded_ns: int | None = None

    def set_config(self, config: PlannerConfig) -> None:
        """Apply other limits from the next command on."""
        self._config = config

    @property
    def commanded_ns(self) -> int:
        """Robot time of the last command, 0 while there is none."""
        return self._commanded_ns or 0

    def record_command(self, twist: Twist2D | None, now_ns: int) -> None:
        """Record what was commanded, None for silence."""
        self._commanded_ns = None if twist is None else now_ns
        self._commanded.record(twist, now_ns)

    def elapsed_s(self, now_ns: int) -> float:
        """Return the time since the last command [s], as far as it matters."""
        if self._commanded_ns is None:
            return MOTION.most_elapsed_s
        return min(max((now_ns - self._commanded_ns) * 1e-9, 0.0), MOTION.most_elapsed_s)

    def motion(self) -> Motion | None:
        """Return pose and velocity in `grid`, None while they are not known."""
        here, context = self._inputs.base_pose(), self._costmap_manager.context
        if here is None or context is None:
            return None
        return Motion(context.costmap.to_grid(here), self._commanded.velocity(self._inputs.twist()))

    def control_input(
        self, goal_speed: float | None, now_ns: int, elapsed_s: float
    ) -> ControlInput | None:
        """Return what a command is computed from, None while something of it is not known."""
        motion, steady = self.motion(), self._inputs.base_pose(steady=True)
        context, odometry = self._costmap_manager.context, self._inputs.odometry
        if motion is None or steady is None or context is None or odometry is None:
            return None
        delay_s = self._delay_s
        ahead = self._until_obeyed(now_ns, delay_s)
        here = motion.pose
        if ahead != Pose2D.identity():
            motion = Motion(here @ ahead, motion.twist, here)
        return ControlInput(
            now_ns,
            now_ns + round(delay_s * 1e9),
            motion,
            context.costmap.to_grid(steady) @ ahead,
            odometry.pose,
            self.limits(goal_speed),
            elapsed_s,
        )

    @property
    def _delay_s(self) -> float:
        """Time until the robot obeys a command, as far as it is reckoned with [s]."""
        robot = self._inputs.robot
        return min(robot.delay, VELOCITY.lag_s) if robot is not None and robot.delay else 0.0

    def _until_obeyed(self, now_ns: int, delay_s: float) -> Pose2D:
        """Return how the robot moves until it obeys a command that is given now."""
        here = Pose2D.identity()
        if delay_s == 0.0:
            return here
        return self._commanded.pose_when_obeyed(here, self._inputs.twist(), now_ns, delay_s)

    def limits(self, goal_speed: float | None) -> Limits:
        """Return the robot's present limits: the lowest of all except those of the place.

        Raises:
            Refused: the robot itself is not known.
        """
        config, robot = self._config, self._inputs.robot
        if robot is None:
            raise Refused(codes.NOT_READY)
        speed = min(config.max_speed_mps, robot.max_speed)
        if goal_speed is not None:
            speed = min(speed, goal_speed)
        if self._inputs.is_unsure:
            speed = min(speed, config.unsure_speed_mps)
        return limits_of(config, speed, robot.max_wz, robot.deceleration)

    def turn_limits(self) -> Limits | None:
        """Return the limits of a turn in place, None while they are unknown."""
        is_known = self._inputs.robot is not None and self._costmap_manager.context is not None
        return self.limits(MOTION.spinning_mps) if is_known else None
