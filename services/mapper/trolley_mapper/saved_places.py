"""Saved places follow the map that is being made: those that moved with it are stored again."""

from collections.abc import Callable
from functools import partial

from trolley import codes, requests, topics
from trolley.codes import Refused
from trolley.messages import SavedPose, SavedPoses
from trolley.messages.request_params import Named
from trolley.runtime.service import Service
from trolley_mapper.map_session import MapSession

MAX_ASKED = 100
"""Number of places that are stored at once."""
MAX_REFUSED = 10
"""Number of times in a row that none was stored after which those left stay as they are."""

TOUR_IS_SILENT = "the tour service does not answer."


def why_not_stored(refused: Refused) -> str:
    """Say why the tour service has not stored something."""
    return TOUR_IS_SILENT if refused.code in codes.UNANSWERED else refused.message


def discard_places(service: Service, session: MapSession, told: Callable[[str], object]) -> None:
    """Delete the places that were saved on a map that nobody will have.

    Args:
        service: that asks.
        session: the map that was given up.
        told: called with a sentence on which were not deleted, and why, if any.
    """
    places, left = session.places, list[str]()

    def tell(names: list[str], why: str) -> None:
        left.extend(names)
        if left:
            told(f"Places on it were not deleted ({', '.join(left)}): {why}")

    def deleted(name: str, result: SavedPose | Refused) -> None:
        if isinstance(result, Refused) and result.code != codes.UNKNOWN_NAME:
            tell([name], why_not_stored(result))

    def heard(found: dict[tuple[str, ...], SavedPoses]) -> None:
        known = found.get(())
        if known is None:
            newer = [name for name, at in places.saved_at.items() if places.is_newer(name, at)]
            tell(newer, TOUR_IS_SILENT)
            return
        for one in known.poses:
            if one.map == session.name and places.is_newer(one.name, one.saved_at):
                named = Named(name=one.name)
                service.request(requests.POSES_DELETE, named, partial(deleted, one.name))

    service.get(topics.POSES, then=heard)


class SavedPlaces:
    """Keeps the stored places of one map where the map has them.

    Args:
        service: that hears and asks.
        session: the map in the making.
    """

    def __init__(self, service: Service, session: MapSession) -> None:
        self._service, self._session = service, session
        self._map = session.name
        self._is_heard = False
        self._saved_as: str | None = None
        self._num_asked = self._num_stored = self._num_refused = 0
        self._problem = TOUR_IS_SILENT
        self._then: Callable[[str], object] | None = None
        self._watch = service.watch(topics.POSES, then=self.update)

    def close(self) -> None:
        """Follow no more."""
        self._service.close_watch(self._watch)

    def update_from_latest(self) -> None:
        """Take what was heard before there was a map to tie it to."""
        if self._watch.latest is not None:
            self.update(self._watch.latest)

    def update(self, poses: SavedPoses) -> None:
        """Tie the stored places to the map, until it is saved."""
        session = self._session
        if session.places.older is None:  # of a map of this name that is not there now, say
            here = (one for one in poses.poses if one.map == self._map)
            session.places.older = {one.name: one.saved_at for one in here}
        if self._saved_as is None:
            if session.core is not None:
                session.places.update(poses.poses, session.name, session.core)
        elif self._is_heard:
            session.places.drop_changed(poses.poses)
        else:
            session.places.recall(poses.poses, self._map)
        self._is_heard = True

    def go_along(self, map_name: str) -> None:
        """Store them as they lie on the map that was saved, under its name."""
        self._saved_as = map_name
        self.store_moved()

    def finish(self, then: Callable[[str], object]) -> None:
        """Call back once all are stored, or with a sentence on why they are not."""
        self._then, self._num_refused = then, 0
        self.store_moved()

    def store_moved(self) -> None:
        """Store those that moved with the map, many at once."""
        core = self._session.core
        if self._num_asked or core is None:
            return
        places = self._session.places.moved(core, self._saved_as)[:MAX_ASKED]
        self._num_asked, self._num_stored = len(places), 0
        for place in places:
            self._service.request(requests.POSES_PUT, place, partial(self._stored, place))
        if not places and not self._is_heard and self._session.places.anchors:
            self._not_stored()
        elif not places:
            self._call_back("")

    def _stored(self, place: SavedPose, result: SavedPose | Refused) -> None:
        self._num_asked -= 1
        if isinstance(result, Refused):
            self._service.count("poses/not_put_right")
            self._service.log.limited("places", "A place was not put right", why=result.message)
            self._problem = why_not_stored(result)
        else:
            self._num_stored += 1
            self._session.places.stored(place)
        if self._num_asked:
            return
        if self._num_stored:
            self._num_refused = 0
            self.store_moved()
            return
        self._not_stored()

    def _not_stored(self) -> None:
        """Let the next second try again, unless that was tried often enough."""
        self._num_refused += 1
        if self._num_refused >= MAX_REFUSED:
            self._call_back(f" Places were not moved along with the map: {self._problem}")

    def _call_back(self, problem: str) -> None:
        then, self._then = self._then, None
        if then is not None:
            then(problem)
