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
from trolley_localizer.matching.seen_surface import NewSurface, SeenSurface


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


@dataclass(frozen=True, slots=True)
class RivalParams:
    """When a rival replaces the estimate. All values were found by hand."""

    max_rivals: int = 4
    """Number of places that are followed beside an estimate."""
    margin: float = 0.1
    """Support below the estimate's beyond which a place is no rival, in the mean of the views."""
    give_up: float = 0.3
    """Sum over the views by which a rival must be behind to be given up: in a room that was
    furnished anew the right place was ahead for five metres, then 0.11 behind in one view."""
    take_over: float = 0.3
    """Lead in support, summed over the views, at which a rival takes over."""
    wander: float = 0.1
    """The same over the square root of their number: of two flats alike, what was moved in one and
    not in the other let that sum wander by 0.03 of it, in 570 views beyond `take_over`."""
    level: float = 0.02
    """Lead in support by one view that says nothing: of two places alike, now one fits a little
    better, now the other. In two flats alike the sum wandered to `take_over` in 400 views."""


@dataclass(frozen=True, slots=True)
class ProofParams:
    """When a place that was found without a prior is believed."""

    between: float = 0.65
    """Support above which a view speaks for a place, below which against it. Of 206 best places on
    maps of other houses 95 % had no more than 0.66 of one scan, six had 0.73 ... 0.84; they have
    less of the next. Of right ones 95 % had at least 0.79 on a recorded drive and in odd houses
    with a third of the furniture moved, 0.65 in square ones, 0.67 on a recorded drive in clutter.
    """
    lead_weight: float = 0.7
    """Weight of the lead that a place had over the next best one when it stood out, as against its
    support. On maps of other houses and floors similar rooms are many: of 1,800 best places only 37
    had a support of 0.7 and a lead of 0.1, half of these a lead of no more than 0.13. Half of the
    right ones had 0.31 and more in square houses, 0.47 on a recorded drive, 0.53 in odd houses."""
    usual_lead: float = 0.25
    """Lead that speaks neither for nor against a place."""
    most_lead: float = 0.45
    """Lead from which on it counts alike."""
    bound: float = 0.15
    """Sum over the views at which a place is right, or wrong: at once from a support of 0.8 on, of
    0.66 where no other place is like it."""
    pinned: float = 0.25
    """Certainty of the pose below which a view counts for less, in proportion: along a bare
    corridor every place fits. Right places have 0.2 ... 0.3 in rooms, less than 0.1 in corridors.
    """
    new_m: float = 0.5
    """Distance from the view before below which a view counts for less, in proportion: it shows the
    same walls again [m]."""
    new_rad: float = math.pi
    """Turn from the view before below which a view counts for less, in proportion [rad]."""
    doubt_per_m: float = 1.0
    """Growth of the bound, as a share of itself, with each metre driven before without a proof: by
    then the map may well be of another house [1/m]."""
    most_doubt: float = 1.0
    """Most that the bound grows, as a share of itself."""
    most_m: float = 2.0
    """Distance after which an undecided proof is given up [m]."""
    agreement: float = 0.2
    """Share of the beams on new surface that must end where the map says for it to speak for a
    place. Counting beams that end short of a wall, too, which are left out here, it was 0.01 in the
    mean on maps of other houses, at right places 0.73 in simulated houses with furniture moved, and
    0.62 and 0.24 on recorded drives."""
    new_weight: float = 3.0
    """Weight of what new surface says, as against views."""
    most_new: float = 0.6
    """Most that the new surface of one look says for or against a place, as a share of the bound.
    It may be a single wall that another floor of the house has as well: one look said as much as it
    took for such a place, while the views said nothing, and the robot was sure of it for 1.6 s. Or
    it lies behind furniture that is gone: one look took the right place back."""
    probation: float = 0.5
    """New surface, as a share of what was seen first, that must fit after the proof until the place
    is as good as one that was tracked all along."""
    probation_bound: float = 0.08
    """Sum over the new surface at which a place on probation is taken back: two or three looks at
    what is not as the map says."""


PARAMS = HypothesisParams()
RIVALS = RivalParams()
PROOF = ProofParams()


def _is_new_view(since: Pose2D) -> bool:
    """Say whether the robot has moved so far since the last view that a scan is a new one."""
    return math.hypot(since.x, since.y) > PARAMS.view_m or abs(since.yaw) > PARAMS.view_rad


def evidence_of(score: MatchScore, *, is_led: bool) -> float:
    """Return what a view says for a place; negative against it.

    Where the odometry has led (`is_led`) the unknown speaks neither for nor against it.
    """
    if is_led:
        return score.known * (score.tracked - PROOF.between)
    return score.value - PROOF.between


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """The newest scan, as it looks from the estimate."""

    matcher: MapMatcher
    pose: NDArray[np.float64]
    """The estimate (3,) x, y [cells], yaw [rad]."""
    beams: BeamSet
    score: MatchScore
    """Of the whole scan."""

    def pinned(self) -> float:
        """Say how firmly the scan pins the pose, 0 ... 1."""
        return self.matcher.pinned(self.pose, self.beams)

    def new_to(self, seen: SeenSurface) -> NewSurface:
        """Return what the scan shows that none before has shown."""
        return seen.add(self.pose, self.beams)


