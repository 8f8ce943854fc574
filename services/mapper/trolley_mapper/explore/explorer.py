"""Exploring: which goal to send next, so that a map gets whole by itself.

A state machine without clock or wire. It sees the map as it grows, hears the planner, the base and
people, and leaves wishes for its service to carry out. The robot drives to a frontier, the border
between floor and unknown; when none is left that it can reach, it drives back to where it began.

Source:
    Yamauchi, A Frontier-Based Approach for Autonomous Exploration (1997); the choice by what a
    goal shows for the way: González-Baños, Latombe (2002), Navigation Strategies for Exploring
    Indoor Environments, section 4.
"""

from typing import Literal

from trolley import codes
from trolley.codes import Refused
from trolley.geometry import Pose2D
from trolley.messages import BaseState, GoalStatus
from trolley.messages.request_params import SendGoal
from trolley_mapper.explore import sentences
from trolley_mapper.explore.exploration_goal import Cancel, Errand, Limits, Scene, Send, Sight, Wish
from trolley_mapper.explore.frontiers import Body, Frontier, Outlook, way_to
from trolley_mapper.explore.traversable_area import Floor
from trolley_mapper.explore.visited_frontiers import SAME_M, Notebook

PLANNER = "planner"
ACTIVE = ("planning", "driving", "recovering")
WAITS = (codes.NOT_READY, codes.TIMEOUT, codes.NOT_LOCALIZED)
"""Refusals that may pass: the goal is sent again."""

LOOK_S = 2.0
"""Between two looks at the map while a goal is driven to."""
BETTER = 2.0
"""Another frontier takes the place of the one that is driven to if it is worth so much more,"""
BETTER_GROWTH_M2 = 0.5
"""and so much floor has been found since the last choice."""
GROWTH_M2 = 0.5
MOST_BARREN = 12
"""So many goals in a row that find less floor than that are the end of it."""
MOST_FAILED = 5
"""So many goals failed in a row: it is the robot, not the places."""
GOAL_S, GOAL_S_PER_M = 40.0, 12.0
"""A goal may take so long, and so long for each metre."""
ANSWER_S = 5.0
"""A goal that nothing was heard of for so long is sent again."""
WAIT_S = 60.0
"""It waits so long for a planner or for a pose."""
START_S = 15.0
"""The map must show somewhere to go within this time,"""
LEAST_M2 = 1.0
"""or at least so much floor."""
LOST_S, UNSURE_S = 5.0, 30.0
"""A pose that is lost or unsure for longer pauses exploring."""
XY_TOLERANCE_M, YAW_TOLERANCE_RAD = 0.15, 0.3

State = Literal["exploring", "homing", "paused", "done"]


