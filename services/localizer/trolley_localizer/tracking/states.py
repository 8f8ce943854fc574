"""The two states of the localizer: it searches, or it follows one pose."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

from trolley.config.localizer import LocalizerConfig
from trolley.geometry import Pose2D
from trolley_localizer.matching.global_search import Place
from trolley_localizer.matching.hypotheses import Hypotheses, Hypothesis, hypothesis_at
from trolley_localizer.matching.map_matcher import MatchScore
from trolley_localizer.matching.proof import PROOF, Proof, Sight, evidence_of
from trolley_localizer.matching.rivals import Rivals
from trolley_localizer.tracking.tracking_state import TrackingMonitor


@dataclass(frozen=True, slots=True)
class FollowingParams:
    """When the localizer replaces or drops a pose. All values were found by hand."""

    loyalty: float = 0.15
    """Support that an estimate is given in advance once it has proven right and no beam contradicts
    it: odometry seldom loses it, while furniture that was moved may well make another place fit
    better."""
    loyalty_astray: float = 0.05
    """Share of beams that end nowhere behind walls at which all of `loyalty` is gone."""
    tried_m: float = 0.5
    """Distance after which a given pose that the map explains poorly is believed [m]."""
    least_known: float = 0.5
    """Share of beams ending on what the map knows below which the robot is off the map."""
    search_known: float = 0.8
    """Share of beams ending on what the map knows below which a search asks too much of the true
    place."""
    known_smoothing_s: float = 0.4
    """Time constant of that share [s]."""
    trusted_m: float = 5.0
    """Distance off the map from which on a robot that comes back must prove where it is [m]."""
    searched_m: float = 0.5
    """Distance since the last search within which a place is believed if the search found none
    beside it [m]."""
    doubted_m: float = 3.0
    """Distance in doubt after which an estimate may be wrong after all [m]."""
    most_doubted_m: float = 20.0
    """The same for one that was right for as long: the odometry has not led it astray by then, and
    in a room that was furnished anew another place may well fit better [m]."""


PARAMS = FollowingParams()


@dataclass(slots=True)
class Searching:
    """The robot may be anywhere; the places that a search has found are followed."""

    places: Hypotheses[Hypothesis]
    has_result: bool = False
    """Whether a search has been completed since; without one there are no places."""
    led: Pose2D = field(default_factory=Pose2D.identity)
    """Where the odometry has led since [m, m, rad]."""

    def predict(self, step: Pose2D) -> None:
        """Note an odometry step [m, m, rad]."""
        self.places.predict(step)
        self.led = self.led @ step

    def take_result(self, places: Sequence[Place]) -> None:
        """Follow what a search has found, best first, beside what was found before.

        What one search overlooks is not forgotten; what was seen before it counts as one view.
        """
        for item in self.places.items:
            item.votes.condense()
        self.places.add([hypothesis_at(place) for place in places])
        self.has_result = True


class Following:
    """One pose is followed; the monitor says whether it is believed.

    Args:
        config: of the localizer.
        rivals: other places that may be the right one.
    """

    def __init__(self, config: LocalizerConfig, rivals: Rivals) -> None:
        self._config = config
        self.rivals = rivals
        self.monitor = TrackingMonitor(config)
        self.is_proven = False
        """Whether no other place explained the scans as well."""
        self.proof: Proof | None = None
        """Must come out before the estimate is believed: it was found without a prior, or the robot
        may have been carried off."""
        self.probation: Proof | None = None
        """The proof of a place that a search has found, while what comes into view may undo it."""
        self.is_found = False
        """It was found by a search: the odometry has not led to it."""
        self.is_searched = False
        """Whether the whole map has been searched since the proof began."""
        self.unsearched_m: float | None = 0.0
        """Distance driven since the first scan after the last search delivered, with turns counted
        in [m]; None until that scan."""
        self.off_m = 0.0
        """Distance driven off the map since it ended [m]."""
        self._driven_m = 0.0
        self._right_m = 0.0
        self._doubted_m = 0.0
        self._known = 1.0

    @property
    def is_off_map(self) -> bool:
        """Whether the map does not know what most beams end on."""
        return self._known < PARAMS.least_known

    @property
    def is_trusted(self) -> bool:
        """Whether the odometry has led here, without a break, from where it was right for a way."""
        return self.is_proven and self._right_m > PARAMS.doubted_m

    @property
    def is_led(self) -> bool:
        """Whether the scans lead, since the map does not know or not explain what they show."""
        return self.is_off_map or (self.is_trusted and self.monitor.is_contradicted)

    def predict(self, step: Pose2D, driven_m: float) -> None:
        """Note an odometry step [m, m, rad], and how far it is with its turn."""
        self.rivals.predict(step)
        for proof in (self.proof, self.probation):
            if proof is not None:
                proof.predict(step)
        self.unsearched_m = 0.0 if self.unsearched_m is None else self.unsearched_m + driven_m
        self._driven_m += driven_m
        self._doubted_m = self._doubted_m + driven_m if self.monitor.doubts else 0.0
        if self.is_proven and self.probation is None and self.monitor.state == "localized":
            self._right_m += driven_m
        if self._doubted_m > min(max(self._right_m, PARAMS.doubted_m), PARAMS.most_doubted_m):
            self._forget_that_it_was_right()
        if self.is_off_map:
            self.off_m += math.hypot(step.x, step.y)

    def update_known(self, known: float, elapsed_s: float) -> None:
        """Take in which share of a scan's beams ends on what the map knows, 0 ... 1."""
        share = min(1.0, elapsed_s / PARAMS.known_smoothing_s)
        self._known += share * (known - self._known)

    def come_back(self) -> bool:
        """Note that the robot is on the map; True if from so far off that it must prove where."""
        must_prove = self.off_m > PARAMS.trusted_m and self.proof is None
        if must_prove:
            self.proof = Proof(has_prior=True)
            self.is_proven = self.is_searched = False
        self.off_m = 0.0
        return must_prove

    def _forget_that_it_was_right(self) -> None:
        self.is_proven, self._right_m, self._doubted_m = False, 0.0, 0.0

    def forget_prior(self) -> None:
        """Note that the robot may have been carried off: the odometry's word is worth nothing."""
        self._forget_that_it_was_right()
        self.is_searched = False
        self.proof, self.probation = Proof(), None
        self.rivals.clear()

    # Whether it is the right place.

    def preferred(self, score: MatchScore) -> float:
        """Return the support of the estimate, with a bonus for having been right so far."""
        if self.proof is not None and not self.is_found:
            return PROOF.between + evidence_of(score, is_led=True)
        if not self.is_proven:
            return score.value
        return score.value + PARAMS.loyalty * max(0.0, 1.0 - score.astray / PARAMS.loyalty_astray)

    def confirm(self, support: float) -> bool:
        """Note that no place explains the scans as well as the estimate; True if that vouches."""
        if self.proof is not None:
            return False
        if support < self._config.good_support and self._driven_m < PARAMS.tried_m:
            return False
        self.is_proven = True
        if support < self._config.poor_support:
            return False
        self.monitor.vouch(support)
        return True

    def prove(self, sight: Sight) -> bool:
        """Take what a scan says for a place without a prior into account; True once it is proven.

        Args:
            sight: from the estimate.
        """
        if self.is_off_map:
            return False
        self._inspect(sight)
        proof = self.proof
        if proof is None:
            return False
        if proof.is_due:
            proof.look(sight)
        if proof.is_right and (self.unsearched_m or 0.0) > PARAMS.searched_m:
            self.is_searched = False  # Other places may fit better from here.
        if not proof.is_right or not self.is_searched or self.rivals.exist:
            return False
        self.probation = proof if proof.put_on_probation() else None
        self.proof, self.is_found, self.is_proven = None, False, True
        self.monitor.vouch(sight.score.tracked)
        return True

    def _inspect(self, sight: Sight) -> None:
        """Take a place that was proven back if what comes into view speaks against it."""
        probation = self.probation
        if probation is None or not probation.is_due:
            return
        probation.inspect(sight)
        if probation.is_taken_back:
            probation.reopen()
            self.proof, self.probation, self.is_found = probation, None, True
            self._forget_that_it_was_right()
            self.is_searched = False
        elif probation.has_passed:
            self.probation = None

    def is_disproven(self) -> bool:
        """Say whether the place that was to be proven is given up.

        One that a search has found is at the first sign. One from before the robot may have been
        carried off may have somebody in front of it for a moment. One to which the odometry has led
        is kept, and the whole map searched again, until another place stands out.
        """
        proof = self.proof
        if proof is None or not self.is_searched:
            return False
        if proof.has_prior:
            if proof.is_overdue:
                self.proof, self.is_searched = Proof(has_prior=True), False
            return False
        return proof.is_overdue or (proof.is_against and self.is_found)

    def needs_search(self, *, is_due: bool) -> bool | None:
        """Say whether to search the whole map for a better place; None: as before.

        Args:
            is_due: a search may bring what the last ones did not.
        """
        if self.proof is None and self._known < PARAMS.search_known:
            return None
        if self.proof is not None and not self.is_searched:
            return True
        if self.monitor.doubts and is_due:
            return not self.rivals.exist or self.rivals.is_stale
        return None
