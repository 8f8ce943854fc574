"""Goals: what they are, whether they can be driven to, and what became of them."""

import math
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from trolley import codes
from trolley.codes import SENTENCES, Refused
from trolley.config import PlannerConfig
from trolley.geometry import Pose2D, wrap_angle
from trolley.geometry.polygon import distance_to_outline, polygon_contains
from trolley.messages import GoalState, GoalStatus
from trolley.messages.request_params import SendGoal
from trolley.names import canonical
from trolley.suggestions import did_you_mean
from trolley.under_way import GOAL_UNDER_WAY
from trolley_planner.context.planning_context import PlanningContext, position_trouble
from trolley_planner.costmap.connected_components import cells_around, components_of
from trolley_planner.paths.path import PlannedPath
from trolley_planner.sensing.inputs import Inputs

NO_MAP = "If there is no map, make one (`trolley map new NAME`), or set [map] file."
VIA_RADIUS_M = 0.3
"""Via points count as passed within this."""


@dataclass(frozen=True, slots=True)
class PassageParams:
    """When a robot at its goal blocks a passage; by hand."""

    person_m: float = 0.22
    """Half the width that a person needs to walk past."""
    window_m: float = 1.5
    """Distance from the goal along both axes within which the floor is checked."""
    leads_on_m: float = 1.2
    """Distance that a part of the floor must reach to lead on; shorter ones are niches."""


PASSAGE = PassageParams()


@dataclass(frozen=True, slots=True)
class StandInParams:
    """Where a robot may stand in place of an occupied goal; by hand."""

    spare_share: float = 0.25
    """Share of the tolerance that is left for missing the place itself."""
    most_spare_m: float = 0.05
    """No more is left than this."""
    most_m: float = 1.0
    """Greatest distance from the goal, whatever the tolerance."""
    ring_m: float = 0.2
    """Greatest distance between two rings around the goal that are tried."""


STAND_IN = StandInParams()


@dataclass(slots=True)
class Tolerances:
    """How near is near enough."""

    xy: float
    """[m]."""
    yaw: float
    """[rad]; pi or more: any heading."""

    @property
    def any_heading(self) -> bool:
        """Whether the heading does not matter."""
        return self.yaw >= math.pi


@dataclass(frozen=True, slots=True)
class Goal:
    """Where to drive, in the frame of the goals."""

    id: str
    pose: Pose2D
    vias: tuple[Pose2D, ...]
    tolerances: Tolerances
    speed: float | None
    sent_ns: int
    warning: str = ""
    """Code of what speaks against it, although it is driven to."""


def nearest_free_pose(
    goal: Pose2D, tolerances: Tolerances, clearance: Callable[[Pose2D], float], wanted_m: float
) -> Pose2D | None:
    """Return the pose nearest to the goal where the robot fits, None if there is none within reach.

    It takes up a part of the tolerances only, since the robot will not stand there exactly.

    Args:
        goal: the pose asked for.
        tolerances: how far it may be missed.
        clearance: of the footprint at a pose [m].
        wanted_m: clearance that is enough; with less, but none below zero, the best is taken.
    """
    best, best_clearance = None, 0.0
    for radius in _radii(tolerances):
        for candidate in _around(goal, radius, tolerances):
            found = clearance(candidate)
            if found >= wanted_m:
                return candidate
            if found > best_clearance:
                best, best_clearance = candidate, found
    return best


def _radii(tolerances: Tolerances) -> list[float]:
    """Return the radii of rings within the tolerance, smallest first [m]."""
    spare = min(STAND_IN.spare_share * tolerances.xy, STAND_IN.most_spare_m)
    most = min(tolerances.xy - spare, STAND_IN.most_m)
    count = max(3, math.ceil(most / STAND_IN.ring_m))
    return [most * index / count for index in range(count + 1)]


def _around(goal: Pose2D, radius: float, tolerances: Tolerances) -> list[Pose2D]:
    """Return poses on a ring around the goal, each with some headings within the tolerance."""
    spots = [(goal.x, goal.y)]
    if radius > 0.0:
        angles = [index * math.pi / 6.0 for index in range(12)]
        spots = [(goal.x + radius * math.cos(a), goal.y + radius * math.sin(a)) for a in angles]
    turns = [0.0]
    if tolerances.any_heading:
        turns = [index * math.pi / 4.0 for index in range(8)]
    elif tolerances.yaw > 0.01:
        turns += [0.5 * tolerances.yaw, -0.5 * tolerances.yaw]
    return [Pose2D(x, y, wrap_angle(goal.yaw + turn)) for x, y in spots for turn in turns]


