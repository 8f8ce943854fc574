"""Follow several places at once while one scan cannot tell which of them is right."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from trolley.config.localizer import LocalizerConfig
from trolley.geometry import Pose2D
from trolley_localizer.matching.global_search import Place, is_near
from trolley_localizer.matching.likelihood_field import LikelihoodField
from trolley_localizer.matching.map_matcher import BeamSet, MapMatcher, MatchScore


@dataclass(frozen=True, slots=True)
class HypothesisParams:
    """When a place stands out. All values were found by hand."""

    max_places: int = 12
    """Number of places of a search that are followed."""
    view_m: float = 0.15
    """Distance from the last view beyond which a view is new [m]."""
    view_rad: float = 0.2
    """Turn from the last view beyond which a view is new [rad]."""
    stale_m: float = 0.5
    """Distance after which it is worth searching again [m]."""
    stale_rad: float = 0.7
    """Turn after which it is worth searching again [rad]."""
    give_up: float = 0.3
    """Mean support behind the best place at which a place is given up."""
    clear: float = 0.7
    """Mean support below which a place may not stand out at once: on the map of another building
    one does, too, in some scan, but not in several views."""
    few_views: int = 3
    """Number of views after which a place with less support than `clear` may stand out."""
    patient_scans: int = 30
    """Number of scans that do instead of `few_views` where the robot gets no other views."""
    lasting_lead: float = 0.8
    """Share of the usual lead that is enough after `few_views` or `patient_scans`."""
    doubtful_lead: float = 2.0
    """Factor on the lead that a place with moderate support needs."""


PARAMS = HypothesisParams()


def is_new_view(since: Pose2D) -> bool:
    """Say whether the robot has moved so far since the last view that a scan is a new one."""
    return math.hypot(since.x, since.y) > PARAMS.view_m or abs(since.yaw) > PARAMS.view_rad


@dataclass(slots=True)
class Votes:
    """What the scans say for one place: the mean of each view, summed over the views."""

    latest: float
    """Support by the newest scan, 0 ... 1."""
    views: int = 0
    """Number of views that have voted."""
    _past: float = 0.0
    _sum: float = 0.0
    _scans: int = 0

    def __post_init__(self) -> None:
        self.add(self.latest, is_new_view=True)

    @property
    def total(self) -> float:
        """Sum over the views."""
        return self._past + self._sum / self._scans

    @property
    def mean(self) -> float:
        """Mean over the views."""
        return self.total / self.views

    def condense(self) -> None:
        """Let the views so far count as one."""
        self._past, self._sum, self._scans, self.views = 0.0, self.mean, 1, 1

    def add(self, support: float, *, is_new_view: bool) -> None:
        """Take one scan into account."""
        if is_new_view:
            if self._scans > 0:
                self._past, self._sum, self._scans = self.total, 0.0, 0
            self.views += 1
        self.latest = support
        self._sum += support
        self._scans += 1


@dataclass(slots=True)
class Hypothesis:
    """One place where the robot might be, and what the views so far say about it."""

    pose: NDArray[np.float64]
    """(3,) x, y [cells], yaw [rad] in `grid`."""
    votes: Votes
    """For it."""
    match: float
    """Share of explained beams in the newest scan."""

    @property
    def mean(self) -> float:
        """Mean support over the views."""
        return self.votes.mean

    @property
    def least_support(self) -> float:
        """Support by the newest scan or the mean over the views, whichever is less."""
        return min(self.votes.latest, self.votes.mean)


def hypothesis_at(place: Place) -> Hypothesis:
    """Begin to follow a place that a search has found."""
    return Hypothesis(place.pose.copy(), Votes(place.support.value), place.support.match)


Item = TypeVar("Item", bound=Hypothesis)


class View(NamedTuple, Generic[Item]):
    """What one scan was compared with."""

    seen: list[Item]
    """The places that it voted for."""
    is_new: bool
    """Whether it shows more than the scan before."""


class Hypotheses(Generic[Item]):
    """Follows the places that searches came up with, view by view, until one stands out."""

    def __init__(
        self, field: LikelihoodField, matcher: MapMatcher, config: LocalizerConfig
    ) -> None:
        self._field = field
        self._matcher = matcher
        self._config = config
        self._scans_seen = 0
        self._since_view = Pose2D.identity()
        self._since_search = Pose2D.identity()
        self._given_up = 0.0
        self.items: list[Item] = []
        """The places, best first."""

    def add(self, items: Sequence[Item], most: int = PARAMS.max_places) -> None:
        """Add what another search has found to the places that are followed already.

        What one search overlooks is not forgotten.

        Args:
            items: best first.
            most: number of places that are followed.
        """
        self._scans_seen = 0
        self._since_search = Pose2D.identity()
        self._given_up = 0.0
        if not self.items:
            self._since_view = Pose2D.identity()
        self.items = sorted([*self.items, *items], key=lambda item: -item.mean)
        self._drop()
        del self.items[most:]

    def clear(self) -> None:
        """Give up all of them."""
        self.items = []

    def predict(self, step: Pose2D) -> None:
        """Carry all places through one odometry step [m, m, rad]."""
        self._since_view = self._since_view @ step
        self._since_search = self._since_search @ step
        cells = Pose2D(step.x / self._field.resolution, step.y / self._field.resolution, step.yaw)
        for item in self.items:
            before = Pose2D(float(item.pose[0]), float(item.pose[1]), float(item.pose[2]))
            item.pose = (before @ cells).as_array()

    def update(self, beams: BeamSet) -> View[Item]:
        """Align places with a scan and let it vote.

        A new view is compared with all places. A scan that shows what the one before has shown is
        compared with the best two, between which `winner` decides, and with one other in turn.
        """
        self._scans_seen += 1
        is_new = is_new_view(self._since_view)
        if is_new:
            self._since_view = Pose2D.identity()
        others = self.items[2:]
        due = others if is_new else others[self._scans_seen % max(len(others), 1) :][:1]
        due = [*self.items[:2], *due]
        seen: list[Item] = []
        while due:  # those that fell behind may have left the lead to what an old scan said
            for item in due:
                item.pose, support = self._aligned(item.pose, beams)
                item.votes.add(support.value, is_new_view=is_new)
                item.match = support.match
            seen += due
            self.items.sort(key=lambda item: -item.mean)
            due = [item for item in self.items[:2] if all(item is not one for one in seen)]
        self._drop()
        return View(seen, is_new)

    def _aligned(
        self, pose: NDArray[np.float64], beams: BeamSet
    ) -> tuple[NDArray[np.float64], MatchScore]:
        """Align a pose; alignment that runs off is no alignment."""
        for aligned, support in self._matcher.settle(pose, beams):
            if is_near(aligned, pose, self._field.resolution):
                return aligned, support
        return pose, self._matcher.score(pose, beams)

    def _drop(self) -> None:
        """Give up places that fell behind or coincide with a better one."""
        kept: list[Item] = []
        for item in self.items:
            if any(is_near(item.pose, other.pose, self._field.resolution) for other in kept):
                continue
            if kept and kept[0].mean - item.mean > PARAMS.give_up:
                self._given_up = max(self._given_up, item.mean)
                continue
            kept.append(item)
        self.items = kept

    @property
    def spread_m(self) -> float:
        """Root mean square distance of the places from their mean [m]."""
        if len(self.items) < 2:
            return 0.0
        points = np.stack([item.pose[:2] for item in self.items]) * self._field.resolution
        return math.sqrt(float(points.var(axis=0).sum()))

    def particles(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return the places (n, 3) x, y [m], yaw [rad] in the map frame, and weights (n,)."""
        poses = [self._field.to_map(item.pose).as_array() for item in self.items]
        latest = np.array([item.votes.latest for item in self.items], np.float32)
        total = float(latest.sum())
        weights = latest / total if total > 0.0 else np.full_like(latest, 1.0 / max(latest.size, 1))
        return np.array(poses, np.float32).reshape(-1, 3), weights

    @property
    def is_plausible(self) -> bool:
        """Whether the best place is supported by the newest scan and by the views so far."""
        return bool(self.items) and self.items[0].least_support >= self._config.poor_support

    @property
    def is_stale(self) -> bool:
        """Whether the robot has moved far since the last search."""
        since = self._since_search
        return math.hypot(since.x, since.y) > PARAMS.stale_m or abs(since.yaw) > PARAMS.stale_rad

    @property
    def lead(self) -> float:
        """By how much the best place is ahead of the next, in the mean of the views.

        Places that were given up since the last search count, with what they had by then.
        """
        best, second = ([item.mean for item in self.items[:2]] + [0.0, 0.0])[:2]
        return best - max(second, self._given_up)

    def winner(self) -> Item | None:
        """Return the place that stands out from all others, or None."""
        if not self.is_plausible:
            return None
        best = self.items[0]
        has_waited = (
            best.votes.views >= PARAMS.few_views or self._scans_seen >= PARAMS.patient_scans
        )
        if best.mean < PARAMS.clear and not has_waited:
            return None
        margin = self._config.search_margin * (PARAMS.lasting_lead if has_waited else 1.0)
        if best.least_support < self._config.good_support:
            # Where much has been moved about, only a place far ahead of all others will do.
            margin *= PARAMS.doubtful_lead
        return best if self.lead >= margin else None
