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
# A search that found nothing better vouches for a pose with little support for so long [s].
_VOUCHED_S = 10.0


@dataclass(frozen=True, slots=True)
class Evidence:
    """What one scan says about the estimate."""

    support: float
    """Share of explained beams less contradictions, 0 ... 1; 0 where the scan is blind."""
    spread_m: float
    """Spread of the hypotheses [m]."""
    is_blind: bool
    """Too few echoes to say anything."""


class Judge:
    """Follows the support of one estimate over time."""

    def __init__(self, config: LocalizerConfig) -> None:
        self._config = config
        self.state: State = "unsure"
        self.support = 0.0
        self._good_scans = 0
        self._poor_s = 0.0
        self._doubt_s = 0.0
        self._vouched_s = 0.0
        self._believed = False

    def restart(self) -> None:
        """Begin with a new estimate that nothing is known of."""
        self.state = "unsure"
        self.support = 0.0
        self._good_scans = 0
        self._poor_s = 0.0
        self._doubt_s = 0.0
        self._vouched_s = 0.0
        self._believed = False

    @property
    def doubts(self) -> bool:
        """Whether the estimate has been in doubt for long enough to look elsewhere."""
        return self._doubt_s > 0.5 * self._config.lost_after_s

    def vouch(self) -> None:
        """Note that a search of the whole map found no better place."""
        self._vouched_s = _VOUCHED_S
        self._poor_s = 0.0
        self._doubt_s = 0.0

    def look(self, evidence: Evidence, elapsed_s: float) -> State:
        """Take one scan into account and return the state.

        Args:
            evidence: of the scan.
            elapsed_s: robot time since the scan before [s].
        """
        config = self._config
        step_s = min(max(elapsed_s, 0.0), _LONGEST_STEP_S)
        share = 1.0 if self._good_scans == 0 and not self._believed else min(1.0, step_s / _SMOOTHING_S)
        self.support += share * (evidence.support - self.support)
        self._vouched_s = max(0.0, self._vouched_s - step_s)
        if evidence.support >= config.good_support:
            self._good_scans += 1
        elif evidence.support < config.poor_support:
            self._good_scans = 0
        is_good = self.support >= config.good_support and evidence.spread_m <= config.max_spread_m
        is_poor = self.support < config.poor_support and not evidence.is_blind
        self._doubt_s = 0.0 if is_good or evidence.is_blind else self._doubt_s + step_s
        self._poor_s = self._poor_s + step_s if is_poor and not self._vouched_s > 0.0 else 0.0
        if is_good and self._good_scans >= _SCANS_TO_BELIEVE:
            self._believed = True
            self.state = "localized"
        elif self._poor_s >= config.lost_after_s:
            self._believed = False
            self.state = "lost"
        elif self.state != "lost":
            self.state = "unsure"
        return self.state
