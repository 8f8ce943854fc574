"""Publishes what the localizer says after each scan."""

from trolley import topics
from trolley.messages import BeamClasses, PoseEstimate, SuspectLine, Suspects
from trolley.runtime.service import Service
from trolley_localizer.core import Localizer
from trolley_localizer.estimate import Estimate
from trolley_localizer.map_server import LoadedMap
from trolley_localizer.to_messages import (
    odom_transform,
    particle_message,
    pose_message,
    suspect_lines,
    unknown_pose,
)

BEAMS_PERIOD_NS = 95_000_000
PARTICLES_PERIOD_NS = 195_000_000
"""Shortest times between two messages, a little less than the contract's periods [ns]."""


class PosePublisher:
    """Publishes `tf/odom`, `pose`, `beams`, `particles` and `suspects`."""

    def __init__(self, service: Service) -> None:
        self._service = service
        self._beams_ns = -BEAMS_PERIOD_NS
        self._particles_ns = -PARTICLES_PERIOD_NS
        self._suspects: list[SuspectLine] = []
        self.latest: PoseEstimate = unknown_pose(0, None, "no map is loaded yet")
        """What is known of the pose."""

    def begin_on_map(self, name: str) -> None:
        """Know nothing of the pose on a new map."""
        self.forget_suspects()
        self.latest = unknown_pose(self._service.stamp_ns, name, "searching the whole map")

    def forget_suspects(self) -> None:
        """Publish the suspected mirrors again with the next scan, if there are any."""
        self._suspects = []

    def publish(self, loaded: LoadedMap, estimate: Estimate) -> None:
        """Publish an estimate and what goes with it."""
        service, stamp_ns = self._service, estimate.stamp_ns
        if estimate.map_T_odom is not None and estimate.state in ("localized", "unsure"):
            service.publish(topics.TF, odom_transform(stamp_ns, estimate.map_T_odom), "odom")
        if estimate.state != self.latest.state:
            service.log.info("Pose", state=estimate.state, why=estimate.message or "the scan fits")
        self.latest = pose_message(estimate, loaded.name)
        service.publish(topics.POSE, self.latest)
        if stamp_ns - self._beams_ns >= BEAMS_PERIOD_NS:
            self._beams_ns = stamp_ns
            classes = memoryview(estimate.beam_classes.tobytes())
            service.publish(topics.BEAMS, BeamClasses(stamp_ns=stamp_ns, classes=classes))
        if stamp_ns - self._particles_ns >= PARTICLES_PERIOD_NS:
            self._particles_ns = stamp_ns
            service.publish(topics.PARTICLES, particle_message(stamp_ns, loaded.localizer))

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
