"""The part of the service that explores: it does what the explorer wishes and tells it the news."""

from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from trolley import codes, requests, topics
from trolley.codes import Refused
from trolley.config import RobotConfig
from trolley.geometry.footprint import circumscribed_radius, inscribed_radius
from trolley.messages import BaseState, GoalStatus, MappingStatus, Robot
from trolley.messages.request_params import ExploreMap, SendGoal, WhichGoal
from trolley.runtime.service import Watch, answers, every
from trolley_mapper.explore import sentences
from trolley_mapper.mapping_service import Maker
from trolley_mapper.slam.estimate import Anchor

if TYPE_CHECKING:  # with numba: a robot that has its map need not carry it
    from trolley_mapper.explore.exploration_goal import Scene, Sight
    from trolley_mapper.explore.explorer import Explorer
    from trolley_mapper.explore.frontiers import Body

GOALS = "map-"
"""What the ids of all goals of this service begin with."""
UNDER_WAY = ("planning", "driving", "recovering", "paused")
PASSING_CELLS, PASSING_M = 0.5, 0.02
"""What the planner adds to the robot's inscribed radius: half a cell, and this [m]."""
STANDING_M = 0.1
"""Room round the robot at a goal: the planner's clearance, and what the map may still shift."""
FULL_TURN_RAD = 6.1
"""A lidar that sees so much sees all round."""


