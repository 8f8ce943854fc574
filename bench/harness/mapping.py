"""Run a mapper over a drive, its jobs at once, and time both."""

import time
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D
from trolley.scanning import ScanInput
from trolley_mapper.slam.estimate import MapEstimate
from trolley_mapper.slam.mapper import Mapper


@dataclass(frozen=True, slots=True)
class MappedDrive:
    """What a mapper made of a drive, and what it cost.

    Attributes:
        poses: map_T_base at each scan, as the finished map has them.
        step_s: (scans,) processor time of each step [s].
        jobs_s: processor time of all searches and closures [s].
        mapping_share: share of the scans at which it was mapping, not searching or lost.
    """

    poses: list[Pose2D]
    step_s: NDArray[np.float64]
    jobs_s: float
    mapping_share: float


def map_drive(mapper: Mapper, scans: Iterable[ScanInput]) -> MappedDrive:
    """Map a drive; loops are searched and closed at once."""
    anchors, step_s, jobs_s, mapped = [], [], 0.0, 0
    for scan in scans:
        began_s = time.process_time()
        estimate = mapper.step(scan)
        step_s.append(time.process_time() - began_s)
        assert isinstance(estimate, MapEstimate)
        began_s = time.process_time()
        job = mapper.take_job()
        if job is not None:
            mapper.finish(job.run())
        jobs_s += time.process_time() - began_s
        mapped += estimate.state == "mapping"
        anchors.append(mapper.anchor(estimate.pose))
    poses = [mapper.moved(anchor) for anchor in anchors]
    return MappedDrive(poses, np.array(step_s), jobs_s, mapped / len(anchors))
