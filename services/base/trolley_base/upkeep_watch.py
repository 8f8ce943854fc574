"""Watches while the robot drives whether wheels and lidar still are as robot.toml says."""

from collections.abc import Callable
from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta, Struct

from trolley import codes, requests, topics
from trolley.codes import Refused
from trolley.geometry import Pose2D
from trolley.messages import Odometry, PoseEstimate, Proposal, Proposals
from trolley.messages.request_params import WhichProposal
from trolley.messages.types import NonNegative, StampNs
from trolley.runtime.service import Later, Service, answers, every, on
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
    dismissed: list[str] = []


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
        self._found: list[Proposal] = []
        self._dismissed: set[str] = set()
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
            self._dismissed = set(saved.dismissed)
            self._find()
        self._publish()

    def add(self, motions: tuple[tuple[MotionSample, float | None], ...]) -> None:
        """Take what the wheels alone have measured."""
        for motion, _ in motions:
            self._odom_T_base = self._odom_T_base @ motion.previous_T_base
            self._comparison.update_odometry(
                Odometry(stamp_ns=motion.stamp_ns, pose=self._odom_T_base, twist=motion.twist)
            )

    @on(topics.POSE, wakes=False)
    def take_pose(self, pose: PoseEstimate) -> None:
        """Take where the localizer sees the robot."""
        self._comparison.update_pose(pose)

    @every(5.0)
    def propose(self) -> None:
        """Publish what is proposed, if that has changed, and keep what was seen."""
        legs, self._comparison.legs = self._comparison.legs, []
        for leg in legs:
            self._upkeep.update(leg)
        if not legs or not self._find():
            return
        right = set(KINDS).difference(one.id for one in self._found)
        self._dismissed -= right
        for kind in right:
            self._right_until[kind] = self._service.stamp_ns
        before = {one.id for one in self._proposed}
        open_ = self._open()
        for one in open_:
            if one.id not in before:
                self._service.log.warning("Proposed a correction of robot.toml", what=one.message)
        if before != {one.id for one in open_}:
            self._publish()
        if self._service.monotonic_ns - self._saved_ns >= SAVE_PERIOD_NS:
            self.save()
            if open_ != self._proposed:  # the figures become better as it drives
                self._publish()

    @answers(requests.PROPOSALS_DISMISS)
    def dismiss(self, params: WhichProposal) -> Later[Proposal]:
        """Do not propose a correction again, until what it is about was right in between."""
        proposal = next((one for one in self._open() if one.id == params.id), None)
        if proposal is None:
            raise Refused(codes.UNKNOWN_NAME, f"No correction {params.id!r} is proposed.")
        reply: Later[Proposal] = self._service.later()
        self._dismissed.add(proposal.id)

        def saved(error: OSError | None) -> None:
            if error is None:
                self._publish()
                reply.reply(proposal)
                return
            self._dismissed.discard(proposal.id)
            why = f"That could not be written to disk: {error.strerror}."
            reply.refuse(Refused(codes.NOT_SAVED, why))

        self.save(saved)
        return reply

    def _find(self) -> bool:
        """Find what is wrong by what was seen; False while that is too little."""
        errors = self._upkeep.errors()
        if errors is None:
            return False
        known = self._dismissed.union(one.id for one in self._found)
        self._found = [
            msgspec.structs.replace(one, right_until=self._right_until.get(one.id))
            for one in find_proposals(errors, self._in_force, known)
        ]
        return True

    def _open(self) -> list[Proposal]:
        """Return what is found and nobody has dismissed."""
        return [one for one in self._found if one.id not in self._dismissed]

    def save(self, then: Callable[[OSError | None], None] | None = None) -> None:
        """Keep what was seen; `then` hears whether that went well."""
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
                dismissed=sorted(self._dismissed),
            ),
            then,
        )

    def _publish(self) -> None:
        self._proposed = self._open()
        self._service.publish(
            topics.PROPOSALS, Proposals(stamp_ns=self._service.stamp_ns, proposals=self._proposed)
        )

    def _of(self) -> list[float]:
        mount, scales = self._in_force.base_T_laser, self._in_force.scales
        return [mount.x, mount.y, mount.yaw, *scales.matrix.ravel().tolist()]
