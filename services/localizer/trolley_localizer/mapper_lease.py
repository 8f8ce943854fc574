"""The lease by which the mapper has the map, its zones and the pose while it makes a map."""

from typing import Protocol

from trolley import codes, requests, topics
from trolley.codes import Refused
from trolley.messages import MappingStatus, PoseEstimate
from trolley.messages.request_params import Yield
from trolley.runtime.service import Service, answers, every
from trolley.under_way import MAPPER_SILENT_NS

_SHARED = (
    topics.MAP,
    topics.ZONES,
    topics.POSE,
    topics.PARTICLES,
    topics.BEAMS,
    topics.SUSPECTS,
    topics.CHANGES,
)


class Owner(Protocol):
    """The owner of the shared topics, whenever they are not leased."""

    def lease_began(self) -> None:
        """The mapper has the shared topics from now on."""

    def lease_ended(self) -> None:
        """The mapper is gone, or has canceled: the map is the previous one."""

    def known_pose(self) -> PoseEstimate:
        """Return what is known of the robot's pose."""
        ...


class MapperLease:
    """Leases the shared topics to the mapper for as long as it renews the lease.

    The mapper may announce the name of the map that it is going to hand over: loading that map
    ends the lease, and renewals that arrive late are refused.
    """

    def __init__(self, service: Service, owner: Owner) -> None:
        self._service = service
        self._owner = owner
        self._until_ns: int | None = None
        self._announced: str | None = None
        self._taken_over: str | None = None

    @property
    def is_held(self) -> bool:
        """Whether the mapper has the shared topics at present."""
        return self._until_ns is not None

    @answers(requests.LOCALIZER_YIELD)
    def renew(self, params: Yield) -> PoseEstimate:
        """Begin or renew the lease, or end it."""
        if not params.on:
            self._end("it was canceled")
            return self._owner.known_pose()
        if not self.is_held and self._taken_over is not None:
            if self._taken_over == params.hand_over:
                raise Refused(codes.NOT_CURRENT, "The localizer has taken over.")
            self._taken_over = None
        self._announced = params.hand_over
        self._begin()
        return self._owner.known_pose()

    def begin_if_mapping(self, status: MappingStatus | None) -> None:
        """Begin at the start of the process if the mapper says that it is making a map."""
        if status is not None and status.state not in ("idle", "starting"):
            self._begin()

    def refuse_while_held(self) -> None:
        """Refuse what needs a map of one's own.

        Raises:
            Refused: `mapping`.
        """
        if self.is_held:
            raise Refused(codes.MAPPING)

    def refuse_other_map(self, name: str) -> None:
        """Refuse to change the map while it is being made, except to the one handed over.

        Raises:
            Refused: `mapping`.
        """
        if name != self._announced:
            self.refuse_while_held()

    def end_with_map(self, name: str) -> None:
        """End the lease because the map that was handed over is loaded."""
        if self.is_held:
            self._until_ns = self._announced = None
            self._taken_over = name

    @every(0.5, clock="local")
    def end_if_expired(self) -> None:
        """Take over from a mapper that is gone."""
        if self._until_ns is not None and self._service.monotonic_ns > self._until_ns:
            self._end("the mapper is silent")

    def _begin(self) -> None:
        service = self._service
        began = not self.is_held
        self._until_ns = service.monotonic_ns + MAPPER_SILENT_NS
        if began:
            service.log.info("The mapper is making a map; leaving map and pose to it")
            for topic in _SHARED:
                service.withdraw(topic)
            service.withdraw(topics.TF, "odom")
            self._owner.lease_began()

    def _end(self, why: str) -> None:
        if self.is_held:
            self._service.log.info("Taking over from the mapper", why=why)
            self._until_ns = self._announced = None
            self._owner.lease_ended()
