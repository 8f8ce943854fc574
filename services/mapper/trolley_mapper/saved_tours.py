"""Tours with spots of their own go along with a map that was saved."""

from collections.abc import Callable
from functools import partial

from trolley import requests, topics
from trolley.codes import Refused
from trolley.geometry import Pose2D
from trolley.messages import Tour, Tours
from trolley.runtime.service import Service
from trolley_mapper.edit.map_transform import moved_tours
from trolley_mapper.saved_places import TOUR_IS_SILENT, why_not_stored

MAX_TRIES = 10
"""Number of times that tours are stored, a second apart, before they stay as they are."""


class SavedTours:
    """Stores the tours on a map as they lie on it once it was saved, again until all are.

    Those that somebody deletes or changes meanwhile are left alone.

    Args:
        service: that hears and asks.
        may_be_unheard: whether some may be stored on the map though none were heard of.
    """

    def __init__(self, service: Service, *, may_be_unheard: bool) -> None:
        self._service = service
        self._may_be_unheard = may_be_unheard
        self._find: Callable[[Tours], None] | None = None
        """What is to be done with the first that are heard of."""
        self._left: list[tuple[Tour, Tour]] = []
        """As they were, and as they lie now."""
        self._num_asked = self._num_tries = 0
        self._problem = TOUR_IS_SILENT
        self._then: Callable[[str], object] | None = None
        self._watch = service.watch(topics.TOURS, then=self._hear)

    def close(self) -> None:
        """Hear nothing any more."""
        self._service.close_watch(self._watch)

    def go_along(self, before: str, name: str, old_T_new: Pose2D) -> None:
        """Store those on the map that was called `before` as they lie on it now."""

        def find(known: Tours) -> None:
            self._left = [
                (tour, moved)
                for tour in known.tours
                for moved in moved_tours((tour,), (before,), name, old_T_new)
            ]

        if self._watch.latest is not None:
            find(self._watch.latest)
        elif self._may_be_unheard:
            self._find = find
        self.store()

    def finish(self, then: Callable[[str], object]) -> None:
        """Call back once all are stored, or with a sentence on why they are not."""
        self._then, self._num_tries = then, 0
        self.store()

    def store(self) -> None:
        """Store those that are left."""
        if self._num_asked:
            return
        if not self._left and self._find is None:
            self._call_back("")
        elif self._num_tries >= MAX_TRIES:
            self._call_back(f" Tours were not moved along with the map: {self._problem}")
        else:
            self._num_tries += 1
            self._num_asked = len(self._left)
            for _, tour in list(self._left):
                self._service.request(requests.TOURS_PUT, tour, partial(self._stored, tour))

    def _hear(self, now: Tours) -> None:
        find, self._find = self._find, None
        if find is not None:
            find(now)
        self._left = [(before, moved) for before, moved in self._left if before in now.tours]

    def _stored(self, tour: Tour, result: Tour | Refused) -> None:
        self._num_asked -= 1
        if isinstance(result, Refused):
            self._service.log.limited("tours", "A tour was not moved along", why=result.message)
            self._problem = why_not_stored(result)
        else:
            self._left = [(before, moved) for before, moved in self._left if moved is not tour]
        if not self._left:
            self._call_back("")

    def _call_back(self, problem: str) -> None:
        then, self._then = self._then, None
        if then is not None:
            then(problem)
