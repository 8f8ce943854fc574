"""From the core's results to messages."""

import math

from trolley import messages as m
from trolley.geometry import Pose2D
from trolley_mapper.slam.estimate import MapEstimate


def pose_message(estimate: MapEstimate, map_name: str) -> m.PoseEstimate:
    """Return an estimate as the contract's `pose`."""
    covariance = [float(value) for value in estimate.covariance.ravel()]
    return m.PoseEstimate(
        stamp_ns=estimate.stamp_ns,
        map=map_name,
        pose=estimate.pose.wrapped(),
        covariance=covariance,
        state=estimate.state,
        match=min(max(estimate.match, 0.0), 1.0),
        spread=math.sqrt(max(covariance[0] + covariance[4], 0.0)),
        message=estimate.message,
    )


def odom_transform(stamp_ns: int, map_T_odom: Pose2D) -> m.Transform:
    """Return `tf/odom`."""
    return m.Transform(stamp_ns=stamp_ns, parent="map", child="odom", pose=map_T_odom.wrapped())
