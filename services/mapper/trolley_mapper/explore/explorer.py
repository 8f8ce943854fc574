"""Exploring: which goal to send next, so that a map is completed without a driver.

A state machine without clock or wire. It sees the map as it grows, hears the planner, the base and
people, and leaves actions for its service to carry out. The robot drives to a frontier, the border
between known floor and the unknown; when it can reach no more of them, it drives back to where it
began. Whose lidar does not see all round looks behind itself first.

Source:
    Yamauchi, A Frontier-Based Approach for Autonomous Exploration (1997); the choice by what a
    goal shows for its distance: González-Baños, Latombe (2002), Navigation Strategies for Exploring
    Indoor Environments, section 4.
"""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from trolley import codes
from trolley.codes import Refused
from trolley.geometry import Pose2D
from trolley.gridmap import GridMap
from trolley.messages import BaseState, GoalStatus, Zone
from trolley.messages.request_params import SendGoal
from trolley.under_way import EXPLORES, GOAL_GOES
from trolley_mapper.explore import sentences
from trolley_mapper.explore.barriers import Barriers
from trolley_mapper.explore.exploration_goal import (
    Action,
    Cancel,
    ExplorationGoal,
    Limits,
    Scene,
    Send,
    Survey,
)
from trolley_mapper.explore.frontiers import (
    Clearance,
    Frontier,
    FrontierReport,
    path_length_to,
)
from trolley_mapper.explore.own_image import OwnImage
from trolley_mapper.explore.traversable_area import TraversableArea
from trolley_mapper.explore.visited_frontiers import (
    PATIENCE,
    SQUEEZED,
    VisitedFrontiers,
    num_places,
)

PLANNER = "planner"
"""Source of the commands that follow from our own goals."""
HALF_TURN = Pose2D(0.0, 0.0, math.pi)
WAITS = (*codes.UNANSWERED, codes.NOT_LOCALIZED)
"""Refusals that may pass: the goal is sent again."""


@dataclass(frozen=True, slots=True)
class ExplorerParams:
    """When to choose anew, and when to give up. Set by hand, and tried in bench/exploring.py."""

    survey_period_s: float = 2.0
    """Time between two surveys of the map while a goal is driven to [s]."""
    better: float = 2.0
    """Factor on the worth by which another frontier replaces the present one."""
    better_growth_m2: float = 0.5
    """Floor found since the last choice after which another frontier may replace the present one
    [m^2]."""
    growth_m2: float = 0.5
    """Floor that a goal must add not to be barren [m^2]."""
    tried_m: float = 0.5
    """Distance that the robot must have driven for a frontier before its vanishing says that there
    is no floor: from a doorway frontiers move as the floor behind it is seen [m]."""
    max_barren: int = 12
    """Number of barren goals in a row after which exploring ends."""
    max_failed: int = 5
    """Number of failed goals in a row after which it is the robot that is stuck, not the places."""
    goal_s: float = 40.0
    """Time that any goal may take [s]."""
    goal_s_per_m: float = 12.0
    """Extra time that a goal may take for each metre of its path [s/m]."""
    stand_s: float = 25.0
    """Time after which a goal under which the robot hardly moves has failed: more than people take
    to step aside [s]."""
    stand_m: float = 1.0
    """Distance within which the robot hardly moves: before a mirror it seeks a way to and fro [m].
    """
    answer_s: float = 5.0
    """Silence after which a goal is sent again [s]."""
    wait_s: float = 60.0
    """Time to wait for a planner, or for the path home to become free [s]."""
    start_s: float = 15.0
    """Time within which the map must show somewhere to go [s]."""
    min_area_m2: float = 1.0
    """Floor below which the robot is boxed in after `start_s` [m^2]."""
    lost_s: float = 5.0
    """Time after which a lost pose pauses exploring [s]."""
    unsure_s: float = 30.0
    """Time after which an unsure pose pauses exploring [s]."""
    xy_tolerance_m: float = 0.15
    """Position tolerance of the goals [m]."""
    squeezed_xy_tolerance_m: float = 0.05
    """The same where it squeezes: a little farther in a door much more is seen [m]."""
    yaw_tolerance_rad: float = 0.3
    """Heading tolerance of the goals, if the lidar must be turned to the frontier [rad]."""
    any_yaw_rad: float = 3.2
    """Heading tolerance for a lidar that sees all round [rad]."""
    home_m: float = 20.0
    """Length assumed for the path home where none is known [m]."""


PARAMS = ExplorerParams()

State = Literal["exploring", "homing", "paused", "done"]


