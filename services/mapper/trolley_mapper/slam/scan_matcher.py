"""Scan matching: the robot's pose, predicted by odometry and corrected by scans.

Source:
    Thrun, Burgard, Fox, Probabilistic Robotics (2005), section 3.3, for the cycle of prediction and
    correction; Olson, Real-Time Correlative Scan Matching (2009), for the search.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D, angle_difference
from trolley.scan_matching.layout import Cloud
from trolley.scan_matching.surfels import EXPLAINED, UNKNOWN
from trolley.scan_matching.sweep import Sweep, read_sweep
from trolley.scanning import ScanInput
from trolley.slices import whole
from trolley_mapper.slam.local_map import LocalMap
from trolley_mapper.slam.motion_model import motion_covariance
from trolley_mapper.slam.pose_graph import between, compose, inverse, turned
from trolley_mapper.slam.slip_detector import SlipDetector


@dataclass(frozen=True, slots=True)
class ScanMatcherParams:
    """When a match is good, and where else a scan is tried. Found with bench/mapper/."""

    min_dev_m: float = 0.004
    """Least standard deviation of the position [m]."""
    min_dev_rad: float = 0.002
    """Least standard deviation of the heading [rad]."""
    contradiction: float = 3.0
    """Number of standard deviations beyond which odometry and scan contradict each other."""
    gate_devs: tuple[float, float] = (0.05, 0.08)
    """Standard deviations of the odometry at any scan, besides its model: it may be late or slip
    [m, rad]."""
    slip_cost: float = 8.0
    """Most log-likelihood that a pose costs, since wheels that slip may report anything; set by
    hand as 4 standard deviations do."""
    carried_cost: float = 25.0
    """The same of a pose farther away than the wheels report to have driven, or the other way:
    whatever slips reports too much. A robot that was carried is found by several scans, not by one
    that looks alike."""
    carried_m: float = 0.3
    """Distance beyond what the wheels report from which on a robot must have been carried [m]."""
    evidence: float = 25.0
    """Log-likelihood of a scan that is explained in all its points: neighbours err together."""
    contradiction_cost: float = 1.5
    """Number of explained points that a point against what is known outweighs."""
    slip_lead: float = 16.0
    """Lead in log-likelihood that a pose needs against the odometry: turns that wheels had missed
    led by 32 to 45, places that look alike by 4."""
    own_word_m: float = 0.3
    """Distance driven from which on a scan says something of its own: nearer ones err as one [m].
    """
    slipping_information: float = 0.05
    """Share of the odometry's information that is kept after wheels slipped at the last scan: with
    more they carry the pose along little by little where the scan does not show it well."""
    min_match: float = 0.6
    """Share of the points in known space that a good match explains at least."""
    min_explained: float = 0.25
    """Share of all points that a good match explains at least."""
    min_explained_points: int = 15
    """Number of points that a good match explains at least."""
    max_new_contradicts: float = 0.15
    """Greatest share of its points by which a scan of unseen surroundings contradicts the map."""
    min_window: tuple[float, float] = (0.35, 1.0)
    """Least half of the search window where the scan does not fit where it is expected [m, rad]."""
    doubtful_cost: float = 3.0
    """Log-likelihood of the odometry against a pose above which it must have no rival."""
    rival_window: tuple[float, float] = (1.0, 0.3)
    """Half the window in which a scan is tried a quarter turn and more away [m, rad]."""
    rival_lead: float = 8.0
    """Lead in log-likelihood that a pose needs over the rivals in `rival_window`; with less the
    robot's heading is unknown."""
    max_window: tuple[float, float] = (2.0, 1.6)
    """Greatest half of the search window [m, rad]."""
    window_per_m: float = 2.0
    """Growth of the search window for each metre that the odometry reports: wheels that spin report
    distance that was not driven, and some report reversing as driving forward."""
    window_per_rad: float = 1.0
    """Growth of the search window for each radian that the odometry reports."""
    min_score: float = 0.4
    """Score below which the search stops, 0 ... 1."""
    pull: float = 0.08
    """Lead in score that a pose in the window's corner needs over one in its middle."""
    lead_as_before: float = 0.03
    """Lead in quality that a pose needs that follows from the motion so far."""
    lead_stood_again: float = 0.01
    """Lead in closeness, as a share of the points, that the last pose needs while wheels slip."""
    lead_stood: float = 0.03
    """Lead in closeness, as a share of the points, that the robot's last pose needs."""
    lead_still: float = 0.07
    """Lead in closeness that a scan needs that is read as one from a standing robot."""
    lead: float = 0.05
    """Lead in quality that a pose from the search needs."""
    below_usual: float = 0.1
    """Drop below the usual match at which a match is doubted."""
    smoothing: float = 0.05
    """Weight of a match in the usual one."""
    apart_m: float = 0.05
    """Distance between the odometry's pose and that of the motion so far from which on both are
    tried [m]."""
    apart_rad: float = 0.06
    """Turn between the odometry's pose and that of the motion so far from which on both are tried
    [rad]."""
    bent_rad: float = 0.03
    """Turn during a scan from which on it is tried as one from a standing robot, too: wheels that
    spin during a scan bend it [rad]."""
    below_when_bent: float = 0.03
    """Drop below the usual match from which on a scan is tried as one from a standing robot."""
    close_m: float = 0.04
    """Distance from a surface within which a point lies on it, stricter than for a match [m]."""
    far_share: float = 0.95
    """Share of a scan's points within whose range it is taken to see."""
    stood_m: float = 0.02
    """Step from which on it is tried whether the robot stood [m]."""
    min_telling_points: int = 3
    """Lead in points that is needed besides the leads in quality and closeness."""


