"""Compile or load all kernels before the first scan needs them."""

import functools

import numpy as np

from trolley.config.localizer import LocalizerConfig
from trolley.geometry import Pose2D
from trolley.gridmap import GridMap
from trolley.scanning import ScanInput
from trolley_localizer.changes.change_detector import ChangeDetector
from trolley_localizer.changes.mirror_detector import MirrorDetector
from trolley_localizer.core import Localizer
from trolley_localizer.filter.wall_depth import WallDepth
from trolley_localizer.kernels import changes as kernels
from trolley_localizer.kernels.layout import Lines
from trolley_localizer.kernels.resting import count_same
from trolley_localizer.matching.likelihood_field import LikelihoodField
from trolley_localizer.matching.map_matcher import BeamSet, read_beams
from trolley_localizer.matching.seen_surface import SeenSurface


@functools.cache
def warm_up() -> None:
    """Run every kernel with the kinds of arrays that it will meet; once in a process.

    The first run on a machine compiles for some seconds; afterwards numba's cache serves.
    """
    cells = np.zeros((60, 80), np.int8)
    cells[0], cells[-1], cells[:, 0], cells[:, -1] = 100, 100, 100, 100
    grid = GridMap("warm-up", 0.05, Pose2D(0.0, 0.0, 0.0), cells)
    mirror = np.array([[1.0, 1.0], [1.0, 1.2]])
    localizer = Localizer(grid, [mirror], LocalizerConfig(), 0)
    ranges = np.full(90, 1.2, np.float32)
    ranges.flags.writeable = False  # as they come off the wire
    count_same(ranges, ranges, 0.0, 1.0, 0.1, 0.1)
    scans = [
        ScanInput(
            stamp_ns=number + 1,
            ranges=ranges,
            angle_min=-3.1,
            angle_increment=0.07,
            range_min=0.05,
            range_max=8.0,
            base_T_laser=Pose2D(0.0, 0.0, 0.0),
            odom_T_base=Pose2D(x, 0.0, 0.0),
            odom_T_base_end=Pose2D(x, 0.0, 0.0),
        )
        for number, x in enumerate((0.0, 0.2, 0.4))
    ]
    for number, scan in enumerate(scans):
        localizer.step(scan)
        job = localizer.take_job()
        if job is not None:
            localizer.finish(job.run())
        if number == 0:
            localizer.set_pose(Pose2D(2.0, 1.5, 0.0))
    # Only a robot that knows where it is looks for mirrors, and one without a pose for proofs.
    field = localizer.field
    beams = read_beams(scans[0], field.resolution, 60.0)
    SeenSurface(field).add(np.array([40.0, 30.0, 0.0]), beams)
    # Nor does one that looks all round ask how deep beams end in walls.
    points = beams.points(beams.used)
    WallDepth(field).update(points, beams.laser, np.array([40.0, 30.0, 0.0]), 0.1)
    no_lines = Lines(*(np.empty(0) for _ in range(4)))
    MirrorDetector(field).update(np.array([40.0, 30.0, 0.0]), beams, beams.classes, no_lines)
    _watch_for_changes(field, beams)


def _watch_for_changes(field: LikelihoodField, beams: BeamSet) -> None:
    """Look twice at echoes from the middle of the floor, and find a change in them."""
    changes = ChangeDetector(field, LocalizerConfig(change_after_s=60.0))
    sure, pose = np.diag([1e-6, 1e-6, 1e-6]), np.array([40.0, 30.0, 0.0])
    for stamp_ns in (1, 2):
        changes.update(stamp_ns, pose, sure, beams, beams.classes)
    where = np.array([[30, 40], [30, 0]])
    kept = np.zeros((2, kernels.COLUMNS), np.int32)
    kept[:, kernels.KIND] = kernels.APPEARED, kernels.GONE
    kept[:, kernels.VISITS], kept[:, kernels.LAST] = kernels.MOST_VISITS, 1000
    changes.change_grid.restore(where, kept)
    changes.propose(())
    grid = field.grid.cells
    mask = np.ones((2, 2), np.uint8)
    kernels.grow_gone(mask, (0, 0), changes.change_grid.arrays, grid, 0)
