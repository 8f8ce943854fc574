"""Publishes what the localizer says after each scan."""

from functools import partial

import numpy as np
from numpy.typing import NDArray

from trolley import topics
from trolley.geometry import Pose2D
from trolley.messages import (
    BeamClasses,
    Candidate,
    ParticleCloud,
    PoseEstimate,
    SuspectLine,
    Suspects,
    Transform,
)
from trolley.messages.types import floats_to_bytes
from trolley.runtime.service import Service
from trolley_localizer.core import Localizer
from trolley_localizer.estimate import Estimate
from trolley_localizer.map_server import LoadedMap

BEAMS_PERIOD_NS = 95_000_000
"""Shortest time between two messages of beams, a little less than the contract's period [ns]."""
PARTICLES_PERIOD_NS = 195_000_000
"""Shortest time between two messages of particles, a little less than the contract's period [ns].
"""


class PosePublisher:
    """Publishes `tf/odom`, `pose`, `beams`, `particles` and `suspects`."""

    def __init__(self, service: Service) -> None:
        self._service = service
        self._beams_ns = -BEAMS_PERIOD_NS
        self._particles_ns = -PARTICLES_PERIOD_NS
        self._suspects: list[SuspectLine] = []
        self._is_correction_told = False
        self.latest: PoseEstimate = unknown_pose(0, None, "no map is loaded yet")
        """What is known of the pose."""
        self.map_T_odom: Pose2D | None = None
        """The same of the odometry's beginning."""

    def begin_on_map(self, name: str) -> None:
        """Know nothing of the pose on a new map."""
        self.forget_told()
        self.map_T_odom = None
        self.latest = unknown_pose(self._service.stamp_ns, name, "searching the whole map")

    def forget_told(self) -> None:
        """Publish `tf/odom`, and the suspected mirrors if any, again with the next scan."""
        self._suspects = []
        self._is_correction_told = False

    def forget_odometry(self) -> None:
        """Know nothing of where the odometry of a new run of base begins."""
        self.map_T_odom = None

    def publish(self, loaded: LoadedMap, estimate: Estimate) -> None:
        """Publish an estimate and what goes with it."""
        service, stamp_ns = self._service, estimate.stamp_ns
        if not (estimate.is_held and self._is_correction_told):
            self._publish_correction(estimate)
        if estimate.state != self.latest.state:
            service.log.info("Pose", state=estimate.state, why=estimate.message or "the scan fits")
        self.latest = pose_message(estimate, loaded.name)
        self.map_T_odom = estimate.map_T_odom
        service.publish(topics.POSE, self.latest)
        if stamp_ns - self._beams_ns >= BEAMS_PERIOD_NS:
            self._beams_ns = stamp_ns
            service.publish_if_heard(topics.BEAMS, partial(beams_message, estimate))
        if stamp_ns - self._particles_ns >= PARTICLES_PERIOD_NS:
            self._particles_ns = stamp_ns
            make = partial(particle_message, stamp_ns, loaded.localizer)
            service.publish_if_heard(topics.PARTICLES, make)

    def say_no_map(self) -> None:
        """Publish that there is no map any more."""
        self.latest = unknown_pose(self._service.stamp_ns, None, "there is no map")
        self._service.publish(topics.POSE, self.latest)

    def _publish_correction(self, estimate: Estimate) -> None:
        """Publish `tf/odom` if the pose is known."""
        if estimate.map_T_odom is not None and estimate.state in ("localized", "unsure"):
            transform = odom_transform(estimate.stamp_ns, estimate.map_T_odom)
            self._service.publish(topics.TF, transform, "odom")
            self._is_correction_told = True

    def publish_suspects(self, localizer: Localizer) -> None:
        """Publish which mirrors are suspected, if that has changed."""
        lines = suspect_lines(localizer)
        if lines == self._suspects:
            return
        if len(lines) != len(self._suspects):
            self._service.log.info("Mirrors suspected", count=len(lines))
        self._suspects = lines
        stamp_ns = self._service.stamp_ns
        self._service.publish(topics.SUSPECTS, Suspects(stamp_ns=stamp_ns, lines=lines))


def pose_message(estimate: Estimate, map_name: str) -> PoseEstimate:
    """Return an estimate as the contract's `pose`."""
    covariance = estimate.covariance
    return PoseEstimate(
        stamp_ns=estimate.stamp_ns,
        map=map_name,
        pose=estimate.map_T_base,
        covariance=None if covariance is None else [float(value) for value in covariance.ravel()],
        state=estimate.state,
        match=_share(estimate.match),
        spread=estimate.spread,
        candidates=[
            Candidate(pose=one.map_T_base, match=_share(one.match)) for one in estimate.candidates
        ],
        wants_turn=estimate.wants_turn,
        message=estimate.message,
        off_map=estimate.off_m,
    )


def unknown_pose(stamp_ns: int, map_name: str | None, message: str) -> PoseEstimate:
    """Return the `pose` of a robot of which nothing is known yet."""
    return PoseEstimate(
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
) -> PoseEstimate:
    """Return the `pose` of a robot whose pose was set and has not been checked yet."""
    return PoseEstimate(
        stamp_ns=stamp_ns,
        map=map_name,
        pose=pose.wrapped(),
        covariance=[float(value) for value in covariance.ravel()],
        state="unsure",
        match=0.0,
        spread=0.0,
        message="checking the pose against the scan",
    )


def odom_transform(stamp_ns: int, map_T_odom: Pose2D) -> Transform:
    """Return `tf/odom`."""
    return Transform(stamp_ns=stamp_ns, parent="map", child="odom", pose=map_T_odom)


def beams_message(estimate: Estimate) -> BeamClasses:
    """Return what each beam met as `beams`."""
    classes = memoryview(estimate.beam_classes.tobytes())
    return BeamClasses(stamp_ns=estimate.stamp_ns, classes=classes)


def particle_message(stamp_ns: int, localizer: Localizer) -> ParticleCloud:
    """Return the hypotheses as `particles`."""
    poses, weights = localizer.particles()
    return ParticleCloud(
        stamp_ns=stamp_ns, poses=floats_to_bytes(poses), weights=floats_to_bytes(weights)
    )


def suspect_lines(localizer: Localizer) -> list[SuspectLine]:
    """Return the suspected mirrors as the lines of `suspects`."""
    return [
        SuspectLine(points=[(float(x), float(y)) for x, y in points], score=_share(score))
        for points, score in localizer.map_watch.suspects()
    ]


def _share(value: float) -> float:
    return min(max(value, 0.0), 1.0)
