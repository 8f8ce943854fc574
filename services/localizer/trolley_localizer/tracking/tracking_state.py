"""Whether an estimate is to be believed, from how well the scans support it over time."""

from dataclasses import dataclass
from typing import Literal

from trolley.config.localizer import LocalizerConfig

TrackingState = Literal["searching", "localized", "unsure", "lost"]


@dataclass(frozen=True, slots=True)
class TrackingParams:
    """When an estimate is believed. All values were found by hand."""

    scans_to_believe: int = 3
    """Number of scans in a row that must support a pose before it is believed."""
    smoothing_s: float = 0.4
    """Time constant of the support: a person walking by is no reason to doubt [s]."""
    max_step_s: float = 0.3
    """Longest time between two scans that counts: a gap says nothing about the pose [s]."""
    silent_s: float = 1.0
    """Time without seeing anything that the map knows after which the pose is unsure [s]."""
    vouched_s: float = 10.0
    """Time for which a search that found nothing better vouches for a pose with little support [s].
    """
    vouched_slack: float = 0.15
    """Drop of the support at which it no longer vouches."""
    grace_s: float = 1.0
    """Time for which a believed estimate stays so while it is checked against other places, unless
    its support is poor [s]."""
    untried_support: float = 0.2
    """Support down to which a given pose that was never believed is kept as unsure: where furniture
    was moved about it, only driving on can show whether it is right."""
    sudden_drop: float = 0.2
    """Drop below the usual support that is a reason to search, however high the support is."""
    usual_s: float = 8.0
    """Time constant of the usual support [s]."""


PARAMS = TrackingParams()


@dataclass(frozen=True, slots=True)
class Evidence:
    """What one scan says about the estimate."""

    support: float
    """Share of explained beams less contradictions, 0 ... 1."""
    spread_m: float
    """Spread of the hypotheses [m]."""
    is_silent: bool
    """Whether there are too few echoes, or too few where the map knows what is there, to say
    anything."""
    is_open: bool = False
    """Whether this is the right place is still to be proven."""
    is_trusted: bool = False
    """Whether the odometry has led here from where the estimate was right: it is never lost."""
    known: float = 1.0
    """Share of the beams that end where the map knows what is there."""

    @property
    def uncontradicted(self) -> float:
        """Share of all beams that do not speak against the estimate, 0 ... 1."""
        return 1.0 - self.known * (1.0 - self.support)


class TrackingMonitor:
    """Follows the support of one estimate over time.

    A new estimate, of which nothing is known yet, gets a new monitor.
    """

    def __init__(self, config: LocalizerConfig) -> None:
        self._config = config
        self.state: TrackingState = "unsure"
        self.support = 0.0
        self._uncontradicted = 0.0
        self._scans = 0
        self._good_scans = 0
        self._poor_s = 0.0
        self._doubt_s = 0.0
        self._vouched_s = 0.0
        self._vouched_support = 0.0
        self._was_believed = False
        self._usual = 0.0
        self._silent_s = 0.0

    def set_config(self, config: LocalizerConfig) -> None:
        """Judge by other thresholds."""
        self._config = config

    @property
    def doubts(self) -> bool:
        """Whether the estimate has been in doubt for long enough to look elsewhere."""
        return self._doubt_s > 0.25 * self._config.lost_after_s

    @property
    def is_contradicted(self) -> bool:
        """Whether the scans have not fitted the map for long."""
        return self._poor_s >= self._config.lost_after_s

    def vouch(self, support: float) -> None:
        """Note that a search of the whole map found no better place.

        Args:
            support: of the estimate in the searched scan, 0 ... 1.
        """
        self._vouched_s = PARAMS.vouched_s
        self._vouched_support = support
        self._usual = support
        self._poor_s = 0.0
        self._doubt_s = 0.0

    def update(self, evidence: Evidence, elapsed_s: float) -> TrackingState:
        """Take one scan into account and return the state.

        Args:
            evidence: of the scan.
            elapsed_s: robot time since the scan before [s].
        """
        step_s = min(max(elapsed_s, 0.0), PARAMS.max_step_s)
        self._vouched_s = max(0.0, self._vouched_s - step_s)
        if evidence.is_silent:
            self._silent_s += step_s
            if self._silent_s > PARAMS.silent_s and self.state == "localized":
                self._good_scans = 0
                self.state = "unsure"
            return self.state
        self._silent_s = 0.0
        self._weigh(evidence, step_s)
        return self._decide(evidence)

    def _weigh(self, evidence: Evidence, step_s: float) -> None:
        """Add one scan to the sums."""
        config = self._config
        share = min(1.0, step_s / PARAMS.smoothing_s) if self._scans > 0 else 1.0
        self._scans += 1
        self.support += share * (evidence.support - self.support)
        self._uncontradicted += share * (evidence.uncontradicted - self._uncontradicted)
        if evidence.support >= self._wanted:
            self._good_scans += 1
        elif evidence.support < config.poor_support:
            self._good_scans = 0
        is_doubtful = (
            self.support < max(self._wanted, self._usual - PARAMS.sudden_drop)
            or evidence.spread_m > config.max_spread_m
        )
        self._doubt_s = self._doubt_s + step_s if is_doubtful else 0.0
        if self.state == "localized" and not is_doubtful:
            self._usual += min(1.0, step_s / PARAMS.usual_s) * (self.support - self._usual)
        self._poor_s = self._poor_s + step_s if self._uncontradicted < self._least else 0.0

    @property
    def _least(self) -> float:
        """Support below which the estimate is lost when it lasts."""
        poor = self._config.poor_support
        if self._vouched_s > 0.0:
            return min(poor, self._vouched_support - PARAMS.vouched_slack)
        return poor if self._was_believed else min(poor, PARAMS.untried_support)

    @property
    def _wanted(self) -> float:
        """Support from which on the estimate is believed."""
        good = self._config.good_support
        if self._vouched_s <= 0.0:
            return good
        return min(
            good, max(self._config.poor_support, self._vouched_support - PARAMS.vouched_slack)
        )

    def _decide(self, evidence: Evidence) -> TrackingState:
        """Choose the state from the sums."""
        narrow = evidence.spread_m <= self._config.max_spread_m
        is_good = narrow and self.support >= self._wanted
        if self.is_contradicted:
            self.state = "unsure" if evidence.is_trusted else "lost"
        elif evidence.is_open:
            self.state = "unsure"
        elif not is_good:
            is_granted = narrow and self.support >= self._config.poor_support
            if not (self.state == "localized" and is_granted and self._doubt_s <= PARAMS.grace_s):
                self.state = "unsure"
        elif self.state != "localized" and self._good_scans >= PARAMS.scans_to_believe:
            self.state = "localized"
            self._was_believed = True
            self._usual = self.support
        return self.state
