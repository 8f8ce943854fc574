"""The localizer without wire, clock and files: scans and odometry in, estimates out.

Frames: `map` (the user's), `grid` (columns and rows of the map, in cells), `odom`, `base_link`.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from trolley.config.localizer import LocalizerConfig
from trolley.geometry import Pose2D
from trolley.gridmap import GridMap
from trolley.scanning import Reject, ScanInput, motion_since, problem_of
from trolley_localizer.changes.change_detector import Change, ChangeDetector
from trolley_localizer.changes.mirror_detector import MirrorDetector
from trolley_localizer.estimate import CandidatePose, Estimate
from trolley_localizer.filter.pose_estimator import AlignedPose, PoseEstimator
from trolley_localizer.filter.scan_to_scan import PARAMS as SCANS
from trolley_localizer.filter.scan_to_scan import LedPose, ScanToScan
from trolley_localizer.matching.global_search import Place, SearchJob, SearchMap, is_near
from trolley_localizer.matching.hypotheses import PROOF, Hypotheses, Hypothesis, Proof, Rivals
from trolley_localizer.matching.likelihood_field import build_field, make_lines, sane_covariance
from trolley_localizer.matching.map_matcher import (
    FRONT_END,
    BeamSet,
    MapMatcher,
    MatchScore,
    read_beams,
)
from trolley_localizer.reach import Reach
from trolley_localizer.resting import Rest
from trolley_localizer.tracking_state import Evidence, TrackingMonitor, TrackingState


@dataclass(frozen=True, slots=True)
class LocalizerParams:
    """When the localizer changes its mind. All values were found by hand."""

    set_dev_m: float = 0.4
    set_dev_rad: float = 0.25
    """How far off a pose set by hand may be: standard deviations [m, rad]."""
    found_dev_m: float = 0.1
    found_dev_rad: float = 0.05
    """How far off a place found by a search may be: standard deviations [m, rad]."""
    near_lead: float = 0.05
    """A place near the estimate that is supported better by this much replaces it."""
    loyalty: float = 0.15
    """An estimate that has proven right, and that no beam contradicts, is preferred by this much:
    odometry seldom loses it, while furniture that was moved may well make another place fit
    better."""
    loyalty_astray: float = 0.05
    """This share of beams that end nowhere behind walls takes all of `loyalty` away."""
    tried_m: float = 0.5
    """A given pose that the map does not explain well is believed only after this distance [m]."""
    turn_counts_m: float = 0.3
    """A turn by 1 rad counts as much as driving this far [m]."""
    least_known: float = 0.5
    """Where less of the beams ends on what the map knows, the robot is off the map."""
    search_known: float = 0.8
    """A search asks too much of the true place where less of the beams does."""
    known_smoothing_s: float = 0.4
    """Time constant of that share [s]."""
    trusted_m: float = 5.0
    """A robot that comes back from further off the map must prove where it is [m]."""
    searched_m: float = 0.5
    """A place is believed only if a search no longer ago than this has found none beside it [m]."""
    doubted_m: float = 3.0
    """An estimate that has been in doubt over this distance may be wrong after all [m]."""


PARAMS = LocalizerParams()

PoseProblem = Literal["outside_map", "in_obstacle"]


@dataclass(slots=True)
class Searching:
    """The robot may be anywhere; the places that a search has found are followed."""

    places: Hypotheses
    has_result: bool = False
    """Whether a search has been completed since; without one there are no places."""


@dataclass(slots=True)
class Following:
    """One pose is followed; the monitor says whether it is believed."""

    monitor: TrackingMonitor
    rivals: Rivals
    """Other places that may be the right one."""
    is_proven: bool = False
    """Whether no other place explained the scans as well."""
    proof: Proof | None = None
    """Must come out before the estimate is believed: it was found without a prior, or the robot may
    have been carried off."""
    is_found: bool = False
    """It was found by a search: the odometry has not led to it."""
    is_searched: bool = False
    """Whether the whole map has been searched since the proof began."""
    unsearched_m: float | None = 0.0
    """Distance driven since the first scan after the last search delivered, with turns counted in
    [m]; None until that scan."""
    driven_m: float = 0.0
    """Distance driven with this estimate, with turns counted in [m]."""
    known: float = 1.0
    """Share of beams that end on what the map knows, smoothed."""
    off_m: float = 0.0
    """Distance driven off the map since it ended [m]."""
    doubted_m: float = 0.0
    """Distance driven in doubt, without a break [m]."""

    @property
    def is_off_map(self) -> bool:
        """Whether the map does not know what most beams end on."""
        return self.known < PARAMS.least_known


@dataclass(slots=True)
class SearchSchedule:
    """When the whole map is searched. One search runs at a time."""

    is_wanted: bool = True
    is_running: bool = False
    is_void: bool = False
    """The one that runs began before the robot was carried off or put elsewhere."""
    since_s: float = math.inf
    """Robot time since the last search began [s]."""
    unproven_m: float = 0.0
    """Distance driven off the map or without a proof, with turns counted in [m]."""


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
        self._search_map = SearchMap(self.field)
        self._matcher = MapMatcher(self.field, make_lines(self.field, mirrors), config)
        self._estimator = PoseEstimator(self.field, self._matcher, config, seed)
        self._scans = ScanToScan(self.field.resolution)
        self._mirrors = MirrorDetector(self.field)
        self.changes = ChangeDetector(self.field, config) if config.propose_changes else None
        self._state: Searching | Following = self._searching([])
        self._reach: Reach | None = None
        """Where the robot can be after a way off the map; None: wherever the scans say."""
        self._schedule = SearchSchedule()
        self._rest = Rest()
        self._stamp_ns: int | None = None
        self._last: ScanInput | None = None
        """The newest scan that was used."""
        self._said: Estimate | None = None
        self._beams: BeamSet | None = None
        self._map_T_odom: Pose2D | None = None

    def set_config(self, config: LocalizerConfig) -> None:
        """Locate by other thresholds from the next scan on; field, noise and counts stay."""
        self._config = config
        self._estimator.set_config(config)
        if isinstance(self._state, Following):
            self._state.monitor.set_config(config)

    # One scan.

    def step(self, scan: ScanInput) -> Estimate | Reject:
        """Predict by the odometry, correct by the scan, judge whether to believe the outcome.

        A robot that knows where it is and stands before what it saw already learns nothing: most
        such scans are only looked at for whether that is so.
        """
        reject = problem_of(scan, self._stamp_ns)
        if reject is not None:
            return reject
        self._stamp_ns = scan.stamp_ns
        if self._rest.tells_nothing(scan) and self._is_settled and self._said is not None:
            return self._said.held(scan)
        self._said = self._use(scan)
        return self._said

    @property
    def _is_settled(self) -> bool:
        """Whether it is sure of the pose and looks for no other."""
        following, schedule = self._state, self._schedule
        return (
            isinstance(following, Following)
            and following.monitor.state == "localized"
            and following.monitor.support >= self._config.good_support
            and following.proof is None
            and not following.rivals.exist
            and not (schedule.is_wanted or schedule.is_running)
        )

    def _use(self, scan: ScanInput) -> Estimate:
        """Learn from a scan."""
        motion = motion_since(self._last, scan, FRONT_END)
        beams = read_beams(scan, self.field.resolution, self._config.max_range_m)
        self._last, self._beams = scan, beams
        self._schedule.since_s += motion.elapsed_s
        led = self._led_by_scans(motion.step, beams)
        self._predict(motion.step if led is None else self._step_to(led.pose))
        if isinstance(self._state, Searching):
            self._settle(self._state, beams)
        if isinstance(self._state, Searching):
            return self._unknown_pose(self._state, scan, beams, "searching")
        self._correct(self._state, beams, led, motion.elapsed_s)
        score, classes = self._matcher.classify(self._estimator.pose, beams)
        following = self._compare_rivals(self._state, beams, score)
        self._prove(following, score, beams)
        is_silent = beams.is_blind or following.is_off_map
        is_open = following.proof is not None
        spread_m, known = self._estimator.spread_m, score.known
        evidence = Evidence(score.tracked, spread_m, is_silent, is_open, known)
        state = following.monitor.update(evidence, motion.elapsed_s)
        if state == "lost" or self._is_disproven(following):
            return self._unknown_pose(self._begin_search(), scan, beams, "lost")
        self._doubt(following, is_silent=is_silent)
        if state == "localized" and not beams.is_blind:
            self._watch_map(scan, beams, classes)
        return self._known_pose(following, scan, beams, score, classes)

    def _led_by_scans(self, step: Pose2D, beams: BeamSet) -> LedPose | None:
        """Return where the scans lead; None where the odometry may be believed, or nothing leads.

        On the map the odometry is believed as long as the scans agree with it.
        """
        if not isinstance(self._state, Following) or beams.is_blind:
            return None
        predicted = self._carried(self._estimator.pose, step)
        if not self._state.is_off_map:
            agreement = self._scans.agreement(beams, predicted)
            if agreement is None or agreement >= SCANS.usual_overlap:
                return None
        return self._scans.align(predicted, beams)

    def _step_to(self, pose: NDArray[np.float64]) -> Pose2D:
        """Return the step [m, m, rad] from the estimate to a pose in cells."""
        return self.field.to_map(self._estimator.pose).inverse() @ self.field.to_map(pose)

    def _predict(self, step: Pose2D) -> None:
        """Carry all that is followed through one odometry step."""
        turned_m = PARAMS.turn_counts_m * abs(step.yaw)
        driven_m = math.hypot(step.x, step.y) + turned_m
        self._schedule.unproven_m += driven_m
        if self._reach is not None:
            self._reach.predict(step)
            if self._reach.is_over:
                self._reach = None
        match self._state:
            case Searching(places):
                places.predict(step)
            case Following(rivals=rivals) as following:
                self._estimator.predict(step)
                rivals.predict(step)
                following.driven_m += driven_m
                before_m = following.unsearched_m
                following.unsearched_m = 0.0 if before_m is None else before_m + driven_m
                if following.proof is not None:
                    following.proof.predict(step)
                doubts = following.monitor.doubts
                following.doubted_m = following.doubted_m + driven_m if doubts else 0.0
                if following.is_off_map:
                    following.off_m += math.hypot(step.x, step.y)
                elif following.proof is None:
                    self._schedule.unproven_m = 0.0

    def _settle(self, searching: Searching, beams: BeamSet) -> None:
        """Correct the places of the last search, and follow one if it stands out."""
        if beams.is_blind:
            return
        places = searching.places
        places.update(beams)
        winner = places.winner()
        if winner is not None:
            self._follow_winner(winner, places.views, beams)
        elif searching.has_result and self._schedule.since_s > self._config.search_again_s:
            # What stands out by now may not be among the places found from where it began.
            self._schedule.is_wanted = not places.is_plausible or places.is_stale

    def _correct(
        self, following: Following, beams: BeamSet, led: LedPose | None, elapsed_s: float
    ) -> None:
        """Align the estimate with the map; off the map take it from where the scans lead."""
        if beams.is_blind:
            return
        known = self._matcher.known_share(self._estimator.pose, beams)
        share = min(1.0, elapsed_s / PARAMS.known_smoothing_s)
        following.known += share * (known - following.known)
        if not following.is_off_map:
            self._come_back(following)
            is_trusted = following.monitor.state == "localized"
            self._estimator.correct(beams, is_trusted=is_trusted)
        elif led is not None:
            self._estimator.lead(led.pose, led.covariance, beams)
        estimator = self._estimator
        if self._scans.follow(beams, estimator.pose, estimator.covariance, elapsed_s):
            self._break(following)

    def _come_back(self, following: Following) -> None:
        """Note that the robot is on the map; from far off it, it must prove where it is."""
        if following.off_m > PARAMS.trusted_m and following.proof is None:
            following.proof = Proof(has_prior=True)
            following.is_proven = following.is_searched = False
            led = AlignedPose(self.field, self._config)
            led.reset(self._estimator.pose, self._estimator.covariance)
            self._reach = Reach(led)
        following.off_m = 0.0

    def _break(self, following: Following) -> None:
        """Note that the robot may have been carried off: the odometry's word is worth nothing."""
        following.is_proven = following.is_searched = False
        following.proof, self._reach = Proof(), None
        following.rivals = Rivals(self.field, self._matcher, self._config)
        self._schedule.is_wanted = True
        self._schedule.is_void = self._schedule.is_running

    def _prove(self, following: Following, score: MatchScore, beams: BeamSet) -> None:
        """Take what the scan says for a place without a prior into account."""
        proof = following.proof
        if proof is None or beams.is_blind or following.is_off_map:
            return
        if proof.is_due:
            pinned = self._matcher.pinned(self._estimator.pose, beams)
            if following.is_found:
                proof.add(score.value, pinned)
            else:
                proof.add(score.tracked, pinned, score.known)
        if proof.is_right and (following.unsearched_m or 0.0) > PARAMS.searched_m:
            following.is_searched = False  # Other places may fit better from here.
        if proof.is_right and following.is_searched and not following.rivals.exist:
            following.proof, following.is_found, self._reach = None, False, None
            following.is_proven = True
            following.monitor.vouch(score.tracked)

    def _compare_rivals(self, following: Following, beams: BeamSet, score: MatchScore) -> Following:
        """Compare the estimate with the places followed beside it; return what is followed now."""
        rivals = following.rivals
        if not rivals.exist or beams.is_blind:
            return following
        rivals.update(beams, self._estimator.pose, self._preferred(following, score))
        winner = rivals.winner()
        if winner is not None:
            return self._follow_winner(winner, rivals.views, beams)
        if not rivals.exist:
            self._confirm(following, score.value)
        return following

    def _is_disproven(self, following: Following) -> bool:
        """Say whether the place that was to be proven is given up.

        One that a search has found is at the first sign. One from before the robot may have been
        carried off may have somebody in front of it for a moment. One to which the odometry has led
        is kept, and the whole map searched again, until another place stands out.
        """
        proof = following.proof
        if proof is None or not following.is_searched:
            return False
        if proof.has_prior:
            if proof.is_overdue:
                following.proof, following.is_searched = Proof(has_prior=True), False
            return False
        return proof.is_overdue or (proof.is_against and following.is_found)

    def _doubt(self, following: Following, *, is_silent: bool) -> None:
        """Have the whole map searched again if the estimate has been in doubt for a while."""
        proof, schedule = following.proof, self._schedule
        if is_silent or (proof is None and following.known < PARAMS.search_known):
            return
        if following.doubted_m > PARAMS.doubted_m:
            following.is_proven, following.doubted_m = False, 0.0
        if proof is not None and not following.is_searched:
            schedule.is_wanted = True
        elif following.monitor.doubts and schedule.since_s > self._config.search_again_s:
            schedule.is_wanted = not following.rivals.exist or following.rivals.is_stale

    def _watch_map(self, scan: ScanInput, beams: BeamSet, classes: NDArray[np.uint8]) -> None:
        """Look for mirrors that are not on the map, and for changes, from a pose believed in."""
        pose = self._estimator.pose
        if self._mirrors.update(pose, beams, classes, self._matcher.mirrors):
            self._matcher.suspects = self._mirrors.lines()
        if self.changes is not None:
            self.changes.update(scan.stamp_ns, pose, self.covariance, beams, classes)

    # What it says.

    def _known_pose(
        self,
        following: Following,
        scan: ScanInput,
        beams: BeamSet,
        score: MatchScore,
        classes: NDArray[np.uint8],
    ) -> Estimate:
        """Say where the robot is."""
        map_T_base = self.field.to_map(self._estimator.pose)
        self._map_T_odom = map_T_base @ scan.odom_T_base.inverse()
        return Estimate(
            stamp_ns=scan.stamp_ns,
            map_T_base=map_T_base,
            map_T_odom=self._map_T_odom,
            covariance=self.covariance,
            state=following.monitor.state,
            match=score.match,
            spread=self._estimator.spread_m,
            beam_classes=classes,
            message=self._why_unsure(following, beams),
            off_m=following.off_m if following.is_off_map else None,
        )

    def _why_unsure(self, following: Following, beams: BeamSet) -> str:
        """Say in one sentence why the state is not `localized`."""
        monitor = following.monitor
        if beams.is_blind:
            return "the lidar sees too little to check the pose"
        if monitor.state == "localized":
            return ""
        if following.is_off_map:
            return f"off the map since {following.off_m:.0f} m"
        if following.proof is not None:
            return "driving on will show whether it is here"
        if self._estimator.spread_m > self._config.max_spread_m:
            return "the hypotheses lie far apart"
        if monitor.support < self._config.good_support:
            return "the scan does not fit the map well here"
        return "checking the pose against the scan"

    def _unknown_pose(
        self, searching: Searching, scan: ScanInput, beams: BeamSet, state: TrackingState
    ) -> Estimate:
        """Say that the pose is not known; the last correction of the odometry is held."""
        items = searching.places.items
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
            wants_turn=searching.has_result and not beams.is_blind,
            message=_why_searching(searching, beams, state),
        )

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

    @property
    def covariance(self) -> NDArray[np.float64]:
        """Covariance (3, 3) of the followed pose over x, y [m], yaw [rad] in the map frame."""
        return self.field.covariance_to_map(self._estimator.covariance)

    def particles(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return the hypotheses (n, 3) x, y [m], yaw [rad] in the map frame, and weights (n,)."""
        if isinstance(self._state, Following):
            return self._estimator.particles()
        items = self._state.places.items
        poses = np.array([self.field.to_map(item.pose).as_array() for item in items], np.float32)
        total = sum(item.latest for item in items)
        weights = [item.latest / total if total > 0.0 else 1.0 / len(items) for item in items]
        return poses.reshape(-1, 3), np.array(weights, np.float32)

    # What people and the shell ask for.

    def set_mirrors(self, polylines: Sequence[NDArray[np.float64]]) -> None:
        """Replace the mirrors and panes: (n, 2) points [m] in the map frame each."""
        self._rest.end()
        self._matcher.mirrors = make_lines(self.field, polylines)
        self._mirrors.reset()
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
            covariance = np.diag(
                np.square([PARAMS.set_dev_m, PARAMS.set_dev_m, PARAMS.set_dev_rad])
            )
        sane = sane_covariance(covariance)
        self._follow(self.field.to_cells(map_T_base), self.field.covariance_to_cells(sane))
        self._schedule.is_wanted, self._reach = True, None

    def resume(self, map_T_base: Pose2D) -> None:
        """Go on at a pose to which the odometry has led since it was known: no search is due.

        Args:
            map_T_base: on the map and not in a wall, see `pose_problem`.
        """
        self._reach = None
        self._follow(self.field.to_cells(map_T_base), self._found_covariance()).is_proven = True

    def search(self) -> None:
        """Forget where the robot is and search the whole map with the next scan."""
        self._reach, self._schedule.unproven_m = None, 0.0
        self._begin_search()

    def restart_odometry(self) -> None:
        """Take the next odometry as the beginning of a new run: no step leads to it."""
        self._last = self._stamp_ns = None
        self._rest.end()
        self._estimator.forget_motion()

    # Searches of the whole map.

    def take_job(self) -> SearchJob | None:
        """Return a search to run now, or None. Give it back to `finish` when it is done."""
        schedule = self._schedule
        if not schedule.is_wanted or schedule.is_running:
            return None
        if self._last is None or self._beams is None or self._beams.is_blind:
            return None
        schedule.is_wanted, schedule.is_running, schedule.since_s = False, True, 0.0
        followed = None
        if isinstance(self._state, Following):
            followed = self._estimator.pose.copy()
        elif self._reach is not None:
            followed = self._reach.pose.copy()
        odom_T_base = self._last.odom_T_base
        return SearchJob(self._search_map, self._matcher, self._beams, odom_T_base, followed)

    def finish(self, job: SearchJob) -> None:
        """Take the outcome of a search into account."""
        self._schedule.is_running = False
        self._rest.end()
        if self._last is None or self._schedule.is_void:
            self._schedule.is_wanted, self._schedule.is_void = True, False
            return
        step = job.odom_T_base.inverse() @ self._last.odom_T_base
        places = [Place(self._carried(place.pose, step), place.support) for place in job.places]
        if self._reach is not None:
            places = [p for p in places if self._reach.holds(p.pose, self.field.resolution)]
        if isinstance(self._state, Searching):
            self._state = self._searching(places, has_result=True)
        elif job.followed is not None and job.support is not None:
            followed = self._carried(job.followed, step)
            self._compare(self._state, places, followed, job.support)

    def _carried(self, pose: NDArray[np.float64], step: Pose2D) -> NDArray[np.float64]:
        """Return a pose in cells after an odometry step in metres."""
        return self.field.to_cells(self.field.to_map(pose) @ step)

    def _compare(
        self,
        following: Following,
        places: Sequence[Place],
        followed: NDArray[np.float64],
        score: MatchScore,
    ) -> None:
        """Compare what a search found with the estimate that it was to check."""
        resolution = self.field.resolution
        elsewhere = [p for p in places if not is_near(p.pose, followed, resolution)]
        here = [p for p in places if is_near(p.pose, followed, resolution)]
        following.is_searched, following.unsearched_m = True, None
        own = max([score, *(p.support for p in here)], key=lambda one: one.value)
        value = self._preferred(following, own)
        best = max((p.support.value for p in elsewhere), default=0.0)
        if following.is_proven and best > value:
            return  # A jump needs a reason, and the robot has driven on without a break.
        if best > value + self._config.search_margin and best >= PROOF.between:
            self._state = self._searching(places, has_result=True)
            self._schedule.is_wanted = False
            return
        if here and here[0].support.value > score.value + PARAMS.near_lead:
            self._estimator.reset(here[0].pose, self._found_covariance())
        rivals = following.rivals
        rivals.start(elsewhere, value)
        if following.is_proven:
            rivals.clear()
        if not rivals.exist:
            self._confirm(following, own.value)

    def _preferred(self, following: Following, score: MatchScore) -> float:
        """Return the support of the estimate, with a bonus for having been right so far."""
        if following.proof is not None and not following.is_found:
            # The odometry has led here: the unknown speaks neither for nor against it.
            return PROOF.between + score.known * (score.tracked - PROOF.between)
        if not following.is_proven:
            return score.value
        return score.value + PARAMS.loyalty * max(0.0, 1.0 - score.astray / PARAMS.loyalty_astray)

    def _confirm(self, following: Following, support: float) -> None:
        """Note that no place explains the scans as well as the estimate."""
        if following.proof is not None:
            return
        if support < self._config.good_support and following.driven_m < PARAMS.tried_m:
            return
        following.is_proven = True
        if support >= self._config.poor_support:
            following.monitor.vouch(support)

    # Transitions.

    def _begin_search(self) -> Searching:
        """Follow nothing any more, and have the whole map searched."""
        self._state = searching = self._searching([])
        self._schedule.is_wanted = True
        return searching

    def _searching(self, places: Sequence[Place], *, has_result: bool = False) -> Searching:
        """Return the state of a search that has found such places, best first."""
        hypotheses = Hypotheses(self.field, self._matcher, self._config)
        hypotheses.start(places)
        return Searching(hypotheses, has_result)

    def _follow(self, pose: NDArray[np.float64], covariance: NDArray[np.float64]) -> Following:
        """Begin to follow a pose in cells."""
        self._rest.end()
        self._estimator.reset(pose, covariance)
        rivals = Rivals(self.field, self._matcher, self._config)
        following = Following(TrackingMonitor(self._config), rivals)
        self._state = following
        self._scans.forget()
        self._schedule.is_wanted = False
        self._schedule.is_void = self._schedule.is_running
        return following

    def _follow_winner(self, winner: Hypothesis, views: int, beams: BeamSet) -> Following:
        """Follow a place that stands out from all others; driving on must prove it."""
        following = self._follow(winner.pose, self._found_covariance())
        following.proof = Proof(self._schedule.unproven_m)
        following.proof.add(winner.total / views, self._matcher.pinned(winner.pose, beams))
        following.is_found = following.is_searched = True
        return following

    def _found_covariance(self) -> NDArray[np.float64]:
        """Return how far off a found place may be, in cells."""
        deviation = np.array([PARAMS.found_dev_m, PARAMS.found_dev_m, PARAMS.found_dev_rad])
        return self.field.covariance_to_cells(np.diag(deviation**2))


def _why_searching(searching: Searching, beams: BeamSet, state: TrackingState) -> str:
    """Say in one sentence how the search stands."""
    if state == "lost":
        return "the scan does not fit the map here: lost"
    if beams.is_blind:
        return "the lidar sees too little to find the robot"
    if not searching.has_result:
        return "searching the whole map"
    if len(searching.places.items) > 1:
        return "several places look alike: a turn in place would help"
    return "no place on the map fits the scan"
