"""Is the estimate to be believed? The state of the localizer from the support of its scans."""

from dataclasses import dataclass
from typing import Literal

from trolley.config.localizer import LocalizerConfig

State = Literal["searching", "localized", "unsure", "lost"]

# Scans in a row that must support a pose before it is believed.
_SCANS_TO_BELIEVE = 3
# Smoothing of the support over scans: a person walking by is not a reason to doubt.
_SMOOTHING_S = 0.4
# Longest time between two scans that counts: a gap in the data says nothing about the pose.
_LONGEST_STEP_S = 0.3
# So long without seeing anything, and the estimate is no longer sure [s].
_BLIND_S = 1.0
# A search that found nothing better vouches for a pose with little support for so long [s], down to
# this much below what it had then.
_VOUCHED_S = 10.0
_VOUCHED_SLACK = 0.15
# An estimate that was believed stays so for this long while it is checked against other places,
# unless its support is poor [s].
_GRACE_S = 1.0
# A pose that was told and not believed yet is kept as unsure down to this: where furniture was
# moved about it, only driving on can show whether it is right.
_UNTRIED_SUPPORT = 0.2
# A support this far below the usual one is a reason to look elsewhere, however high it is.
_SUDDEN_DROP = 0.2
_USUAL_S = 8.0


@dataclass(frozen=True, slots=True)
class Evidence:
    """What one scan says about the estimate."""

    support: float
    """Share of explained beams less contradictions, 0 ... 1."""
    spread_m: float
    """Spread of the hypotheses [m]."""
    is_blind: bool
    """Too few echoes to say anything."""


class TrackingMonitor:
    """Follows the support of one estimate over time."""

    def __init__(self, config: LocalizerConfig) -> None:
        self._config = config
        self.restart()

    def restart(self) -> None:
        """Begin with a new estimate that nothing is known of."""
        self.state: State = "unsure"
        self.support = 0.0
        self._scans = 0
        self._good_scans = 0
        self._poor_s = 0.0
        self._doubt_s = 0.0
        self._vouched_s = 0.0
        self._vouched_support = 0.0
        self._was_believed = False
        self._usual = 0.0
        self._blind_s = 0.0

    @property
    def doubts(self) -> bool:
        """Whether the estimate has been in doubt for long enough to look elsewhere."""
        return self._doubt_s > 0.25 * self._config.lost_after_s

    def vouch(self, support: float) -> None:
        """Note that a search of the whole map found no better place.

        Args:
            support: of the estimate in the searched scan, 0 ... 1.
        """
        self._vouched_s = _VOUCHED_S
        self._vouched_support = support
        self._usual = support
        self._poor_s = 0.0
        self._doubt_s = 0.0

    def look(self, evidence: Evidence, elapsed_s: float) -> State:
        """Take one scan into account and return the state.

        Args:
            evidence: of the scan.
            elapsed_s: robot time since the scan before [s].
        """
        step_s = min(max(elapsed_s, 0.0), _LONGEST_STEP_S)
        self._vouched_s = max(0.0, self._vouched_s - step_s)
        if evidence.is_blind:
            self._blind_s += step_s
            if self._blind_s > _BLIND_S and self.state == "localized":
                self._good_scans = 0
                self.state = "unsure"
            return self.state
        self._blind_s = 0.0
        self._weigh(evidence, step_s)
        return self._decide(evidence)

    def _weigh(self, evidence: Evidence, step_s: float) -> None:
        """Add one scan to the sums."""
        config = self._config
        share = min(1.0, step_s / _SMOOTHING_S) if self._scans > 0 else 1.0
        self._scans += 1
        self.support += share * (evidence.support - self.support)
        if evidence.support >= self._wanted:
            self._good_scans += 1
        elif evidence.support < config.poor_support:
            self._good_scans = 0
        is_doubtful = (
            self.support < max(self._wanted, self._usual - _SUDDEN_DROP)
            or evidence.spread_m > config.max_spread_m
        )
        self._doubt_s = self._doubt_s + step_s if is_doubtful else 0.0
        if self.state == "localized" and not is_doubtful:
            self._usual += min(1.0, step_s / _USUAL_S) * (self.support - self._usual)
        self._poor_s = self._poor_s + step_s if self.support < self._least else 0.0

    @property
    def _least(self) -> float:
        """Support below which the estimate is lost when it lasts."""
        poor = self._config.poor_support
        if self._vouched_s > 0.0:
            return min(poor, self._vouched_support - _VOUCHED_SLACK)
        return poor if self._was_believed else min(poor, _UNTRIED_SUPPORT)

    @property
    def _wanted(self) -> float:
        """Support from which on the estimate is believed."""
        good = self._config.good_support
        if self._vouched_s <= 0.0:
            return good
        return min(good, max(self._config.poor_support, self._vouched_support - _VOUCHED_SLACK))

    def _decide(self, evidence: Evidence) -> State:
        """Choose the state from the sums."""
        narrow = evidence.spread_m <= self._config.max_spread_m
        is_good = narrow and self.support >= self._wanted
        if self._poor_s >= self._config.lost_after_s:
            self.state = "lost"
        elif not is_good:
            is_granted = narrow and self.support >= self._config.poor_support
            if not (self.state == "localized" and is_granted and self._doubt_s <= _GRACE_S):
                self.state = "unsure"
        elif self.state != "localized" and self._good_scans >= _SCANS_TO_BELIEVE:
            self.state = "localized"
            self._was_believed = True
            self._usual = self.support
        return self.state
