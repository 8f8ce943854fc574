"""From the core's results to messages."""

from trolley import messages as m
from trolley.geometry import Pose2D
from trolley.gridmap import GridMap
from trolley.messages.types import floats_to_bytes
from trolley_localizer.core import Localizer
from trolley_localizer.estimate import Estimate


def pose_message(estimate: Estimate, map_name: str) -> m.PoseEstimate:
    """Return an estimate as the contract's `pose`."""
    covariance = estimate.covariance
    return m.PoseEstimate(
        stamp_ns=estimate.stamp_ns,
        map=map_name,
        pose=estimate.map_T_base,
        covariance=None if covariance is None else [float(value) for value in covariance.ravel()],
        state=estimate.state,
        match=_share(estimate.match),
        spread=estimate.spread,
        candidates=[
            m.Candidate(pose=one.map_T_base, match=_share(one.match)) for one in estimate.candidates
        ],
        wants_turn=estimate.wants_turn,
        message=estimate.message,
    )


def unknown_pose(stamp_ns: int, map_name: str | None, message: str) -> m.PoseEstimate:
    """Return the `pose` of a robot of which nothing is known yet."""
    return m.PoseEstimate(
        stamp_ns=stamp_ns,
        map=map_name,
        pose=None,
        covariance=None,
        state="searching",
        match=0.0,
        spread=0.0,
        message=message,
    )


def odom_transform(stamp_ns: int, map_T_odom: Pose2D) -> m.Transform:
    """Return `tf/odom`."""
    return m.Transform(stamp_ns=stamp_ns, parent="map", child="odom", pose=map_T_odom)


def particle_message(stamp_ns: int, localizer: Localizer) -> m.ParticleCloud:
    """Return the hypotheses as `particles`."""
    poses, weights = localizer.particles()
    return m.ParticleCloud(
        stamp_ns=stamp_ns, poses=floats_to_bytes(poses), weights=floats_to_bytes(weights)
    )


def suspect_lines(localizer: Localizer) -> list[m.SuspectLine]:
    """Return the suspected mirrors as the lines of `suspects`."""
    return [
        m.SuspectLine(points=[(float(x), float(y)) for x, y in points], score=_share(score))
        for points, score in localizer.suspects()
    ]


def map_message(stamp_ns: int, grid: GridMap) -> m.OccupancyGrid:
    """Return a map as the contract's `map`."""
    return m.OccupancyGrid(
        stamp_ns=stamp_ns,
        name=grid.name,
        frame="map",
        resolution=grid.resolution,
        width=grid.cols,
        height=grid.rows,
        origin=grid.origin,
        cells=memoryview(grid.cells.tobytes()),
    )


def map_info(grid: GridMap) -> m.MapInfo:
    """Return what a map is, without its cells."""
    return m.MapInfo(
        name=grid.name,
        frame="map",
        resolution=grid.resolution,
        width=grid.cols,
        height=grid.rows,
        origin=grid.origin,
    )


def _share(value: float) -> float:
    return min(max(value, 0.0), 1.0)