@dataclass(frozen=True, slots=True)
class ValidatedGoal:
    """A goal that can be driven to."""

    goal: Goal
    path: PlannedPath


def check_ready(inputs: Inputs, now_ns: int | None) -> None:
    """Refuse while something is missing that no goal can be driven without.

    Raises:
        Refused: `not_ready`, naming what is missing.
    """
    missing = inputs.missing(has_time=now_ns is not None)
    if missing:
        raise Refused(
            codes.NOT_READY,
            f"The planner is still waiting for {', '.join(missing)}."
            + (f" {NO_MAP}" if "map" in missing else ""),
            missing=missing,
        )


def check_frame(frame: str | None, inputs: Inputs) -> None:
    """Refuse places in another frame than the planner's.

    Raises:
        Refused: `wrong_frame`.
    """
    if frame is not None and frame.lstrip("/") != inputs.frame:
        raise Refused(codes.WRONG_FRAME, f"This planner only takes goals in frame {inputs.frame}.")


def goal_pose(params: SendGoal, inputs: Inputs) -> Pose2D:
    """Return the pose that a goal asks for, in the planner's frame.

    Raises:
        Refused: another frame, an unknown name, a place of another map.
    """
    check_frame(params.frame, inputs)
    if params.pose is not None:
        return params.pose.wrapped()
    if inputs.frame != "map":
        raise Refused(codes.WRONG_FRAME, "Saved poses belong to a map, and this planner has none.")
    if inputs.places is None:
        raise Refused(codes.TOUR_NOT_RUNNING)
    name = canonical(params.name or "")
    for place in inputs.places.poses:
        if place.name == name:
            if inputs.map is not None and place.map != inputs.map.name:
                raise Refused(
                    codes.WRONG_MAP,
                    f"{place.name} belongs to the map {place.map}; "
                    f"the robot is on {inputs.map.name}.",
                )
            return place.pose.wrapped()
    hint = did_you_mean(name, (place.name for place in inputs.places.poses))
    raise Refused(codes.UNKNOWN_NAME, f"There is no saved place {name!r}. {hint}")


def check_state(inputs: Inputs, now_ns: int) -> None:
    """Refuse while the robot must not drive.

    Raises:
        Refused: `stopped`, `not_localized`.
    """
    if inputs.base is not None and inputs.base.is_halted:
        is_stopped = inputs.base.mode == "stopped"
        raise Refused(codes.STOPPED, None if is_stopped else inputs.base.message)
    trouble = inputs.pose_trouble(now_ns)
    if trouble == codes.STALE:
        raise Refused(codes.NOT_LOCALIZED, "No current pose from the localizer.")
    if trouble is not None:
        raise Refused(codes.NOT_LOCALIZED)


def validate(
    goal: Goal, context: PlanningContext, start: Pose2D, config: PlannerConfig
) -> ValidatedGoal:
    """Return the goal with its first path, or refuse it.

    Args:
        goal: in the frame of the goals.
        context: costmap and planner.
        start: frame_T_base of the robot.
        config: of the planner.

    Raises:
        Refused: `outside_map`, `keepout`, `in_obstacle`, `no_path`, the last one with `blocked`,
            the places where the path would be too narrow.
    """
    costmap = context.costmap
    vias = ((via, f"The {_via_in_words(via)}") for via in goal.vias)
    for pose, place in ((goal.pose, "That place"), *vias):
        in_grid = costmap.to_grid(pose)
        if not costmap.contains(in_grid.x, in_grid.y):
            raise Refused(codes.OUTSIDE_MAP, f"{place} lies outside the map.")
        zones = costmap.static.keepouts_at(pose.x, pose.y)
        if zones:
            raise Refused(codes.KEEPOUT, f"{place} lies in the no-go area {zones[0].name}.")
    check_clearance(goal.pose, goal.tolerances, context, config)
    trouble = position_trouble(context, start)
    if trouble is not None:
        raise trouble
    here = costmap.to_grid(start)
    costmap.set_position(start.x, start.y)
    costmap.refresh()
    targets = [costmap.to_grid(pose) for pose in (*goal.vias, goal.pose)]
    goal_yaw = None if goal.tolerances.any_heading else targets[-1].yaw
    path = _first_path(context, here, targets, goal_yaw)
    if path is None:
        raise _no_path(context, here, targets, goal.vias)
    warning = codes.IN_PASSAGE if blocks_passage(context, targets[-1]) else ""
    return ValidatedGoal(replace(goal, warning=warning), path)


