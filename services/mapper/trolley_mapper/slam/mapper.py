"""The mapper without wire, clock and files: scans and odometry in, poses and a map out.

Frames: `map` (fixed by the first keyframe, or by the map that is extended), `odom`, `base_link`.
"""

import math
from typing import Self

import numpy as np
from numpy.typing import NDArray

from trolley.config.mapper import MapperConfig
from trolley.geometry import Pose2D
from trolley.gridmap import GridMap
from trolley.scanning.front_end import Reject, ScanInput, problem_of
from trolley_mapper.slam.anchors import Anchors
from trolley_mapper.slam.edges import next_edge, ties
from trolley_mapper.slam.estimate import Anchor, MapEstimate
from trolley_mapper.slam.keyframe import Keyframe
from trolley_mapper.slam.keyframe_store import Atlas
from trolley_mapper.slam.local_map import LocalMap
from trolley_mapper.slam.loop_closure import Closure, LoopJob
from trolley_mapper.slam.occupancy_grid import Occupancy, draw_all
from trolley_mapper.slam.odometry_scale import OdometryScale
from trolley_mapper.slam.pose_graph import between, compose, to_frame
from trolley_mapper.slam.prior_map import prior_keyframe
from trolley_mapper.slam.relocalization import RelocationJob
from trolley_mapper.slam.scan_matcher import Fit, Tracker
from trolley_mapper.slam.serialization import State, unpack
from trolley_mapper.slam.sweep import Sweep, read_sweep
from trolley_mapper.slam.tracking_state import Trust

# A wheeled indoor robot is slower; a longer step is a reset or a fault of the odometry [m/s, m].
_FASTEST_MPS = 4.0
_LONGEST_JUMP_M = 0.5
# Where the odometry is not to be believed, the robot may be so far off [m, rad].
_JUMP_DEVS = (0.3, 0.3)
# How far off a start pose on an existing map may be, and one that a search has found [m, rad].
_TOLD_DEVS = (0.2, 0.15)
_FOUND_DEVS = (0.1, 0.05)
_SEARCH_AGAIN_S = 2.0
_PENDING = 12
# Keyframes this near to each other show the same: the share of the distances between keyframes.
_SAME_PLACE = 1.2
_SLIPPING = 2.0

MapJob = LoopJob | RelocationJob


