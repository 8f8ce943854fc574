"""The other robots of the house, by what they report: where they are and will be.

Times are those of arrival on the local monotonic clock: stamps of different robots are never
compared. Only robots that are on the same map, sure of their pose and heard of lately count, no
recordings that are replayed; one that falls silent is what the lidar sees of it, like anything else
that stands or moves.
"""

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley import codes
from trolley.geometry import Pose2D
from trolley.messages import GoalStatus, Path, PoseEstimate, Robot
from trolley.messages.types import floats_from_bytes
from trolley.under_way import GOAL_GOES
from trolley_planner.paths.path import SPACING_M
from trolley_planner.people.moving_obstacles import ROBOT_DT_S


@dataclass(frozen=True, slots=True)
class NeighbourParams:
    """How long and how far messages of other robots count; all by hand."""

    most_robots: int = 32
    """Number of robots that are remembered."""
    forget_ns: int = 60_000_000_000
    """Silence after which a robot is forgotten if another needs its place [ns]."""
    silent_s: float = 1.5
    """Age of a robot's pose above which the robot does not count."""
    track_silent_s: float = 0.6
    """Age above which a trajectory is not used."""
    track_steps: int = 25
    """Number of steps of `ROBOT_DT_S` that are predicted."""
    moves_m: float = 0.03
    """Distance in the next second below which a robot counts as standing; the lidar sees it."""
    path_ahead_m: float = 6.0
    """Length of a robot's path that is considered."""
    off_path_m: float = 1.0
    """Distance from its path beyond which a robot is not taken to follow it."""
    most_points: int = 20_000
    """Number of points above which a path is not read."""
    most_discs: int = 4
    """Number of discs in a row that represent an outline at most."""


NEIGHBOURS = NeighbourParams()


Floats = NDArray[np.float64]
NO_POINTS: Floats = np.empty((0, 2))


class Neighbour(NamedTuple):
    """Another robot at a moment; all lengths in metres."""

    name: str
    pose: Pose2D
    radius_m: float
    """Of the circle about its origin that holds it."""
    path: Floats
    """(n, 2) where it drives next, from where it is on; empty where it has no goal."""
    waited_s: float | None
    """How long it has been reporting that it gives way; None if it does not."""
    track: Floats
    """(discs, steps, 3) x, y, radius at each `ROBOT_DT_S` from now on; empty where it stands."""

    @property
    def is_going(self) -> bool:
        """Whether it is on its way to a goal."""
        return len(self.path) > 0

    @property
    def is_standing(self) -> bool:
        """Whether it stands, with a goal or without."""
        return len(self.track) == 0

    @property
    def is_waiting(self) -> bool:
        """Whether it reports that it gives way."""
        return self.waited_s is not None


NO_TRACK: Floats = np.empty((0, NEIGHBOURS.track_steps, 3))


@dataclass(slots=True)
class _Heard:
    """The newest messages of one robot, and when they came [ns]."""

    discs: Floats = field(default_factory=lambda: np.array([[0.0, 0.0, 0.2]]))
    """(k, 3) x, y in `base_link`, radius: what its outline is taken for."""
    is_replayed: bool = False
    """Whether it is a recording, and nothing stands there."""
    pose: PoseEstimate | None = None
    pose_ns: int = 0
    is_going: bool = False
    waiting_ns: int | None = None
    """When it first reported that it waits; None if it does not."""
    path: Floats = field(default_factory=lambda: NO_POINTS)
    poses_ahead: Floats = field(default_factory=lambda: np.empty((0, 3)))
    step_s: float = ROBOT_DT_S
    ahead_ns: int = 0


class Neighbours:
    """What is known of all other robots; everything in frame `map`."""

    def __init__(self) -> None:
        self.own_name = ""
        """Name of this robot, which is none of the others."""
        self._heard: dict[str, _Heard] = {}

    def update_robot(self, robot: Robot, name: str) -> None:
        """Keep a robot's outline, and whether it is there at all."""
        heard = self._of(name)
        if heard is None:
            return
        heard.is_replayed = robot.replayed
        corners = np.array(robot.footprint, dtype=np.float64)
        if np.isfinite(corners).all() and np.abs(corners).max() < 5.0:
            heard.discs = outline_discs(corners)

    def update_pose(self, pose: PoseEstimate, name: str, arrived_ns: int) -> None:
        """Keep a robot's pose estimate."""
        heard = self._of(name)
        if heard is not None:
            heard.pose, heard.pose_ns = pose, arrived_ns

    def update_goal(self, goal: GoalStatus, name: str, arrived_ns: int) -> None:
        """Keep whether a robot is on its way to a goal, and whether it gives way."""
        heard = self._of(name)
        if heard is not None:
            heard.is_going = goal.state in GOAL_GOES
            if goal.reason != codes.WAITING:
                heard.waiting_ns = None
            elif heard.waiting_ns is None:
                heard.waiting_ns = arrived_ns

    def update_path(self, path: Path, name: str) -> None:
        """Keep a robot's path."""
        heard = self._of(name)
        if heard is not None:
            heard.path = _spread(_poses_of(path)[:, :2])

    def update_trajectory(self, trajectory: Path, name: str, arrived_ns: int) -> None:
        """Keep what a robot is about to drive."""
        heard = self._of(name)
        if heard is not None and trajectory.dt > 0.0:
            heard.poses_ahead = _poses_of(trajectory)
            heard.step_s, heard.ahead_ns = trajectory.dt, arrived_ns

    def on_map(self, map_name: str, now_ns: int) -> list[Neighbour]:
        """Return the robots on a map, by name.

        Args:
            map_name: of this robot's map.
            now_ns: local monotonic time.
        """
        found: list[Neighbour] = []
        for name in sorted(self._heard):
            heard, estimate = self._heard[name], self._heard[name].pose
            if estimate is None or estimate.pose is None or estimate.map != map_name:
                continue
            is_good = estimate.state in ("localized", "unsure", "mapping") and not heard.is_replayed
            if not is_good or now_ns - heard.pose_ns > NEIGHBOURS.silent_s * 1e9:
                continue
            pose = estimate.pose
            path = _rest(heard.path, pose) if heard.is_going else NO_POINTS
            radius_m = float((np.hypot(*heard.discs[:, :2].T) + heard.discs[:, 2]).max())
            track = _track(heard, pose, now_ns)
            waited_s = None if heard.waiting_ns is None else (now_ns - heard.waiting_ns) * 1e-9
            found.append(Neighbour(name, pose, radius_m, path, waited_s, track))
        return found

    def _of(self, name: str) -> _Heard | None:
        """Return the record of a robot; None for this robot, or beyond `most_robots`."""
        if name == self.own_name:
            return None
        heard = self._heard.get(name)
        if heard is None and len(self._heard) >= NEIGHBOURS.most_robots:
            last_ns = {other: known.pose_ns for other, known in self._heard.items()}
            oldest = min(last_ns, key=lambda other: last_ns[other])
            if max(last_ns.values()) - last_ns[oldest] > NEIGHBOURS.forget_ns:
                del self._heard[oldest]
        if heard is None and len(self._heard) < NEIGHBOURS.most_robots:
            heard = self._heard[name] = _Heard()
        return heard


