"""Places beside an estimate, which replace it once the views speak for them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley.config.localizer import LocalizerConfig
from trolley.geometry import Pose2D
from trolley_localizer.matching.global_search import Place, is_near
from trolley_localizer.matching.hypotheses import Hypotheses, Hypothesis, Votes
from trolley_localizer.matching.likelihood_field import LikelihoodField
from trolley_localizer.matching.map_matcher import BeamSet, MapMatcher


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


RIVALS = RivalParams()


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
