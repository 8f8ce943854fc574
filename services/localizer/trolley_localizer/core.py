"""The localizer without wire, clock and files: scans and odometry in, estimates out.

Frames: `map` (the user's), `grid` (columns and rows of the map, in cells), `odom`, `base_link`.
"""

import math
from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from trolley.config.localizer import LocalizerConfig
from trolley.geometry import Pose2D
from trolley.gridmap import GridMap
from trolley.scanning.front_end import Reject, ScanInput, motion_since, problem_of
from trolley_localizer.changes.change_detector import Change, ChangeDetector
from trolley_localizer.changes.mirror_detector import MirrorDetector
from trolley_localizer.estimate import CandidatePose, Estimate
from trolley_localizer.filter.pose_estimator import PoseEstimator
from trolley_localizer.matching.global_search import Place, SearchJob, SearchMap, is_near
from trolley_localizer.matching.hypotheses import Hypotheses, Hypothesis, Rivals
from trolley_localizer.matching.likelihood_field import build_field, make_lines, sane_covariance
from trolley_localizer.matching.map_matcher import (
    FRONT_END,
    BeamSet,
    MapMatcher,
    MatchScore,
    read_beams,
)
from trolley_localizer.tracking_state import Evidence, State, TrackingMonitor

# How far off a pose set by hand may be: standard deviations [m, rad].
SET_DEV_M = 0.4
SET_DEV_RAD = 0.25
# How far off a place found by a search may be.
FOUND_DEV_M = 0.1
FOUND_DEV_RAD = 0.05
# A place this much better supported, near by, replaces the estimate.
NEAR_LEAD = 0.05
# An estimate that was proven, and that no beam contradicts, is preferred by this much: odometry
# seldom loses it, while furniture that was moved can well make another place fit better. So many
# beams that end nowhere behind walls take all of it away.
LOYALTY = 0.15
LOYALTY_ASTRAY = 0.05
# A pose that was told, and that the map does not explain well, is believed only when the robot has
# driven so far with it; a turn by 1 rad counts as much as a way of `_TURN_M`.
_TRIED_M = 0.5
_TURN_M = 0.3

PoseProblem = Literal["outside_map", "in_obstacle"]