def outline_discs(corners: Floats) -> Floats:
    """Return discs (k, 3) x, y, radius that hold an outline (n, 2), in a row along it."""
    low, high = corners.min(axis=0), corners.max(axis=0)
    size = np.maximum(high - low, 1e-3)
    along = int(np.argmax(size))
    count = min(NEIGHBOURS.most_discs, math.ceil(float(size[along] / size[1 - along])))
    discs = np.empty((count, 3))
    shares = (np.arange(count) + 0.5) / count
    discs[:, along] = low[along] + shares * size[along]
    discs[:, 1 - along] = 0.5 * (low[1 - along] + high[1 - along])
    discs[:, 2] = math.hypot(float(size[along]) / count / 2.0, float(size[1 - along]) / 2.0)
    return discs


def _poses_of(path: Path) -> Floats:
    """Return the poses (n, 3) of a path on the map; none of one that cannot be used."""
    if path.frame.lstrip("/") != "map" or len(path.poses) > 12 * NEIGHBOURS.most_points:
        return np.empty((0, 3))
    poses = floats_from_bytes(path.poses, 3).astype(np.float64)
    return poses if np.isfinite(poses).all() else np.empty((0, 3))


def _spread(points: Floats) -> Floats:
    """Return points of a path at even distances, whoever planned it."""
    if len(points) < 2:
        return points
    lengths = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    total = min(float(lengths[-1]), NEIGHBOURS.most_points * SPACING_M)
    at = np.linspace(0.0, total, max(2, math.ceil(total / SPACING_M) + 1))
    return np.stack([np.interp(at, lengths, points[:, axis]) for axis in range(2)], axis=1)


def _rest(path: Floats, pose: Pose2D) -> Floats:
    """Return what is left of a path and matters now."""
    if len(path) == 0:
        return path
    away = np.hypot(path[:, 0] - pose.x, path[:, 1] - pose.y)
    first = int(away.argmin())
    if float(away[first]) > NEIGHBOURS.off_path_m:
        return NO_POINTS
    return path[first : first + round(NEIGHBOURS.path_ahead_m / SPACING_M) + 1]


def _track(heard: _Heard, pose: Pose2D, now_ns: int) -> Floats:
    """Return where the discs of a robot will be, none where it stands."""
    age_s = (now_ns - heard.ahead_ns) * 1e-9
    poses = heard.poses_ahead
    if len(poses) < 2 or not 0.0 <= age_s < NEIGHBOURS.track_silent_s:
        return NO_TRACK
    at = (age_s + ROBOT_DT_S * np.arange(NEIGHBOURS.track_steps)) / heard.step_s
    index = np.arange(len(poses))
    x, y = (np.interp(at, index, poses[:, axis]) for axis in range(2))
    yaw = np.interp(at, index, np.unwrap(poses[:, 2]))
    second = min(NEIGHBOURS.track_steps - 1, round(1.0 / ROBOT_DT_S))
    far_off = math.hypot(float(x[0]) - pose.x, float(y[0]) - pose.y) > NEIGHBOURS.off_path_m
    if far_off or math.hypot(float(x[second] - x[0]), float(y[second] - y[0])) < NEIGHBOURS.moves_m:
        return NO_TRACK
    track = np.empty((len(heard.discs), NEIGHBOURS.track_steps, 3))
    for disc, (ahead, left, radius) in zip(track, heard.discs, strict=True):
        disc[:, 0] = x + np.cos(yaw) * ahead - np.sin(yaw) * left
        disc[:, 1] = y + np.sin(yaw) * ahead + np.cos(yaw) * left
        disc[:, 2] = radius
    return track


def moved_into(neighbour: Neighbour, grid_T_map: Pose2D) -> Neighbour:
    """Return the same in another frame."""
    path, track = neighbour.path, neighbour.track
    if len(path):
        path = grid_T_map.transform_points(path)
    if len(track):
        places = grid_T_map.transform_points(track[:, :, :2].reshape(-1, 2))
        track = np.concatenate([places.reshape(*track.shape[:2], 2), track[:, :, 2:]], axis=2)
    return neighbour._replace(pose=grid_T_map @ neighbour.pose, path=path, track=track)