def check_clearance(
    pose: Pose2D, tolerances: Tolerances, context: PlanningContext, config: PlannerConfig
) -> None:
    """Refuse a pose where map or zones leave the footprint no room.

    Raises:
        Refused: `in_obstacle`.
    """
    enough = config.clearance_m + 0.01
    in_grid = context.costmap.to_grid(pose)
    found = nearest_free_pose(
        in_grid,
        tolerances,
        lambda candidate: context.map_clearance(candidate, enough),
        enough,
    )
    if found is None:
        if context.costmap.static.is_unknown(in_grid.x, in_grid.y):
            raise Refused(codes.IN_OBSTACLE, "The map does not show what is there.")
        raise Refused(codes.IN_OBSTACLE)


def blocks_passage(context: PlanningContext, pose_grid: Pose2D) -> bool:
    """Say whether a robot that stands there blocks a passage of the map.

    The floor around, on which somebody could walk from one side of it to the other, falls into
    parts then, and more than one of them leads on.
    """
    costmap, footprint = context.costmap, context.footprint
    rows, cols = cells_around(costmap.shape, costmap.resolution_m, pose_grid, PASSAGE.window_m)
    walkable = costmap.static.distance_m[rows, cols] >= PASSAGE.person_m
    y, x = np.mgrid[rows, cols]
    points = (np.stack([x.ravel(), y.ravel()], axis=1) + 0.5) * costmap.resolution_m
    local = pose_grid.inverse().transform_points(points)
    past = distance_to_outline(footprint.polygon, local) >= PASSAGE.person_m
    past &= ~polygon_contains(footprint.polygon, local)
    past = past.reshape(walkable.shape) & walkable
    before, after = components_of(walkable), components_of(past)
    away = np.abs(points - (pose_grid.x, pose_grid.y)).max(axis=1).reshape(walkable.shape)
    leads_on = (away > PASSAGE.leads_on_m) & (after > 0)
    sides = np.unique(np.stack([before[leads_on], after[leads_on]]), axis=1)
    return len(np.unique(sides[0])) < sides.shape[1]


def _first_path(
    context: PlanningContext, here: Pose2D, targets: list[Pose2D], goal_yaw: float | None
) -> PlannedPath | None:
    """Return a path around the seen obstacles, or else one that assumes that they will be gone."""
    planner, costmap = context.planner, context.costmap
    points = [(target.x, target.y) for target in targets]
    start, yaws = (here.x, here.y), (here.yaw, goal_yaw)
    path = planner.plan(start, points, costmap.weights, costmap.distance_m, yaws)
    if path is not None:
        return path
    weights = planner.optimistic_weights()
    return planner.plan(start, points, weights, costmap.static.distance_m, yaws)


def _no_path(
    context: PlanningContext, here: Pose2D, targets: list[Pose2D], vias: tuple[Pose2D, ...]
) -> Refused:
    """Return the refusal; it names the via point and the place that is too narrow, if that is why.

    Args:
        context: costmap and planner.
        here: grid_T_base.
        targets: via points and goal in `grid`.
        vias: the same via points in the frame of the goals.
    """
    planner, costmap = context.planner, context.costmap
    start, *points = [(pose.x, pose.y) for pose in (here, *targets)]
    layers = planner.optimistic_weights(), costmap.static.distance_m
    narrow = planner.too_narrow(start, points, *layers)
    legs = zip(vias, pairwise([start, *points]), strict=False)
    unreached = (via for via, (begin, end) in legs if planner.plan(begin, [end], *layers) is None)
    to_via = next((f"to the {_via_in_words(via)}" for via in unreached), "there")
    sentence = f"There is no path {to_via} for a robot of this size"
    if not narrow:
        return Refused(codes.NO_PATH, f"{sentence}.")
    in_frame = costmap.frame_T_grid.transform_points(np.array(narrow))
    blocked = [(round(float(x), 3), round(float(y), 3)) for x, y in in_frame]
    x, y = blocked[0]
    where = f"it is too narrow at x {x:.2f}, y {y:.2f}"
    return Refused(codes.NO_PATH, f"{sentence}: {where}.", blocked=blocked)