@dataclass(slots=True)
class Progress:
    """How far exploring has come."""

    area_m2: float = 0.0
    """Floor that is known by now [m^2]."""
    best_area_m2: float = 0.0
    """Floor that was known when a goal last added any [m^2]."""
    num_sent: int = 0
    num_barren: int = 0
    """Number of goals since then that added no floor."""
    num_failed_in_row: int = 0
    num_missed: int = 0
    """Places that could not be reached, once no other is left."""
    num_left_out: int = 0
    """Small frontiers that were not worth the way, once no other is left."""
    is_enough: bool = False
    """Whether no more floor may be explored although there is some."""

    def update(self, area_m2: float) -> None:
        """Take in how much floor there is."""
        self.area_m2 = area_m2
        if area_m2 > self.best_area_m2 + PARAMS.growth_m2:
            self.best_area_m2 = area_m2
            self.num_barren = 0


@dataclass(slots=True)
class Others:
    """Who else has a say in where the robot drives, as it was when exploring set off."""

    source: str | None = None
    """Who drives the robot."""
    goal: str | None = None
    """The planner's goal that ours replaces."""


class Explorer:
    """Explores once, from where it is made until `done`.

    Args:
        run: what its goals are called by, `[a-z0-9]{1,12}`.
        clearance: that the robot needs.
        limits: how far and how much.
        sees_all_round: whether its lidar does; else it must turn to what it wants to see.
        barriers: of the map; new ones are added.
    """

    def __init__(
        self,
        run: str,
        clearance: Clearance,
        limits: Limits,
        sees_all_round: bool = True,
        barriers: Barriers | None = None,
    ) -> None:
        self.state: State = "exploring"
        self.reason = ""
        self.message = sentences.BEGINS
        self.clearance, self.limits = clearance, limits
        """How much room is asked for now: less, once nothing else is left; and how far it goes."""
        self._roomy = clearance
        self._run, self._sees_all_round = run, sees_all_round
        self._has_looked_round = sees_all_round
        self._visited_roomily = VisitedFrontiers()
        self._visited_squeezed = VisitedFrontiers(SQUEEZED)
        self._barriers = Barriers() if barriers is None else barriers
        self._own_image = OwnImage()
        # Where a mirror was seen (`map`, x pointing into it) since the last step.
        self._mirror: Pose2D | None = None
        self._goal: ExplorationGoal | None = None
        self._speed_mps: float | None = None
        # The frontier that was driven to last, how much floor was known then [m^2], and where it
        # counts.
        self._last: tuple[Frontier, float, VisitedFrontiers] | None = None
        self._progress = Progress()
        self._others = Others()
        self._surveyed_s: float | None = None
        # Since when something lasts [s], by what it is.
        self._since: dict[str, float] = {}
        self._actions: list[Action] = []

    @property
    def is_under_way(self) -> bool:
        """Whether it sends goals."""
        return self.state in ("exploring", "homing")

    @property
    def area_m2(self) -> float:
        """Floor that is known by now [m^2]."""
        return self._progress.area_m2

    def take_actions(self) -> list[Action]:
        """Return what is to be done now, in order."""
        actions, self._actions = self._actions, []
        return actions

    @property
    def _visited(self) -> VisitedFrontiers:
        """Where it has been with the room that it asks for now."""
        return self._visited_squeezed if self.clearance.is_squeezed else self._visited_roomily

    @property
    def barriers(self) -> list[Zone]:
        """Lines that it takes for walls: mirrors, and where the robot could not get on."""
        return self._barriers.zones

    # People.
    def begin(
        self, goal_before: str | None, source: str | None, speed_mps: float | None = None
    ) -> None:
        """Set off, or go on after a pause.

        Args:
            goal_before: the planner's present goal, which will be replaced.
            source: who drives the robot just now.
            speed_mps: the highest speed to drive at, None for the planner's own.
        """
        self._speed_mps = speed_mps
        self._others.goal, self._others.source = goal_before, source
        self._since.clear()
        self._progress.num_failed_in_row = 0
        self._goal = None
        self._surveyed_s = None
        self.clearance = self._roomy
        self._set("exploring", "", sentences.BEGINS)

    def pause(self, reason: str, message: str) -> None:
        """Stop the robot until `begin`."""
        if self.is_under_way:
            if self._goal is not None:
                self._actions.append(Cancel(self._goal.id))
                self._goal = None
            self._set("paused", reason, message)

    # The base.
    def hear_base(self, base: BaseState) -> None:
        """A stop or a hand on the robot pauses."""
        taken = base.source not in (None, PLANNER) and base.source != self._others.source
        self._others.source = base.source
        if base.is_halted:
            self._pause_for(codes.STOPPED)
        elif taken:
            self._pause_for(codes.TAKEN_OVER)

    def epoch_began(self) -> None:
        """A restart of the base pauses."""
        self._pause_for(codes.RESTARTED)

    # The planner.
    def hear_refusal(self, goal_id: str, refused: Refused, now_s: float) -> None:
        """React to a goal that the planner refuses."""
        goal = self._goal
        if goal is None or goal_id != goal.id:
            return
        if refused.code in WAITS:
            goal.heard_s = now_s  # and it is sent again
            goal.stood_at = None
            if self._lasts("refused", now_s) > PARAMS.wait_s:
                self._goal = None
                self.pause(refused.code, sentences.paused(refused.message))
        elif refused.code == codes.STOPPED:
            self._pause_for(codes.STOPPED)
        else:
            self._fail(refused.code, refused.message, now_s)

    def hear_goal(self, status: GoalStatus, now_s: float) -> None:
        """React to what the planner says of its goal."""
        goal = self._goal
        if goal is not None and status.id == goal.id:
            goal.heard_s = now_s
            self._since.pop("refused", None)
            self._hear_own(goal, status, now_s)
        elif status.id is None or status.state not in GOAL_GOES:
            return
        elif status.id.startswith(f"{EXPLORES}{self._run}-"):
            if not self.is_under_way:
                self._actions.append(Cancel(status.id))
        elif status.id != self._others.goal:
            self._others.goal = status.id
            self._pause_for(codes.OTHER_GOAL)

    def _hear_own(self, goal: ExplorationGoal, status: GoalStatus, now_s: float) -> None:
        match status.state:
            case "arrived":
                self._arrive(goal)
            case "failed":
                self._fail(status.reason, status.message, now_s)
            case "paused":
                self._pause_for(status.reason or codes.PAUSED)
            case "canceled":
                self._goal = None
                replaced = status.reason == codes.REPLACED
                self._pause_for(codes.OTHER_GOAL if replaced else codes.CANCELED)
            case _:
                pass

    def _arrive(self, goal: ExplorationGoal) -> None:
        self._progress.num_failed_in_row = 0
        self._goal = None
        if self.state == "homing":
            self._finish(sentences.AT_HOME)
        elif goal.frontier is not None:
            self._visited.find_or_add(goal.frontier).arrivals += 1
            self.clearance = self._roomy  # there may be a whole room

    def _fail(self, code: str, why: str, now_s: float) -> None:
        """Note that a goal failed; where all of them do, the robot itself is stuck."""
        goal, self._goal = self._goal, None
        if goal is None:
            return
        if goal.is_turn(PARAMS.tried_m):
            self._last = None  # it says nothing of the floor there
        # Where it squeezes, what is too narrow is the places' fault.
        self._progress.num_failed_in_row += not self.clearance.is_squeezed
        if goal.frontier is not None:
            self._visited.find_or_add(goal.frontier).failures += 1
            if self._progress.num_failed_in_row >= PARAMS.max_failed:
                self.pause(code, sentences.stuck(why))
        elif self.state == "homing" and self._lasts("shut out", now_s) > PARAMS.wait_s:
            self._finish(sentences.not_home(why))

    def _pause_for(self, reason: str) -> None:
        """Pause for a reason of this program's or of the planner's."""
        said = sentences.PAUSES.get(reason)
        self.pause(reason, said or sentences.paused(codes.SENTENCES.get(reason, reason)))

    # The lidar.
    def hear_scan(
        self,
        map_T_laser: Pose2D,
        ranges: NDArray[np.float64],
        angles: NDArray[np.float64],
        mirrors: NDArray[np.float64],
    ) -> None:
        """Look for the robot's own image in a scan: see `OwnImage.update`."""
        found = self._own_image.update(map_T_laser, ranges, angles, mirrors)
        self._mirror = found or self._mirror

    # The map.
    def wants_survey(self, now_s: float) -> bool:
        """Whether `step` needs to see the map now (robot time [s])."""
        if not self.is_under_way:
            return False
        is_due = self._surveyed_s is None or now_s - self._surveyed_s >= PARAMS.survey_period_s
        if self.state == "homing":
            return self._goal is None and is_due
        return self._goal is None or is_due

    def step(self, scene: Scene, survey: Survey | None, now_s: float) -> None:
        """Choose where to drive, or go on.

        Args:
            scene: map and robot now.
            survey: what is left to explore, if it was wanted.
            now_s: robot time [s].
        """
        if not self.is_under_way or self._is_lost(scene, now_s):
            return
        goal = self._goal
        self._barriers.update_position(scene.pose)
        self._note_mirror(scene.grid)
        if survey is not None:
            self._surveyed_s = now_s
            self._progress.update(survey.report.area_m2)
        if goal is None:
            if survey is not None:
                self._choose(scene, survey, now_s)
        elif now_s - goal.sent_s > goal.limit_s:
            self._actions.append(Cancel(goal.id))
            self._fail(codes.TIMEOUT, sentences.TOO_LONG, now_s)
        elif goal.standing_s(scene.pose, PARAMS.stand_m, now_s) > PARAMS.stand_s:
            # In a tight place it is the room that it lacks.
            is_wall = goal.frontier is not None and not self.clearance.is_squeezed
            is_wall &= not goal.is_turn(PARAMS.tried_m)
            if is_wall and goal.goal.pose is not None:
                self._barriers.add(scene.pose, goal.goal.pose, self.clearance.passing_m, scene.grid)
            self._actions.append(Cancel(goal.id))
            self._fail(codes.TIMEOUT, sentences.STOOD, now_s)
        elif now_s - goal.heard_s > PARAMS.answer_s:
            goal.heard_s = now_s
            self._actions.append(Send(goal.goal))
        elif survey is not None:
            self._reconsider(goal, scene, survey, now_s)

    def _note_mirror(self, grid: GridMap) -> None:
        """Take a mirror that was seen for a wall, and look at once what that leaves to explore."""
        mirror, self._mirror = self._mirror, None
        if mirror is not None:
            self._barriers.add_mirror(mirror, grid)
            self._surveyed_s = None

    def _is_lost(self, scene: Scene, now_s: float) -> bool:
        """Pause once the robot has been lost or unsure for too long; say whether it is lost."""
        for what, is_so, limit_s in (
            (codes.LOST, scene.is_lost, PARAMS.lost_s),
            (codes.NOT_CONVERGED, scene.is_unsure, PARAMS.unsure_s),
        ):
            if not is_so:
                self._since.pop(what, None)
            elif self._lasts(what, now_s) > limit_s:
                self._pause_for(what)
        return scene.is_lost or not self.is_under_way

    def _note_growth(self) -> None:
        """Note where the last goal added no floor."""
        last, self._last = self._last, None
        if last is None:
            return
        frontier, best_area_m2, visited = last
        if self._progress.best_area_m2 <= best_area_m2:
            visited.add_barren(frontier)

    def _choose(self, scene: Scene, survey: Survey, now_s: float) -> None:
        """Send the best goal, or turn home."""
        report = survey.report
        if self.state == "homing":
            self._go_home(survey.area, scene, now_s)
            return
        if not self._has_looked_round:
            self._has_looked_round = True
            self._send(scene.pose @ HALF_TURN, None, scene.pose, 0.0, now_s)
            return
        self._note_growth()
        best = self._best(survey)
        is_at_start = self._progress.num_sent <= (not self._sees_all_round)
        is_shut_in = not report.can_move or (best is None and is_at_start)
        waits = is_shut_in and self._lasts("shut in", now_s) <= PARAMS.start_s
        # Not where mirrors are: behind them there is always more to see.
        if best is None and not survey.clearance.is_squeezed and not self.barriers:
            self.clearance, self._surveyed_s = self._roomy.squeezed, None
            return
        if waits:
            return  # the map has only begun
        # One that came there gets out again: the planner backs up, and home is known.
        has_nowhere = not report.can_move or self.area_m2 < PARAMS.min_area_m2
        if is_shut_in and is_at_start and has_nowhere:
            self.pause(codes.IN_OBSTACLE, sentences.SHUT_IN)
            return
        self._since.pop("shut in", None)
        is_enough = best is not None and report.area_m2 >= self.limits.area_m2
        if best is None or is_enough or self._progress.num_barren >= PARAMS.max_barren:
            self._progress.is_enough = is_enough
            self._progress.num_missed = self._count_missed(report)
            self._progress.num_left_out = sum(not one.is_worth_the_way for one in report.frontiers)
            self._set("homing", "", f"{self._found}. {sentences.GOES_HOME}")
            self._go_home(survey.area, scene, now_s)
        else:
            self._send(best.goal, best, scene.pose, best.distance_m, now_s)
            self._set("exploring", "", sentences.exploring(self.area_m2, len(report.frontiers)))

    def _count_missed(self, report: FrontierReport) -> int:
        """Return at how many places there is a frontier left that could not be reached.

        Behind barriers the map may show what is not there.
        """
        kept = (self._visited_roomily, self._visited_squeezed)
        failed = [
            (one.x, one.y)
            for one in report.frontiers
            if any(visited.has_failed(goal) for goal in one.chain for visited in kept)
        ]
        if self.barriers:
            return num_places(failed) + len(self.barriers)
        return num_places([*failed, *report.unreachable])

    def _best(self, survey: Survey) -> Frontier | None:
        """Return the place that is worth most; those that failed come last, and only once.

        Barren regions and small corners far away are left out, behind a squeeze all small ones.
        """
        fresh: list[Frontier] = []
        again: list[Frontier] = []
        for frontier in survey.report.frontiers:
            step: Frontier | None = frontier
            left: list[Frontier] = []
            while step is not None and not left:
                left = [one for one in step.goals if self._is_left(one)]
                step = step.nearer
            for one in left:
                (again if self._visited.has_failed(one) else fresh).append(one)
        return max(fresh or again, key=lambda one: one.worth, default=None)

    def _is_left(self, one: Frontier) -> bool:
        """Say whether a goal is worth a try."""
        is_squeezed = self.clearance.is_squeezed
        is_worth = one.is_worth_squeezing if is_squeezed else one.is_worth_the_way
        return is_worth and not self._visited.is_given_up(one)

    def _reconsider(
        self, goal: ExplorationGoal, scene: Scene, survey: Survey, now_s: float
    ) -> None:
        """Turn to another frontier where this one has vanished, or one that is far better."""
        report, frontier = survey.report, goal.frontier
        if frontier is None:
            return
        every = [one for each in report.frontiers for one in each.chain]
        left = [one for one in every if _apart(one, frontier) <= PATIENCE.same_m]
        best = self._best(survey)
        if not left:
            self._progress.num_failed_in_row = 0
            self._goal = None  # the next goal replaces this one
            if goal.set_off.distance_to(scene.pose) < PARAMS.tried_m:
                self._last = None
            self._choose(scene, survey, now_s)
            return
        now = max(left, key=lambda one: one.worth)
        has_grown = report.area_m2 > goal.area_m2 + PARAMS.better_growth_m2
        if best is not None and has_grown and best.worth > PARAMS.better * now.worth:
            self._send(best.goal, best, scene.pose, best.distance_m, now_s)

    def _go_home(self, area: TraversableArea, scene: Scene, now_s: float) -> None:
        distance_m = path_length_to(area, scene.pose, scene.home, self.clearance)
        length_m = PARAMS.home_m if distance_m is None else distance_m
        self._send(scene.home, None, scene.pose, length_m, now_s)

    def _send(
        self,
        pose: Pose2D,
        frontier: Frontier | None,
        here: Pose2D,
        distance_m: float,
        now_s: float,
    ) -> None:
        self._progress.num_sent += 1
        self._progress.num_barren += frontier is not None
        best_area_m2 = self._progress.best_area_m2
        self._last = None if frontier is None else (frontier, best_area_m2, self._visited)
        goal = SendGoal(
            id=f"{EXPLORES}{self._run}-{self._progress.num_sent}",
            pose=pose.wrapped(),
            frame="map",
            xy_tolerance=self._xy_tolerance(frontier),
            yaw_tolerance=self._yaw_tolerance(frontier),
            speed=self._speed_mps,
        )
        limit_s = PARAMS.goal_s + PARAMS.goal_s_per_m * distance_m
        self._goal = ExplorationGoal(goal, frontier, here, now_s, limit_s, self.area_m2, now_s)
        self._actions.append(Send(goal))

    def _xy_tolerance(self, frontier: Frontier | None) -> float:
        is_exact = frontier is not None and self.clearance.is_squeezed
        return PARAMS.squeezed_xy_tolerance_m if is_exact else PARAMS.xy_tolerance_m

    def _yaw_tolerance(self, frontier: Frontier | None) -> float:
        is_free = frontier is not None and self._sees_all_round
        return PARAMS.any_yaw_rad if is_free else PARAMS.yaw_tolerance_rad

    def _finish(self, home: str) -> None:
        self._goal = None
        self._set("done", "", f"{self._found}. {home}")

    @property
    def _found(self) -> str:
        left_out, is_enough = self._progress.num_left_out, self._progress.is_enough
        return sentences.found(self.area_m2, self._progress.num_missed, left_out, is_enough)

    def _lasts(self, what: str, now_s: float) -> float:
        """Return for how long something lasts [s], which begins now if it did not before."""
        return now_s - self._since.setdefault(what, now_s)

    def _set(self, state: State, reason: str, message: str) -> None:
        self.state, self.reason, self.message = state, reason, message


def _apart(one: Frontier, other: Frontier) -> float:
    return Pose2D(one.x, one.y, 0.0).distance_to(Pose2D(other.x, other.y, 0.0))
