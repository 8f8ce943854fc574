"""Following the robot from scan to scan on the surfaces round about it."""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D, angle_difference
from trolley.scanning.front_end import ScanInput
from trolley_mapper.kernels.layout import Cloud
from trolley_mapper.kernels.surfels import EXPLAINED, UNKNOWN
from trolley_mapper.slam.local_map import LocalMap
from trolley_mapper.slam.pose_graph import between, compose, inverse
from trolley_mapper.slam.slip_detector import Slipping
from trolley_mapper.slam.sweep import Sweep, read_sweep

# Odometry between two scans: deviation whatever it says, and as a share of what it says.
_STILL_M = 0.01
_STILL_RAD = 0.01
_SHARE = 0.12
_TURN_SHARE = 0.12
_TURN_PER_M = 0.04
# The covariance is never believed to be smaller than this [m, rad].
_LEAST_DEV_M = 0.004
_LEAST_DEV_RAD = 0.002
# Beyond so many standard deviations odometry and scan contradict each other.
_CONTRADICTION = 3.0
# Wheels that slipped at the last scan are believed so much less at the next: else they carry the
# pose along little by little where the scan does not show it well.
_BELIEVED_SLIPPING = 0.05
# How good a match has to be: see `Verdict`.
GOOD_MATCH = 0.6
_GOOD_EXPLAINED = 0.25
_MIN_EXPLAINED = 15
# A scan that shows what was not seen before contradicts by at most this share of its points.
_NEW_CONTRADICTS = 0.15
# Windows of the search where the scan does not fit where it is expected.
_LEAST_WINDOW = (0.35, 0.3)
_MOST_WINDOW = (2.0, 1.0)
# Wheels that spin report a way that was not driven; some report reversing as driving on.
_WINDOW_PER_M = 2.0
_WINDOW_PER_RAD = 1.0
_LEAST_SCORE = 0.4
_PULL = 0.08
_LEAD = 0.05
# A match by so much below the usual one is doubted.
_BELOW_USUAL = 0.1
_SMOOTHING = 0.05
# Where odometry and the motion so far lead that far apart, both are tried [m, rad].
_APART_M = 0.05
_APART_RAD = 0.06
_LEAD_AS_BEFORE = 0.03
# Where wheels may have spun during the scan, which bends it by so much [rad] or makes it fit by so
# much less than usual: how much better it must fit when it is read as one from a standing robot.
_BENT_RAD = 0.03
_BELOW_WHEN_BENT = 0.03
_LEAD_STILL = 0.07
_CLOSE_M = 0.04
# A step from which on it is tried whether the robot stood [m], and how much better the scan must
# fit then, as a share, less where it stood just before, and in points.
_STOOD_M = 0.02
_LEAD_STOOD = 0.03
_LEAD_STOOD_AGAIN = 0.01
_MIN_TELLING = 3


@dataclass(frozen=True, slots=True)
class Verdict:
    """How well a scan fits from a pose."""

    match: float
    """Share of the points in known space that are explained, 0 ... 1."""
    explained: float
    """Share of all points that are explained, 0 ... 1."""
    is_good: bool
    """It fits, and shows enough of what is known to be sure."""
    is_new: bool = False
    """It shows little of what is known, and nothing speaks against where the odometry leads."""

    @property
    def value(self) -> float:
        """One number to compare poses by."""
        return self.match * min(1.0, 2.0 * self.explained)


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """Where a scan fits: map_T_base (3,), information of the scan (3, 3) in `map`, how well."""

    pose: NDArray[np.float64]
    information: NDArray[np.float64]
    verdict: Verdict
    sweep: Sweep
    """The scan, as it was read."""


def judge(
    local: LocalMap, pose: NDArray[np.float64], sweep: Sweep, *, by_side: bool = False
) -> Verdict:
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
    fits = match >= GOOD_MATCH and explained >= _MIN_EXPLAINED
    contradicts = (known - explained) / max(count, 1)
    is_good = fits and share >= _GOOD_EXPLAINED
    return Verdict(match, share, is_good, not is_good and contradicts < _NEW_CONTRADICTS)


def _without_sides(sweep: Sweep) -> Sweep:
    """Return a scan without the directions of its surfaces."""
    return replace(sweep, cloud=Cloud(sweep.cloud.points, np.zeros_like(sweep.cloud.normals)))


def _better(fit: Fit, other: Fit, lead: float) -> Fit:
    """Return another fit where it is good and better by more than a lead, else the first."""
    is_better = other.verdict.value > fit.verdict.value + lead
    return other if other.verdict.is_good and is_better else fit