class Proof:
    """Whether driving on shows that a place is the right one.

    A place that a search has found is also judged by the surface that comes into view for the
    first time: rooms of the same shape fit as well in each scan as in the first, until the robot
    looks out of the door. It is on probation for as much surface again as was seen first: what is
    not where the map says takes it back before its support has fallen.

    Source:
        Wald, Sequential Tests of Statistical Hypotheses (1945), with a linear likelihood ratio;
        Page, Continuous Inspection Schemes (1954), for the probation.

    Args:
        unproven_m: distance driven before without a proof [m].
        has_prior: the odometry has led here: the unknown does not count against the place.
        seen: what the robot has seen from the place, of one that a search has found.
        lead: support by which it was ahead of the next best place.
    """

    def __init__(
        self,
        unproven_m: float = 0.0,
        *,
        has_prior: bool = False,
        seen: SeenSurface | None = None,
        lead: float = PROOF.usual_lead,
    ) -> None:
        self.has_prior = has_prior
        self._seen = seen
        self._lead = lead
        self._standing = PROOF.lead_weight * (min(lead, PROOF.most_lead) - PROOF.usual_lead)
        doubt = min(PROOF.doubt_per_m * unproven_m, PROOF.most_doubt)
        self._bound = PROOF.bound * (1.0 + doubt)
        self._sum = 0.0
        self._views = 0
        self._since_view = Pose2D.identity()
        self._driven_m = 0.0
        self._best = 0.0
        self._new = 0.0
        self._passed = 0.0

    def predict(self, step: Pose2D) -> None:
        """Note an odometry step [m, m, rad]."""
        self._since_view = self._since_view @ step

    @property
    def is_due(self) -> bool:
        """Whether the next scan is a new view."""
        return self._views == 0 or _is_new_view(self._since_view)

    def begin(self, evidence: float, pinned: float) -> None:
        """Take into account what the scan says by which the place stood out.

        A place that no other comes near is pinned by that as well: where much stands about, a scan
        fits half as well a little beside. The arguments are those of `add`.
        """
        self.add(evidence, self._extent * max(pinned, self._lead))

    def look(self, sight: Sight) -> None:
        """Take what a new view says for the place into account."""
        if self._seen is not None:
            self.add_new(sight.new_to(self._seen))
        evidence = evidence_of(sight.score, is_led=self._seen is None)
        self.add(evidence, self._extent * sight.pinned())

    @property
    def _extent(self) -> float:
        """How much was seen of the place, as a share of what tells it from all others, 0 ... 1."""
        return 1.0 if self._seen is None else self._seen.extent

    def add_new(self, new: NewSurface) -> None:
        """Take what the new surface of one look says for the place into account."""
        self._new += _evidence_of_new(new, self._bound)

    def add(self, evidence: float, pinned: float) -> None:
        """Take what a new view says for the place into account.

        Args:
            evidence: see `evidence_of`.
            pinned: how firmly the view pins the pose, 0 ... 1.
        """
        since, firmness = self._since_view, min(1.0, pinned / PROOF.pinned)
        distance_m = math.hypot(since.x, since.y)
        newness = min(1.0, distance_m / PROOF.new_m + abs(since.yaw) / PROOF.new_rad)
        evidence += self._standing
        self._best = max(self._best, evidence)
        evidence *= 1.0 if self._views == 0 else newness
        self._driven_m += firmness * distance_m
        self._sum += evidence * (firmness if evidence > 0.0 else 1.0)
        if self._seen is not None:
            # Rooms of the same shape fit as well in each scan as in the first: until something new
            # comes into view, all views together say no more than the best one. A room of another
            # floor between the same outer walls had a support of 0.87, one of another house 0.79;
            # without a lead, 0.8 is too little, and 0.95 once it has driven a metre unproven.
            self._sum = min(self._sum, self._best)
        # What spoke against a place that is kept nevertheless counts no more than once.
        self._sum = max(self._sum, -PROOF.bound)
        self._views += 1
        self._since_view = Pose2D.identity()

    @property
    def total(self) -> float:
        """Sum of what the views and the new surface say."""
        return self._sum + self._new

    @property
    def is_right(self) -> bool:
        """Whether the views speak for the place."""
        return self.total >= self._bound

    @property
    def is_against(self) -> bool:
        """Whether the views speak against the place."""
        return self.total <= -PROOF.bound

    @property
    def is_overdue(self) -> bool:
        """Whether it should have come out by now."""
        return not self.is_right and self._driven_m > PROOF.most_m

    # After it has come out.

    def put_on_probation(self) -> bool:
        """Begin to watch for what would undo the proof; returns whether there is a reason to."""
        self._new = self._passed = 0.0
        return self._seen is not None

    def inspect(self, sight: Sight) -> None:
        """Take in what a new view says about a place on probation."""
        assert self._seen is not None
        self.inspect_new(sight.new_to(self._seen))

    def inspect_new(self, new: NewSurface) -> None:
        """Take in what the new surface of one look says about a place on probation."""
        # What spoke for it before is no excuse for what speaks against it now.
        self._new = min(self._new + _evidence_of_new(new, PROOF.probation_bound), 0.0)
        self._passed += new.amount
        self._since_view = Pose2D.identity()

    @property
    def is_taken_back(self) -> bool:
        """Whether what came into view since the proof has undone it."""
        return self._new <= -PROOF.probation_bound

    @property
    def has_passed(self) -> bool:
        """Whether enough has come into view since the proof."""
        return self._passed >= PROOF.probation

    def reopen(self) -> None:
        """Look again for what speaks for the place; what spoke against it stays."""
        self._sum = self._best = self._driven_m = 0.0
        self._new = min(self._new, 0.0)


