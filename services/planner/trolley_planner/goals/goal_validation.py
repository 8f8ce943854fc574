"""Whether a goal can be driven to at all: the checks before it is accepted, and its first path."""

from dataclasses import dataclass

import numpy as np

from trolley import codes
from trolley.codes import Refused
from trolley.config import PlannerConfig
from trolley.geometry import Pose2D
from trolley.messages.request_params import SendGoal
from trolley_planner.context.costmap_manager import place_trouble
from trolley_planner.context.planning_context import Rig
from trolley_planner.goals.goal import Goal, Tolerances, free_pose_near
from trolley_planner.paths.path import PlannedPath
from trolley_planner.sensing.inputs import Senses


@dataclass(frozen=True, slots=True)
class Admitted:
    """A goal that may be driven to."""

    goal: Goal
    path: PlannedPath


def check_ready(senses: Senses, now_ns: int | None) -> None:
    """Refuse while something is missing that no goal can be driven without.

    Raises:
        Refused: `not_ready`, naming what is missing.
    """
    missing = senses.missing(has_time=now_ns is not None)
    if missing:
        raise Refused(
            codes.NOT_READY, f"The planner still misses {', '.join(missing)}.", missing=missing
        )


def goal_pose(params: SendGoal, senses: Senses) -> Pose2D:
    """Return the pose that a goal asks for, in the planner's frame.

    Raises:
        Refused: another frame, an unknown name, a place of another map.
    """
    if params.frame is not None and params.frame.lstrip("/") != senses.frame:
        raise Refused(codes.WRONG_FRAME, f"This planner takes goals in frame {senses.frame} only.")
    if params.pose is not None:
        return params.pose.wrapped()
    if senses.frame != "map":
        raise Refused(codes.WRONG_FRAME, "Saved places lie on a map; this planner has none.")
    if senses.places is None:
        raise Refused(codes.TOUR_NOT_RUNNING)
    for place in senses.places.poses:
        if place.name == params.name:
            if senses.map is not None and place.map != senses.map.name:
                raise Refused(
                    codes.WRONG_MAP,
                    f"{place.name} belongs to the map {place.map}; "
                    f"the robot is on {senses.map.name}.",
                )
            return place.pose.wrapped()
    raise Refused(codes.UNKNOWN_NAME, f"There is no saved place called {params.name}.")


def check_state(senses: Senses, now_ns: int) -> None:
    """Refuse while the robot must not drive.

    Raises:
        Refused: `stopped`, `not_localized`.
    """
    if senses.base is not None and senses.base.mode == "stopped":
        raise Refused(codes.STOPPED)
    trouble = senses.pose_trouble(now_ns)
    if trouble == codes.STALE:
        raise Refused(codes.NOT_LOCALIZED, "No fresh pose arrives from the localizer.")
    if trouble is not None:
        raise Refused(codes.NOT_LOCALIZED)


def admit(goal: Goal, rig: Rig, start: Pose2D, config: PlannerConfig) -> Admitted:
    """Return the goal with its first path, or refuse it.

    Args:
        goal: in the frame of the goals.
        rig: costmap and planner.
        start: frame_T_base of the robot.
        config: of the planner.

    Raises:
        Refused: `outside_map`, `keepout`, `in_obstacle`, `no_path`, the latter with `blocked`, the
            places that are too narrow, where the way would lead.
    """
    costmap = rig.costmap
    for pose in (goal.pose, *goal.vias):
        in_grid = costmap.to_grid(pose)
        if not costmap.contains(in_grid.x, in_grid.y):
            raise Refused(codes.OUTSIDE_MAP)
        zones = costmap.keepouts_at(pose.x, pose.y)
        if zones:
            raise Refused(codes.KEEPOUT, f"That place lies in the keep-out zone {zones[0].name}.")
    check_room(goal.pose, goal.tolerances, rig, config)
    trouble = place_trouble(rig, start)
    if trouble is not None:
        raise trouble
    here = costmap.to_grid(start)
    costmap.set_position(start.x, start.y)
    costmap.refresh()
    targets = [costmap.to_grid(pose) for pose in (*goal.vias, goal.pose)]
    path = _first_path(rig, here, targets)
    if path is None:
        raise _no_path(rig, here, targets)
    return Admitted(goal, path)


def check_room(pose: Pose2D, tolerances: Tolerances, rig: Rig, config: PlannerConfig) -> None:
    """Refuse a place where the map or a zone leaves the robot no room.

    Raises:
        Refused: `in_obstacle`.
    """
    enough = config.clearance_m + 0.01
    in_grid = rig.costmap.to_grid(pose)
    found = free_pose_near(
        in_grid,
        tolerances,
        lambda candidate: rig.map_clearance(candidate, enough),
        enough,
    )
    if found is None:
        if rig.costmap.is_unknown(in_grid.x, in_grid.y):
            raise Refused(codes.IN_OBSTACLE, "The map does not know what is in that place.")
        raise Refused(codes.IN_OBSTACLE)


def _first_path(rig: Rig, here: Pose2D, targets: list[Pose2D]) -> PlannedPath | None:
    """Return a path round what is seen, or else one that hopes that it will go away."""
    planner, costmap = rig.planner, rig.costmap
    points = [(target.x, target.y) for target in targets]
    start = (here.x, here.y)
    path = planner.plan(start, points, costmap.weights, costmap.distance_m)
    if path is not None:
        return path
    return planner.plan(start, points, planner.hopeful_weights(), costmap.static_distance_m)


def _no_path(rig: Rig, here: Pose2D, targets: list[Pose2D]) -> Refused:
    """Return the refusal that names where it is too narrow, if that is why there is no way."""
    planner, costmap = rig.planner, rig.costmap
    points = [(target.x, target.y) for target in targets]
    narrow = planner.too_narrow(
        (here.x, here.y), points, planner.hopeful_weights(), costmap.static_distance_m
    )
    if not narrow:
        return Refused(codes.NO_PATH)
    in_frame = costmap.frame_T_grid.transform_points(np.array(narrow))
    blocked = [(round(float(x), 3), round(float(y), 3)) for x, y in in_frame]
    x, y = blocked[0]
    where = f"it is too narrow at x {x:.2f}, y {y:.2f}"
    sentence = f"There is no way there for a robot of this size: {where}."
    return Refused(codes.NO_PATH, sentence, blocked=blocked)
