"""Goal validation: the checks before a goal is accepted, and its first path."""

from dataclasses import dataclass

import numpy as np

from trolley import codes
from trolley.codes import Refused
from trolley.config import PlannerConfig
from trolley.geometry import Pose2D
from trolley.messages.request_params import SendGoal
from trolley_planner.context.costmap_manager import position_trouble
from trolley_planner.context.planning_context import PlanningContext
from trolley_planner.goals.goal import Goal, Tolerances, nearest_free_pose
from trolley_planner.paths.path import PlannedPath
from trolley_planner.sensing.inputs import Inputs


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
            f"The planner is still waiting for {', '.join(missing)}.",
            missing=missing,
        )


def goal_pose(params: SendGoal, inputs: Inputs) -> Pose2D:
    """Return the pose that a goal asks for, in the planner's frame.

    Raises:
        Refused: another frame, an unknown name, a place of another map.
    """
    if params.frame is not None and params.frame.lstrip("/") != inputs.frame:
        raise Refused(codes.WRONG_FRAME, f"This planner only takes goals in frame {inputs.frame}.")
    if params.pose is not None:
        return params.pose.wrapped()
    if inputs.frame != "map":
        raise Refused(codes.WRONG_FRAME, "Saved poses belong to a map, and this planner has none.")
    if inputs.places is None:
        raise Refused(codes.TOUR_NOT_RUNNING)
    for place in inputs.places.poses:
        if place.name == params.name:
            if inputs.map is not None and place.map != inputs.map.name:
                raise Refused(
                    codes.WRONG_MAP,
                    f"{place.name} belongs to the map {place.map}; "
                    f"the robot is on {inputs.map.name}.",
                )
            return place.pose.wrapped()
    raise Refused(codes.UNKNOWN_NAME, f"There is no saved pose called {params.name}.")


def check_state(inputs: Inputs, now_ns: int) -> None:
    """Refuse while the robot must not drive.

    Raises:
        Refused: `stopped`, `not_localized`.
    """
    if inputs.base is not None and inputs.base.mode == "stopped":
        raise Refused(codes.STOPPED)
    trouble = inputs.pose_trouble(now_ns)
    if trouble == codes.STALE:
        raise Refused(codes.NOT_LOCALIZED, "No fresh pose arrives from the localizer.")
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
    for pose in (goal.pose, *goal.vias):
        in_grid = costmap.to_grid(pose)
        if not costmap.contains(in_grid.x, in_grid.y):
            raise Refused(codes.OUTSIDE_MAP)
        zones = costmap.keepouts_at(pose.x, pose.y)
        if zones:
            raise Refused(codes.KEEPOUT, f"That place lies in the keep-out zone {zones[0].name}.")
    check_clearance(goal.pose, goal.tolerances, context, config)
    trouble = position_trouble(context, start)
    if trouble is not None:
        raise trouble
    here = costmap.to_grid(start)
    costmap.set_position(start.x, start.y)
    costmap.refresh()
    targets = [costmap.to_grid(pose) for pose in (*goal.vias, goal.pose)]
    path = _first_path(context, here, targets)
    if path is None:
        raise _no_path(context, here, targets)
    return ValidatedGoal(goal, path)


def check_clearance(
    pose: Pose2D, tolerances: Tolerances, context: PlanningContext, config: PlannerConfig
) -> None:
    """Refuse a place where the map or a zone leaves the robot no room.

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
        if context.costmap.is_unknown(in_grid.x, in_grid.y):
            raise Refused(codes.IN_OBSTACLE, "The map does not show what is there.")
        raise Refused(codes.IN_OBSTACLE)


def _first_path(
    context: PlanningContext, here: Pose2D, targets: list[Pose2D]
) -> PlannedPath | None:
    """Return a path around what is seen, or else one that assumes it will be gone."""
    planner, costmap = context.planner, context.costmap
    points = [(target.x, target.y) for target in targets]
    start = (here.x, here.y)
    path = planner.plan(start, points, costmap.weights, costmap.distance_m)
    if path is not None:
        return path
    return planner.plan(start, points, planner.optimistic_weights(), costmap.static_distance_m)


def _no_path(context: PlanningContext, here: Pose2D, targets: list[Pose2D]) -> Refused:
    """Return the refusal; it names where it is too narrow, if that is why there is no path."""
    planner, costmap = context.planner, context.costmap
    points = [(target.x, target.y) for target in targets]
    narrow = planner.too_narrow(
        (here.x, here.y), points, planner.optimistic_weights(), costmap.static_distance_m
    )
    if not narrow:
        return Refused(codes.NO_PATH)
    in_frame = costmap.frame_T_grid.transform_points(np.array(narrow))
    blocked = [(round(float(x), 3), round(float(y), 3)) for x, y in in_frame]
    x, y = blocked[0]
    where = f"it is too narrow at x {x:.2f}, y {y:.2f}"
    sentence = f"There is no path there for a robot of this size: {where}."
    return Refused(codes.NO_PATH, sentence, blocked=blocked)