def _evidence_of_new(new: NewSurface, bound: float) -> float:
    """Return what the new surface of one look says for a place; negative against it.

    Args:
        new: what came into view.
        bound: what it takes.
    """
    evidence = PROOF.new_weight * new.amount * (new.agreement - PROOF.agreement)
    most = PROOF.most_new * bound
    return min(max(evidence, -most), most)


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
        is_new = _is_new_view(self._since_view)
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


@dataclass(slots=True)
class Rival(Hypothesis):
    """A place beside an estimate."""

    own: Votes
    """For the estimate, by the same scans."""
    _lowest: float = 0.0

    def vote(self, own: float, *, is_new_view: bool) -> None:
        """Take into account what a scan says for the estimate."""
        self.own.add(own, is_new_view=is_new_view)
        self._lowest = min(self._lowest, self._level_lead)

    @property
    def lead(self) -> float:
        """By how much it is ahead of the estimate, summed over the views."""
        return self.votes.total - self.own.total

    @property
    def _level_lead(self) -> float:
        """The lead, less what says nothing."""
        return self.lead - RIVALS.level * self.votes.views

    @property
    def is_ahead(self) -> bool:
        """Whether the views say that it is right, and the estimate is not.

        Source:
            Page, Continuous inspection schemes (1954): the cumulative sum from its lowest point,
            so that what only wanders about never adds up.
        """
        beyond_chance = max(RIVALS.take_over, RIVALS.wander * math.sqrt(self.votes.views))
        return min(self.lead, self._level_lead - self._lowest) >= beyond_chance

    @property
    def is_behind(self) -> bool:
        """Whether the views say that it is wrong: one of them may well mislead."""
        return self.lead < -max(RIVALS.give_up, RIVALS.margin * self.votes.views)


class Rivals:
    """Follows other places beside an estimate until the views tell which is right."""

    def __init__(
        self, field: LikelihoodField, matcher: MapMatcher, config: LocalizerConfig
    ) -> None:
        self._places = Hypotheses[Rival](field, matcher, config)
        self._resolution = field.resolution

    def add(self, places: Sequence[Place], own: float) -> None:
        """Add places that a search found elsewhere to those that are followed.

        Args:
            places: none of them near the estimate, best first.
            own: support of the estimate by the same scan, 0 ... 1.
        """
        near = [p for p in places if p.support.value >= own - RIVALS.margin]
        rivals = [
            Rival(p.pose.copy(), Votes(p.support.value), p.support.match, Votes(own)) for p in near
        ]
        self._places.add(rivals, RIVALS.max_rivals)

    def clear(self) -> None:
        """Give up all of them."""
        self._places.clear()

    def predict(self, step: Pose2D) -> None:
        """Carry all rivals through one odometry step [m, m, rad]."""
        self._places.predict(step)

    def update(self, beams: BeamSet, pose: NDArray[np.float64], own: float) -> None:
        """Take one scan into account.

        Args:
            beams: of the scan.
            pose: the estimate (3,) [cells, rad].
            own: support of the estimate, 0 ... 1.
        """
        view = self._places.update(beams)
        for rival in view.seen:
            rival.vote(own, is_new_view=view.is_new)
        self._places.items = [
            rival
            for rival in self._places.items
            if not rival.is_behind and not is_near(rival.pose, pose, self._resolution)
        ]

    @property
    def exist(self) -> bool:
        """Whether some place explains the views about as well as the estimate."""
        return bool(self._places.items)

    @property
    def is_stale(self) -> bool:
        """Whether the robot has moved far since the last search."""
        return self._places.is_stale

    @property
    def mean_lead(self) -> float:
        """By how much the best is ahead of the estimate and the rest, in the mean of the views."""
        if not self.exist:
            return -math.inf
        best = self._places.items[0]
        return min(self._places.lead, best.lead / best.votes.views)

    def winner(self) -> Rival | None:
        """Return the place that stands out from the estimate and all others, or None."""
        best = self._places.winner()
        return best if best is not None and best.is_ahead else None
