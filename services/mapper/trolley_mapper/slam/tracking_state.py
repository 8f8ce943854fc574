"""Whether the pose may be believed, and so whether the map may grow."""

import math

from trolley_mapper.slam.estimate import State
from trolley_mapper.slam.scan_matcher import Verdict

# A pause of the lidar is no proof against the pose: it counts as a bad match of at most [s].
_LONGEST_STEP_S = 0.3
# A lost robot is somewhere else: what fits no better where it was is chance.
_FOUND_MATCH = 0.85
# A place that was found anew is believed after so long a way without a bad match [m].
_PROOF_M = 0.4


class Trust:
    """Mapping, unsure or lost, by how well the scans fit.

    Args:
        lost_after_s: time without a good match after which the robot is lost [s].
    """

    def __init__(self, lost_after_s: float) -> None:
        self._lost_after_s = lost_after_s
        self._bad_s = 0.0
        self._proof_m = math.inf
        self.state: State = "mapping"

    def doubt(self, is_lost: bool) -> None:
        """Ask for proof of a pose that was told or found, or say that there is none."""
        self._bad_s, self._proof_m = 0.0, 0.0
        self.state = "lost" if is_lost else "unsure"

    def look(self, verdict: Verdict, elapsed_s: float, way_m: float) -> State:
        """Draw the consequences of a match.

        Args:
            verdict: how good it is.
            elapsed_s: time since the one before [s].
            way_m: driven since then [m].
        """
        if self.state == "lost" and verdict.match < _FOUND_MATCH:
            return self.state
        if verdict.is_good or (verdict.is_new and self.state == "mapping"):
            self._bad_s = 0.0
            self._proof_m = 0.0 if self.state == "lost" else self._proof_m + way_m
            self.state = "mapping" if self._proof_m >= _PROOF_M else "unsure"
            return self.state
        self._bad_s += min(elapsed_s, _LONGEST_STEP_S)
        if self.state != "lost":
            # What was found anew and fails at once was the wrong place.
            is_lost = self._bad_s > self._lost_after_s or self._proof_m < _PROOF_M
            self.state = "lost" if is_lost else "unsure"
        return self.state

    def may_grow(self, verdict: Verdict, is_joined: bool) -> bool:
        """Say whether a scan may become part of the map.

        Args:
            verdict: how good its match is.
            is_joined: whether the odometry leads from the newest keyframe to here.
        """
        fits = verdict.is_good or (verdict.is_new and is_joined)
        return fits and self.state == "mapping"

    @property
    def message(self) -> str:
        """What is the matter, in one sentence; empty when all is well."""
        if self.state == "lost":
            return "the scan does not fit the map made so far: lost, the map does not grow"
        if self.state == "unsure":
            return "checking the pose: drive on a little, then the map grows on"
        return ""
