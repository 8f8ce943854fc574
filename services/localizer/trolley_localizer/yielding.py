"""The part of the service that leaves map and pose to the mapper while it makes a map."""

from trolley import codes, requests, topics
from trolley.codes import Refused
from trolley.messages import MappingStatus, PoseEstimate
from trolley.messages.request_params import Yield
from trolley.runtime.service import Service, answers, every

LEASE_NS = 3_000_000_000
"""A mapper that has not been heard for so long is gone; it asks each second."""
_SHARED = (
    topics.MAP,
    topics.ZONES,
    topics.POSE,
    topics.PARTICLES,
    topics.BEAMS,
    topics.SUSPECTS,
    topics.CHANGES,
)


class Yielding(Service):
    """Gives way to the mapper as long as that asks for it."""

    _until_ns: int | None = None
    _hand_over: str | None = None
    _took_over: str | None = None

    @property
    def is_yielding(self) -> bool:
        """Whether map, zones and pose are the mapper's at present."""
        return self._until_ns is not None

    def gave_way(self) -> None:
        """Called when the mapper begins."""

    def took_back(self) -> None:
        """Called when the mapper is gone or has canceled: the map is the one of before."""

    def known_pose(self) -> PoseEstimate:
        """Return what is known of the robot's place."""
        raise NotImplementedError

    @answers(requests.LOCALIZER_YIELD)
    def give_way(self, params: Yield) -> PoseEstimate:
        """Give way for a while, or no longer."""
        if not params.on:
            self._take_back("it was canceled")
            return self.known_pose()
        if not self.is_yielding and self._took_over is not None:
            if self._took_over == params.hand_over:
                raise Refused(codes.NOT_CURRENT, "The localizer has taken over.")
            self._took_over = None
        self._hand_over = params.hand_over
        self._yield()
        return self.known_pose()

    def yield_if_mapping(self, status: MappingStatus | None) -> None:
        """Give way from the start where the mapper says that it is making a map."""
        if status is not None and status.state not in ("idle", "starting"):
            self._yield()

    def refuse_while_mapping(self) -> None:
        """Refuse what needs a map of one's own.

        Raises:
            Refused: `mapping`.
        """
        if self.is_yielding:
            raise Refused(codes.MAPPING)

    def refuse_other_map(self, name: str) -> None:
        """Refuse to load a map under the mapper's hands, unless it is the one that it hands over.

        Raises:
            Refused: `mapping`.
        """
        if name != self._hand_over:
            self.refuse_while_mapping()

    def end_yield_on(self, name: str) -> None:
        """Own the shared topics again, because the map that was handed over is loaded."""
        if self.is_yielding:
            self._until_ns = self._hand_over = None
            self._took_over = name

    @every(0.5, clock="local")
    def end_lease(self) -> None:
        """Take over from a mapper that is gone."""
        if self._until_ns is not None and self.monotonic_ns > self._until_ns:
            self._take_back("the mapper is silent")

    def _yield(self) -> None:
        if not self.is_yielding:
            self.log.info("The mapper makes a map; giving way")
            for topic in _SHARED:
                self.withdraw(topic)
            self.withdraw(topics.TF, "odom")
            self._until_ns = self.monotonic_ns + LEASE_NS
            self.gave_way()
        self._until_ns = self.monotonic_ns + LEASE_NS

    def _take_back(self, why: str) -> None:
        if self.is_yielding:
            self.log.info("Taking over from the mapper", why=why)
            self._until_ns = self._hand_over = None
            self.took_back()
