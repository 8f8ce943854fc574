"""Yielding to people in corridors and doors that are too narrow to pass them.

In open floor and in wide corridors the controller keeps to its side. Where somebody comes along
the route and there is no room beside them, the robot looks for a place that they will not touch, a
niche or a room, that it reaches before they are in its way, drives there, and waits until they have
passed. Who walks is taken to walk on as now, along walls and not into them. It also waits beside
the only path while something stands on it.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Twist2D
from trolley_planner.context.motion_state import ControlInput
from trolley_planner.context.planning_context import PlanningContext
from trolley_planner.control.controller import Motion, limited_change
from trolley_planner.driving.goal_execution import GoalExecution
from trolley_planner.fleet.beside_way import BesideWay
from trolley_planner.fleet.refuge import REFUGE, Surroundings, find_meeting
from trolley_planner.fleet.right_of_way import Passages


class AsideParams(NamedTuple):
    """When the robot yields to people in narrow places, and for how long; all by hand."""

    moves_m: float = 0.1
    """Distance within which two waiting places count as the same."""
    look_s: float = 0.3
    """Time between two checks."""
    sure_s: float = 0.8
    """Time for which there must be room to pass somebody before the robot no longer yields to them,
    and for which it does not yield then: who sees a robot steps aside, too."""
    passed_s: float = 0.8
    """Time without anybody coming after which the robot drives on."""
    late_s: float = 0.7
    """Time after the predicted passing that the robot still waits: from a niche it does not see
    people come."""
    most_s: float = 12.0
    """Longest time that the robot waits [s]."""
    rest_s: float = 6.0
    """Time after a wait before the next one may begin [s]."""


ASIDE = AsideParams()
SENTENCE = "Somebody is coming and there is no room to pass; the robot is stepping aside."


class SteppingAside:
    """Decides whether to yield to people, and drives to a refuge."""

    def __init__(self) -> None:
        self._passages: tuple[NDArray[np.float32], Passages] | None = None
        self._beside_way = BesideWay()
        self._execution: GoalExecution | None = None
        self._place = (0.0, 0.0)
        self._since_ns: int | None = None
        self._until_ns = 0
        self._came_ns = 0
        self._looked_ns = 0
        self._narrow_ns = 0
        self._rests_ns = 0
        self._waited_ns = 0

    @property
    def is_active(self) -> bool:
        """Whether the robot is yielding."""
        return self._since_ns is not None

    @property
    def waits_beside_way(self) -> bool:
        """Whether that is for what stands on the only path."""
        return self.is_active and self._beside_way.there is not None

    def forget(self) -> None:
        """Drive on, as with a new goal."""
        self._execution, self._since_ns, self._rests_ns, self._waited_ns = None, None, 0, 0
        self._until_ns = self._came_ns = self._looked_ns = 0
        self._beside_way.forget()

    def pop_waited_ns(self) -> int:
        """Return how long it yielded the last time, only once; 0 if it did not."""
        waited_ns, self._waited_ns = self._waited_ns, 0
        return waited_ns

    def decide(self, driven: GoalExecution, motion: Motion, speed: float, now_ns: int) -> None:
        """Decide whether to yield, and where.

        Args:
            driven: how the goal is driven to.
            motion: of the robot, in `grid`.
            speed: that it may have [m/s].
            now_ns: robot time.
        """
        if now_ns - self._looked_ns < ASIDE.look_s * 1e9 or now_ns < self._rests_ns:
            return
        # While the lidar was silent it waited for that.
        elapsed_s = min(1e-9 * (now_ns - self._looked_ns), 2.0 * ASIDE.look_s)
        self._looked_ns = now_ns
        driven.route.update_position(motion.pose)
        passages = self._passages_of(driven.context)
        meeting = find_meeting(driven, motion.pose, speed, passages, now_ns)
        was_beside_way = self.waits_beside_way
        is_beside_way = self._beside_way.must_wait(driven, motion.pose, elapsed_s)
        if was_beside_way:
            self._came_ns = now_ns if is_beside_way else 0  # then it drives on at once
        if meeting is None or not meeting.has_room:
            self._narrow_ns = now_ns
        is_sure = now_ns - self._narrow_ns >= ASIDE.sure_s * 1e9
        if self.is_active and is_sure and not is_beside_way:
            self._resume(now_ns, ASIDE.sure_s)
        if meeting is None:
            self._wait_beside_way(driven, motion, speed, now_ns)
        elif not meeting.has_room:
            found = meeting.find_refuge(driven.context, motion.pose, speed)
            if found is not None:
                place, passed_s = found
                self._yield_at(place, driven, motion, speed, now_ns)
                until_ns = now_ns + round(1e9 * (passed_s + ASIDE.late_s))
                self._until_ns = max(self._until_ns, until_ns)
        self._resume_when_passed(now_ns)

    def _yield_at(
        self,
        place: tuple[float, float],
        driven: GoalExecution,
        motion: Motion,
        speed: float,
        now_ns: int,
    ) -> None:
        """Hurry to a place, unless it is on its way to one that still does."""
        self._came_ns = now_ns
        moves = self._execution is None or math.dist(place, self._place) > ASIDE.moves_m
        if not self.is_active or (moves and not self._still_does(driven, motion, speed)):
            aside = driven.to_place_beside(place, motion.pose, now_ns, hurries=True)
            self._set_off(aside, place, motion, now_ns)

    def _wait_beside_way(
        self, driven: GoalExecution, motion: Motion, speed: float, now_ns: int
    ) -> None:
        """Set off to wait beside the only path, if the robot waits on it."""
        if self.is_active or not driven.progress.is_waiting_on_way:
            return
        place = self._beside_way.find_place(driven, motion.pose, speed)
        if place is not None:
            there = self._beside_way.there
            aside = driven.to_place_beside(place, motion.pose, now_ns, looks_at=there)
            self._set_off(aside, place, motion, now_ns)
            if not self.is_active:
                self._beside_way.forget()

    def _set_off(
        self, aside: GoalExecution | None, place: tuple[float, float], motion: Motion, now_ns: int
    ) -> None:
        """Drive to a place, if a path leads there."""
        if aside is None:
            return
        self._execution, self._place, self._came_ns = aside, place, now_ns
        self._since_ns = now_ns if self._since_ns is None else self._since_ns
        aside.update(motion, now_ns)

    def _passages_of(self, context: PlanningContext) -> Passages:
        """Return where on the map this robot does not fit beside a person in the middle."""
        walls_m, known = context.costmap.static.distance_m, self._passages
        if known is None or known[0] is not walls_m:
            half_m = REFUGE.person_m + 2.0 * context.footprint.inscribed_m
            passages = Passages(walls_m, context.costmap.resolution_m, half_m)
            known = self._passages = walls_m, passages
        return known[1]

    def _resume_when_passed(self, now_ns: int) -> None:
        if self._since_ns is None:
            return
        has_passed = now_ns > max(self._until_ns, self._came_ns + ASIDE.passed_s * 1e9)
        # The goal's own patience holds for what stands on the only path.
        is_enough = not self.waits_beside_way and now_ns - self._since_ns > ASIDE.most_s * 1e9
        if has_passed or is_enough:
            self._resume(now_ns, 0.0 if has_passed else ASIDE.rest_s)

    def _resume(self, now_ns: int, rest_s: float) -> None:
        """Drive on, and yield to nobody for a while [s]."""
        self._rests_ns = now_ns + round(1e9 * rest_s)
        if self._since_ns is not None:
            self._waited_ns = now_ns - self._since_ns
        self._since_ns, self._execution, self._until_ns = None, None, 0
        self._beside_way.forget()

    def _still_does(self, driven: GoalExecution, motion: Motion, speed: float) -> bool:
        """Say whether the refuge that it drives to is still in nobody's way."""
        around = Surroundings(driven.context, motion.pose)
        closes_s = around.closes_s(driven.context.footprint.circumscribed_m)
        arrival = around.arrivals(closes_s, motion.pose, speed)
        cell = around.cell_of(*self._place)
        return cell is not None and math.isinf(closes_s[cell]) and arrival[cell] < math.inf

    def update(self, motion: Motion, now_ns: int) -> bool:
        """Take in a scan on the way to the refuge; False if it is not yielding."""
        if self._execution is not None:
            self._execution.update(motion, now_ns)
        return self.is_active

    def command(self, now: ControlInput) -> Twist2D:
        """Return the velocity to the refuge, and zero there."""
        aside = self._execution
        if aside is not None and aside.outcome is None:
            twist = aside.command(now)
            if aside.outcome is None:
                return twist
        return limited_change(now.motion.twist, Twist2D.zero(), now.limits, now.elapsed_s)

    def maintain(self, now: ControlInput) -> None:
        """Do what takes longer: update costmap and path."""
        if self._execution is not None:
            self._execution.replan_if_due(now)
