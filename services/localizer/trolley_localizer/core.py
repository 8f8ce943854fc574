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
from trolley.scanning import Motion, Reject, ScanInput, motion_since, problem_of
from trolley_localizer.changes.map_watch import MapWatch
from trolley_localizer.estimate import Estimate, EstimateReporter, SeenScan
from trolley_localizer.filter.pose_estimator import AlignedPose, PoseEstimator
from trolley_localizer.filter.scan_to_scan import PARAMS as SCANS
from trolley_localizer.filter.scan_to_scan import LedPose, ScanToScan
from trolley_localizer.matching.global_search import Place, SearchJob, SearchMap, is_near
from trolley_localizer.matching.hypotheses import Hypotheses, Hypothesis
from trolley_localizer.matching.likelihood_field import build_field, make_lines, sane_covariance
from trolley_localizer.matching.map_matcher import (
    FRONT_END,
    BeamSet,
    MapMatcher,
    MatchScore,
    read_beams,
)
from trolley_localizer.matching.proof import PROOF, Proof, Sight
from trolley_localizer.matching.rivals import Rivals
from trolley_localizer.matching.seen_surface import SeenSurface
from trolley_localizer.tracking.reach import Reach
from trolley_localizer.tracking.resting import Rest
from trolley_localizer.tracking.search_schedule import SearchSchedule
from trolley_localizer.tracking.states import Following, Searching
from trolley_localizer.tracking.tracking_state import Evidence


@dataclass(frozen=True, slots=True)
class LocalizerParams:
    """How a pose is first followed. All values were found by hand."""

    set_devs: tuple[float, float, float] = (0.4, 0.4, 0.25)
    """Standard deviations of a pose set by hand: x, y [m], yaw [rad]."""
    found_devs: tuple[float, float, float] = (0.1, 0.1, 0.05)
    """Standard deviations of a pose found by a search: x, y [m], yaw [rad]."""
    near_lead: float = 0.05
    """Lead in support by which a place near the estimate replaces it."""
    turn_counts_m: float = 0.3
    """Distance that a turn by 1 rad counts as [m]."""


PARAMS = LocalizerParams()

PoseProblem = Literal["outside_map", "in_obstacle"]


