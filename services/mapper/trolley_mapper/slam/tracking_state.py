"""Whether the pose may be believed, and so whether the map may grow."""

import math
from dataclasses import dataclass

from trolley_mapper.slam import sentences
from trolley_mapper.slam.estimate import State
from trolley_mapper.slam.scan_matcher import MatchQuality


@dataclass(frozen=True, slots=True)
class TrackingParams:
    """What it takes to believe a pose. Set by hand."""

    max_step_s: float = 0.3
    """A pause of the lidar proves nothing: it counts as a bad match for at most this long [s]."""
    found_match: float = 0.85
    """A lost robot is somewhere else: what fits no better than this where it was is chance."""
    proof_m: float = 0.4
    """A pose that was given or found is believed after this distance without a bad match [m]."""


PARAMS = TrackingParams()


@dataclass(frozen=True, slots=True)
class TrackingState:
    """Mapping, unsure or lost, with what led there; each scan leads to the next state."""

    name: State = "mapping"
    bad_s: float = 0.0
    """Time without a good match [s]."""
    proof_m: float = math.inf
    """Distance driven without a bad match since the pose was given or found [m]."""

    @classmethod
    def unproven(cls) -> "TrackingState":
        """A pose was given or found, and must be proven."""
        return cls("unsure", proof_m=0.0)

    @classmethod
    def lost(cls) -> "TrackingState":
        """There is no pose to prove."""
        return cls("lost", proof_m=0.0)

    def after(
        self, quality: MatchQuality, elapsed_s: float, distance_m: float, lost_after_s: float
    ) -> "TrackingState":
        """Return the state after a match.

        Args:
            quality: of the match.
            elapsed_s: time since the one before [s].
            distance_m: driven since then [m].
            lost_after_s: time without a good match after which the robot is lost [s].
        """
        was_lost = self.name == "lost"
        if was_lost and quality.match < PARAMS.found_match:
            return self
        if quality.is_good or (quality.is_new and self.name == "mapping"):
            proof_m = 0.0 if was_lost else self.proof_m + distance_m
            is_proven = proof_m >= PARAMS.proof_m
            return TrackingState("mapping" if is_proven else "unsure", 0.0, proof_m)
        bad_s = self.bad_s + min(elapsed_s, PARAMS.max_step_s)
        # A pose that was found and fails at once was the wrong one.
        is_lost = was_lost or bad_s > lost_after_s or self.proof_m < PARAMS.proof_m
        return TrackingState("lost" if is_lost else "unsure", bad_s, self.proof_m)

    @property
    def is_lost(self) -> bool:
        """Whether the robot must be searched for."""
        return self.name == "lost"

    @property
    def message(self) -> str:
        """What is the matter, in one sentence; empty when all is well."""
        return {"mapping": "", "unsure": sentences.UNSURE, "lost": sentences.LOST}[self.name]