def _via_in_words(via: Pose2D) -> str:
    """Name a via point by its place: some may have been passed, so numbers would mislead."""
    return f"via point at x {via.x:.2f}, y {via.y:.2f}"


KEPT_GOALS = 32


class StatusBoard:
    """The state of the current goal, and every change of it in its order.

    Args:
        frame: of the goals.
    """

    def __init__(self, frame: str) -> None:
        self.goal: Goal | None = None
        self.state: GoalState = "idle"
        self.reason = ""
        self.message = ""
        self.history = GoalHistory()
        self._frame = frame
        self._changes: list[GoalStatus] = []
        self._ended_ns: int | None = None
        self._details: GoalStatus | None = None

    @property
    def is_active(self) -> bool:
        """Whether there is a goal that is not over."""
        return self.state in GOAL_UNDER_WAY

    def begin(self, goal: Goal) -> None:
        """Begin a new goal; `set` follows it."""
        self.goal = goal
        self._ended_ns = None
        self._details = None

    def move(self, goal: Goal) -> None:
        """Put the current goal somewhere else."""
        self.goal = goal

    def set(
        self,
        state: GoalState,
        reason: str,
        now_ns: int,
        message: str | None = None,
        details: GoalStatus | None = None,
    ) -> None:
        """Enter a state; nothing happens where state, reason and message stay the same.

        Args:
            state: the new state.
            reason: a code, "" if there is none.
            now_ns: robot time.
            message: one sentence; that of the code if not given.
            details: distance, time and so on at this moment.
        """
        sentence = SENTENCES.get(reason, "") if message is None else message
        if (state, reason, sentence) == (self.state, self.reason, self.message):
            return
        self.state, self.reason, self.message = state, reason, sentence
        if not self.is_active:
            self._ended_ns = now_ns
        self._changes.append(self.snapshot(now_ns, details))

    def snapshot(self, now_ns: int, details: GoalStatus | None = None) -> GoalStatus:
        """Return the present status, and keep it for whoever asks by id later."""
        goal = self.goal
        # How it ended stays known after its execution is gone.
        self._details = details = self._details if details is None else details
        end_ns = now_ns if self._ended_ns is None else self._ended_ns
        status = GoalStatus(
            stamp_ns=now_ns,
            id=None if goal is None else goal.id,
            state=self.state,
            reason=self.reason,
            message=self.message,
            frame=self._frame,
            pose=None if goal is None else goal.pose,
            distance_remaining=None if details is None else details.distance_remaining,
            eta=None if details is None or not self.is_active else details.eta,
            elapsed=0.0 if goal is None else max(0.0, (end_ns - goal.sent_ns) * 1e-9),
            recoveries=0 if details is None else details.recoveries,
            blocked=[] if details is None else details.blocked,
            person=None if details is None else details.person,
            warning="" if goal is None else goal.warning,
        )
        self.history.remember(status)
        return status

    def pop_changes(self) -> list[GoalStatus]:
        """Return every status since the last call, oldest first."""
        changes, self._changes = self._changes, []
        return changes

    def check_current(self, goal_id: str | None) -> None:
        """Refuse unless this is the current goal, and it is not over.

        Raises:
            Refused: `not_current`.
        """
        goal = self.goal if self.is_active else None
        if goal is None and goal_id is None:
            raise codes.Refused(codes.NOT_CURRENT, "The robot has no goal now.")
        if goal is None or (goal_id is not None and goal_id != goal.id):
            raise codes.Refused(codes.NOT_CURRENT)


class GoalHistory:
    """The last goals by their id."""

    def __init__(self) -> None:
        self._statuses: OrderedDict[str, GoalStatus] = OrderedDict()

    def remember(self, status: GoalStatus) -> None:
        """Keep the newest status of a goal; drop the oldest goals."""
        if status.id is None:
            return
        self._statuses[status.id] = status
        self._statuses.move_to_end(status.id)
        while len(self._statuses) > KEPT_GOALS:
            self._statuses.popitem(last=False)

    def find(self, goal_id: str) -> GoalStatus | None:
        """Return the newest status of a goal, None if it is not known (any more)."""
        return self._statuses.get(goal_id)
