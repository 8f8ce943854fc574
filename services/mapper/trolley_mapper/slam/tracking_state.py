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
    """Longest time that a gap between scans counts as a bad match: a pause of the lidar proves
    nothing [s]."""
    lost_after_m: float = 1.5
    """Distance driven without a good match after which the pose is lost where scans are few [m]."""
    proof_m: float = 0.4
    """Distance without a bad match after which a given or found pose is believed [m]."""


PARAMS = TrackingParams()


@dataclass(frozen=True, slots=True)
class TrackingState:
    """Mapping, unsure or lost, with what led there; each scan leads to the next state."""

    name: State = "mapping"
    bad_s: float = 0.0
    """Time without a good match [s]."""
    bad_m: float = 0.0
    """Distance driven without a good match [m]."""
    proof_m: float = math.inf
    """Distance driven without a bad match since the pose was given [m]."""
    breaks: bool = False
    """Whether the scans contradict what was seen before, so that a new part of the map must begin.
    """

    @classmethod
    def unproven(cls) -> "TrackingState":
        """A pose was given, and must be proven."""
        return cls("unsure", proof_m=0.0)

    @classmethod
    def lost(cls) -> "TrackingState":
        """The robot is in a part of which nobody knows yet how it lies to the map."""
        return cls("lost")

    def after(
        self, quality: MatchQuality, elapsed_s: float, distance_m: float, lost_after_s: float
    ) -> "TrackingState":
        """Return the state after a match.

        Args:
            quality: of the match, with the part that the robot is in.
            elapsed_s: time since the one before [s].
            distance_m: driven since then [m].
            lost_after_s: time without a good match after which the robot is lost [s].
        """
        if quality.is_good or (quality.is_new and self.name != "unsure"):
            if self.is_lost:
                return TrackingState.lost()
            proof_m = self.proof_m + distance_m
            is_proven = proof_m >= PARAMS.proof_m
            return TrackingState("mapping" if is_proven else "unsure", proof_m=proof_m)
        bad_s = self.bad_s + min(elapsed_s, PARAMS.max_step_s)
        bad_m = self.bad_m + distance_m
        # A pose that was given and fails at once was the wrong one.
        breaks = (
            quality.is_ambiguous
            or bad_s > lost_after_s
            or bad_m > PARAMS.lost_after_m
            or self.proof_m < PARAMS.proof_m
        )
        name: State = "lost" if breaks or self.is_lost else "unsure"
        return TrackingState(name, bad_s, bad_m, self.proof_m, breaks)

    @property
    def is_lost(self) -> bool:
        """Whether it must be found out where the robot is on the map."""
        return self.name == "lost"

    @property
    def message(self) -> str:
        """What is the matter, in one sentence; empty when all is well."""
        return {"mapping": "", "unsure": sentences.UNSURE, "lost": sentences.LOST}[self.name]
