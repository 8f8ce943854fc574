"""Exploring as a part of the service: carries out what the explorer decides, tells it the news."""

from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from trolley import codes, requests, topics
from trolley.codes import Refused
from trolley.config import MapperConfig
from trolley.geometry.footprint import circumscribed_radius, inscribed_radius
from trolley.messages import BaseState, GoalStatus, MappingStatus, Robot
from trolley.messages.request_params import ExploreMap, SendGoal, WhichGoal
from trolley.messages.types import floats_from_bytes
from trolley.runtime.service import Service, answers, every
from trolley.sight import LidarView
from trolley.under_way import EXPLORES, GOAL_UNDER_WAY
from trolley_mapper.explore import sentences
from trolley_mapper.explore.barriers import Barriers
from trolley_mapper.map_session import MapSession
from trolley_mapper.mapping import Mapping

if TYPE_CHECKING:  # with numba: a robot that has its map need not load it
    from trolley_mapper.explore.exploration_goal import Scene, Survey
    from trolley_mapper.explore.explorer import Explorer
    from trolley_mapper.explore.frontiers import Clearance
    from trolley_mapper.slam.mapper import Mapper

PASSING_CELLS = 0.5
"""Cells that the planner adds to the robot's inscribed radius."""
PASSING_M = 0.02
"""Distance that the planner adds besides `PASSING_CELLS` [m]."""
HIDDEN_RAD = 1.0
"""Angle without any beam from which on the robot is turned to what it is to see: black furniture
hides as much just now, and what a narrow gap hides is seen as the robot drives on [rad]."""
STANDING_M = 0.1
"""Room round the robot at a goal [m]: the planner's clearance, and what the map may still shift."""


class RobotWatches:
    """What an explorer hears of planner, base and robot.

    Args:
        part: that hears it.
        service: that watches.
    """

    def __init__(self, part: "ExploreService", service: Service) -> None:
        self._service = service
        self.goal = service.watch(topics.GOAL, then=part.hear_goal)
        self.base = service.watch(topics.BASE, then=part.hear_base)
        self.robot = service.watch(topics.ROBOT)

    def close(self) -> None:
        """Hear nothing any more."""
        for watch in (self.goal, self.base, self.robot):
            self._service.close_watch(watch)