class Explorer:
    """Explores once, from where it is made until `done`.

    Args:
        run: what its goals are called by, `[a-z0-9]{1,12}`.
        body: of the robot.
        limits: how far and how much.
        sees_all_round: whether its lidar does; else it must turn to what it wants to see.
    """

    def __init__(self, run: str, body: Body, limits: Limits, sees_all_round: bool = True) -> None:
        self.state: State = "exploring"
        self.reason = ""
        self.message = sentences.BEGINS
        self.area_m2 = 0.0
        self.wishes: list[Wish] = []
        """What is to be done, in order; the service takes them out."""
        self.body, self.limits = body, limits
        self._run = run
        self._yaw_tolerance = 3.2 if sees_all_round else YAW_TOLERANCE_RAD
        self._notes = Notebook()
        self._errand: Errand | None = None
        self._num_sent = 0
        self._num_failed_in_row = 0
        self._num_barren = 0
        self._best_area_m2 = 0.0
        self._num_unreachable = 0
        self._home_failed = False
        self._source: str | None = None
        self._foreign: str | None = None
        self._looked_s: float | None = None
        # Since when something lasts [s], by what it is.
        self._since: dict[str, float] = {}

    @property
    def is_under_way(self) -> bool:
        """Whether it sends goals."""
        return self.state in ("exploring", "homing")

    @property
    def num_missed(self) -> int:
        """Number of places that could not be reached."""
        return self._notes.num_failed + self._num_unreachable

    # People.
    def begin(self, goal_before: str | None, source: str | None) -> None:
        """Set off, or go on after a pause.

        Args:
            goal_before: the planner's present goal, which will be replaced.
            source: who drives the robot just now.
        """
        self._foreign, self._source = goal_before, source
        self._since.clear()
        self._num_failed_in_row = 0
        self._errand = None
        self._looked_s = None
        self._set("exploring", "", sentences.BEGINS)

    def pause(self, reason: str, message: str) -> None:
        """Let the robot stand until `begin`."""
        if self.is_under_way:
            if self._errand is not None:
                self.wishes.append(Cancel(self._errand.id))
                self._errand = None
            self._set("paused", reason, message)

    # The base.
    def hear_base(self, base: BaseState) -> None:
        """A stop or a hand on the robot pauses."""
        taken = base.source not in (None, PLANNER) and base.source != self._source
        self._source = base.source
        if base.mode == "stopped":
            self._stand(codes.STOPPED)
        elif taken:
            self._stand(codes.TAKEN_OVER)

    def epoch_began(self) -> None:
        """A restart of the base pauses."""
        self._stand(codes.RESTARTED)

    # The planner.
    def hear_refusal(self, goal_id: str, refused: Refused, now_s: float) -> None:
        """Take the planner's refusal of a goal."""
        errand = self._errand
        if errand is None or goal_id != errand.id:
            return
        if refused.code in WAITS:
            errand.heard_s = now_s  # and it is sent again
            if self._lasts("refused", now_s) > WAIT_S:
                self._errand = None
                self.pause(refused.code, sentences.paused(refused.message))
        elif refused.code == codes.STOPPED:
            self._stand(codes.STOPPED)
        else:
            self._fail(refused.code, refused.message)

    def hear_goal(self, status: GoalStatus, now_s: float) -> None:
        """Take what the planner says of its goal."""
        errand = self._errand
        if errand is not None and status.id == errand.id:
            errand.heard_s = now_s
            self._since.pop("refused", None)
            self._hear_own(errand, status)
        elif status.id is None or status.state not in ACTIVE:
            return
        elif status.id.startswith(f"map-{self._run}-"):
            if not self.is_under_way:
                self.wishes.append(Cancel(status.id))
        elif status.id != self._foreign:
            self._foreign = status.id
            self._stand(codes.OTHER_GOAL)

    def _hear_own(self, errand: Errand, status: GoalStatus) -> None:
        match status.state:
            case "arrived":
                self._arrive(errand)
            case "failed":
                self._fail(status.reason, status.message)
            case "paused":
                self._stand(status.reason or codes.PAUSED)
            case "canceled":
                self._errand = None
                replaced = status.reason == codes.REPLACED
                self._stand(codes.OTHER_GOAL if replaced else codes.CANCELED)
            case _:
                pass

    def _arrive(self, errand: Errand) -> None:
        self._num_failed_in_row = 0
        self._errand = None
        if errand.target is None:
            self._finish(sentences.AT_HOME)
        else:
            self._notes.note(errand.target.x, errand.target.y).arrivals += 1

    def _fail(self, code: str, why: str) -> None:
        """Take note that a goal failed; where all do, it is the robot."""
        errand, self._errand = self._errand, None
        if errand is None:
            return
        self._num_failed_in_row += 1
        if errand.target is not None:
            self._notes.note(errand.target.x, errand.target.y).failures += 1
            if self._num_failed_in_row >= MOST_FAILED:
                self.pause(code, sentences.stuck(why))
        elif self._home_failed:
            self._finish(sentences.not_home(why))
        else:
            self._home_failed = True

    def _stand(self, reason: str) -> None:
        """Pause for a reason of this program's or of the planner's."""
        said = sentences.PAUSES.get(reason)
        self.pause(reason, said or sentences.paused(codes.SENTENCES.get(reason, reason)))

    # The map.
    def wants_look(self, now_s: float) -> bool:
        """Whether `step` needs to see the map now (robot time [s])."""
        if not self.is_under_way:
            return False
        is_due = self._looked_s is None or now_s - self._looked_s >= LOOK_S
        return self._errand is None or (is_due and self._errand.target is not None)

    def step(self, scene: Scene, sight: Sight | None, now_s: float) -> None:
        """Choose where to drive, or go on.

        Args:
            scene: what is so.
            sight: what a look at the map has shown, if it was wanted.
            now_s: robot time [s].
        """
        if not self.is_under_way or self._has_lost_its_way(scene, now_s):
            return
        errand = self._errand
        if sight is not None:
            self._take_in(sight, now_s)
        if errand is None:
            if sight is not None:
                self._choose(scene, sight, now_s)
        elif now_s - errand.sent_s > errand.limit_s:
            self.wishes.append(Cancel(errand.id))
            self._fail(codes.TIMEOUT, sentences.TOO_LONG)
        elif now_s - errand.heard_s > ANSWER_S:
            errand.heard_s = now_s
            self.wishes.append(Send(errand.goal))
        elif sight is not None:
            self._reconsider(errand, scene, sight, now_s)

    def _has_lost_its_way(self, scene: Scene, now_s: float) -> bool:
        """Pause where the mapper does not know for too long where the robot is."""
        for what, is_so, limit_s in (
            (codes.LOST, scene.is_lost, LOST_S),
            (codes.NOT_CONVERGED, scene.is_unsure, UNSURE_S),
        ):
            if not is_so:
                self._since.pop(what, None)
            elif self._lasts(what, now_s) > limit_s:
                self._stand(what)
        return scene.is_lost or not self.is_under_way

    def _take_in(self, sight: Sight, now_s: float) -> None:
        """Take note of how much floor there is."""
        self._looked_s = now_s
        self.area_m2 = sight.outlook.area_m2
        if self.area_m2 > self._best_area_m2 + GROWTH_M2:
            self._best_area_m2 = self.area_m2
            self._num_barren = 0

    def _choose(self, scene: Scene, sight: Sight, now_s: float) -> None:
        """Send the best goal, or turn home."""
        outlook = sight.outlook
        if self.state == "homing":
            self._go_home(sight.floor, scene, now_s)
            return
        best = self._best(outlook)
        if not outlook.can_move or (best is None and self._num_sent == 0):
            if self._lasts("shut in", now_s) <= START_S:
                return  # the map has only begun
            if not outlook.can_move or self.area_m2 < LEAST_M2:
                self.pause(codes.IN_OBSTACLE, sentences.SHUT_IN)
                return
        self._since.pop("shut in", None)
        is_enough = outlook.area_m2 >= self.limits.area_m2
        if best is None or is_enough or self._num_barren >= MOST_BARREN:
            self._num_unreachable = self._count_unreachable(outlook)
            self._set("homing", "", sentences.going_home(self.area_m2, self.num_missed))
            self._go_home(sight.floor, scene, now_s)
        else:
            self._send(best.goal, best, best.way_m, now_s)
            self._set("exploring", "", sentences.explores(self.area_m2, len(outlook.frontiers)))

    def _count_unreachable(self, outlook: Outlook) -> int:
        """Return how many wide frontiers there is no way to, those left out that were tried."""
        places = Notebook()
        for x, y in outlook.unreachable:
            if self._notes.find(x, y) is None:
                places.note(x, y)
        return len(places)

    def _best(self, outlook: Outlook) -> Frontier | None:
        """Return the frontier that is worth most; those that failed come last, and only once."""
        fresh: list[Frontier] = []
        again: list[Frontier] = []
        for one in outlook.frontiers:
            entry = self._notes.find(one.x, one.y)
            if entry is None or (not entry.is_given_up and entry.failures == 0):
                fresh.append(one)
            elif not entry.is_given_up:
                again.append(one)
        return max(fresh or again, key=lambda one: one.worth, default=None)

    def _reconsider(self, errand: Errand, scene: Scene, sight: Sight, now_s: float) -> None:
        """Turn to another frontier where this one has vanished, or one that is far better."""
        outlook, target = sight.outlook, errand.target
        if target is None:
            return
        left = [one for one in outlook.frontiers if _apart(one, target) <= SAME_M]
        best = self._best(outlook)
        if not left:
            self._num_failed_in_row = 0
            self._errand = None  # the next goal replaces this one
            self._choose(scene, sight, now_s)
            return
        now = max(left, key=lambda one: one.worth)
        has_grown = outlook.area_m2 > errand.area_m2 + BETTER_GROWTH_M2
        if best is not None and has_grown and best.worth > BETTER * now.worth:
            self._send(best.goal, best, best.way_m, now_s)

    def _go_home(self, floor: Floor, scene: Scene, now_s: float) -> None:
        way_m = way_to(floor, scene.pose, scene.home, self.body)
        self._send(scene.home, None, 20.0 if way_m is None else way_m, now_s)

    def _send(self, pose: Pose2D, target: Frontier | None, way_m: float, now_s: float) -> None:
        self._num_sent += 1
        self._num_barren += target is not None
        goal = SendGoal(
            id=f"map-{self._run}-{self._num_sent}",
            pose=pose.wrapped(),
            frame="map",
            xy_tolerance=XY_TOLERANCE_M,
            yaw_tolerance=YAW_TOLERANCE_RAD if target is None else self._yaw_tolerance,
        )
        limit_s = GOAL_S + GOAL_S_PER_M * way_m
        self._errand = Errand(goal, target, now_s, limit_s, self.area_m2, now_s)
        self.wishes.append(Send(goal))

    def _finish(self, home: str) -> None:
        self._errand = None
        self._set("done", "", sentences.explored(self.area_m2, self.num_missed, home))

    def _lasts(self, what: str, now_s: float) -> float:
        """Return for how long something lasts [s], which begins now if it did not before."""
        return now_s - self._since.setdefault(what, now_s)

    def _set(self, state: State, reason: str, message: str) -> None:
        self.state, self.reason, self.message = state, reason, message


def _apart(one: Frontier, other: Frontier) -> float:
    return Pose2D(one.x, one.y, 0.0).distance_to(Pose2D(other.x, other.y, 0.0))
