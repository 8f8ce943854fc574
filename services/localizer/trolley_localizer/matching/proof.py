"""Whether driving on shows that a place which was found is the right one."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D
from trolley_localizer.matching.hypotheses import is_new_view
from trolley_localizer.matching.map_matcher import BeamSet, MapMatcher, MatchScore
from trolley_localizer.matching.seen_surface import NewSurface, SeenSurface


@dataclass(frozen=True, slots=True)
class ProofParams:
    """When a place that was found without a prior is believed."""

    between: float = 0.65
    """Support above which a view speaks for a place, below which against it. Of 206 best places on
    maps of other houses 95 % had no more than 0.66 of one scan, six had 0.73 ... 0.84; they have
    less of the next. Of right ones 95 % had at least 0.79 on a recorded drive and in odd houses
    with a third of the furniture moved, 0.65 in square ones, 0.67 on a recorded drive in clutter.
    """
    lead_weight: float = 1.0
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
    0.6 where no other place is like it, if enough is seen of it."""
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
    most_new: float = 0.5
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


PROOF = ProofParams()


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
        return self._views == 0 or is_new_view(self._since_view)

    def begin(self, evidence: float, pinned: float) -> None:
        """Take into account what the scan says by which the place stood out.

        A place that no other comes near is pinned by that as well: where much stands about, a scan
        fits half as well a little beside. The arguments are those of `add`.
        """
        self.add(evidence, max(pinned, self._lead))

    def look(self, sight: Sight) -> None:
        """Take what a new view says for the place into account."""
        if self._seen is not None:
            self.add_new(sight.new_to(self._seen))
        evidence = evidence_of(sight.score, is_led=self._seen is None)
        self.add(evidence, sight.pinned())

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
        since = self._since_view
        telling = self._extent * min(1.0, pinned / PROOF.pinned)
        distance_m = math.hypot(since.x, since.y)
        newness = min(1.0, distance_m / PROOF.new_m + abs(since.yaw) / PROOF.new_rad)
        evidence += self._standing
        evidence *= telling if evidence > 0.0 else 1.0
        self._best = max(self._best, evidence)
        self._driven_m += telling * distance_m
        self._sum += evidence * (1.0 if self._views == 0 else newness)
        if self._seen is not None:
            # Rooms of the same shape fit as well in each scan as in the first: until something new
            # comes into view, all views together say no more than the best one. A room of another
            # floor between the same outer walls had a support of 0.87, one of another house 0.94.
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
