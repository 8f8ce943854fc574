"""What may keep the robot from its goal, and how long it waits."""

from dataclasses import dataclass

from trolley import codes
from trolley.config import PlannerConfig
from trolley.geometry import Pose2D, Twist2D
from trolley_planner.context.motion_state import ControlInput
from trolley_planner.context.planning_context import PlanningContext
from trolley_planner.control.proximity import PROXIMITY
from trolley_planner.driving.contact_hold import ContactHold
from trolley_planner.driving.progress_checker import ProgressChecker
from trolley_planner.driving.route import Blockage


@dataclass(frozen=True, slots=True)
class PatienceParams:
    """When the robot waits, and when recovery begins; all by hand."""

    no_path_s: float = 0.7
    """Time without a path in the local costmap after which recovery begins."""
    on_goal_m: float = 0.1
    """Distance to an occupied goal within which the robot does not wait: it has only to turn."""
    wait_at_goal_m: float = 0.5
    """Distance from the robot's outline to an occupied goal at which it waits."""
    goal_patience: float = 4.0
    """It waits there for this many times the usual patience."""
    wait_on_way_m: float = 0.9
    """Length of free path ahead of the robot's outline at which it waits for what stands on the
    only path. With the path's clearance that is the 1.2 m beyond which a stranger is not too near:
    Hall, The Hidden Dimension (1966)."""
    way_patience: float = 3.0
    """It waits there for this many times the usual patience, then comes closer. Nobody is come
    closer to: for who was seen to walk or to stir there it waits until it gives up."""
    yield_m: float = 0.8
    """Distance from the outline within which a moving person may be why the robot stands."""


PATIENCE = PatienceParams()


class Patience:
    """How long something was waited for; it comes back while nothing is, slowly with things."""

    def __init__(self) -> None:
        self._waited_s = 0.0
        self.is_with_somebody = False
        """Whether it is somebody who is waited for."""

    def begin_with_somebody(self) -> None:
        """Note that it is somebody; how long a thing was waited for before does not count."""
        if not self.is_with_somebody:
            self.is_with_somebody, self._waited_s = True, 0.0

    def lasts(self, elapsed_s: float, most_s: float, *, waits: bool) -> bool:
        """Record whether the robot waits; say whether it has not yet waited for too long."""
        back = 1.0 if self.is_with_somebody else 0.2
        self._waited_s = max(0.0, self._waited_s + (elapsed_s if waits else -back * elapsed_s))
        self.is_with_somebody &= self._waited_s > 0.0
        return self._waited_s <= most_s


class ProgressMonitor:
    """Detects that the robot makes no progress, and why.

    Args:
        context: costmaps, and people.
        config: of the planner.
    """

    def __init__(self, context: PlanningContext, config: PlannerConfig) -> None:
        self._context = context
        self._patience_s, self._give_up_s = config.patience_s, config.give_up_s
        self._checker = ProgressChecker(config)
        self._contact_hold = ContactHold(context.footprint, config.patience_s)
        self._no_path_s = 0.0
        self._held_s = 0.0
        self.at_goal = Patience()
        """With what stands on the goal."""
        self.on_way = Patience()
        """With what stands on the only path."""
        self.is_waiting_at_goal = False
        """Whether the robot waits before an occupied goal."""
        self.is_waiting_on_way = False
        """Whether it waits for what stands on the only path."""

    def update(self, now_ns: int, pose: Pose2D) -> None:
        """Take in a scan."""
        costmap = self._context.costmap
        beams, people = costmap.obstacle_layer.beams, costmap.moving.people
        self._contact_hold.update(now_ns, beams, people, pose)

    def reset_progress(self) -> None:
        """Restart the measurement of progress, as with a new goal."""
        self._checker.reset()

    def reset(self) -> None:
        """Restart the measurement of progress and the wait for a path."""
        self._checker.reset()
        self._no_path_s = 0.0

    def must_stand(self, now_ns: int) -> bool:
        """Say whether somebody touches the robot."""
        return self._contact_hold.must_stand(now_ns)

    def is_held(self, now: ControlInput) -> bool:
        """Say whether a person may be why the robot stands: they touch it, or move near it."""
        return self.is_anyone_near(now.motion.pose) or self.must_stand(now.now_ns)

    def is_anyone_near(self, pose: Pose2D) -> bool:
        """Say whether somebody moves so near to a robot at a pose that it may stand for them."""
        near_m = self._context.footprint.circumscribed_m + PATIENCE.yield_m
        return self._context.local_costmap.is_anyone_near(pose, near_m)

    def is_excused(self, twist: Twist2D, now: ControlInput) -> bool:
        """Say whether a person holds the robot up, within its patience."""
        is_held = abs(twist.vx) < PROXIMITY.standing_mps and self.is_held(now)
        self._held_s = self._held_s + now.elapsed_s if is_held else 0.0
        return is_held and self._held_s < self._patience_s

    def check(self, now: ControlInput, left_m: float, *, is_led: bool) -> str | None:
        """Return the code of what is wrong, None while all is well.

        Args:
            now: where the robot is.
            left_m: what is left to do.
            is_led: whether there is a path for it.
        """
        self._no_path_s = 0.0 if is_led else self._no_path_s + now.elapsed_s
        pose = now.motion.pose
        speed = min(now.limits.max_speed, self._context.zone_speed(pose))
        trouble = self._checker.check(
            now.now_ns, left_m, pose, now.odom_T_base, speed, now.limits.max_turn
        )
        has_no_path = self._no_path_s > PATIENCE.no_path_s
        if trouble is None and has_no_path and now.motion.is_standing:
            return codes.BLOCKED
        return trouble

    def is_near_goal(self, left_m: float) -> bool:
        """Say whether the robot is where it waits before an occupied goal.

        Args:
            left_m: how far it is to the goal.
        """
        reach_m = self._context.footprint.circumscribed_m + PATIENCE.wait_at_goal_m
        return PATIENCE.on_goal_m < left_m < reach_m

    def wait_at_goal(self, elapsed_s: float, *, waits: bool) -> bool:
        """Record whether it waits there; False when it has waited for long enough."""
        most_s = PATIENCE.goal_patience * self._patience_s
        is_patient = self.at_goal.lasts(elapsed_s, most_s, waits=waits)
        self.is_waiting_at_goal = waits or not is_patient
        if is_patient and waits:
            self._checker.reset()
        return is_patient

    def wait_on_way(self, blockage: Blockage | None, pose: Pose2D, elapsed_s: float) -> bool:
        """Record whether to wait, at a distance, for what stands on the only path.

        Args:
            blockage: what does; None where the path is free.
            pose: of the robot in `grid`.
            elapsed_s: since the last time.

        Returns:
            False when it has waited for somebody for long enough.
        """
        reach_m = self._context.footprint.circumscribed_m + PATIENCE.wait_on_way_m
        near = blockage if blockage is not None and blockage.free_m < reach_m else None
        waits, patience = near is not None, self.on_way
        if near is not None and self._context.costmap.moving.is_somebody_at(*near.place, pose):
            patience.begin_with_somebody()
        is_with_somebody = waits and patience.is_with_somebody
        most_s = self._give_up_s if is_with_somebody else PATIENCE.way_patience * self._patience_s
        is_patient = patience.lasts(elapsed_s, most_s, waits=waits)
        self.is_waiting_on_way = is_patient and waits
        if self.is_waiting_on_way:
            self._checker.reset()
        return is_patient or not is_with_somebody