def _closer(local: LocalMap, fit: Fit, other: Fit, lead: float) -> Fit:
    """Return another fit where it is good and by more than a lead closer, else the first."""
    is_closer = _closely(local, other) - _closely(local, fit) > lead
    return other if other.verdict.is_good and is_closer else fit


def _closely(local: LocalMap, fit: Fit) -> float:
    """Return the share of a scan's points that lie on surfaces, 0 ... 1, stricter than `judge`."""
    classes = local.classify(fit.pose, fit.sweep, _CLOSE_M)
    return int(np.count_nonzero(classes == EXPLAINED)) / max(len(classes), 1)


class Tracker:
    """The pose and its covariance, by odometry and by scans.

    Args:
        max_range_m: farther echoes are left out.
    """

    def __init__(self, max_range_m: float) -> None:
        self._max_range_m = max_range_m
        self.pose = np.zeros(3)
        self.covariance = np.diag([_LEAST_DEV_M**2, _LEAST_DEV_M**2, _LEAST_DEV_RAD**2])
        self.is_slipping = False
        """Whether the newest scan contradicted the wheels."""
        self.slipping = Slipping()
        self._told = Pose2D.identity()
        self._before = np.zeros(3)
        self._motion = np.zeros(3)
        self._usual_match = GOOD_MATCH
        self._unseen = (0.0, 0.0)

    def reset(self, pose: NDArray[np.float64], devs: tuple[float, float]) -> None:
        """Start at a pose (3,) that may be so far off [m, rad]."""
        self.pose = pose.copy()
        self.covariance = np.diag([devs[0] ** 2, devs[0] ** 2, devs[1] ** 2])
        self._unseen = (0.0, 0.0)
        self._before, self._motion = self.pose, np.zeros(3)
        self.slipping = Slipping()

    def loosen(self, devs: tuple[float, float]) -> None:
        """Take into account that the robot may have moved so far [m, rad]."""
        self.covariance = self.covariance + np.diag([devs[0] ** 2, devs[0] ** 2, devs[1] ** 2])

    def predict(self, step: Pose2D) -> None:
        """Carry the pose through one odometry step."""
        way = math.hypot(step.x, step.y)
        self._before, self._told = self.pose, step
        moved = compose(self.pose, step.as_array())
        carry = np.eye(3)
        carry[0, 2] = -(moved[1] - self.pose[1])
        carry[1, 2] = moved[0] - self.pose[0]
        self.covariance = carry @ self.covariance @ carry.T + self.noise(way, abs(step.yaw))
        self.pose = moved
        self._unseen = (self._unseen[0] + way, self._unseen[1] + abs(step.yaw))

    @staticmethod
    def noise(way_m: float, turn_rad: float) -> NDArray[np.float64]:
        """Return the covariance (3, 3) of an odometry step, the same in all directions."""
        dev_m = _STILL_M + _SHARE * way_m
        dev_rad = _STILL_RAD + _TURN_SHARE * turn_rad + _TURN_PER_M * way_m
        return np.diag([dev_m**2, dev_m**2, dev_rad**2])

    @property
    def devs(self) -> tuple[float, float]:
        """Standard deviations of place [m] and heading [rad]."""
        across = math.sqrt(float(np.linalg.eigvalsh(self.covariance[:2, :2])[-1]))
        return across, math.sqrt(float(self.covariance[2, 2]))

    def look(self, local: LocalMap, sweep: Sweep, scan: ScanInput) -> Fit:
        """Correct the pose by a scan where it fits; where not, the odometry holds.

        Args:
            local: the surfaces near by.
            sweep: the scan, corrected for the motion that the wheels told.
            scan: the same as it was measured.

        Returns:
            Where it fits best if that was good enough, else where the odometry leads.
        """
        devs = self.devs
        fit = self._fit(local, sweep, self.pose, devs[0])
        fit = self._as_before(local, sweep, fit)
        fit = self._as_stood(local, sweep, fit)
        if self._is_doubtful(fit, devs):
            fit = self._search(local, sweep, fit, devs)
        turned = abs(angle_difference(scan.odom_T_base_end.yaw, scan.odom_T_base.yaw)) > _BENT_RAD
        is_below = fit.verdict.match < self._usual_match - _BELOW_WHEN_BENT
        if self.is_slipping or turned or is_below:
            fit = self._as_still(local, scan, fit)
        if fit.verdict.is_good:
            self._accept(fit)
        return fit if fit.verdict.is_good else replace(fit, pose=self.pose)

    def _is_doubtful(self, fit: Fit, devs: tuple[float, float]) -> bool:
        """Say whether the scan may well fit better somewhere else near by."""
        away = fit.pose - self.pose
        return bool(
            not fit.verdict.is_good
            or fit.verdict.match < self._usual_match - _BELOW_USUAL
            or math.hypot(away[0], away[1]) > 0.1 + 3.0 * devs[0]
            or abs(math.remainder(away[2], 2.0 * math.pi)) > 0.1 + 3.0 * devs[1]
        )

    def _as_before(self, local: LocalMap, sweep: Sweep, fit: Fit) -> Fit:
        """Try where the robot would be had it gone on as before, if wheels say otherwise."""
        kept_on = compose(self._before, self._motion)
        away = between(self.pose, kept_on)
        if math.hypot(away[0], away[1]) < _APART_M and abs(away[2]) < _APART_RAD:
            return fit
        return _better(fit, self._fit(local, sweep, kept_on, 0.05), _LEAD_AS_BEFORE)

    def _as_stood(self, local: LocalMap, sweep: Sweep, fit: Fit) -> Fit:
        """Try whether the robot stood while the wheels turned, where few surfaces tell."""
        away = between(self._before, fit.pose)
        if math.hypot(away[0], away[1]) < _STOOD_M:
            return fit
        prior = inverse(self.noise(0.0, 0.0))
        pose, information = local.align(self._before, sweep.cloud, self._before, prior, 0.2)
        other = Fit(pose, information, judge(local, pose, sweep), sweep)
        wanted = _LEAD_STOOD_AGAIN if self.slipping.message else _LEAD_STOOD
        enough = max(wanted, _MIN_TELLING / max(len(sweep.cloud.points), 1))
        return _closer(local, fit, other, enough)

    def _as_still(self, local: LocalMap, scan: ScanInput, fit: Fit) -> Fit:
        """Try whether the wheels turned during the scan and the robot did not: that bends it."""
        sweep = read_sweep(scan, self._max_range_m, is_still=True)
        return _closer(local, fit, self._fit(local, sweep, fit.pose, 0.05), _LEAD_STILL)

    def _fit(self, local: LocalMap, sweep: Sweep, start: NDArray[np.float64], dev_m: float) -> Fit:
        """Align from a start; odometry that contradicts the scan counts less."""
        reach_m = min(max(3.0 * dev_m, 0.2), 0.5)
        prior = self._prior(start)
        pose, information = local.align(start, sweep.cloud, self.pose, prior, reach_m)
        weaker = self._prior(pose)
        if weaker[0, 0] < 0.9 * prior[0, 0]:
            pose, information = local.align(pose, sweep.cloud, self.pose, weaker, 0.15)
        return Fit(pose, information, judge(local, pose, sweep), sweep)

    def _prior(self, pose: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the information (3, 3) of the odometry, less where a pose contradicts it."""
        prior = inverse(self.covariance) * (_BELIEVED_SLIPPING if self.is_slipping else 1.0)
        away = pose - self.pose
        away[2] = math.remainder(away[2], 2.0 * math.pi)
        length = math.sqrt(float(away @ prior @ away))
        return prior * min(1.0, _CONTRADICTION / max(length, 1e-9)) ** 2

    def _search(self, local: LocalMap, sweep: Sweep, fit: Fit, devs: tuple[float, float]) -> Fit:
        """Look round about for a pose from which the scan fits clearly better."""
        way, turn = self._unseen
        window = (
            min(max(4.0 * devs[0], _LEAST_WINDOW[0] + _WINDOW_PER_M * way), _MOST_WINDOW[0]),
            min(max(4.0 * devs[1], _LEAST_WINDOW[1] + _WINDOW_PER_RAD * turn), _MOST_WINDOW[1]),
        )
        cloud = _without_sides(sweep).cloud
        found = local.correlate(cloud, self.pose, window, _LEAST_SCORE, _PULL)
        if found is None:
            return fit
        return _better(fit, self._fit(local, sweep, found[0], 0.05), _LEAD)

    def _accept(self, fit: Fit) -> None:
        """Take a fit over; count it as slip where the wheels said something else."""
        away = fit.pose - self.pose
        away[2] = math.remainder(away[2], 2.0 * math.pi)
        together = self.covariance + np.linalg.inv(fit.information + np.eye(3))
        self.is_slipping = float(away @ np.linalg.solve(together, away)) > _CONTRADICTION**2
        self._motion = between(self._before, fit.pose)
        self.slipping.look(self._told, self._motion)
        self._usual_match += _SMOOTHING * (fit.verdict.match - self._usual_match)
        self.pose = fit.pose
        self._unseen = (0.0, 0.0)
        floor = np.diag([_LEAST_DEV_M**2, _LEAST_DEV_M**2, _LEAST_DEV_RAD**2])
        self.covariance = inverse(inverse(self.covariance) + fit.information) + floor
