"""Run a mapper over a drive, its jobs between the scans, and time both."""

import time
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D
from trolley.scanning import ScanInput
from trolley_mapper.slam.estimate import MapEstimate, State
from trolley_mapper.slam.mapper import Mapper

JOB_EVERY_NS = 100_000_000
"""A lidar scans ten times a second, and with each scan a job may be done."""
MAX_JOBS = 30
"""Jobs between two scans at most."""


@dataclass(frozen=True, slots=True)
class MappedDrive:
    """What a mapper made of a drive, and what it cost.

    Attributes:
        poses: map_T_base at each scan, as the finished map has them.
        states: what the mapper said of itself at each scan.
        step_s: (scans,) processor time of each step [s].
        job_s: (scans,) processor time of the longest search or closure after each step [s].
        jobs_s: processor time of all of them [s].
    """

    poses: list[Pose2D]
    states: list[State]
    step_s: NDArray[np.float64]
    job_s: NDArray[np.float64]
    jobs_s: float

    @property
    def mapping_share(self) -> float:
        """Share of the scans at which it was mapping, not searching or lost."""
        return self.states.count("mapping") / len(self.states)


def map_drive(mapper: Mapper, scans: Iterable[ScanInput]) -> MappedDrive:
    """Map a drive; a job is done as often as a lidar would scan."""
    anchors, states, step_s, job_s = [], [], [], []
    jobs_s, last_ns = 0.0, 0
    for scan in scans:
        began_s = time.process_time()
        estimate = mapper.step(scan)
        step_s.append(time.process_time() - began_s)
        assert isinstance(estimate, MapEstimate)
        states.append(estimate.state)
        # Before the map moves under it.
        anchors.append(mapper.anchor(estimate.pose))
        longest_s = 0.0
        for _ in range(min(max((scan.stamp_ns - last_ns) // JOB_EVERY_NS, 1), MAX_JOBS)):
            began_s = time.process_time()
            job = mapper.take_job()
            if job is None:
                break
            mapper.finish(job.run())
            took_s = time.process_time() - began_s
            longest_s, jobs_s = max(longest_s, took_s), jobs_s + took_s
        job_s.append(longest_s)
        last_ns = scan.stamp_ns
    poses = [mapper.moved(anchor) for anchor in anchors]
    return MappedDrive(poses, states, np.array(step_s), np.array(job_s), jobs_s)
