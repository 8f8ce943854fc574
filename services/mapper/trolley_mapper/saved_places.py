"""Saved places follow the map that is being made: those that moved with it are stored again."""

from functools import partial

from trolley import requests, topics
from trolley.codes import Refused
from trolley.messages import SavedPose, SavedPoses
from trolley.runtime.service import Service
from trolley_mapper.map_session import MapSession


class SavedPlaces:
    """Keeps the stored places of one map where the map has them.

    Args:
        service: that hears and asks.
        session: the map in the making.
    """

    def __init__(self, service: Service, session: MapSession) -> None:
        self._service, self._session = service, session
        self._watch = service.watch(topics.POSES, then=self.update)

    def close(self) -> None:
        """Follow no more."""
        self._service.close_watch(self._watch)

    def update_from_latest(self) -> None:
        """Take what was heard before there was a map to tie it to."""
        if self._watch.latest is not None:
            self.update(self._watch.latest)

    def update(self, poses: SavedPoses) -> None:
        """Tie the stored places to the map."""
        session = self._session
        if session.core is not None:
            session.places.update(poses.poses, session.name, session.core)

    def store_moved(self, map_name: str | None = None) -> None:
        """Store the places that moved with the map; under another name of it if there is one."""
        if self._session.core is None:
            return
        for place in self._session.places.moved(self._session.core, map_name):
            self._service.request(requests.POSES_PUT, place, partial(self._stored, place.name))

    def _stored(self, name: str, result: SavedPose | Refused) -> None:
        if isinstance(result, Refused):
            self._service.count("poses/not_put_right")
            self._service.log.warning("A place was not put right", name=name, why=result.message)