PARAMS = ScanMatcherParams()


@dataclass(frozen=True, slots=True)
class MatchQuality:
    """How well a scan fits from a pose."""

    match: float
    """Share of the points in known space that are explained, 0 ... 1."""
    explained: float
    """Share of all points that are explained, 0 ... 1."""
    is_good: bool
    """Whether it fits, and shows enough of what is known to be sure."""
    is_new: bool = False
    """Whether it shows little of what is known, and nothing contradicts the odometry's pose."""
    contradicts: float = 0.0
    """Share of all points that lie where nothing should be, or behind a surface, 0 ... 1."""

    is_ambiguous: bool = False
    """Whether wheels slipped and several poses remain possible."""

    @property
    def log_likelihood(self) -> float:
        """Of the scan, but for a constant: what is new speaks neither for a pose nor against it."""
        return PARAMS.evidence * (self.explained - PARAMS.contradiction_cost * self.contradicts)

    @property
    def value(self) -> float:
        """One number to compare poses by."""
        return self.match * min(1.0, 2.0 * self.explained)


@dataclass(frozen=True, slots=True, eq=False)
class ScanMatch:
    """Where a scan matches: map_T_base (3,), information of the scan (3, 3) in `map`, how well."""

    pose: NDArray[np.float64]
    information: NDArray[np.float64]
    quality: MatchQuality
    sweep: Sweep
    """The scan, as it was read."""


def judge(
    local: LocalMap, pose: NDArray[np.float64], sweep: Sweep, *, by_side: bool = False
) -> MatchQuality:
    """Say how well a scan fits from a pose (3,).

    Where the robot may be in the next room, the back of a wall must not pass for its front: judge
    `by_side`. Near to where it was the directions of surfaces say less than their places: those of
    sparse scans are vague, and those of bent ones wrong.
    """
    classes = local.classify(pose, sweep if by_side else _without_sides(sweep))
    count = len(classes)
    explained = int(np.count_nonzero(classes == EXPLAINED))
    known = count - int(np.count_nonzero(classes == UNKNOWN))
    match, share = explained / max(known, 1), explained / max(count, 1)
    fits = match >= PARAMS.min_match and explained >= PARAMS.min_explained_points
    contradicts = (known - explained) / max(count, 1)
    is_good = fits and share >= PARAMS.min_explained
    is_new = not is_good and contradicts < PARAMS.max_new_contradicts
    return MatchQuality(match, share, is_good, is_new, contradicts)


def _without_sides(sweep: Sweep) -> Sweep:
    """Return a scan without the directions of its surfaces."""
    return replace(sweep, cloud=Cloud(sweep.cloud.points, np.zeros_like(sweep.cloud.normals)))


def _better(match: ScanMatch, other: ScanMatch, lead: float) -> ScanMatch:
    """Return another match where it is good and better by more than a lead, else the first."""
    is_better = other.quality.value > match.quality.value + lead
    return other if other.quality.is_good and is_better else match


def _closer(local: LocalMap, match: ScanMatch, other: ScanMatch, lead: float) -> ScanMatch:
    """Return another match where it is good and by more than a lead closer, else the first."""
    is_closer = _closely(local, other) - _closely(local, match) > lead
    return other if other.quality.is_good and is_closer else match


def _closely(local: LocalMap, match: ScanMatch) -> float:
    """Return the share of a scan's points that lie on surfaces, 0 ... 1, stricter than `judge`."""
    classes = local.classify(match.pose, match.sweep, PARAMS.close_m)
    return int(np.count_nonzero(classes == EXPLAINED)) / max(len(classes), 1)