class Localizer:
    """Follows the robot on one map, notices when it is lost, and finds it again.

    A search of the whole map takes long, so it is handed out: after each call ask `take_job`, run
    the job anywhere (it touches nothing of the localizer), and give it back to `finish`.
    """

    def __init__(
        self,
        grid: GridMap,
        mirrors: Sequence[NDArray[np.float64]],
        config: LocalizerConfig,
        seed: int,
    ) -> None:
        self._config = config
        self.field = build_field(grid, config)
        self._map = SearchMap(self.field)
        self._matcher = MapMatcher(self.field, make_lines(self.field, mirrors), config)
        self._estimator = PoseEstimator(self.field, self._matcher, config, seed)
        self._hypotheses = Hypotheses(self.field, self._matcher, config)
        self._rivals = Rivals(self.field, self._matcher, config)
        self._monitor = TrackingMonitor(config)
        self._mirrors = MirrorDetector(self.field)
        self.changes = ChangeDetector(self.field, config) if config.propose_changes else None
        self._is_searching = True
        self._is_proven = False
        self._tried_m = 0.0
        self._wants_job = True
        self._job_runs = False
        self._searched = False
        self._since_search_s = math.inf
        self._last: ScanInput | None = None
        self._beams: BeamSet | None = None
        self._map_T_odom: Pose2D | None = None

    # What people and the shell ask for.

    def set_mirrors(self, polylines: Sequence[NDArray[np.float64]]) -> None:
        """Replace the mirrors and panes: (n, 2) points [m] in the map frame each."""
        self._matcher.mirrors = make_lines(self.field, polylines)
        self._mirrors.forget()
        self._matcher.suspects = self._mirrors.lines()

    def suspects(self) -> list[tuple[NDArray[np.float64], float]]:
        """Return lines (2, 2) [m] in `map` that look like mirrors, and how sure it is (0 to 1)."""
        return [
            (self.field.to_map_points(np.array([one.start, one.end])), one.score)
            for one in self._mirrors.suspects
        ]

    def find_changes(self) -> list[Change]:
        """Return what seems to have come or gone since the map was made, the surest first."""
        if self.changes is None:
            return []
        self.changes.propose((self._matcher.mirrors, self._matcher.suspects))
        return self.changes.proposed

    def pose_problem(self, map_T_base: Pose2D) -> PoseProblem | None:
        """Say why the robot cannot be at a pose, or None."""
        pose = self.field.to_cells(map_T_base)
        if not (0.0 <= pose[0] < self.field.grid.cols and 0.0 <= pose[1] < self.field.grid.rows):
            return "outside_map"
        return None if self._matcher.may_stand(pose) else "in_obstacle"

    def set_pose(self, map_T_base: Pose2D, covariance: NDArray[np.float64] | None = None) -> None:
        """Take a pose as a hypothesis: it is followed, and believed once the scans agree.

        Args:
            map_T_base: on the map and not in a wall, see `pose_problem`.
            covariance: (3, 3) over x, y [m], yaw [rad] in the map frame; None for a hand's aim.
        """
        if covariance is None:
            covariance = np.diag([SET_DEV_M**2, SET_DEV_M**2, SET_DEV_RAD**2])
        sane = sane_covariance(covariance)
        self._follow(self.field.to_cells(map_T_base), self.field.covariance_to_cells(sane))
        self._wants_job = True

    @property
    def covariance(self) -> NDArray[np.float64]:
        """Covariance (3, 3) of the followed pose over x, y [m], yaw [rad] in the map frame."""
        return self.field.covariance_to_map(self._estimator.covariance)

    def search(self) -> None:
        """Forget where the robot is and search the whole map with the next scan."""
        self._is_searching = True
        self._wants_job = True
        self._searched = False
        self._hypotheses.start([])
        self._rivals.start([], 0.0)

    def restart_odometry(self) -> None:
        """Take the next odometry as the beginning of a new run: no step leads to it."""
        self._last = None
        self._estimator.forget_motion()

    def take_job(self) -> SearchJob | None:
        """Return a search to run now, or None. Give it back to `finish` when it is done."""
        if not self._wants_job or self._job_runs or self._last is None or self._beams is None:
            return None
        if self._beams.is_blind:
            return None
        self._wants_job = False
        self._job_runs = True
        self._since_search_s = 0.0
        followed = None if self._is_searching else self._estimator.pose.copy()
        return SearchJob(self._map, self._matcher, self._beams, self._last.odom_T_base, followed)

    def finish(self, job: SearchJob) -> None:
        """Take the outcome of a search into account."""
        self._job_runs = False
        if self._last is None:
            self._wants_job = True
            return
        step = job.odom_T_base.inverse() @ self._last.odom_T_base
        places = [Place(self._carried(place.pose, step), place.support) for place in job.places]
        if self._is_searching:
            self._searched = True
            self._hypotheses.start(places)
        elif job.followed is not None and job.support is not None:
            self._compare(places, self._carried(job.followed, step), job.support)

    def particles(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return the hypotheses (n, 3) x, y [m], yaw [rad] in the map frame, and weights (n,)."""
        if not self._is_searching:
            return self._estimator.particles()
        items = self._hypotheses.items
        poses = np.array([self.field.to_map(item.pose).as_array() for item in items], np.float32)
        total = sum(item.latest for item in items)
        weights = [item.latest / total if total > 0.0 else 1.0 / len(items) for item in items]
        return poses.reshape(-1, 3), np.array(weights, np.float32)

    # One scan.

    def step(self, scan: ScanInput) -> Estimate | Reject:
        """Take one scan and its odometry into account."""
        reject = problem_of(scan, None if self._last is None else self._last.stamp_ns)
        if reject is not None:
            return reject
        motion = motion_since(self._last, scan, FRONT_END)
        step, elapsed_s = motion.step, motion.elapsed_s
        beams = read_beams(scan, self.field.resolution, self._config.max_range_m)
        self._last, self._beams = scan, beams
        self._since_search_s += elapsed_s
        self._estimator.predict(step)
        self._hypotheses.move(step)
        self._rivals.move(step)
        self._tried_m += math.hypot(step.x, step.y) + _TURN_M * abs(step.yaw)
        if self._is_searching and not beams.is_blind:
            self._search_step(beams)
        if self._is_searching:
            return self._searching_estimate(scan, beams, "searching")
        return self._follow_step(scan, beams, elapsed_s)

    def _follow_step(self, scan: ScanInput, beams: BeamSet, elapsed_s: float) -> Estimate:
        """Align the estimate with a scan and judge it."""
        if not beams.is_blind:
            self._estimator.look(beams, is_trusted=self._monitor.state == "localized")
        support, classes = self._matcher.classify(self._estimator.pose, beams)
        if self._rivals.exist and not beams.is_blind:
            self._weigh_rivals(beams, support)
        evidence = Evidence(support.value, self._estimator.spread_m, beams.is_blind)
        state = self._monitor.look(evidence, elapsed_s)
        if state == "lost":
            self.search()
            return self._searching_estimate(scan, beams, "lost")
        if self._monitor.doubts and self._since_search_s > self._config.search_again_s:
            self._wants_job = not self._rivals.exist or self._rivals.is_stale
        if state == "localized" and not beams.is_blind:
            self._suspect(beams, classes)
            if self.changes is not None:
                pose = self._estimator.pose
                self.changes.look(scan.stamp_ns, pose, self.covariance, beams, classes)
        map_T_base = self.field.to_map(self._estimator.pose)
        self._map_T_odom = map_T_base @ scan.odom_T_base.inverse()
        return Estimate(
            stamp_ns=scan.stamp_ns,
            map_T_base=map_T_base,
            map_T_odom=self._map_T_odom,
            covariance=self.covariance,
            state=state,
            match=support.match,
            spread=self._estimator.spread_m,
            beam_classes=classes,
            message=self._doubt(state, beams),
        )

    def _suspect(self, beams: BeamSet, classes: NDArray[np.uint8]) -> None:
        """Look for mirrors that are not on the map, from a pose that is believed."""
        if self._mirrors.look(self._estimator.pose, beams, classes, self._matcher.mirrors):
            self._matcher.suspects = self._mirrors.lines()

    def _doubt(self, state: State, beams: BeamSet) -> str:
        """Say in one sentence why the state is not `localized`."""
        if beams.is_blind:
            return "the lidar sees too little to check the pose"
        if state == "localized":
            return ""
        if self._estimator.spread_m > self._config.max_spread_m:
            return "the hypotheses lie far apart"
        if self._monitor.support < self._config.good_support:
            return "the scan does not fit the map well here"
        return "checking the pose against the scan"

    def _search_step(self, beams: BeamSet) -> None:
        """Follow the places of the last search and settle on one if it stands out."""
        self._hypotheses.look(beams)
        winner = self._hypotheses.winner()
        if winner is not None:
            self._take(winner)
        elif self._searched and self._since_search_s > self._config.search_again_s:
            # What stands out by now may not be among the places found from where it began.
            self._wants_job = not self._hypotheses.is_plausible or self._hypotheses.is_stale

    def _searching_estimate(self, scan: ScanInput, beams: BeamSet, state: State) -> Estimate:
        """Say that the pose is not known; the last correction of the odometry is held."""
        items = self._hypotheses.items
        held = self._map_T_odom
        return Estimate(
            stamp_ns=scan.stamp_ns,
            map_T_base=None if held is None else held @ scan.odom_T_base,
            map_T_odom=held,
            covariance=None if held is None else self._wide_covariance(items),
            state=state,
            match=items[0].match if items else 0.0,
            spread=self._spread(items),
            beam_classes=beams.classes,
            candidates=[CandidatePose(self.field.to_map(i.pose), i.match) for i in items],
            wants_turn=self._searched and not beams.is_blind,
            message=self._search_message(state, beams),
        )

    def _search_message(self, state: State, beams: BeamSet) -> str:
        """Say in one sentence how the search stands."""
        if state == "lost":
            return "the scan does not fit the map here: lost"
        if beams.is_blind:
            return "the lidar sees too little to find the robot"
        if not self._searched:
            return "searching the whole map"
        if len(self._hypotheses.items) > 1:
            return "several places look alike: a turn in place would help"
        return "no place on the map fits the scan"

    def _spread(self, items: Sequence[Hypothesis]) -> float:
        """Return the root mean square distance of places from their mean [m]."""
        if len(items) < 2:
            return 0.0
        points = np.stack([item.pose[:2] for item in items]) * self.field.resolution
        return math.sqrt(float(points.var(axis=0).sum()))

    def _wide_covariance(self, items: Sequence[Hypothesis]) -> NDArray[np.float64]:
        """Return a covariance that says "anywhere among the places, or on the map"."""
        spread = self._spread(items) if len(items) > 1 else 0.25 * max(self.field.grid.size_m)
        return np.diag([spread**2 + 1.0, spread**2 + 1.0, math.pi**2 / 3.0])

    # Changing one's mind.

    def _follow(self, pose: NDArray[np.float64], covariance: NDArray[np.float64]) -> None:
        """Begin to follow a pose in cells."""
        self._is_searching = False
        self._wants_job = False
        self._is_proven = False
        self._tried_m = 0.0
        self._estimator.reset(pose, covariance)
        self._hypotheses.start([])
        self._rivals.start([], 0.0)
        self._monitor.restart()

    def _carried(self, pose: NDArray[np.float64], step: Pose2D) -> NDArray[np.float64]:
        """Return a pose in cells after an odometry step in metres."""
        return self.field.to_cells(self.field.to_map(pose) @ step)

    def _compare(
        self, places: Sequence[Place], followed: NDArray[np.float64], support: MatchScore
    ) -> None:
        """Weigh what a search found against the estimate that it was to check."""
        resolution = self.field.resolution
        elsewhere = [p for p in places if not is_near(p.pose, followed, resolution)]
        best = max((p.support.value for p in elsewhere), default=0.0)
        here = [p for p in places if is_near(p.pose, followed, resolution)]
        own = max([support, *(p.support for p in here)], key=lambda one: one.value)
        value = self._preferred(own)
        if best > value + self._config.search_margin and best >= self._config.good_support:
            self.search()
            self._wants_job = False
            self._searched = True
            self._hypotheses.start(places)
            return
        if here and here[0].support.value > support.value + NEAR_LEAD:
            self._estimator.reset(here[0].pose, self._found_covariance())
        self._rivals.start(elsewhere, value)
        if not self._rivals.exist or (self._is_proven and self._rivals.lead <= 0.0):
            self._confirm(own.value)

    def _weigh_rivals(self, beams: BeamSet, support: MatchScore) -> None:
        """Compare the estimate with the places followed beside it, and change over if need be."""
        self._rivals.look(beams, self._estimator.pose, self._preferred(support))
        winner = self._rivals.winner()
        if winner is not None:
            self._take(winner)
        elif not self._rivals.exist:
            self._confirm(support.value)

    def _preferred(self, support: MatchScore) -> float:
        """Return the support of the estimate with what is added for having been right so far."""
        if not self._is_proven:
            return support.value
        return support.value + LOYALTY * max(0.0, 1.0 - support.astray / LOYALTY_ASTRAY)

    def _confirm(self, support: float) -> None:
        """Note that no place explains the scans as well as the estimate."""
        if support < self._config.good_support and self._tried_m < _TRIED_M:
            return
        self._is_proven = True
        if support >= self._config.poor_support:
            self._monitor.vouch(support)

    def _take(self, winner: Hypothesis) -> None:
        """Follow a place that stands out from all others."""
        self._follow(winner.pose, self._found_covariance())
        self._is_proven = True
        self._monitor.vouch(winner.latest)

    def _found_covariance(self) -> NDArray[np.float64]:
        """Return how far off a found place may be, in cells."""
        deviation = np.array([FOUND_DEV_M, FOUND_DEV_M, FOUND_DEV_RAD])
        return self.field.covariance_to_cells(np.diag(deviation**2))
