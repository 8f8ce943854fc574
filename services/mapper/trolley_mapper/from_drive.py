"""A map from a recorded drive, without a robot: `trolley map new --from`."""

from collections.abc import Callable
from dataclasses import dataclass

from trolley.config import MapperConfig
from trolley.gridmap import GridMap
from trolley.messages import Transform
from trolley.recording.drive import Drive
from trolley.scanning import Reject, assemble
from trolley.slices import whole
from trolley_mapper.slam import sentences
from trolley_mapper.slam.mapper import Mapper

JOB_EVERY_NS = 100_000_000
"""Robot time in which the service does a job beside the scans [ns]."""
MAX_JOBS = 30
"""Number of jobs between two scans: after a long pause there is nothing left to search."""
LAST_JOBS = 300
"""Number of jobs after the last scan, in which loops are closed that were found late."""


@dataclass(frozen=True)
class Made:
    """A map, and what it was made of."""

    grid: GridMap
    num_scans: int
    num_unused: int
    """Scans without odometry, or that are damaged."""
    num_loops: int
    num_lost: int
    """Scans at which the mapper did not know where it was."""
    doubt: str
    """Where it may be wrong, in a sentence; empty if nowhere."""


def make_map(drive: Drive, tell: Callable[[float], None]) -> Made:
    """Map a drive as the service would have; the map's origin is where it begins.

    Args:
        drive: with at least one scan.
        tell: is called with the share of the drive that is done.

    Raises:
        ValueError: No scan can be used.
    """
    mapper = Mapper(MapperConfig())
    assert drive.base_T_laser is not None
    laser = Transform(stamp_ns=0, parent="base_link", child="laser", pose=drive.base_T_laser)
    num_unused = num_lost = 0
    last_ns = drive.scans[0].stamp_ns
    for number, scan in enumerate(drive.scans):
        entered = assemble(scan, drive.odometry, laser)
        estimate = entered if isinstance(entered, Reject) else mapper.step(entered)
        if isinstance(estimate, Reject):
            num_unused += 1
            continue
        num_lost += estimate.state != "mapping"
        _do_jobs(mapper, min(max((scan.stamp_ns - last_ns) // JOB_EVERY_NS, 1), MAX_JOBS))
        last_ns = scan.stamp_ns
        tell(number / len(drive.scans))
    if not mapper.num_keyframes:
        raise ValueError("none of its scans can be used")
    _do_jobs(mapper, LAST_JOBS)
    doubt = sentences.doubtful(mapper.doubtful())
    return Made(mapper.grid(), len(drive.scans), num_unused, mapper.num_loops, num_lost, doubt)


def _do_jobs(mapper: Mapper, at_most: int) -> None:
    for _ in range(at_most):
        job = mapper.take_job()
        if job is None:
            return
        whole(job.slices())
        mapper.finish(job)
