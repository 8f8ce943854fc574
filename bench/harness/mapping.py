"""Run a mapper over a drive, its jobs at once, and time both."""

import time
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D
from trolley.scanning import ScanInput
from trolley_mapper.slam.estimate import MapEstimate, State
from trolley_mapper.slam.mapper import Mapper


@dataclass(frozen=True, slots=True)
class MappedDrive:
    """What a mapper made of a drive, and what it cost.

    Attributes:
        poses: map_T_base at each scan, as the finished map has them.
        states: what the mapper said of itself at each scan.
        step_s: (scans,) processor time of each step [s].
        job_s: (scans,) processor time of the search or closure after each step [s].
    """

    poses: list[Pose2D]
    states: list[State]
    step_s: NDArray[np.float64]
    job_s: NDArray[np.float64]

    @property
    def jobs_s(self) -> float:
        """Processor time of all searches and closures [s]."""
        return float(self.job_s.sum())

    @property
    def mapping_share(self) -> float:
        """Share of the scans at which it was mapping, not searching or lost."""
        return self.states.count("mapping") / len(self.states)


def map_drive(mapper: Mapper, scans: Iterable[ScanInput]) -> MappedDrive:
    """Map a drive; loops are searched and closed at once."""
    anchors, states, step_s, job_s = [], [], [], []
    for scan in scans:
        began_s = time.process_time()
        estimate = mapper.step(scan)
        step_s.append(time.process_time() - began_s)
        assert isinstance(estimate, MapEstimate)
        # Before the map moves under it.
        anchors.append(mapper.anchor(estimate.pose))
        began_s = time.process_time()
        job = mapper.take_job()
        if job is not None:
            mapper.finish(job.run())
        job_s.append(time.process_time() - began_s)
        states.append(estimate.state)
    poses = [mapper.moved(anchor) for anchor in anchors]
    return MappedDrive(poses, states, np.array(step_s), np.array(job_s))