class Localizer:
    """Follows the robot on one map, notices when it is lost, and finds it again.

    A search of the whole map takes long, so it is handed out: after each call ask `take_job`, do
    the job's slices anywhere (they touch nothing of the localizer), and give it back to `finish`.
    Between slices a job that `wants` denies may be left.
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
        self.map_watch = MapWatch(self.field, self._matcher, config)
        """What is not as the map says."""
        self._state: Searching | Following = self._searching()
        self._reach: Reach | None = None
        """Where the robot can be after a way off the map; None: wherever the scans say."""
        self._schedule = SearchSchedule()
        self._rest = Rest()
        self._stamp_ns: int | None = None
        self._last: SeenScan | None = None
        """The newest scan that was used."""
        self._reporter = EstimateReporter(self.field, config)

    def set_config(self, config: LocalizerConfig) -> None:
        """Locate by other thresholds from the next scan on; field, noise and counts stay."""
        self._config = config
        self._estimator.set_config(config)
        self._reporter.set_config(config)
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
        said = self._reporter.said
        if self._rest.tells_nothing(scan) and self._is_settled and said is not None:
            return said.held(scan)
        motion = motion_since(None if self._last is None else self._last.scan, scan, FRONT_END)
        beams = read_beams(scan, self.field.resolution, self._config.max_range_m)
        self._last = SeenScan(scan, beams)
        return self._update(self._last, motion)

    def _update(self, seen: SeenScan, motion: Motion) -> Estimate:
        """Predict, correct, judge."""
        beams = seen.beams
        self._schedule.since_s += motion.elapsed_s
        led = self._led_by_scans(motion.step, beams)
        self._predict(motion.step if led is None else self._step_to(led.pose))
        if isinstance(self._state, Searching):
            self._settle(self._state, seen, motion.elapsed_s)
        if isinstance(self._state, Searching):
            return self._reporter.searching(self._state, seen, "searching")
        self._correct(self._state, beams, led, motion.elapsed_s)
        score, classes = self._matcher.classify(self._estimator.pose, beams)
        following = self._compare_rivals(self._state, beams, score)
        self._judge(following, seen, score, motion.elapsed_s)
        if isinstance(self._state, Searching):
            return self._reporter.searching(self._state, seen, "lost")
        if following.monitor.state == "localized" and not beams.is_blind:
            pose, covariance = self._estimator.pose, self.covariance
            self.map_watch.update(seen.scan.stamp_ns, pose, covariance, beams, classes)
        return self._reporter.following(following, self._estimator, seen, score, classes)

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
            and not (schedule.is_wanted or schedule.running)
        )

    def _led_by_scans(self, step: Pose2D, beams: BeamSet) -> LedPose | None:
        """Return where the scans lead; None where the odometry may be believed, or nothing leads.

        Where the map helps, or cannot, since no pose is known on it, the odometry is believed as
        long as the scans agree with it.
        """
        if beams.is_blind:
            return None
        predicted = self._carried(self._pose, step)
        if not (isinstance(self._state, Following) and self._state.is_led):
            agreement = self._scans.agreement(beams, predicted)
            if agreement is None or agreement >= SCANS.usual_overlap:
                return None
        return self._scans.align(predicted, beams)

    def _step_to(self, pose: NDArray[np.float64]) -> Pose2D:
        """Return the step [m, m, rad] to a pose in cells."""
        return self.field.to_map(self._pose).inverse() @ self.field.to_map(pose)

    @property
    def _pose(self) -> NDArray[np.float64]:
        """The estimate (3,) [cells, rad]; while it is searched, where the odometry has led."""
        match self._state:
            case Searching() as searching:
                return self.field.to_cells(searching.led)
            case Following():
                return self._estimator.pose

    def _predict(self, step: Pose2D) -> None:
        """Carry all that is followed through one odometry step."""
        driven_m = math.hypot(step.x, step.y) + PARAMS.turn_counts_m * abs(step.yaw)
        self._schedule.predict(driven_m)
        if self._is_settled:
            self._schedule.restart()
        if self._reach is not None:
            self._reach.predict(step)
            if self._reach.is_over:
                self._reach = None
        match self._state:
            case Searching() as searching:
                searching.predict(step)
            case Following() as following:
                self._estimator.predict(step)
                following.predict(step, driven_m)
                if not following.is_off_map and following.proof is None:
                    self._schedule.unproven_m = 0.0

    def _settle(self, searching: Searching, seen: SeenScan, elapsed_s: float) -> None:
        """Correct the places of the searches, and follow one if it stands out."""
        places, beams = searching.places, seen.beams
        if beams.is_blind:
            return
        is_break = self._scans.follow(beams, self._pose, np.zeros((3, 3)), elapsed_s)
        if is_break:
            self._schedule.restart()
        places.update(beams)
        winner = places.winner()
        if winner is not None:
            self._follow_winner(winner, places.lead, beams)
        elif searching.has_result and self._is_search_due(seen):
            # What stands out by now may not be among the places found from where it began.
            self._schedule.is_wanted = is_break or not places.is_plausible or places.is_stale

    def _is_search_due(self, seen: SeenScan) -> bool:
        return self._schedule.is_due(seen.scan, self._config.search_again_s)

    def _correct(
        self, following: Following, beams: BeamSet, led: LedPose | None, elapsed_s: float
    ) -> None:
        """Align the estimate with the map; where it does not help, go where the scans lead."""
        if beams.is_blind:
            return
        estimator = self._estimator
        following.update_known(self._matcher.known_share(estimator.pose, beams), elapsed_s)
        if not following.is_off_map and following.come_back():
            led_here = AlignedPose(self.field, self._config)
            led_here.reset(estimator.pose, estimator.covariance)
            self._reach = Reach(led_here)
        if not following.is_led:
            estimator.correct(beams, is_trusted=following.monitor.state == "localized")
        elif led is not None:
            estimator.lead(led.pose, led.covariance, beams)
        if self._scans.follow(beams, estimator.pose, estimator.covariance, elapsed_s):
            following.forget_prior()
            self._reach = None
            self._schedule.discard(is_wanted=True)
            self._schedule.restart()

    def _compare_rivals(self, following: Following, beams: BeamSet, score: MatchScore) -> Following:
        """Compare the estimate with the places followed beside it; return what is followed now."""
        rivals = following.rivals
        if not rivals.exist or beams.is_blind:
            return following
        rivals.update(beams, self._estimator.pose, following.preferred(score))
        winner = rivals.winner()
        if winner is not None:
            left = Place(self._estimator.pose.copy(), score)
            taken = self._follow_winner(winner, rivals.mean_lead, beams)
            taken.rivals.add([left], winner.votes.latest)  # It may have been right all the same.
            return taken
        if not rivals.exist:
            if following.proof is not None:
                following.proof.reopen()  # What fitted as well elsewhere has proven nothing.
            following.confirm(score.value)
        return following

    def _judge(
        self, following: Following, seen: SeenScan, score: MatchScore, elapsed_s: float
    ) -> None:
        """Decide whether the estimate is believed; begin a search where it is lost or in doubt."""
        beams = seen.beams
        sight = Sight(self._matcher, self._estimator.pose, beams, score)
        if not beams.is_blind and following.prove(sight):
            self._reach = None
        is_silent = beams.is_blind or following.is_off_map
        is_open = following.proof is not None
        spread_m = self._estimator.spread_m
        evidence = Evidence(
            score.tracked, spread_m, is_silent, is_open, following.is_trusted, score.known
        )
        state = following.monitor.update(evidence, elapsed_s)
        if state == "lost" or following.is_disproven():
            self._begin_search()
        elif not is_silent:
            is_wanted = following.needs_search(is_due=self._is_search_due(seen))
            if is_wanted is not None:
                self._schedule.is_wanted = is_wanted

    # What it says.

    @property
    def covariance(self) -> NDArray[np.float64]:
        """Covariance (3, 3) of the followed pose over x, y [m], yaw [rad] in the map frame."""
        return self.field.covariance_to_map(self._estimator.covariance)

    def particles(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return the hypotheses (n, 3) x, y [m], yaw [rad] in the map frame, and weights (n,)."""
        if isinstance(self._state, Following):
            return self._estimator.particles()
        return self._state.places.particles()

    # What people and the shell ask for.

    def set_mirrors(self, polylines: Sequence[NDArray[np.float64]]) -> None:
        """Replace the mirrors and panes: (n, 2) points [m] in the map frame each."""
        self._rest.end()
        self.map_watch.set_mirrors(polylines)

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
            covariance = np.diag(np.square(PARAMS.set_devs))
        self._follow(self.field.to_cells(map_T_base), sane_covariance(covariance))
        self._schedule.is_wanted, self._reach = True, None
        self._schedule.restart()

    def resume(self, map_T_base: Pose2D) -> None:
        """Go on at a pose to which the odometry has led since it was known: no search is due.

        Args:
            map_T_base: on the map and not in a wall, see `pose_problem`.
        """
        self._reach = None
        self._follow(self.field.to_cells(map_T_base)).is_proven = True

    def search(self) -> None:
        """Forget where the robot is and search the whole map with the next scan."""
        self._reach, self._schedule.unproven_m = None, 0.0
        self._schedule.restart()
        self._begin_search()

    def restart_odometry(self) -> None:
        """Take the next odometry as the beginning of a new run, at zero: no step leads to it."""
        self._last = self._stamp_ns = None
        self._rest.end()
        self._estimator.forget_motion()
        self._reporter.restart_odometry()
        if self._schedule.running is not None:
            self._schedule.discard(is_wanted=True)

    # Searches of the whole map.

    def take_job(self) -> SearchJob | None:
        """Return a search to run now, or None. Give it back to `finish` when it is done."""
        schedule, last = self._schedule, self._last
        is_free = schedule.is_wanted and schedule.running is None
        if not is_free or last is None or last.beams.is_blind:
            return None
        followed = None
        if isinstance(self._state, Following):
            followed = self._estimator.pose.copy()
        elif self._reach is not None:
            followed = self._reach.pose.copy()
        odom_T_base = last.scan.odom_T_base
        job = SearchJob(self._search_map, self._matcher, last.beams, odom_T_base, followed)
        schedule.begin(job, last.scan)
        return job

    def wants(self, job: SearchJob) -> bool:
        """Say whether a search is still of use."""
        return self._schedule.running is job

    def finish(self, job: SearchJob) -> None:
        """Take the outcome of a search into account, if it is still of use."""
        if self._last is None or not self.wants(job):
            return
        self._schedule.running = None
        self._rest.end()
        step = job.odom_T_base.inverse() @ self._last.scan.odom_T_base
        places = [Place(self._carried(place.pose, step), place.support) for place in job.places]
        if self._reach is not None:
            places = [p for p in places if self._reach.holds(p.pose, self.field.resolution)]
        if isinstance(self._state, Searching):
            self._state.take_result(places)
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
        value = following.preferred(own)
        best = max((p.support.value for p in elsewhere), default=0.0)
        if following.is_proven and best > value:
            return  # A jump needs a reason, and the robot has driven on without a break.
        is_better = best > value + self._config.search_margin and best >= PROOF.between
        if is_better and not following.is_found:
            self._state = self._searching()
            self._state.take_result(places)
            self._schedule.is_wanted = False
            return
        if here and here[0].support.value > score.value + PARAMS.near_lead:
            self._estimator.reset(here[0].pose, self._covariance_in_cells(None))
        rivals = following.rivals
        rivals.add(elsewhere, value)
        if following.is_proven:
            rivals.clear()
        if not rivals.exist and following.confirm(own.value):
            self._schedule.restart()

    # Transitions.

    def _begin_search(self) -> None:
        """Follow nothing any more, and have the whole map searched."""
        self._state = self._searching()
        self._schedule.is_wanted = True

    def _searching(self) -> Searching:
        """Return the state before a search has found anything."""
        self._scans.forget()
        return Searching(Hypotheses[Hypothesis](self.field, self._matcher, self._config))

    def _follow(
        self, pose: NDArray[np.float64], covariance: NDArray[np.float64] | None = None
    ) -> Following:
        """Begin to follow a pose in cells.

        Args:
            pose: (3,) x, y [cells], yaw [rad].
            covariance: (3, 3) over x, y [m], yaw [rad] in the map frame; None for a found place.
        """
        self._rest.end()
        self._estimator.reset(pose, self._covariance_in_cells(covariance))
        rivals = Rivals(self.field, self._matcher, self._config)
        self._state = following = Following(self._config, rivals)
        self._scans.forget()
        self._schedule.discard(is_wanted=False)
        return following

    def _follow_winner(self, winner: Hypothesis, lead: float, beams: BeamSet) -> Following:
        """Follow a place that stands out from all others; driving on must prove it."""
        following = self._follow(winner.pose)
        seen = SeenSurface(self.field)
        seen.add(winner.pose, beams)
        following.proof = Proof(self._schedule.unproven_m, seen=seen, lead=lead)
        pinned = self._matcher.pinned(winner.pose, beams)
        following.proof.begin(winner.mean - PROOF.between, pinned)
        following.is_found = following.is_searched = True
        return following

    def _covariance_in_cells(self, covariance: NDArray[np.float64] | None) -> NDArray[np.float64]:
        """Return a covariance (3, 3) in cells, that of a found place if none is given."""
        found = np.diag(np.square(PARAMS.found_devs))
        return self.field.covariance_to_cells(found if covariance is None else covariance)
