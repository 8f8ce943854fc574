"""Watches while the robot drives whether wheels and lidar still are as robot.toml says."""

from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta, Struct

from trolley import topics
from trolley.geometry import Pose2D
from trolley.messages import Odometry, PoseEstimate, Proposal, Proposals
from trolley.messages.types import NonNegative, StampNs
from trolley.runtime.service import Service, every, on
from trolley_base.drivers import MotionSample
from trolley_base.upkeep.comparison import Comparison
from trolley_base.upkeep.evidence import Upkeep
from trolley_base.upkeep.findings import InForce, find_proposals

UPKEEP_FILE = "base_upkeep.toml"
SAVE_PERIOD_NS = 60_000_000_000
"""Time between two saves of the evidence [ns]."""
KINDS = ("lidar", "wheels", "odometry")


class SavedUpkeep(Struct, frozen=True, kw_only=True):
    """The evidence so far, and of which settings it is."""

    of: list[float]
    information: Annotated[list[float], Meta(min_length=36, max_length=36)]
    gradient: Annotated[list[float], Meta(min_length=6, max_length=6)]
    squares: NonNegative
    num_legs: NonNegative
    misfit: NonNegative
    right_until: dict[str, StampNs] = {}


class UpkeepWatch:
    """Proposes what to correct in robot.toml, once it is sure.

    Args:
        service: base.
        in_force: what base uses.
    """

    def __init__(self, service: Service, in_force: InForce) -> None:
        self._service = service
        self._in_force = in_force
        self._upkeep = Upkeep(in_force.base_T_laser)
        self._comparison = Comparison()
        self._odom_T_base = Pose2D.identity()
        self._right_until: dict[str, int] = {}
        self._proposed: list[Proposal] = []
        self._saved_ns = 0

    def begin(self) -> None:
        """Go on with what was seen before, if it was seen of the same settings."""
        saved = self._service.state.read(UPKEEP_FILE, SavedUpkeep)
        if saved is not None and np.allclose(saved.of, self._of(), atol=1e-6):
            self._upkeep = Upkeep(
                self._in_force.base_T_laser,
                np.array(saved.information).reshape(6, 6),
                np.array(saved.gradient),
                saved.squares,
                saved.num_legs,
                saved.misfit,
            )
            self._right_until = dict(saved.right_until)
        self._publish([])

    def add(self, motions: tuple[tuple[MotionSample, float | None], ...]) -> None:
        """Take what the wheels alone have measured."""
        for motion, _ in motions:
            self._odom_T_base = self._odom_T_base @ motion.previous_T_base
            self._comparison.update_odometry(
                Odometry(stamp_ns=motion.stamp_ns, pose=self._odom_T_base, twist=motion.twist)
            )

    @on(topics.POSE)
    def take_pose(self, pose: PoseEstimate) -> None:
        """Take where the localizer sees the robot."""
        self._comparison.update_pose(pose)

    @every(5.0)
    def propose(self) -> None:
        """Publish what is proposed, if that has changed, and keep what was seen."""
        legs, self._comparison.legs = self._comparison.legs, []
        for leg in legs:
            self._upkeep.update(leg)
        errors = self._upkeep.errors()
        if not legs or errors is None:
            return
        found = find_proposals(errors, self._in_force, [one.id for one in self._proposed])
        for kind in set(KINDS).difference(one.id for one in found):
            self._right_until[kind] = self._service.stamp_ns
        found = [
            msgspec.structs.replace(one, right_until=self._right_until.get(one.id)) for one in found
        ]
        if [one.id for one in found] != [one.id for one in self._proposed]:
            for one in found:
                self._service.log.warning("Proposed a correction of robot.toml", what=one.message)
            self._publish(found)
        if self._service.monotonic_ns - self._saved_ns >= SAVE_PERIOD_NS:
            self.save()
            if found != self._proposed:  # the figures become better as it drives
                self._publish(found)

    def save(self) -> None:
        """Keep what was seen."""
        self._saved_ns = self._service.monotonic_ns
        upkeep = self._upkeep
        self._service.save(
            UPKEEP_FILE,
            SavedUpkeep(
                of=self._of(),
                information=upkeep.information.ravel().tolist(),
                gradient=upkeep.gradient.tolist(),
                squares=upkeep.squares,
                num_legs=upkeep.num_legs,
                misfit=upkeep.misfit,
                right_until=self._right_until,
            ),
        )

    def _publish(self, found: list[Proposal]) -> None:
        self._proposed = found
        self._service.publish(
            topics.PROPOSALS, Proposals(stamp_ns=self._service.stamp_ns, proposals=found)
        )

    def _of(self) -> list[float]:
        mount, scales = self._in_force.base_T_laser, self._in_force.scales
        return [mount.x, mount.y, mount.yaw, *scales.matrix.ravel().tolist()]
