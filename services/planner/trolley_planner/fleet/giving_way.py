"""Giving way to other robots: when to wait, where, and when to drive on."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from trolley.config import PlannerConfig
from trolley.geometry import Pose2D, Twist2D
from trolley_planner.context.motion_state import Situation
from trolley_planner.context.planning_context import Rig
from trolley_planner.control.controller import Motion
from trolley_planner.driving.final_alignment import limited_change
from trolley_planner.driving.goal_execution import Drive
from trolley_planner.fleet.neighbours import Neighbour, moved_into
from trolley_planner.fleet.right_of_way import (
    MARGIN_M,
    Own,
    Passages,
    must_step_aside,
    must_wait,
    standing_on,
)
from trolley_planner.fleet.waiting_pose import is_clear, place_aside
from trolley_planner.goals.goal import Goal, Tolerances

FACING_S = 1.5
"""Two that have stood face to face for so long stay there unless one steps aside."""
PASSED_S = 0.6
"""The way must have been free for so long before the robot drives on."""
IDLE_S, IDLE_M = 12.0, 0.2
"""Who has the right of way and does not move this far within this time leaves it to the other,"""
TURN_S = 15.0
"""for so long."""
LOOK_ASIDE_S = 1.0
"""Time between two looks for a better place to wait."""
STANDS_MPS, STANDS_RADPS = 0.03, 0.1
MOST_WAITS = 5.0
"""After so many times the time to give up it does not wait any longer."""
TO_PASS = "to pass"
ASIDE = Tolerances(0.12, math.pi)
BLOCKING_M = 2.0
"""Who stands on the way within this is named."""


@dataclass(slots=True)
class Wait:
    """For whom the robot waits."""

    name: str
    where: str
    """In words: before which narrow place; "to pass" where they face each other."""
    since_ns: int
    place: Pose2D
    """Where the other one was when it last moved."""
    moved_ns: int
    free_ns: int | None = None
    """Since when it does not have to wait for that one any more."""

    @property
    def sentence(self) -> str:
        """What people read."""
        return f"Waits for robot {self.name} {self.where}."


class GivingWay:
    """Knows the other robots, and decides whether to wait for one of them.

    Args:
        config: of the planner.
    """

    def __init__(self, config: PlannerConfig) -> None:
        self._config = config
        self._passages: tuple[object, Passages] | None = None
        self._stood_ns: int | None = None
        self._left_to: dict[str, int] = {}
        self._looked_ns = 0
        self._waited_ns = 0
        self._aside: Drive | None = None
        self.others: list[Neighbour] = []
        """Who else is there, in `grid`."""
        self.wait: Wait | None = None
        """For whom the robot waits now."""

    def meet(self, rig: Rig, others: Sequence[Neighbour], now_ns: int) -> None:
        """Take where the others are.

        Args:
            rig: its costmap learns where they will be.
            others: in the frame of the goals.
            now_ns: robot time.
        """
        grid_T_frame = rig.costmap.frame_T_grid.inverse()
        self.others = [moved_into(other, grid_T_frame) for other in others]
        rig.costmap.moving.set_robots([one.track for one in self.others if len(one.track)], now_ns)

    def forget(self) -> None:
        """Wait for nobody, as with a new goal."""
        self.wait, self._aside, self._stood_ns, self._waited_ns = None, None, None, 0
        self._left_to.clear()

    def decide(self, name: str, drive: Drive, motion: Motion, now_ns: int) -> None:
        """Decide anew whether to wait, and for whom.

        Args:
            name: of this robot.
            drive: to its goal.
            motion: of it.
            now_ns: robot time.
        """
        self._note_standing(motion, now_ns)
        going = [one for one in self.others if one.is_going]
        if not going:
            self._note_free(now_ns)
            return
        pose, rig = motion.pose, drive.rig
        drive.route.follow(pose)
        passages = self._passages_for(rig, going)
        stood_s = 0.0 if self._stood_ns is None else (now_ns - self._stood_ns) * 1e-9
        own = Own(
            name,
            (pose.x, pose.y),
            rig.footprint.circumscribed_m,
            drive.route.path.points[drive.route.index :],
            None if self.wait is None else self.waited_s(now_ns),
            stood_s,
        )
        before = self.wait
        order = sorted(going, key=lambda one: before is None or one.name != before.name)
        for other in order:
            if self._left_to.get(other.name, 0) > now_ns:
                continue
            where = must_wait(own, other, passages)
            if where is None and self._is_face_to_face(own, other):
                where = TO_PASS
            if where is not None:
                self._wait_for(other, where, now_ns)
                self._look_aside(drive, pose, passages, now_ns)
                return
        self._note_free(now_ns)

    def look(self, motion: Motion, now_ns: int) -> bool:
        """Take in a scan for the way aside; False if there is none to drive."""
        if self._aside is None:
            return False
        self._aside.look(motion, now_ns)
        return True

    def command(self, now: Situation) -> Twist2D:
        """Return the velocity while it waits: to the place where it does, and there none."""
        aside = self._aside
        if aside is not None:
            twist = aside.command(now)
            if aside.outcome is None:
                return twist
            self._aside = None
        return limited_change(now.motion.twist, Twist2D.zero(), now.limits, now.elapsed_s)

    def maintain(self, rig: Rig, now: Situation) -> None:
        """Do what takes longer: keep costmap and way aside up to date."""
        if self._aside is not None:
            self._aside.maintain(now)
        else:
            rig.costmap.refresh()

    def waited_s(self, now_ns: int) -> float:
        """Return how long it has been waiting [s]."""
        return 0.0 if self.wait is None else (now_ns - self.wait.since_ns) * 1e-9

    def take_waited_ns(self) -> int:
        """Return how long the last wait took that is over, once; 0 if there was none."""
        waited_ns, self._waited_ns = self._waited_ns, 0
        return waited_ns

    def has_waited_enough(self, now_ns: int) -> bool:
        """Say whether to give up."""
        return self.waited_s(now_ns) > MOST_WAITS * self._config.give_up_s

    def in_the_way(self, drive: Drive) -> str | None:
        """Return the name of a robot without a goal that stands on the way, None if none does."""
        route = drive.route
        last = route.path.ahead(route.index, BLOCKING_M)
        ahead = route.path.points[route.index : last + 1]
        return standing_on(ahead, self.others, drive.rig.footprint.inscribed_m)

    def _note_standing(self, motion: Motion, now_ns: int) -> None:
        stands = abs(motion.twist.vx) < STANDS_MPS and abs(motion.twist.wz) < STANDS_RADPS
        if not stands:
            self._stood_ns = None
        elif self._stood_ns is None:
            self._stood_ns = now_ns

    def _is_face_to_face(self, own: Own, other: Neighbour) -> bool:
        """Say whether to let another pass; who began to wait for that does so until it has."""
        waits = (
            self.wait is not None and self.wait.name == other.name and self.wait.where == TO_PASS
        )
        return must_step_aside(replace(own, stood_s=math.inf) if waits else own, other, FACING_S)

    def _wait_for(self, other: Neighbour, where: str, now_ns: int) -> None:
        wait = self.wait
        if wait is None or wait.name != other.name:
            since_ns = now_ns if wait is None else wait.since_ns
            self.wait = Wait(other.name, where, since_ns, other.pose, now_ns)
            return
        wait.free_ns = None
        if wait.place.distance_to(other.pose) > IDLE_M:
            wait.place, wait.moved_ns = other.pose, now_ns
        elif now_ns - wait.moved_ns > IDLE_S * 1e9:
            self._left_to[other.name] = now_ns + round(TURN_S * 1e9)

    def _note_free(self, now_ns: int) -> None:
        """Drive on, once there has been nobody to wait for during some time."""
        if self.wait is None:
            return
        if self.wait.free_ns is None:
            self.wait.free_ns = now_ns
        if now_ns - self.wait.free_ns > PASSED_S * 1e9:
            self._waited_ns = now_ns - self.wait.since_ns
            self.wait, self._aside = None, None

    def _look_aside(self, drive: Drive, pose: Pose2D, passages: Passages, now_ns: int) -> None:
        """Look for a place to wait, where the robot would be in somebody's way."""
        if now_ns - self._looked_ns < LOOK_ASIDE_S * 1e9:
            return
        self._looked_ns = now_ns
        rig = drive.rig
        radius_m = rig.footprint.circumscribed_m
        if is_clear(pose, radius_m, passages, self.others):
            self._aside = None
            return
        place = place_aside(rig.costmap, passages, pose, radius_m, self.others)
        if place is None:
            self._aside = None
            return
        target = Pose2D(*place, 0.0)
        if self._aside is not None and self._aside.goal_grid.distance_to(target) < 0.3:
            return
        costmap = rig.costmap
        costmap.refresh()
        path = rig.planner.plan((pose.x, pose.y), [place], costmap.weights, costmap.distance_m)
        if path is None:
            self._aside = None
            return
        goal = Goal(
            drive.goal.id, costmap.frame_T_grid @ target, (), ASIDE, drive.goal.speed, now_ns
        )
        self._aside = Drive(goal, rig, self._config, path, now_ns)

    def _passages_for(self, rig: Rig, going: Sequence[Neighbour]) -> Passages:
        """Return where this robot and the largest of the others do not fit side by side."""
        largest_m = max(one.radius_m for one in going)
        half_m = rig.footprint.circumscribed_m + largest_m + MARGIN_M
        known = self._passages
        walls_m = rig.costmap.static_distance_m
        if known is None or known[0] is not walls_m or abs(known[1].half_m - half_m) > 1e-6:
            passages = Passages(walls_m, rig.costmap.resolution_m, half_m)
            known = self._passages = walls_m, passages
        return known[1]
