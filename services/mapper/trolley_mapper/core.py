"""The mapper without wire, clock and files: scans and odometry in, poses and a map out.

Frames: `map` (fixed by the first keyframe), `odom`, `base_link`.
"""

import math
from typing import Self

import numpy as np
from numpy.typing import NDArray

from trolley.config.mapper import MapperConfig
from trolley.geometry import Pose2D
from trolley.gridmap import GridMap
from trolley_mapper.atlas import Atlas
from trolley_mapper.estimate import Anchor, MapEstimate, Reject, State
from trolley_mapper.graph import NEAR, NEXT, Edge, between, compose, to_frame
from trolley_mapper.keyframe import Keyframe
from trolley_mapper.local_map import LocalMap
from trolley_mapper.loops import Closure, LoopJob
from trolley_mapper.occupancy import Occupancy
from trolley_mapper.relocation import RelocationJob
from trolley_mapper.scan import ScanInput, Sweep, read_sweep
from trolley_mapper.tracking import Fit, Tracker

# A wheeled indoor robot is slower; a longer step is a reset or a fault of the odometry [m/s, m].
_FASTEST_MPS = 4.0
_LONGEST_JUMP_M = 0.5
# Where the odometry is not to be believed, the robot may be so far off [m, rad].
_JUMP_DEV_M = 0.3
_JUMP_DEV_RAD = 0.3
# A keyframe is tied to as many others as contributed at least such a share of the matched points.
_TIES = 3
_TIE_SHARE = 0.12
_SEARCH_AGAIN_S = 2.0
# A pause of the lidar is no proof against the pose: it counts as a bad match of at most [s].
_LONGEST_STEP_S = 0.3
# A place that was found anew is believed after so long a way without a bad match [m].
_PROOF_M = 0.4
_PENDING = 12

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
        self._start = (start or Pose2D.identity()).as_array()
        self._atlas = Atlas()
        self._tracker = Tracker(config)
        self._occupancy = Occupancy(config.resolution_m, prior)
        self._local: LocalMap | None = None
        self._local_pose = np.full(3, np.inf)
        self._last: ScanInput | None = None
        self._sweep: Sweep | None = None
        self._chain = False
        self._since_keyframe = np.zeros((3, 3))
        self._state: State = "mapping"
        self._bad_s = 0.0
        self._proof_m = math.inf
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

    # One scan.

    def step(self, scan: ScanInput) -> MapEstimate | Reject:
        """Take one scan and its odometry into account."""
        reject = self._problem(scan)
        if reject is not None:
            return reject
        elapsed_s = self._predict(scan)
        sweep = read_sweep(scan, self._config.max_range_m)
        self._last, self._sweep = scan, sweep
        self._since_search_s += elapsed_s
        if sweep.is_blind:
            return self._estimate(scan, 0.0, "the lidar sees too little")
        if len(self._atlas) == 0:
            self._begin(scan, sweep)
            return self._estimate(scan, 1.0, "")
        fit = self._tracker.look(self._local_map(), sweep)
        self._fit_dbg = fit.verdict
        self._judge(fit, elapsed_s)
        if self._may_grow(fit) and self._has_moved():
            self._add_keyframe(scan, sweep, fit)
        return self._estimate(scan, fit.verdict.match, self._words())

    def _problem(self, scan: ScanInput) -> Reject | None:
        """Say why a scan cannot be used."""
        if self._last is not None and scan.stamp_ns <= self._last.stamp_ns:
            return Reject.OLD_STAMP
        if not (scan.odom_T_base.is_finite() and scan.odom_T_base_end.is_finite()):
            return Reject.BAD_ODOMETRY
        numbers = (scan.angle_min, scan.angle_increment, scan.range_min, scan.range_max)
        if not (all(math.isfinite(n) for n in numbers) and scan.base_T_laser.is_finite()):
            return Reject.BAD_GEOMETRY
        return None

    def _predict(self, scan: ScanInput) -> float:
        """Follow the odometry since the scan before; return the time since then [s]."""
        if self._last is None:
            return 0.0
        elapsed_s = (scan.stamp_ns - self._last.stamp_ns) * 1e-9
        step = self._last.odom_T_base.inverse() @ scan.odom_T_base
        way = math.hypot(step.x, step.y)
        if way > _LONGEST_JUMP_M + _FASTEST_MPS * elapsed_s:
            jump = np.diag([_JUMP_DEV_M**2, _JUMP_DEV_M**2, _JUMP_DEV_RAD**2])
            self._tracker.covariance = self._tracker.covariance + jump
            self._since_keyframe = self._since_keyframe + jump
            return elapsed_s
        self._tracker.predict(step)
        self._since_keyframe = self._since_keyframe + self._tracker.noise(way, abs(step.yaw))
        self._proof_m += way
        return elapsed_s

    def _judge(self, fit: Fit, elapsed_s: float) -> None:
        """Draw the consequences of a good or a bad match."""
        if fit.verdict.is_good or (fit.verdict.is_new and self._state == "mapping"):
            self._bad_s = 0.0
            if self._state == "lost":
                self._proof_m = 0.0
            is_proven = self._proof_m >= _PROOF_M
            self._state = "mapping" if is_proven else "unsure"
            return
        self._bad_s += min(elapsed_s, _LONGEST_STEP_S)
        if self._state == "lost":
            return
        self._state = "unsure"
        # What was found anew and fails at once was the wrong place.
        if self._bad_s > self._config.lost_after_s or self._proof_m < _PROOF_M:
            self._state = "lost"
            self._chain = False

    def _may_grow(self, fit: Fit) -> bool:
        """Say whether a scan may become part of the map."""
        fits = fit.verdict.is_good or (fit.verdict.is_new and self._chain)
        return fits and self._state == "mapping" and not self._is_paused

    def _words(self) -> str:
        """Say in one sentence what is the matter."""
        if self._state == "lost":
            return "the scan does not fit the map made so far: lost, the map does not grow"
        if self._state == "unsure":
            return "checking the pose before the map grows on"
        return "paused: the map does not grow" if self._is_paused else ""

    def _estimate(self, scan: ScanInput, match: float, message: str) -> MapEstimate:
        """Say where the robot is."""
        pose = Pose2D.from_array(self._tracker.pose)
        closed, self._closed_loop = self._closed_loop, False
        return MapEstimate(
            stamp_ns=scan.stamp_ns,
            pose=pose,
            covariance=self._tracker.covariance.copy(),
            match=match,
            state=self._state,
            message=message,
            map_T_odom=pose @ scan.odom_T_base.inverse(),
            closed_loop=closed,
        )

    # The map grows.

    def _begin(self, scan: ScanInput, sweep: Sweep) -> None:
        """Make the first scan the first keyframe."""
        self._tracker.reset(self._start, 0.001, 0.001)
        self._insert(Keyframe.of(self._next_number, scan.stamp_ns, sweep), self._tracker.pose, [])

    def _insert(self, keyframe: Keyframe, pose: NDArray[np.float64], edges: list[Edge]) -> None:
        """Put a keyframe into the graph and the grid."""
        self._next_number += 1
        self._atlas.add(keyframe, pose, edges)
        self._occupancy.add(keyframe, pose)
        self._local = None
        self._chain = True
        self._since_keyframe = np.zeros((3, 3))
        self._wants_loop = True
        self._version += 1

    def _has_moved(self) -> bool:
        """Say whether the robot has moved enough since the newest keyframe."""
        if not self._chain:
            return True
        step = between(self._atlas.poses[-1], self._tracker.pose)
        return bool(
            math.hypot(step[0], step[1]) >= self._config.keyframe_distance_m
            or abs(step[2]) >= self._config.keyframe_turn_rad
        )

    def _add_keyframe(self, scan: ScanInput, sweep: Sweep, fit: Fit) -> None:
        """Make a scan a keyframe, tied to those that it was matched with."""
        keyframe = Keyframe.of(self._next_number, scan.stamp_ns, sweep)
        ties = self._ties(keyframe.number, sweep, fit.pose) if fit.verdict.is_good else []
        if not ties and self._chain:
            nothing = np.zeros((3, 3))
            ties = [self._next_edge(keyframe.number, fit.pose, nothing)]
        self._insert(keyframe, fit.pose, ties)

    def _ties(self, number: int, sweep: Sweep, pose: NDArray[np.float64]) -> list[Edge]:
        """Return edges from the keyframes near by, by what each has contributed."""
        local = self._local_map()
        hessians, counts = local.shares(pose, sweep.cloud)
        newest = self._atlas.newest.number
        own = np.zeros((3, 3))
        edges: list[Edge] = []
        for row, one in enumerate(local.keyframes):
            if self._chain and one.number == newest:
                own = hessians[row]
        for row in np.argsort(-counts)[:_TIES]:
            one = local.keyframes[row].number
            if counts[row] < _TIE_SHARE * len(sweep.cloud.points):
                break
            if not self._chain or one != newest:
                step = between(local.poses[row], pose)
                edges.append(
                    Edge(one, number, step, to_frame(hessians[row], float(pose[2])), NEAR)
                )
        if self._chain:
            # Without other ties all that was matched counts for this one.
            whole = own if edges else hessians.sum(axis=0)
            edges.append(self._next_edge(number, pose, whole))
        return edges

    def _next_edge(
        self, number: int, pose: NDArray[np.float64], matched: NDArray[np.float64]
    ) -> Edge:
        """Tie a keyframe to the one before, by odometry and what was matched, (3, 3) in `map`."""
        information = np.linalg.inv(self._since_keyframe + 1e-6 * np.eye(3)) + matched
        step = between(self._atlas.poses[-1], pose)
        newest = self._atlas.newest.number
        return Edge(newest, number, step, to_frame(information, float(pose[2])), NEXT)

    def _local_map(self) -> LocalMap:
        """Return the surfaces near the robot, put together anew when it has moved on."""
        pose = self._tracker.pose
        away = between(self._local_pose, pose) if self._local is not None else np.zeros(3)
        moved = math.hypot(away[0], away[1]) > 2.0 * self._config.keyframe_distance_m
        if self._local is None or moved:
            numbers = self._near_numbers()
            keyframes = [self._atlas.keyframes[self._atlas.rows[n]] for n in numbers]
            poses = np.array([self._atlas.pose(n) for n in numbers])
            self._local = LocalMap(keyframes, poses, pose[:2], self._config.local_reach_m)
            self._local_pose = pose.copy()
        return self._local

    def _near_numbers(self) -> list[int]:
        """Choose the keyframes to compare scans with."""
        newest = self._anchor_number()
        ways = self._atlas.ways_from(newest, self._config.local_way_m)
        recent = [newest]
        return self._atlas.choose_near(
            ways, self._tracker.pose, self._config.local_keyframes, recent
        )

    def _anchor_number(self) -> int:
        """Return the keyframe that the pose hangs on."""
        if self._chain:
            return self._atlas.newest.number
        away = np.hypot(*(self._atlas.poses[:, :2] - self._tracker.pose[:2]).T)
        return self._atlas.keyframes[int(np.argmin(away))].number

    # Heavy work.

    def take_job(self) -> MapJob | None:
        """Return work to do now, or None. Give it back to `finish` when it is done."""
        if self._job is not None or len(self._atlas) == 0 or self._last is None:
            return None
        if self._state == "lost":
            if self._since_search_s < _SEARCH_AGAIN_S or self._sweep is None:
                return None
            if self._sweep.is_blind:
                return None
            self._since_search_s = 0.0
            self._job = RelocationJob(self._atlas.copy(), self._sweep, self._last.odom_T_base)
        elif self._wants_loop:
            self._wants_loop = False
            self._job = LoopJob(
                self._atlas.copy(),
                self._atlas.newest.number,
                list(self._pending),
                self._config,
                [self._atlas.keyframes[0].number],
                Occupancy(self._config.resolution_m, self._prior),
            )
        return self._job

    def finish(self, job: MapJob) -> None:
        """Take the outcome of a job into account."""
        if job is not self._job:
            return
        self._job = None
        if isinstance(job, RelocationJob):
            self._take_place(job)
        else:
            self._take_loops(job)

    def _take_place(self, job: RelocationJob) -> None:
        """Go on from where a lost robot was found."""
        if job.found is None or self._state != "lost" or self._last is None:
            return
        step = job.odom_T_base.inverse() @ self._last.odom_T_base
        self._tracker.reset(compose(job.found, step.as_array()), 0.1, 0.05)
        self._state = "unsure"
        self._bad_s, self._proof_m = 0.0, 0.0
        self._chain = False
        self._local = None

    def _take_loops(self, job: LoopJob) -> None:
        """Take over closures, and the poses and the grid that follow from them."""
        self._pending = [*self._pending, *job.found][-_PENDING:]
        known = self._atlas.rows
        self._pending = [
            c
            for c in self._pending
            if c.edge.first in known
            and c.edge.second in known
            and all(c.edge is not edge for edge in job.accepted)
        ]
        if job.occupancy is None:
            return
        self._move_all(job)
        for edge in job.accepted:
            if edge.first in known and edge.second in known:
                self._atlas.link(edge)
        self.num_loops += len(job.accepted)
        self._closed_loop = True
        self._local = None
        self._version += 1

    def _move_all(self, job: LoopJob) -> None:
        """Take over optimised poses; what was added since moves with the newest of those."""
        old_newest = self._atlas.pose(job.query) if job.query in self._atlas.rows else None
        if old_newest is None or job.occupancy is None:
            return
        new_newest = job.atlas.pose(job.query)
        correction = compose(new_newest, between(old_newest, np.zeros(3)))
        later = [one for one in self._atlas.keyframes if one.number not in job.atlas.rows]
        moved = {one.number: compose(correction, self._atlas.pose(one.number)) for one in later}
        for row, one in enumerate(self._atlas.keyframes):
            is_later = one.number in moved
            self._atlas.poses[row] = moved[one.number] if is_later else job.atlas.pose(one.number)
        self._tracker.pose = compose(correction, self._tracker.pose)
        self._occupancy = job.occupancy
        for one in later:
            self._occupancy.add(one, moved[one.number])

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
        if len(self._atlas) == 0:
            return Anchor(-1, map_T_pose)
        pose = map_T_pose.as_array()
        away = np.hypot(*(self._atlas.poses[:, :2] - pose[:2]).T)
        # Of several as near the newest: where loops are open still, it is the robot's own.
        row = len(away) - 1 - int(np.argmin(away[::-1]))
        if self._chain and away[-1] < 1.5 * self._config.keyframe_distance_m:
            row = len(away) - 1
        step = between(self._atlas.poses[row], pose)
        return Anchor(self._atlas.keyframes[row].number, Pose2D.from_array(step))

    def moved(self, anchor: Anchor) -> Pose2D:
        """Return where an anchored pose lies on the map now: map_T_pose."""
        if anchor.keyframe not in self._atlas.rows:
            return anchor.keyframe_T_pose
        return Pose2D.from_array(self._atlas.pose(anchor.keyframe)) @ anchor.keyframe_T_pose

    def undo(self, seconds: float) -> Pose2D | None:
        """Forget what was mapped in the last seconds of robot time; tracking goes on.

        Returns:
            map_T_base of the newest keyframe that is left; None when there is none.
        """
        return None

    def pause(self) -> None:
        """Let the map be as it is; the pose is followed on it as long as the scans fit."""
        self._is_paused = True

    def resume(self, pose: Pose2D | None = None) -> None:
        """Go on mapping; with a pose where the robot was carried to, map_T_base."""
        self._is_paused = False
        if pose is not None:
            self._tracker.reset(pose.as_array(), 0.3, 0.2)
            self._state, self._chain, self._local = "unsure", False, None

    @property
    def is_paused(self) -> bool:
        """Whether the map is let be as it is."""
        return self._is_paused

    @property
    def num_keyframes(self) -> int:
        """Number of scans that the map is made of."""
        return len(self._atlas)

    @property
    def memory_bytes(self) -> int:
        """Bytes of keyframes, graph and grids, about."""
        kept = sum(one.num_bytes for one in self._atlas.keyframes)
        return kept + 250 * len(self._atlas.edges) + self._occupancy.num_bytes

    def to_bytes(self) -> bytes:
        """Return all that is needed to go on after a restart, compactly."""
        return b""

    @classmethod
    def from_bytes(cls, config: MapperConfig, data: bytes) -> Self:
        """Make a mapper that goes on where `to_bytes` was called.

        The robot is taken to stand where it stood then; the first scan checks it.

        Raises:
            ValueError: the bytes are none of a mapper, or damaged.
        """
        return cls(config)
