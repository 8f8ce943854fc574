"""Turns the core's results into messages."""

import numpy as np
from numpy.typing import NDArray

from trolley import messages as m
from trolley.geometry import Pose2D
from trolley.gridmap import GridMap
from trolley.messages.types import floats_to_bytes
from trolley_localizer.changes.change_detector import Change
from trolley_localizer.core import Localizer
from trolley_localizer.estimate import Estimate
from trolley_localizer.matching.likelihood_field import LikelihoodField


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


def set_pose_message(
    stamp_ns: int, map_name: str, pose: Pose2D, covariance: NDArray[np.float64]
) -> m.PoseEstimate:
    """Return the `pose` of a robot whose pose was set and has not been checked yet."""
    return m.PoseEstimate(
        stamp_ns=stamp_ns,
        map=map_name,
        pose=pose.wrapped(),
        covariance=[float(value) for value in covariance.ravel()],
        state="unsure",
        match=0.0,
        spread=0.0,
        message="checking the pose against the scan",
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


def change_message(change: Change, field: LikelihoodField) -> m.MapChange:
    """Return a proposed change as one of `changes`."""
    strokes = field.to_map_points(change.strokes.reshape(-1, 2)).reshape(-1, 2, 2)
    points = field.to_map_points(change.outline)
    return m.MapChange(
        id=change.id,
        kind=change.kind,
        points=[_point(point) for point in points],
        strokes=[(_point(start), _point(end)) for start, end in strokes],
        width=field.resolution,
        seconds=change.seconds,
        score=_share(change.score),
        message=_sentence(change, field.resolution),
    )


def _sentence(change: Change, resolution: float) -> str:
    """Say what has changed."""
    first_row, first_col, last_row, last_col = change.box
    low, high = sorted(((last_row - first_row + 1), (last_col - first_col + 1)))
    size = f"{high * resolution:.1f} x {low * resolution:.1f} m"
    minutes = max(1, round(change.seconds / 60))
    since = "1 minute" if minutes == 1 else f"{minutes} minutes"
    what = "Something has come" if change.kind == "appeared" else "Something is gone"
    return f"{what}: about {size}, seen so for {since}."


def _point(point: NDArray[np.float64]) -> tuple[float, float]:
    x, y = (round(float(value), 4) for value in point)
    return x, y


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