class ExploreService:
    """Drives the robot to what the map does not show yet, when it is asked to.

    Args:
        mapping: which makes the map.
    """

    def __init__(self, service: Service, config: MapperConfig, mapping: Mapping) -> None:
        self._service, self._config, self._mapping = service, config, mapping
        # Whether exploring begins as soon as map and robot are known.
        self._is_wanted = False
        self._speed_mps: float | None = None
        self._watches: RobotWatches | None = None
        self._set_off_ns = 0
        self._is_surveying = False
        self._published = ("", "")

    # Life.

    def start(self) -> None:
        """Cancel what a process before this one drove to: nothing sets off by itself."""
        self._service.get(topics.GOAL, then=lambda found: self._cancel_left_over(found.get(())))

    def _cancel_left_over(self, status: GoalStatus | None) -> None:
        if status is None or status.id is None or self._explorer is not None:
            return
        if status.id.startswith(EXPLORES) and status.state in GOAL_UNDER_WAY:
            self._cancel(status.id)

    def epoch_began(self) -> None:
        """Take note of a restart of the base."""
        if self._explorer is not None:
            self._explorer.epoch_began()
            self._carry_out()

    def end(self) -> None:
        """Drive nowhere any more: the map is finished."""
        self.stop()
        if self._watches is not None:
            self._watches.close()
            self._watches = None

    @property
    def _explorer(self) -> "Explorer | None":
        session = self._mapping.session
        return None if session is None else session.explorer

    # People.

    @answers(requests.MAP_EXPLORE)
    def explore(self, params: ExploreMap) -> MappingStatus:
        """Start exploring, continue it, or stop the robot."""
        phase, explorer = self._mapping.phase, self._explorer
        if phase not in ("starting", "mapping"):
            is_paused = phase == "paused"
            why = "The map is paused; resume it first." if is_paused else None
            raise Refused(codes.NOT_MAPPING, why)
        if not params.on:
            self.stop()
        elif explorer is not None and explorer.state == "paused":
            self._speed_mps = params.speed
            self._set_off(explorer)
        elif explorer is None or explorer.state == "done":
            self.begin_when_ready(speed_mps=params.speed)
        return self._mapping.publish_status()

    def begin_when_ready(self, is_wanted: bool = True, speed_mps: float | None = None) -> None:
        """Begin to explore as soon as map and robot are known, if that is wanted.

        Args:
            is_wanted: whether it is.
            speed_mps: the highest speed to drive at, None for the planner's own.
        """
        self._is_wanted, self._speed_mps = is_wanted, speed_mps

    def stop(self) -> None:
        """Stop the robot until exploring is asked for again."""
        self._is_wanted = False
        if self._explorer is not None:
            self._explorer.pause(codes.PAUSED, sentences.PAUSES[codes.PAUSED])
            self._carry_out()

    def _set_off(self, explorer: "Explorer") -> None:
        """Let it explore, knowing the planner's present goal, and who drives the robot."""
        self._set_off_ns = self._service.stamp_ns
        goal = None if self._watches is None else self._watches.goal.latest
        base = None if self._watches is None else self._watches.base.latest
        explorer.begin(
            None if goal is None else goal.id,
            None if base is None else base.source,
            self._speed_mps,
        )
        self._carry_out()

    # The map.

    @every(0.5)
    def _explore_on(self) -> None:
        """Choose where to drive next."""
        if self._mapping.phase in ("paused", "saving"):
            self.stop()
        session = self._mapping.session
        if self._mapping.phase != "mapping" or session is None:
            return
        if self._is_wanted:
            self._try_to_begin(session)
        explorer, scene = session.explorer, self._scene(session)
        is_ready = explorer is not None and explorer.is_under_way and not self._is_surveying
        if explorer is None or scene is None or not is_ready:
            return
        if explorer.wants_survey(self._now_s):
            self._is_surveying = True
            self._service.work(
                partial(_survey, scene, explorer), partial(self._surveyed, explorer, scene)
            )
        else:
            self._step(explorer, scene, None)

    def _try_to_begin(self, session: MapSession) -> None:
        """Explore from here, as soon as map and robot are known."""
        if self._watches is None:
            self._watches = RobotWatches(self, self._service)
        robot, pose = self._watches.robot.latest, self._mapping.pose_now()
        if robot is None or pose is None or session.core is None:
            return
        from trolley_mapper.explore.exploration_goal import Limits
        from trolley_mapper.explore.explorer import Explorer

        limits = Limits(self._config.explore_radius_m, self._config.explore_area_m2)
        clearance = _clearance(robot, self._config.resolution_m)
        session.home = session.home or session.core.anchor(pose)
        self._is_wanted = False
        session.barriers = Barriers(session.barriers.mirrors)  # who stood in a door may be gone
        self._mapping.publish_zones(session)
        explorer = Explorer(
            self._service.new_id(), clearance, limits, self._sees_all_round, session.barriers
        )
        session.explore_with(explorer)
        self._set_off(explorer)

    @property
    def _sees_all_round(self) -> bool:
        inputs = self._mapping.inputs
        scan = None if inputs is None else inputs.scan.latest
        if scan is None:
            return True
        view, ranges_m = LidarView(), floats_from_bytes(scan.ranges)
        view.note(ranges_m, scan.angle_min, scan.angle_increment)
        return view.widest_gap_rad < HIDDEN_RAD

    def _surveyed(self, explorer: "Explorer", scene: "Scene", survey: "Survey") -> None:
        self._is_surveying = False
        if explorer is self._explorer:
            has_arrived = survey.clearance is not explorer.clearance  # meanwhile
            self._step(explorer, scene, None if has_arrived else survey)

    def _step(self, explorer: "Explorer", scene: "Scene", survey: "Survey | None") -> None:
        num_barriers = len(explorer.barriers)
        explorer.step(scene, survey, self._now_s)
        session = self._mapping.session
        if session is not None and len(explorer.barriers) != num_barriers:
            # Before the next goal: the planner must not lead there, either.
            self._mapping.publish_zones(session)
        self._carry_out()

    def _scene(self, session: MapSession) -> "Scene | None":
        """What the explorer needs to know of this moment; None while there is no map."""
        core: Mapper | None = session.core
        estimate, pose = session.estimate, self._mapping.pose_now()
        if core is None or estimate is None or pose is None or session.home is None:
            return None
        from trolley_mapper.explore.exploration_goal import Scene

        is_lost, is_unsure = estimate.state == "lost", estimate.state == "unsure"
        home = core.moved(session.home)
        return Scene(core.grid(), pose, is_lost, is_unsure, session.zones_shown, home)

    @property
    def _now_s(self) -> float:
        return self._service.stamp_ns * 1e-9

    # What the explorer decides, and what comes of it.

    def _carry_out(self) -> None:
        """Do what the explorer has decided, and publish what has changed."""
        explorer = self._explorer
        if explorer is None:
            return
        from trolley_mapper.explore.exploration_goal import Send

        for action in explorer.take_actions():
            if isinstance(action, Send):
                answered = partial(self._hear_reply, explorer, action.goal)
                self._service.request(requests.GOAL_SEND, action.goal, answered)
            else:
                self._cancel(action.goal_id)
        if self._published != (explorer.state, explorer.message):
            self._published = (explorer.state, explorer.message)
            self._service.log.info(explorer.message, state=explorer.state)
            self._mapping.publish_status()

    def _cancel(self, goal_id: str) -> None:
        # A refusal means that it is gone already.
        self._service.request(requests.GOAL_CANCEL, WhichGoal(id=goal_id), lambda _: None)

    def _hear_reply(
        self, explorer: "Explorer", goal: SendGoal, result: GoalStatus | Refused
    ) -> None:
        if explorer is not self._explorer:
            self._cancel(goal.id or "")  # given up while it was on its way
        elif isinstance(result, Refused):
            explorer.hear_refusal(goal.id or "", result, self._now_s)
            self._carry_out()
        else:
            self.hear_goal(result)

    def hear_goal(self, status: GoalStatus) -> None:
        """Tell the explorer what the planner says of a goal."""
        if self._explorer is not None:
            self._explorer.hear_goal(status, self._now_s)
            self._carry_out()

    def hear_base(self, state: BaseState) -> None:
        """Tell the explorer of a stop, or of a hand on the robot."""
        if self._explorer is not None and not state.is_from_before(self._set_off_ns):
            self._explorer.hear_base(state)
            self._carry_out()


def _survey(scene: "Scene", explorer: "Explorer") -> "Survey":
    """Survey the map; only reads of the explorer how far it goes, and how much room it asks for."""
    from trolley_mapper.explore.exploration_goal import survey

    return survey(scene, explorer.clearance, explorer.limits)


def _clearance(robot: Robot, resolution_m: float) -> "Clearance":
    """Return how much room a robot needs, as the planner sees it."""
    from trolley_mapper.explore.frontiers import Clearance

    outline = np.array(robot.footprint, np.float64)
    half_cell_m, inscribed_m = PASSING_CELLS * resolution_m, inscribed_radius(outline)
    return Clearance(
        outline,
        passing_m=inscribed_m + PASSING_M + half_cell_m,
        standing_m=circumscribed_radius(outline) + STANDING_M + half_cell_m,
        squeezing_m=inscribed_m,
    )