class Exploring(Maker):
    """Drives the robot to what the map does not know yet, when it is asked to."""

    def __init__(self, config: RobotConfig) -> None:
        super().__init__(config)
        self.wants_to_explore = False
        """Whether exploring begins as soon as all is there."""
        self._home: Anchor | None = None
        self._asked_ns = 0
        self._is_looking = False
        self._told: tuple[str, str] = ("", "")
        self._goal: Watch[GoalStatus] | None = None
        self._base: Watch[BaseState] | None = None
        self._outline: Watch[Robot] | None = None

    # Life.

    def start(self) -> None:
        """Give up what a process before this one drove to: nothing sets off by itself."""
        super().start()
        self.get(topics.GOAL, then=lambda found: self._drop(found.get(())))

    def _drop(self, status: GoalStatus | None) -> None:
        if status is None or status.id is None or self.explorer is not None:
            return
        if status.id.startswith(GOALS) and status.state in UNDER_WAY:
            self._cancel(status.id)

    def epoch_began(self) -> None:
        """Take note of a restart of the base."""
        super().epoch_began()
        if self.explorer is not None:
            self.explorer.epoch_began()
            self._carry_out()

    def finish(self, note: str) -> MappingStatus:
        """Drive nowhere any more."""
        self.stand()
        for watch in (self._goal, self._base, self._outline):
            if watch is not None:
                self.close_watch(watch)
        self._goal = self._base = self._outline = self.explorer = None
        return super().finish(note)

    # People.

    @answers(requests.MAP_EXPLORE)
    def explore(self, params: ExploreMap) -> MappingStatus:
        """Explore, go on with it, or let the robot stand."""
        if self.making is None or self.phase not in ("starting", "mapping"):
            is_paused = self.phase == "paused"
            why = "The map is paused; resume it first." if is_paused else None
            raise Refused(codes.NOT_MAPPING, why)
        if not params.on:
            self.stand()
        elif self.explorer is not None and self.explorer.state == "paused":
            self._let_explore(self.explorer)
        elif self.explorer is None or self.explorer.state == "done":
            self.wants_to_explore = True
        return self.say()

    def stand(self) -> None:
        """Let the robot stand until exploring is asked for again."""
        self.wants_to_explore = False
        if self.explorer is not None:
            self.explorer.pause(codes.PAUSED, sentences.PAUSES[codes.PAUSED])
            self._carry_out()

    def _let_explore(self, explorer: "Explorer") -> None:
        """Set off from the planner's present goal, and from who drives the robot."""
        self._asked_ns = self.stamp_ns
        goal = None if self._goal is None else self._goal.latest
        base = None if self._base is None else self._base.latest
        explorer.begin(None if goal is None else goal.id, None if base is None else base.source)
        self._carry_out()

    # The map.

    @every(0.5)
    def _explore_on(self) -> None:
        """Look where to drive next."""
        if self.phase in ("paused", "saving"):
            self.stand()
        if self.phase != "mapping":
            return
        if self.wants_to_explore:
            self._set_off()
        explorer, scene = self.explorer, self._scene()
        if explorer is None or scene is None or not explorer.is_under_way or self._is_looking:
            return
        if explorer.wants_look(self._now_s):
            self._is_looking = True
            self.work(partial(_look, scene, explorer), partial(self._looked, explorer, scene))
        else:
            self._step(explorer, scene, None)

    def _set_off(self) -> None:
        """Explore from here, as soon as map and robot are known."""
        if self._goal is None:
            self._goal = self.watch(topics.GOAL, then=self._hear_goal)
            self._base = self.watch(topics.BASE, then=self._hear_base)
            self._outline = self.watch(topics.ROBOT)
        making, pose = self.making, self.pose_now()
        robot = None if self._outline is None else self._outline.latest
        if robot is None or pose is None or making is None or making.core is None:
            return
        from trolley_mapper.explore.exploration_goal import Limits
        from trolley_mapper.explore.explorer import Explorer

        config = self.config.mapper
        limits = Limits(config.explore_radius_m, config.explore_area_m2)
        body = _body(robot, config.resolution_m)
        self._home = making.core.anchor(pose)
        self.wants_to_explore = False
        self.explorer = Explorer(self.new_id(), body, limits, self._sees_all_round)
        self._let_explore(self.explorer)

    @property
    def _sees_all_round(self) -> bool:
        scan = None if self.senses is None else self.senses.scan.latest
        return scan is None or len(scan.ranges) // 4 * scan.angle_increment > FULL_TURN_RAD

    def _looked(self, explorer: "Explorer", scene: "Scene", sight: "Sight") -> None:
        self._is_looking = False
        if explorer is self.explorer:
            self._step(explorer, scene, sight)

    def _step(self, explorer: "Explorer", scene: "Scene", sight: "Sight | None") -> None:
        explorer.step(scene, sight, self._now_s)
        self._carry_out()

    def _scene(self) -> "Scene | None":
        """What there is to be seen; None while there is nothing."""
        making, pose, home = self.making, self.pose_now(), self._home
        core = None if making is None else making.core
        estimate = None if making is None else making.estimate
        if making is None or core is None or estimate is None or pose is None or home is None:
            return None
        from trolley_mapper.explore.exploration_goal import Scene

        is_lost, is_unsure = estimate.state == "lost", estimate.state == "unsure"
        return Scene(core.grid(), pose, is_lost, is_unsure, making.zones, core.moved(home))

    @property
    def _now_s(self) -> float:
        return self.stamp_ns * 1e-9

    # What it wishes, and what comes of it.

    def _carry_out(self) -> None:
        """Do what the explorer wishes, and say what has changed."""
        explorer = self.explorer
        if explorer is None:
            return
        from trolley_mapper.explore.exploration_goal import Send

        wishes, explorer.wishes = explorer.wishes, []
        for wish in wishes:
            if isinstance(wish, Send):
                reply = partial(self._hear_reply, explorer, wish.goal)
                self.request(requests.GOAL_SEND, wish.goal, reply)
            else:
                self._cancel(wish.goal_id)
        if self._told != (explorer.state, explorer.message):
            self._told = (explorer.state, explorer.message)
            self.log.info(explorer.message, state=explorer.state)
            self.say()

    def _cancel(self, goal_id: str) -> None:
        # A refusal means that it is gone already.
        self.request(requests.GOAL_CANCEL, WhichGoal(id=goal_id), lambda _: None)

    def _hear_reply(
        self, explorer: "Explorer", goal: SendGoal, result: GoalStatus | Refused
    ) -> None:
        if explorer is not self.explorer:
            self._cancel(goal.id or "")  # given up while it was on its way
        elif isinstance(result, Refused):
            explorer.hear_refusal(goal.id or "", result, self._now_s)
            self._carry_out()
        else:
            self._hear_goal(result)

    def _hear_goal(self, status: GoalStatus) -> None:
        if self.explorer is not None:
            self.explorer.hear_goal(status, self._now_s)
            self._carry_out()

    def _hear_base(self, state: BaseState) -> None:
        if self.explorer is not None and not state.is_from_before(self._asked_ns):
            self.explorer.hear_base(state)
            self._carry_out()


def _look(scene: "Scene", explorer: "Explorer") -> "Sight":
    """Look at the map; touches nothing of the explorer but what never changes."""
    from trolley_mapper.explore.exploration_goal import look

    return look(scene, explorer.body, explorer.limits)


def _body(robot: Robot, resolution_m: float) -> "Body":
    """Return how much room a robot needs, as the planner has it."""
    from trolley_mapper.explore.frontiers import Body

    outline = np.array(robot.footprint, np.float64)
    half_cell_m = PASSING_CELLS * resolution_m
    return Body(
        passes_m=inscribed_radius(outline) + PASSING_M + half_cell_m,
        stands_m=circumscribed_radius(outline) + STANDING_M + half_cell_m,
    )
