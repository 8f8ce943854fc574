"""Run a mapper over a drive, its jobs between the scans, and time both."""

import time
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D
from trolley.scanning import ScanInput
from trolley.slices import is_left
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
        step_s: (scans,) processor time of each step, and of taking over what jobs found [s].
        slice_s: (slices,) processor time of each slice of searches and closures [s].
    """

    poses: list[Pose2D]
    states: list[State]
    step_s: NDArray[np.float64]
    slice_s: NDArray[np.float64]

    @property
    def mapping_share(self) -> float:
        """Share of the scans at which it was mapping, not searching or lost."""
        return self.states.count("mapping") / len(self.states)


def map_drive(mapper: Mapper, scans: Iterable[ScanInput]) -> MappedDrive:
    """Map a drive; a job is done as often as a lidar would scan."""
    anchors, states, step_s, slice_s = [], [], [], []
    last_ns = 0
    for scan in scans:
        began_s = time.process_time()
        estimate = mapper.step(scan)
        step_s.append(time.process_time() - began_s)
        assert isinstance(estimate, MapEstimate)
        states.append(estimate.state)
        # Before the map moves under it.
        anchors.append(mapper.anchor(estimate.pose))
        for _ in range(min(max((scan.stamp_ns - last_ns) // JOB_EVERY_NS, 1), MAX_JOBS)):
            job = mapper.take_job()
            if job is None:
                break
            slices, is_more = job.slices(), True
            while is_more:
                began_s = time.process_time()
                is_more = is_left(slices)
                slice_s.append(time.process_time() - began_s)
            began_s = time.process_time()
            mapper.finish(job)
            step_s[-1] += time.process_time() - began_s
        last_ns = scan.stamp_ns
    poses = [mapper.moved(anchor) for anchor in anchors]
    return MappedDrive(poses, states, np.array(step_s), np.array(slice_s))