class Mapper:
    """Makes a map from scans and odometry.

    Heavy work is handed out: after each call of `step` ask `take_job`, run the job anywhere (it
    touches nothing of the mapper), and give it back to `finish` from the thread that calls `step`.

    Args:
        config: settings.
        start: map_T_base at the first scan; None: the origin, or with a prior a search on it.
        prior: an existing map to extend.
    """

    def __init__(
        self, config: MapperConfig, start: Pose2D | None = None, prior: GridMap | None = None
    ) -> None:
        self._config = config
        self._prior = prior
        self._atlas = Atlas()
        self._anchors = Anchors()
        self._tracker = Tracker(config.max_range_m)
        self._scale = OdometryScale()
        self._trust = Trust(config.lost_after_s)
        self._occupancy = Occupancy(config.resolution_m, prior)
        self._local: LocalMap | None = None
        self._local_pose = np.zeros(3)
        self._last: ScanInput | None = None
        self._sweep: Sweep | None = None
        # Whether the newest keyframe and the robot are joined by a way without a break.
        self._is_joined = False
        self._way_covariance = np.zeros((3, 3))
        self._next_number = 0
        self._pending: list[Closure] = []
        self._wants_loop = False
        self._job: MapJob | None = None
        self._since_search_s = math.inf
        self._closed_loop = False
        self._is_paused = False
        self._version = 0
        self._grid: tuple[int, GridMap] | None = None
        self.num_loops = 0
        self._tracker.reset((start or Pose2D.identity()).as_array(), (0.001, 0.001))
        if prior is not None:
            self._extend(prior, is_told=start is not None)

    def _extend(self, prior: GridMap, is_told: bool) -> None:
        """Begin on a map made before."""
        self._atlas.add(prior_keyframe(self._next_number, prior), np.zeros(3), [])
        self._next_number += 1
        self._trust.doubt(is_lost=not is_told)
        self._tracker.reset(self._tracker.pose, _TOLD_DEVS)
        self._version += 1

    # One scan.

    def step(self, scan: ScanInput) -> MapEstimate | Reject:
        """Take one scan and its odometry into account."""
        reject = problem_of(scan, None if self._last is None else self._last.stamp_ns)
        if reject is not None:
            return reject
        elapsed_s, way_m = self._predict(scan)
        sweep = read_sweep(scan, self._config.max_range_m)
        self._last, self._sweep = scan, sweep
        self._since_search_s += elapsed_s
        if sweep.is_blind:
            return self._estimate(scan, 0.0, "the lidar sees too little")
        if len(self._atlas) == 0:
            self._insert(scan, sweep, self._tracker.pose)
            return self._estimate(scan, 1.0, "")
        fit = self._tracker.look(self._local_map(), sweep, scan)
        if self._trust.look(fit.verdict, elapsed_s, way_m) == "lost":
            self._is_joined = False
        may_grow = self._trust.may_grow(fit.verdict, self._is_joined) and not self._is_paused
        if may_grow and self._has_moved():
            self._insert(scan, fit.sweep, fit.pose, fit)
        message = self._tracker.slipping.message
        if self._is_paused:
            message = "paused: the map does not grow"
        return self._estimate(scan, fit.verdict.match, self._trust.message or message)

    def _predict(self, scan: ScanInput) -> tuple[float, float]:
        """Follow the odometry since the scan before; return the time [s] and the way [m]."""
        if self._last is None:
            return 0.0, 0.0
        elapsed_s = (scan.stamp_ns - self._last.stamp_ns) * 1e-9
        step = self._last.odom_T_base.inverse() @ scan.odom_T_base
        way_m = math.hypot(step.x, step.y)
        if way_m > _LONGEST_JUMP_M + _FASTEST_MPS * elapsed_s:
            step, way_m = Pose2D.identity(), 0.0
            self._tracker.loosen(_JUMP_DEVS)
            self._way_covariance = self._way_covariance + np.diag(np.square([0.3, 0.3, 0.3]))
        step = self._scale.correct(step)
        self._tracker.predict(step)
        self._way_covariance = self._way_covariance + self._tracker.noise(way_m, abs(step.yaw))
        return elapsed_s, way_m

    def _estimate(self, scan: ScanInput, match: float, message: str) -> MapEstimate:
        """Say where the robot is."""
        pose = Pose2D.from_array(self._tracker.pose)
        closed, self._closed_loop = self._closed_loop, False
        return MapEstimate(
            stamp_ns=scan.stamp_ns,
            pose=pose,
            covariance=self._tracker.covariance.copy(),
            match=match,
            state=self._trust.state,
            message=message,
            map_T_odom=pose @ scan.odom_T_base.inverse(),
            closed_loop=closed,
        )

    # The map grows.

    def _insert(
        self, scan: ScanInput, sweep: Sweep, pose: NDArray[np.float64], fit: Fit | None = None
    ) -> None:
        """Make a scan a keyframe, tied to those that it was matched with."""
        number = self._next_number
        keyframe = Keyframe.of(number, scan.stamp_ns, sweep)
        edges, matched = [], np.zeros((3, 3))
        previous = self._atlas.newest if self._is_joined else None
        if fit is not None and fit.verdict.is_good:
            before = None if previous is None else previous.number
            edges, matched = ties(number, self._local_map(), pose, sweep.cloud, before)
        if previous is not None and fit is not None and fit.verdict.is_good:
            moved = between(self._atlas.poses[-1], pose)
            self._scale.learn(moved, to_frame(fit.information, float(pose[2])))
        self._scale.restart()
        if previous is not None:
            poses = (self._atlas.poses[-1], pose)
            way = self._way_covariance
            edges.append(next_edge((previous.number, number), poses, way, matched))
        self._atlas.add(keyframe, pose, edges)
        self._occupancy.add(keyframe, pose)
        self._next_number += 1
        self._is_joined = True
        self._way_covariance = np.zeros((3, 3))
        self._local = None
        self._wants_loop = True
        self._version += 1
        self._thin_out()

    def _thin_out(self) -> None:
        """Forget a keyframe where many show the same, so that time alone costs no memory."""
        config = self._config
        alike = self._atlas.alike(
            _SAME_PLACE * config.keyframe_distance_m, _SAME_PLACE * config.keyframe_turn_rad
        )
        if len(alike) > config.keyframes_per_place:
            # The oldest hold the map in place, the newest show what has changed.
            gone = alike[len(alike) // 2]
            self._anchors.forget(self._atlas, [gone])
            self._atlas.dissolve(gone)

    def _has_moved(self) -> bool:
        """Say whether the robot has moved enough since the newest keyframe."""
        if not self._is_joined:
            return True
        step = between(self._atlas.poses[-1], self._tracker.pose)
        share = max(
            math.hypot(step[0], step[1]) / self._config.keyframe_distance_m,
            abs(step[2]) / self._config.keyframe_turn_rad,
        )
        # While wheels slip, the motion during the scan is not known either: wait, if not for long.
        return share >= (_SLIPPING if self._tracker.is_slipping else 1.0)

    def _local_map(self) -> LocalMap:
        """Return the surfaces near the robot, put together anew when it has moved on."""
        atlas, pose = self._atlas, self._tracker.pose
        away = between(self._local_pose, pose)
        has_moved = math.hypot(away[0], away[1]) > 2.0 * self._config.keyframe_distance_m
        if self._local is None or has_moved:
            start = atlas.newest.number if self._is_joined else atlas.nearest(pose)
            limits = (self._config.local_way_m, self._config.local_keyframes)
            numbers = atlas.around(start, pose, *limits)
            keyframes = [atlas.keyframes[atlas.rows[n]] for n in numbers]
            poses = np.array([atlas.pose(n) for n in numbers])
            self._local = LocalMap(keyframes, poses, pose[:2], self._config.local_reach_m)
            self._local_pose = pose.copy()
        return self._local

    # Heavy work.

    def take_job(self) -> MapJob | None:
        """Return work to do now, or None. Give it back to `finish` when it is done."""
        if self._job is not None or len(self._atlas) == 0 or self._last is None:
            return None
        if self._trust.state == "lost":
            waits = self._since_search_s < _SEARCH_AGAIN_S
            if waits or self._sweep is None or self._sweep.is_blind:
                return None
            self._since_search_s = 0.0
            self._job = RelocationJob(self._atlas.copy(), self._sweep, self._last.odom_T_base)
        elif self._wants_loop:
            self._wants_loop = False
            self._job = LoopJob(self._atlas.copy(), list(self._pending), self._config, self._prior)
        return self._job

    def finish(self, job: MapJob) -> None:
        """Take the outcome of a job into account."""
        if job is not self._job:  # the map was changed by hand meanwhile
            return
        self._job = None
        if isinstance(job, RelocationJob):
            self._take_place(job)
        else:
            self._take_loops(job)

    def _take_place(self, job: RelocationJob) -> None:
        """Go on from where a lost robot was found."""
        if job.found is None or self._trust.state != "lost" or self._last is None:
            return
        step = job.odom_T_base.inverse() @ self._last.odom_T_base
        self._tracker.reset(compose(job.found, step.as_array()), _FOUND_DEVS)
        self._trust.doubt(is_lost=False)
        self._local = None

    def _take_loops(self, job: LoopJob) -> None:
        """Take over closures, and the poses and the grid that follow from them."""
        self._pending = [
            closure
            for closure in [*self._pending, *job.found][-_PENDING:]
            if self._atlas.has(closure.edge)
            and all(closure.edge is not edge for edge in job.accepted)
        ]
        if job.occupancy is None:
            return
        for edge in filter(self._atlas.has, job.accepted):
            self._atlas.link(edge)
            self.num_loops += 1
        correction, later = self._atlas.move_to(job.atlas)
        self._tracker.pose = compose(correction, self._tracker.pose)
        self._occupancy = job.occupancy
        for one in later:
            self._occupancy.add(one, self._atlas.pose(one.number))
        self._closed_loop = True
        self._local = None
        self._version += 1

    # What people ask for.

    def grid(self) -> GridMap:
        """Return the map as it is now; cheap as long as `version` is the same."""
        if self._grid is None or self._grid[0] != self._version:
            self._grid = (self._version, self._occupancy.grid())
        return self._grid[1]

    @property
    def version(self) -> int:
        """A number that changes whenever `grid` would return something else."""
        return self._version

    def anchor(self, map_T_pose: Pose2D) -> Anchor:
        """Tie a pose to the nearest keyframe."""
        newest = self._atlas.newest.number if self._is_joined else None
        return self._anchors.tie(self._atlas, map_T_pose, newest)

    def moved(self, anchor: Anchor) -> Pose2D:
        """Return where an anchored pose lies on the map now: map_T_pose."""
        return self._anchors.place(self._atlas, anchor)

    def undo(self, seconds: float) -> Pose2D | None:
        """Forget what was mapped in the last seconds of robot time; tracking goes on.

        The first keyframe stays: it is where the map begins.

        Returns:
            map_T_base of the newest keyframe that is left; None when there is none.
        """
        if len(self._atlas) == 0 or self._last is None:
            return None
        since_ns = self._last.stamp_ns - round(seconds * 1e9)
        rows = [r for r, k in enumerate(self._atlas.keyframes) if r > 0 and k.stamp_ns >= since_ns]
        if rows:
            self._forget(rows)
        newest = self._atlas.newest
        return None if newest.is_prior else Pose2D.from_array(self._atlas.poses[-1])

    def _forget(self, rows: list[int]) -> None:
        """Take keyframes, given by their rows, off the map and draw it anew."""
        atlas = self._atlas
        for step in between(atlas.poses[rows[:-1]], atlas.poses[rows[1:]]):
            noise = self._tracker.noise(math.hypot(step[0], step[1]), abs(step[2]))
            self._way_covariance = self._way_covariance + noise
        numbers = [atlas.keyframes[row].number for row in rows]
        self._anchors.forget(atlas, numbers)
        atlas.remove(numbers)
        self._pending = [c for c in self._pending if atlas.has(c.edge)]
        self._is_joined = self._is_joined and not atlas.newest.is_prior
        resolution = self._config.resolution_m
        self._occupancy = draw_all(resolution, self._prior, atlas.keyframes, atlas.poses)
        self._job, self._local = None, None
        self._version += 1

    def pause(self) -> None:
        """Let the map be as it is; the pose is followed on it as long as the scans fit."""
        self._is_paused = True

    def resume(self, pose: Pose2D | None = None) -> None:
        """Go on mapping; with a pose where the robot was carried to, map_T_base."""
        self._is_paused = False
        if pose is not None:
            self._tracker.reset(pose.as_array(), _TOLD_DEVS)
            self._trust.doubt(is_lost=False)
            self._is_joined, self._local = False, None

    @property
    def is_paused(self) -> bool:
        """Whether the map is let be as it is."""
        return self._is_paused

    @property
    def num_keyframes(self) -> int:
        """Number of scans that the map is made of."""
        return len(self._atlas) - (self._atlas.prior is not None)

    @property
    def memory_bytes(self) -> int:
        """Bytes of keyframes, graph and grids, about."""
        return self._atlas.num_bytes + self._occupancy.num_bytes

    def snapshot(self) -> State:
        """Return a copy of all that is needed to go on after a restart; cheap: pack it aside."""
        atlas, anchors = self._atlas.copy(), self._anchors.copy()
        pose = Pose2D.from_array(self._tracker.pose)
        return State(atlas, anchors, self._prior, pose, self._next_number, self.num_loops)

    @classmethod
    def from_bytes(cls, config: MapperConfig, data: bytes) -> Self:
        """Make a mapper that goes on where `snapshot` was called.

        The robot is taken to stand where it stood then; the first scans check it.

        Raises:
            ValueError: the bytes are none of a mapper, or damaged.
        """
        state = unpack(data)
        mapper = cls(config, state.pose)
        mapper._prior, mapper._atlas, mapper._anchors = state.prior, state.atlas, state.anchors
        mapper._next_number, mapper.num_loops = state.next_number, state.num_loops
        mapper._occupancy = draw_all(
            config.resolution_m, state.prior, state.atlas.keyframes, state.atlas.poses
        )
        mapper._version = 1
        if len(state.atlas) > 0:
            mapper._tracker.reset(state.pose.as_array(), _TOLD_DEVS)
            mapper._trust.doubt(is_lost=False)
        return mapper
