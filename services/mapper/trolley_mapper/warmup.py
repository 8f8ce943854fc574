"""Compile or load all kernels before the first scan needs them."""

import functools
import gc
import math

import numpy as np

from trolley.config.mapper import MapperConfig
from trolley.geometry import Pose2D
from trolley.gridmap import GridMap
from trolley.scanning import ScanInput
from trolley.slices import whole
from trolley_mapper.explore import warmup
from trolley_mapper.slam.mapper import Mapper

_BEAMS = 120
_FAR = Pose2D(30.0, 0.0, 0.0)


@functools.cache
def warm_up() -> None:
    """Run every kernel with the kinds of arrays that it will meet; once in a process.

    The first run on a machine compiles for some seconds; afterwards numba's cache serves.
    """
    _run()
    warmup.warm_up()
    # What was loaded stays for good: it took the collector 50 to 80 ms to look through it, in the
    # middle of whatever was being done.
    gc.collect()
    gc.freeze()


def _run() -> None:
    """Map a little, and extend a map."""
    mapper = Mapper(MapperConfig())
    scans = [_scan(number, 0.35 * number) for number in range(4)]
    # Of messages, which cannot be written to.
    scans[2].ranges.setflags(write=False)
    for scan in scans:
        mapper.step(scan)
        job = mapper.take_job()
        if job is not None:
            whole(job.slices())
            mapper.finish(job)
    grid = mapper.grid()
    cells = np.where(grid.cells < 0, 0, grid.cells).astype(np.int8)
    # A robot that does not stand on the map at all is lost: it searches nearby, and then the
    # whole map.
    prior = GridMap("warm-up", grid.resolution, _FAR @ grid.origin, cells)
    extended = Mapper(MapperConfig(), prior=prior)
    for number in (2, 3):
        extended.step(scans[number])
        job = extended.take_job()
        if job is not None:
            whole(job.slices())
            extended.finish(job)


def _scan(number: int, x: float) -> ScanInput:
    """What a lidar sees at x [m] in a room of 8 x 3 m."""
    angles = -math.pi + np.arange(_BEAMS) * (2.0 * math.pi / _BEAMS)
    with np.errstate(divide="ignore"):
        ahead = np.where(np.cos(angles) > 0.0, 6.0 - x, -2.0 - x) / np.cos(angles)
        beside = np.where(np.sin(angles) > 0.0, 1.7, -1.3) / np.sin(angles)
    pose = Pose2D(x, 0.0, 0.0)
    return ScanInput(
        stamp_ns=number + 1,
        ranges=np.minimum(ahead, beside).astype(np.float32),
        angle_min=-math.pi,
        angle_increment=2.0 * math.pi / _BEAMS,
        range_min=0.05,
        range_max=12.0,
        base_T_laser=Pose2D.identity(),
        odom_T_base=pose,
        odom_T_base_end=pose,
    )
