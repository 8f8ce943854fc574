"""SLAM without wire, clock and files: scans and odometry in, poses and a map out.

With each scan: predict from odometry, match the scan, judge the match, add a keyframe. Where scans
contradict what was seen, or nothing was seen for long, a new part begins, which hangs loose. Aside:
close loops and optimise, or find out where a loose part belongs and join it.

Frames: `map` (fixed by the first keyframe, or by the map that is extended), `odom`, `base_link`.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Self

import numpy as np
from numpy.typing import NDArray

from trolley.config.mapper import MapperConfig
from trolley.geometry import Pose2D
from trolley.gridmap import GridMap
from trolley.scan_matching.layout import Cloud
from trolley.scan_matching.sweep import FRONT_END, Sweep, read_sweep
from trolley.scanning import Motion, Reject, ScanInput, motion_since, problem_of
from trolley.slices import whole
from trolley_mapper.slam import sentences
from trolley_mapper.slam.back_end import BackEnd, MapJob
from trolley_mapper.slam.edges import Travel, odometry_edge, scan_match_edges
from trolley_mapper.slam.estimate import Anchor, MapEstimate
from trolley_mapper.slam.finishing import FinishJob
from trolley_mapper.slam.join_watch import CutJob, JoinWatch, across
from trolley_mapper.slam.joining import JoinJob, Joint
from trolley_mapper.slam.keyframe import Keyframe
from trolley_mapper.slam.keyframe_map import KeyframeMap
from trolley_mapper.slam.local_map import LocalMap, Neighbourhood
from trolley_mapper.slam.loop_closure import LoopJob
from trolley_mapper.slam.map_check import contradictions
from trolley_mapper.slam.motion_model import motion_covariance
from trolley_mapper.slam.odometry_model import OdometryModel
from trolley_mapper.slam.pose_graph import Edge, between, compose, to_frame
from trolley_mapper.slam.scan_matcher import MatchQuality, ScanMatch, ScanMatcher
from trolley_mapper.slam.serialization import State, unpack
from trolley_mapper.slam.tracking_state import TrackingState


@dataclass(frozen=True, slots=True)
class MapperParams:
    """How uncertain poses from elsewhere are, and when mapping waits. Set by hand."""

    origin_devs: tuple[float, float] = (0.001, 0.001)
    """Standard deviations of the pose that a new map begins at [m, rad]."""
    jump_devs: tuple[float, float] = (0.3, 0.3)
    """Standard deviations after a jump of the odometry [m, rad]."""
    given_devs: tuple[float, float] = (0.2, 0.15)
    """Standard deviations of a start pose on an existing map [m, rad]."""
    slip_devs: tuple[float, float] = (0.3, 0.3)
    """Standard deviations of the odometry over a step in which the wheels slipped [m, rad]."""
    break_devs: tuple[float, float] = (0.5, 1.8)
    """Standard deviations of the odometry where scans contradict it: wheels that miss a turn tell
    the place about right, and nothing of the heading [m, rad]."""
    blind_devs: tuple[float, float] = (0.35, 0.2)
    """Standard deviations above which one scan cannot tell where the robot is after driving
    blindly: a new part begins [m, rad]."""
    blind_times: float = 3.0
    """Factor on the distance between keyframes while nothing is seen."""
    min_part: int = 3
    """Number of scans below which a loose part is forgotten when the next one begins."""
    slip_patience: float = 2.0
    """Factor on the distance between keyframes while wheels slip."""
    stood_s: float = 10.0
    """Time between two keyframes in which the robot may have been in a lift [s]."""


PARAMS = MapperParams()


class Mapper:
    """Makes a map from scans and odometry.

    Heavy work is handed out: after each call of `step` ask `take_job`, do the job's slices anywhere
    (it touches nothing of the mapper), and give it back to `finish` from the thread that calls
    `step`. Between slices a job that `wants` denies may be left.

    Args:
        config: settings.
        start: map_T_base at the first scan; None: the origin, or with a prior a search on it.
        prior: an existing map to extend.
    """

    def __init__(
        self, config: MapperConfig, start: Pose2D | None = None, prior: GridMap | None = None
    ) -> None:
        self.num_loops = 0
        self._config = config
        self._map = KeyframeMap(config, prior)
        self._matcher = ScanMatcher(config.max_range_m)
        self._odometry_model = OdometryModel()
        self._tracking = TrackingState()
        self._neighbourhood = Neighbourhood(config)
        self._back_end = BackEnd(config)
        self._latest: ScanInput | None = None
        self._is_new_run = False
        self._is_blind = False
        # Over the part that was joined last, or begun where the robot stood, as long as it is
        # doubted; and why one was cut off.
        self._watch: JoinWatch | None = None
        self._cut_message = ""
        # Since the newest keyframe; None where the odometry does not lead there.
        self._travel: Travel | None = None
        self._is_paused = False
        self._closed_loop = False
        self._matcher.reset((start or Pose2D.identity()).as_array(), PARAMS.origin_devs)
        if prior is not None:
            self._tracking = TrackingState.unproven() if start is not None else TrackingState.lost()
            self._matcher.reset(self._matcher.pose, PARAMS.given_devs)

    # One scan.

    def begin_epoch(self) -> None:
        """Take note that base started over: its time may begin earlier than that of before."""
        self._is_new_run = True

    def go_on_from(self, before: ScanInput) -> None:
        """Take note of the last scan before the snapshot: from it the odometry leads on."""
        if self._map.is_empty:
            return
        self._latest, self._tracking = before, TrackingState()
        if not self._map.store.newest.is_prior:
            step = between(self._map.store.poses[-1], self._matcher.pose)
            covariance = motion_covariance(math.hypot(step[0], step[1]), abs(step[2]))
            self._travel = Travel.begin(self._matcher.covariance.copy()).then(step, covariance)

    def step(self, scan: ScanInput) -> MapEstimate | Reject:
        """Take one scan and its odometry into account."""
        if self._is_new_run and self._latest is not None:
            earlier_ns = min(self._latest.stamp_ns, scan.stamp_ns - 1)
            self._latest = replace(self._latest, stamp_ns=earlier_ns)
        self._is_new_run = False
        reject = problem_of(scan, None if self._latest is None else self._latest.stamp_ns)
        if reject is not None:
            return reject
        motion = self._predict(scan)
        sweep = read_sweep(scan, self._config.max_range_m)
        self._latest = scan
        was_blind, self._is_blind = self._is_blind, sweep.is_blind
        if sweep.is_blind:
            return self._follow_blindly(scan, sweep)
        if self._map.is_empty:
            self._add_keyframe(scan, sweep)
            return self._estimate(scan, 1.0, "")
        if self._is_adrift or (was_blind and self._is_vague):
            self._begin_part(scan, sweep)
            return self._estimate(scan, 0.0, self._message())
        match = self._matcher.correct(self._local_map(), sweep, scan)
        self._judge(match.quality, motion)
        if self._tracking.breaks:
            self._begin_part(scan, sweep)
        elif self._may_grow(match.quality) and self._has_moved():
            self._add_keyframe(scan, match.sweep, match)
        return self._estimate(scan, match.quality.match, self._message())

    def _follow_blindly(self, scan: ScanInput, sweep: Sweep) -> MapEstimate:
        """Follow the odometry alone; keyframes that show nothing keep what it says of the path."""
        if not self._map.is_empty and self._is_connected and not self._is_paused:
            nothing = replace(sweep, cloud=Cloud(np.empty((0, 2)), np.empty((0, 2))))
            if self._moved_share() >= PARAMS.blind_times:
                self._add_keyframe(scan, nothing)
        if self._is_vague and not self._tracking.is_lost:
            self._tracking = TrackingState("unsure")
        return self._estimate(scan, 0.0, sentences.BLIND)

    @property
    def _is_vague(self) -> bool:
        """Whether odometry alone has led so far that one scan cannot tell where the robot is."""
        return bool(np.any(np.array(self._matcher.devs) > PARAMS.blind_devs))

    @property
    def _is_adrift(self) -> bool:
        """Whether the robot is in no part at all."""
        store = self._map.store
        return self._tracking.is_lost and not store.is_loose(store.newest.number)

    def _predict(self, scan: ScanInput) -> Motion:
        """Follow the odometry since the scan before."""
        if self._latest is None:
            return Motion(Pose2D.identity(), 0.0)
        motion = motion_since(self._latest, scan, FRONT_END)
        if motion.is_jump:
            self._matcher.loosen(PARAMS.jump_devs)
            self._doubt_odometry(_covariance(PARAMS.jump_devs))
        step = self._odometry_model.correct(motion.step)
        covariance = self._odometry_model.covariance(step)
        self._matcher.predict(step, covariance)
        if self._travel is not None:
            self._travel = self._travel.then(step.as_array(), covariance)
        return motion

    def _judge(self, quality: MatchQuality, motion: Motion) -> None:
        """Draw the consequences of a match for whether the pose is believed."""
        self._tracking = self._tracking.after(
            quality, motion.elapsed_s, _distance_m(motion.step), self._config.lost_after_s
        )
        if self._matcher.is_slipping:
            self._doubt_odometry(_covariance(PARAMS.slip_devs))

    def _may_grow(self, quality: MatchQuality) -> bool:
        """Say whether a scan may become part of the map."""
        fits = quality.is_good or (quality.is_new and self._is_connected)
        is_paused = self._is_paused and not self._tracking.is_lost
        return fits and self._tracking.name != "unsure" and not is_paused

    def _has_moved(self) -> bool:
        """Say whether the robot has moved enough since the newest keyframe."""
        if not self._is_connected or self._map.store.newest.is_blind:
            return True
        # While wheels slip, the motion during the scan is not known either: wait, if not for long.
        return self._moved_share() >= (PARAMS.slip_patience if self._matcher.is_slipping else 1.0)

    def _moved_share(self) -> float:
        """Return how far the robot is from the newest keyframe, 1: as far as the next one."""
        step = between(self._map.store.poses[-1], self._matcher.pose)
        return max(
            math.hypot(step[0], step[1]) / self._config.keyframe_distance_m,
            abs(step[2]) / self._config.keyframe_turn_rad,
        )

    def _message(self) -> str:
        """What is the matter, in one sentence; empty when all is well."""
        if self._cut_message and self._tracking.is_lost:
            return self._cut_message
        if self._tracking.message:
            return self._tracking.message
        return sentences.PAUSED if self._is_paused else self._matcher.slip.message

    def _estimate(self, scan: ScanInput, match: float, message: str) -> MapEstimate:
        """Say where the robot is."""
        pose = Pose2D.from_array(self._matcher.pose)
        closed, self._closed_loop = self._closed_loop, False
        return MapEstimate(
            stamp_ns=scan.stamp_ns,
            pose=pose,
            covariance=self._matcher.covariance.copy(),
            match=match,
            state=self._tracking.name,
            message=message,
            map_T_odom=pose @ scan.odom_T_base.inverse(),
            closed_loop=closed,
        )

    # The map grows.

    def _begin_part(self, scan: ScanInput, sweep: Sweep) -> None:
        """Begin a part of which only the odometry says how it lies to the map, if that."""
        joint = self._joint(scan)
        watch, self._watch = self._watch, None
        self._cut_message = watch.sentence if watch is not None and watch.is_other_floor else ""
        self._drop_small_part()
        self._tracking = TrackingState.lost()
        self._matcher.reset(joint.pose, PARAMS.origin_devs)
        self._travel = None
        self._add_keyframe(scan, sweep)
        self._back_end.part_began(joint)

    def _joint(self, scan: ScanInput) -> Joint:
        """Return what the odometry says of how a part that begins here lies to the map."""
        store, pose, number = self._map.store, self._matcher.pose.copy(), self._map.next_number
        covariance = edge = None
        if store.newest.is_blind and self._travel is not None:
            poses = (store.poses[-1], pose)
            ends = (store.newest.number, number)
            edge = odometry_edge(ends, poses, self._travel, np.zeros((3, 3)))
        breaks = self._tracking.breaks
        was_on_map = (breaks or not self._tracking.is_lost) and self._is_connected
        if was_on_map and not store.is_loose(store.newest.number):
            covariance = self._matcher.covariance.copy()
            covariance += _covariance(PARAMS.break_devs) if breaks else 0.0
        shown = next(one for one in reversed(store.keyframes) if not one.is_blind)
        unseen_s = 1e-9 * (scan.stamp_ns - shown.stamp_ns)
        return Joint(number, pose, covariance, edge, unseen_s)

    def _drop_small_part(self) -> None:
        """Forget the newest part if it hangs loose and shows next to nothing."""
        store = self._map.store
        if not store.is_loose(store.newest.number):
            return
        part = store.part_of(store.newest.number)
        if len(part) < PARAMS.min_part:
            self._map.drop(part)
            self._back_end.keyframes_removed(store)

    def _add_keyframe(self, scan: ScanInput, sweep: Sweep, match: ScanMatch | None = None) -> None:
        """Add a scan to the map, with edges to what it was matched with and driven from."""
        pose, number = self._matcher.pose, self._map.next_number
        edges = self._edges(number, match)
        if edges and self._watch is None and self._has_stood(scan):
            joint = Joint(number, pose.copy(), self._matcher.covariance.copy(), None)
            self._watch = JoinWatch(joint, edges, has_stood=True)
        spared = self._back_end.part_begins
        if self._watch is not None:
            spared.add(self._watch.joint.number)
        self._map.add(Keyframe.of(number, scan.stamp_ns, sweep), pose, edges, spared)
        self._odometry_model.restart()
        model = self._odometry_model
        self._map.store.scale = model.distance
        covariance = self._matcher.covariance.copy()
        self._travel = Travel.begin(covariance, model.distance, model.unlearnt)
        self._neighbourhood.invalidate()
        if len(sweep.cloud.points):
            self._back_end.keyframe_added()
            self._watch_join()

    def _has_stood(self, scan: ScanInput) -> bool:
        """Say whether the robot stood since the newest keyframe, perhaps in a lift."""
        return (scan.stamp_ns - self._map.store.newest.stamp_ns) * 1e-9 >= PARAMS.stood_s

    def _watch_join(self) -> None:
        """See whether the newest keyframe bears the last join out."""
        watch, store = self._watch, self._map.store
        if watch is not None:
            watch.see(store, self._config)
            if watch.is_refuted:
                self._back_end.cut(watch)
            if watch.is_refuted or watch.is_over:
                self._watch = None

    def _edges(self, number: int, match: ScanMatch | None) -> list[Edge]:
        """Return the edges of a new keyframe; its match teaches the odometry's scale, too."""
        store, pose, travel = self._map.store, self._matcher.pose, self._travel
        previous = None if travel is None else store.newest.number
        edges: list[Edge] = []
        matched = np.zeros((3, 3))
        if match is not None and match.quality.is_good:
            cloud = match.sweep.cloud
            edges, matched = scan_match_edges(number, self._local_map(), pose, cloud, previous)
            if previous is not None:
                moved = between(store.poses[-1], pose)
                self._odometry_model.learn(moved, to_frame(match.information, float(pose[2])))
        if previous is not None and travel is not None:
            poses = (store.poses[-1], pose)
            edges.append(odometry_edge((previous, number), poses, travel, matched))
        return edges

    def _doubt_odometry(self, covariance: NDArray[np.float64]) -> None:
        """Let the odometry since the newest keyframe be less sure."""
        if self._travel is not None:
            self._travel = self._travel.less_sure(covariance)

    @property
    def _is_connected(self) -> bool:
        """Whether odometry leads from the newest keyframe to the robot without a break."""
        return self._travel is not None

    def _local_map(self) -> LocalMap:
        """Return the surfaces near the robot."""
        store, pose = self._map.store, self._matcher.pose
        newest = store.newest.number if self._is_connected else None
        return self._neighbourhood.around(store, pose, newest)

    # Heavy work.

    def take_job(self) -> MapJob | None:
        """Return work to do now, or None. Give it back to `finish` when all its slices are done."""
        if self._latest is None:
            return None
        return self._back_end.next_job(self._map, self._matcher.pose)

    def wants(self, job: MapJob) -> bool:
        """Say whether a job that is out still counts; if not, leave the rest of it undone."""
        return self._back_end.wants(job)

    def finish(self, job: MapJob) -> None:
        """Take the outcome of a job into account."""
        if not self._back_end.finish(job, self._map.store) or job.occupancy is None:
            return
        part = self._map.store.part_of(self._map.store.newest.number)
        if isinstance(job, LoopJob):
            self._map.store.cut(job.cut)
        if isinstance(job, CutJob):
            self._map.store.cut(across(self._map.store, job.joint))
        loops = [edge for edge in job.accepted if self._map.store.has(edge)]
        correction = self._map.take_over(job.store, job.occupancy, loops)
        self._matcher.move(correction)
        self._neighbourhood.invalidate()
        self.num_loops += 0 if isinstance(job, CutJob) else len(loops)
        self._closed_loop = True
        if isinstance(job, CutJob):
            self._cut_message, self._tracking = job.sentence, TrackingState.lost()
        if isinstance(job, JoinJob):
            self._cut_message, self._tracking = "", TrackingState()
            self._watch = JoinWatch(job.joint, job.accepted)
        if isinstance(job, JoinJob) and self._is_paused:
            self._remove([self._map.store.rows[number] for number in part])
            self._travel = None

    # The end.

    def finishing(self) -> FinishJob:
        """Return the work of making the map ready to be saved; run it anywhere."""
        store = self._map.store.copy()
        made = self._map
        return FinishJob(store, self._config, made.prior, self.grid(), self.mirrors)

    def doubtful(self) -> list[tuple[float, float]]:
        """Return places x, y [m] where the map may be wrong, the worst first; takes long."""
        return whole(contradictions(self._map.store))

    def turn(self, job: FinishJob) -> Pose2D:
        """Turn the map and all that lies on it as `job` has, if it has.

        Returns:
            The motion of the robot's pose, new_map_T_old_map.
        """
        if job.occupancy is None:
            return Pose2D.identity()
        self._map.blank.mirrors = job.occupancy.mirrors
        correction = self._map.take_over(job.store, job.occupancy, [])
        self._matcher.move(correction)
        self._back_end.map_turned(correction)
        self._neighbourhood.invalidate()
        return Pose2D.from_array(correction)

    # What people ask for.

    def grid(self) -> GridMap:
        """Return the map as it is now; cheap as long as `version` is the same."""
        return self._map.grid()

    @property
    def version(self) -> int:
        """A number that changes whenever `grid` would return something else."""
        return self._map.version

    @property
    def mirrors(self) -> NDArray[np.float64]:
        """Where the mirrors that are known begin and end (n, 4) x, y, x, y [m]."""
        return self._map.blank.mirrors

    def set_mirrors(self, lines: Sequence[Sequence[tuple[float, float]]]) -> None:
        """Draw the map without what is seen through mirrors, given by their points [m]."""
        ends = [(*one, *other) for line in lines for one, other in pairwise(line)]
        self._map.set_mirrors(np.array(ends, np.float64).reshape(-1, 4))

    def anchor(self, map_T_pose: Pose2D) -> Anchor:
        """Tie a pose to the nearest keyframe."""
        newest = self._map.store.newest.number if self._is_connected else None
        return self._map.anchor(map_T_pose, newest)

    def moved(self, anchor: Anchor) -> Pose2D:
        """Return where an anchored pose lies on the map now: map_T_pose."""
        return self._map.moved(anchor)

    def undo(self, seconds: float) -> Pose2D | None:
        """Remove what was mapped in the last seconds of robot time; tracking goes on.

        The first keyframe stays: it is where the map begins. So does what was mapped before a new
        run of base, whose time began earlier.

        Returns:
            map_T_base of the newest keyframe that is left; None when there is none.
        """
        if self._map.is_empty or self._latest is None:
            return None
        rows = self._map.newest_rows(round(seconds * 1e9), self._latest.stamp_ns)
        if rows:
            self._remove(rows)
        store = self._map.store
        return None if store.newest.is_prior else Pose2D.from_array(store.poses[-1])

    def _remove(self, rows: list[int]) -> None:
        """Remove keyframes, given by their rows."""
        poses = self._map.store.poses
        for step in between(poses[rows[:-1]], poses[rows[1:]]):
            self._doubt_odometry(motion_covariance(math.hypot(step[0], step[1]), abs(step[2])))
        self._map.remove(rows)
        if self._map.store.newest.is_prior:
            self._travel = None
        if self._travel is not None:
            here = between(self._map.store.poses[-1], self._matcher.pose)
            self._travel = replace(self._travel, step=here, unlearnt=0.0)
        self._back_end.keyframes_removed(self._map.store)
        self._neighbourhood.invalidate()

    @property
    def is_loose(self) -> bool:
        """Whether the robot is in a part of which it is not known how it lies to the map."""
        store = self._map.store
        return not self._map.is_empty and store.is_loose(store.newest.number)

    @property
    def num_loose(self) -> int:
        """Number of scans in such parts."""
        return int(np.count_nonzero(self._map.store.loose))

    def join(self, map_T_base: Pose2D) -> None:
        """Join the part that the robot is in: a person says where the robot is, roughly.

        It is cut off again where later scans show that this was wrong.
        """
        newest = between(self._matcher.pose, self._map.store.poses[-1])
        self._back_end.join_as_said(compose(map_T_base.as_array(), newest))

    def drop_loose(self) -> None:
        """Forget all parts that hang loose; what is seen from now on begins another one."""
        was_loose = self.is_loose
        self._map.drop_loose()
        self._back_end.keyframes_removed(self._map.store)
        self._neighbourhood.invalidate()
        if was_loose:
            self._travel = None

    def pause(self) -> None:
        """Stop the map from growing; the pose is tracked on it as long as the scans fit."""
        self._is_paused = True

    def resume(self) -> None:
        """Let the map grow again."""
        self._is_paused = False

    @property
    def is_paused(self) -> bool:
        """Whether the map does not grow."""
        return self._is_paused

    @property
    def num_keyframes(self) -> int:
        """Number of scans that the map is made of."""
        return self._map.num_keyframes

    @property
    def memory_bytes(self) -> int:
        """Bytes of keyframes, graph and grids, about."""
        return self._map.num_bytes

    def snapshot(self) -> State:
        """Return a copy of all that is needed to go on after a restart; cheap: pack it aside."""
        return self._map.snapshot(Pose2D.from_array(self._matcher.pose), self.num_loops)

    @classmethod
    def from_bytes(cls, config: MapperConfig, data: bytes) -> Self:
        """Make a mapper that goes on where `snapshot` was called.

        The robot is taken to stand where it stood then; the first scans check it.

        Raises:
            ValueError: the bytes are none of a mapper, or damaged.
        """
        state = unpack(data)
        mapper = cls(config, state.pose)
        mapper._map, mapper.num_loops = KeyframeMap.restore(config, state), state.num_loops
        # Nobody knows any more how loose parts lie.
        mapper._map.drop_loose()
        if not mapper._map.is_empty:
            mapper._matcher.reset(state.pose.as_array(), PARAMS.given_devs)
            mapper._tracking = TrackingState.unproven()
        return mapper


def _covariance(devs: tuple[float, float]) -> NDArray[np.float64]:
    """Return a covariance (3, 3) with these standard deviations [m, rad]."""
    return np.diag(np.square([devs[0], devs[0], devs[1]]))


def _distance_m(step: Pose2D) -> float:
    return math.hypot(step.x, step.y)
