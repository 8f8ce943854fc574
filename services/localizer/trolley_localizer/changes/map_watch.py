"""What is not as the map says: mirrors that are not on it, and what has come or gone."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from trolley.config.localizer import LocalizerConfig
from trolley.zones import is_known
from trolley_localizer.changes.change_detector import Change, ChangeDetector
from trolley_localizer.changes.mirror_detector import MirrorDetector
from trolley_localizer.kernels.layout import Lines
from trolley_localizer.matching.likelihood_field import LikelihoodField, make_lines
from trolley_localizer.matching.map_matcher import BeamSet, MapMatcher


class MapWatch:
    """Looks for mirrors and changes from poses that are believed.

    Args:
        field: of the map.
        matcher: gets the mirrors that are known and suspected.
        config: of the localizer.
    """

    def __init__(
        self, field: LikelihoodField, matcher: MapMatcher, config: LocalizerConfig
    ) -> None:
        self._field = field
        self._matcher = matcher
        self._mirrors = MirrorDetector(field)
        # Mirrors that were suspected before, polylines (n, 2) [m] in the map frame.
        self._told: list[NDArray[np.float64]] = []
        self.changes = ChangeDetector(field, config) if config.propose_changes else None

    def update(
        self,
        stamp_ns: int,
        pose: NDArray[np.float64],
        covariance: NDArray[np.float64],
        beams: BeamSet,
        classes: NDArray[np.uint8],
    ) -> None:
        """Take a scan in.

        Args:
            stamp_ns: robot time of it.
            pose: (3,) x, y [cells], yaw [rad] in `grid`.
            covariance: (3, 3) over x, y [m], yaw [rad] in the map frame.
            beams: of the scan.
            classes: (n,) of its beams.
        """
        if self._mirrors.update(pose, beams, classes, self._matcher.mirrors):
            self._tell_matcher()
        if self.changes is not None:
            self.changes.update(stamp_ns, pose, covariance, beams, classes)

    def set_mirrors(self, polylines: Sequence[NDArray[np.float64]]) -> None:
        """Replace the mirrors and panes: (n, 2) points [m] in the map frame each."""
        self._matcher.mirrors = make_lines(self._field, polylines)
        self._mirrors.reset()
        self._told = [
            line
            for line in self._told
            if not is_known(line.tolist(), [one.tolist() for one in polylines])
        ]
        self._tell_matcher()

    def suspect(self, polylines: Sequence[NDArray[np.float64]]) -> None:
        """Suspect mirrors, (n, 2) points [m] in the map frame each, until they are known."""
        self._told = list(polylines)
        self._tell_matcher()

    def _tell_matcher(self) -> None:
        found, told = self._mirrors.lines(), make_lines(self._field, self._told)
        self._matcher.suspects = Lines(*map(np.append, found, told))

    def suspects(self) -> list[tuple[NDArray[np.float64], float]]:
        """Return lines (n, 2) [m] in `map` that look like mirrors, and how sure it is (0 to 1)."""
        found = [
            (self._field.to_map_points(np.array([one.start, one.end])), one.score)
            for one in self._mirrors.suspects
        ]
        return [(line, 1.0) for line in self._told] + found

    def find_changes(self) -> list[Change]:
        """Return what seems to have come or gone since the map was made, the surest first."""
        if self.changes is None:
            return []
        self.changes.propose((self._matcher.mirrors, self._matcher.suspects))
        return self.changes.proposed