class ScanMatcher:
    """The pose and its covariance, by odometry and by scans.

    Args:
        max_range_m: farther echoes are left out.
    """

    def __init__(self, max_range_m: float) -> None:
        self._max_range_m = max_range_m
        self.pose = np.zeros(3)
        self.covariance = np.diag([PARAMS.min_dev_m**2, PARAMS.min_dev_m**2, PARAMS.min_dev_rad**2])
        self.is_slipping = False
        """Whether the newest scan contradicted the wheels."""
        self.slip = SlipDetector()
        self._odometry_step = Pose2D.identity()
        self._before = np.zeros(3)
        self._motion = np.zeros(3)
        self._usual_match = PARAMS.min_match
        self._unseen = (0.0, 0.0)
        # Where the robot was when that began.
        self._seen_at = np.zeros(3)
        # Log-likelihood of the scans since then against where the wheels led.
        self._against = 0.0

    def reset(self, pose: NDArray[np.float64], devs: tuple[float, float]) -> None:
        """Start at a pose (3,) with these standard deviations [m, rad]."""
        self.pose = pose.copy()
        self.covariance = np.diag([devs[0] ** 2, devs[0] ** 2, devs[1] ** 2])
        self._unseen = (0.0, 0.0)
        self._before, self._motion = self.pose, np.zeros(3)
        self._seen_at, self._against = self.pose, 0.0
        self.slip = SlipDetector()

    def loosen(self, devs: tuple[float, float]) -> None:
        """Let the pose be less sure by these standard deviations [m, rad]."""
        self.covariance = self.covariance + np.diag([devs[0] ** 2, devs[0] ** 2, devs[1] ** 2])

    def move(self, new_map_T_old_map: NDArray[np.float64]) -> None:
        """Move along with the map, by a motion (3,) of its frame."""
        self.pose = compose(new_map_T_old_map, self.pose)
        self._seen_at = compose(new_map_T_old_map, self._seen_at)
        self.covariance = turned(self.covariance, float(new_map_T_old_map[2]))

    def predict(self, step: Pose2D, covariance: NDArray[np.float64]) -> None:
        """Carry the pose through one odometry step with a covariance (3, 3)."""
        distance_m = math.hypot(step.x, step.y)
        self._before, self._odometry_step = self.pose, step
        moved = compose(self.pose, step.as_array())
        carry = np.eye(3)
        carry[0, 2] = -(moved[1] - self.pose[1])
        carry[1, 2] = moved[0] - self.pose[0]
        self.covariance = carry @ self.covariance @ carry.T + covariance
        self.pose = moved
        self._unseen = (self._unseen[0] + distance_m, self._unseen[1] + abs(step.yaw))

    @property
    def devs(self) -> tuple[float, float]:
        """Standard deviations of place [m] and heading [rad]."""
        across = math.sqrt(float(np.linalg.eigvalsh(self.covariance[:2, :2])[-1]))
        return across, math.sqrt(float(self.covariance[2, 2]))

    def correct(self, local: LocalMap, sweep: Sweep, scan: ScanInput) -> ScanMatch:
        """Correct the pose by a scan where it fits; where not, the odometry holds.

        Args:
            local: the surfaces nearby.
            sweep: the scan, corrected for the motion that the wheels reported.
            scan: the same as it was measured.

        Returns:
            Where it fits best if that was good enough, else where the odometry leads.
        """
        devs = self.devs
        match = self._match(local, sweep, self.pose, devs[0])
        match = self._try_as_before(local, sweep, match)
        match = self._try_stood(local, sweep, match)
        if self._is_doubtful(match, devs):
            match = self._search(local, sweep, match, devs)
        if self._may_be_bent(match, scan):
            match = self._try_unbent(local, scan, match)
        if match.quality.is_good and self._has_rival(local, match):
            quality = replace(match.quality, is_good=False, is_ambiguous=True)
            match = replace(match, quality=quality)
        if match.quality.is_good and self._is_outweighed(match):
            match = replace(match, quality=replace(match.quality, is_good=False))
        if match.quality.is_good:
            self._accept(match)
        else:
            step_m = math.hypot(self._odometry_step.x, self._odometry_step.y)
            share = min(step_m / PARAMS.own_word_m, 1.0)
            self._against = max(self._against - share * match.quality.log_likelihood, 0.0)
        return match if match.quality.is_good else replace(match, pose=self.pose)

    def _may_be_bent(self, match: ScanMatch, scan: ScanInput) -> bool:
        """Say whether wheels may have spun during the scan, which bends it."""
        turn_rad = abs(angle_difference(scan.odom_T_base_end.yaw, scan.odom_T_base.yaw))
        is_below = match.quality.match < self._usual_match - PARAMS.below_when_bent
        return self.is_slipping or turn_rad > PARAMS.bent_rad or is_below

    def _is_doubtful(self, match: ScanMatch, devs: tuple[float, float]) -> bool:
        """Say whether the scan may well fit better somewhere else nearby."""
        away = match.pose - self.pose
        return bool(
            not match.quality.is_good
            or match.quality.match < self._usual_match - PARAMS.below_usual
            or math.hypot(away[0], away[1]) > 0.1 + 3.0 * devs[0]
            or abs(math.remainder(away[2], 2.0 * math.pi)) > 0.1 + 3.0 * devs[1]
        )

    def _try_as_before(self, local: LocalMap, sweep: Sweep, match: ScanMatch) -> ScanMatch:
        """Try where the robot would be had it moved on as before, if the wheels say otherwise."""
        kept_on = compose(self._before, self._motion)
        away = between(self.pose, kept_on)
        if math.hypot(away[0], away[1]) < PARAMS.apart_m and abs(away[2]) < PARAMS.apart_rad:
            return match
        other = self._match(local, sweep, kept_on, 0.05)
        return self._likelier(match, _better(match, other, PARAMS.lead_as_before))

    def _try_stood(self, local: LocalMap, sweep: Sweep, match: ScanMatch) -> ScanMatch:
        """Try whether the robot stood while the wheels turned, where few surfaces tell."""
        away = between(self._before, match.pose)
        if math.hypot(away[0], away[1]) < PARAMS.stood_m:
            return match
        prior = inverse(motion_covariance(0.0, 0.0))
        pose, information = local.align(self._before, sweep.cloud, self._before, prior, 0.2)
        other = ScanMatch(pose, information, judge(local, pose, sweep), sweep)
        wanted = PARAMS.lead_stood_again if self.slip.message else PARAMS.lead_stood
        count = len(sweep.cloud.points)
        enough = max(wanted, PARAMS.min_telling_points / max(count, 1))
        # Who drives on sees what nobody saw: about a step's share of how far one sees.
        far_m = float(np.quantile(np.hypot(*sweep.cloud.points.T), PARAMS.far_share))
        enough += math.hypot(away[0], away[1]) / max(far_m, 1e-3)
        return self._likelier(match, _closer(local, match, other, enough))

    def _try_unbent(self, local: LocalMap, scan: ScanInput, match: ScanMatch) -> ScanMatch:
        """Try whether the wheels turned during the scan and the robot did not: that bends it."""
        sweep = read_sweep(scan, self._max_range_m, is_still=True)
        return _closer(local, match, self._match(local, sweep, match.pose, 0.05), PARAMS.lead_still)

    def _match(
        self, local: LocalMap, sweep: Sweep, start: NDArray[np.float64], dev_m: float
    ) -> ScanMatch:
        """Align from a start; odometry that contradicts the scan counts less."""
        reach_m = min(max(3.0 * dev_m, 0.2), 0.5)
        prior = self._prior(start)
        pose, information = local.align(start, sweep.cloud, self.pose, prior, reach_m)
        weaker = self._prior(pose)
        if weaker[0, 0] < 0.9 * prior[0, 0]:
            pose, information = local.align(pose, sweep.cloud, self.pose, weaker, 0.15)
        return ScanMatch(pose, information, judge(local, pose, sweep), sweep)

    def _prior(self, pose: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the information (3, 3) of the odometry, less where a pose contradicts it."""
        believed = PARAMS.slipping_information if self.is_slipping else 1.0
        prior = inverse(self.covariance) * believed
        away = pose - self.pose
        away[2] = math.remainder(away[2], 2.0 * math.pi)
        length = math.sqrt(float(away @ prior @ away))
        return prior * min(1.0, PARAMS.contradiction / max(length, 1e-9)) ** 2

    def _search(
        self, local: LocalMap, sweep: Sweep, match: ScanMatch, devs: tuple[float, float]
    ) -> ScanMatch:
        """Search the neighbourhood for a pose from which the scan fits clearly better."""
        distance_m, turn_rad = self._unseen
        reach_m = PARAMS.min_window[0] + PARAMS.window_per_m * distance_m
        reach_rad = PARAMS.min_window[1] + PARAMS.window_per_rad * turn_rad
        window = (
            min(max(4.0 * devs[0], reach_m), PARAMS.max_window[0]),
            min(max(4.0 * devs[1], reach_rad), PARAMS.max_window[1]),
        )
        cloud = _without_sides(sweep).cloud
        found = whole(local.correlate(cloud, self.pose, window, PARAMS.min_score, PARAMS.pull))
        if found is None:
            return match
        other = self._match(local, sweep, found[0], 0.05)
        return self._likelier(match, _better(match, other, PARAMS.lead))

    def _has_rival(self, local: LocalMap, match: ScanMatch) -> bool:
        """Say whether a scan that shows slip fits another way round as well: walls are square."""
        if self._prior_cost(match) < PARAMS.doubtful_cost:
            return False
        cloud = _without_sides(match.sweep).cloud
        for quarters in (1, 2, 3):
            yaw = float(match.pose[2]) + 0.5 * math.pi * quarters
            if abs(math.remainder(yaw - self.pose[2], 2.0 * math.pi)) > PARAMS.max_window[1]:
                continue
            around = np.array([self.pose[0], self.pose[1], yaw])
            search = local.correlate(cloud, around, PARAMS.rival_window, PARAMS.min_score, 0.0)
            found = whole(search)
            if found is None:
                continue
            rival = self._match(local, match.sweep, found[0], 0.05)
            if self._likelihood(rival) > self._likelihood(match) - PARAMS.rival_lead:
                return True
        return False

    def _is_outweighed(self, match: ScanMatch) -> bool:
        """Say whether the scans since the last match speak against the wheels, all in all.

        After a turn that they missed, the corridor across may look like the one before.
        """
        is_by_wheels = self._prior_cost(match) < PARAMS.slip_cost
        against = self._against - match.quality.log_likelihood
        return is_by_wheels and against > PARAMS.slip_cost

    def _likelier(self, match: ScanMatch, other: ScanMatch) -> ScanMatch:
        """Return another match where scan and odometry together speak for it, else the first."""
        if other is match:
            return match
        lead = self._likelihood(other) - self._likelihood(match)
        is_near = self._prior_cost(other) < PARAMS.slip_cost
        return other if is_near or lead > PARAMS.slip_lead else match

    def _likelihood(self, match: ScanMatch) -> float:
        """Return the log-likelihood of scan and odometry from a pose, but for a constant."""
        return match.quality.log_likelihood - self._prior_cost(match)

    def _prior_cost(self, match: ScanMatch) -> float:
        """Return what the odometry says against a pose; wheels that slip say nothing."""
        believed = PARAMS.slipping_information if self.is_slipping else 1.0
        away = match.pose - self.pose
        away[2] = math.remainder(away[2], 2.0 * math.pi)
        dev_m, dev_rad = PARAMS.gate_devs
        together = self.covariance / believed + np.diag(np.square([dev_m, dev_m, dev_rad]))
        most = PARAMS.carried_cost if self._is_beyond_wheels(match.pose) else PARAMS.slip_cost
        return min(0.5 * float(away @ np.linalg.solve(together, away)), most)

    def _is_beyond_wheels(self, pose: NDArray[np.float64]) -> bool:
        """Say whether the wheels cannot have driven there since the last match, as they report."""
        spare_m = PARAMS.carried_m + 3.0 * self.devs[0]
        moved, reported = (pose - self._seen_at)[:2], (self.pose - self._seen_at)[:2]
        back_m = -float(moved @ reported) / max(math.hypot(*reported.tolist()), 1e-9)
        is_too_far = math.hypot(*moved.tolist()) > self._unseen[0] + spare_m
        return is_too_far or back_m > spare_m

    def _accept(self, match: ScanMatch) -> None:
        """Take a match over; it is slip where the wheels said something else."""
        away = match.pose - self.pose
        away[2] = math.remainder(away[2], 2.0 * math.pi)
        together = self.covariance + np.linalg.inv(match.information + np.eye(3))
        self.is_slipping = float(away @ np.linalg.solve(together, away)) > PARAMS.contradiction**2
        self._motion = between(self._before, match.pose)
        self.slip.update(self._odometry_step, self._motion)
        self._usual_match += PARAMS.smoothing * (match.quality.match - self._usual_match)
        self.pose = self._seen_at = match.pose
        self._unseen, self._against = (0.0, 0.0), 0.0
        floor = np.diag([PARAMS.min_dev_m**2, PARAMS.min_dev_m**2, PARAMS.min_dev_rad**2])
        self.covariance = inverse(inverse(self.covariance) + match.information) + floor
