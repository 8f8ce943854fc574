"""Letting the robot follow a map that was changed: the map first, then what lies on it."""

from collections.abc import Callable
from functools import partial
from typing import Any

from trolley import codes, requests, topics
from trolley.codes import Refused
from trolley.geometry import Pose2D
from trolley.messages import PoseEstimate, Zones
from trolley.messages.request_params import LoadMap, Named
from trolley.runtime.service import Service
from trolley_mapper.edit import map_edit
from trolley_mapper.edit.map_edit import Follow

LOAD_NS = 60_000_000_000
"""Local time after which a map counts as not loaded."""
TRIES = 5
"""So often a service is told before it counts as deaf."""
KNOWN = ("localized", "unsure")
NO_ROOM = (codes.IN_OBSTACLE, codes.OUTSIDE_MAP)
LATE = (codes.TIMEOUT, codes.NOT_READY)


class Following:
    """Tells localizer and tour of a changed map, one request after the other.

    On a small computer the localizer reads a map for longer than it may take to answer. Zones that
    came before it has would be those of the map before.

    Args:
        service: that asks.
        follow: what they are to be told.
        done: called at the end, with what did not go through, in a sentence; empty if all did.
    """

    def __init__(self, service: Service, follow: Follow, done: Callable[[str], None]) -> None:
        self._service, self._follow, self._done = service, follow, done
        self._problems: list[str] = []
        self._todo: list[tuple[requests.Request[Any, Any], Any]] = []
        self._tries = 0
        self._zones_before: Zones | None = None
        self._waits_until_ns: int | None = None

    def begin(self, estimate: PoseEstimate | None = None) -> None:
        """Begin: with where the robot is now, or unknown to us after a restart."""
        follow = self._follow
        pose = None
        moves = follow.of != follow.map or follow.old_T_new != Pose2D.identity()
        if moves and estimate is not None and estimate.pose and estimate.state in KNOWN:
            pose = follow.old_T_new.inverse() @ estimate.pose
        self._todo += [(requests.ZONES_DELETE, Named(name=name)) for name in follow.zones_gone]
        self._todo += [(requests.ZONES_PUT, zone) for zone in follow.zones]
        self._todo += [(requests.POSES_PUT, place) for place in follow.places]
        self._todo += [(requests.TOURS_PUT, tour) for tour in follow.tours]
        self._service.get(topics.ZONES, then=partial(self._load, pose))

    def look(self) -> None:
        """See whether a map that was long in coming is there; to be called now and then."""
        if self._waits_until_ns is not None:
            self._service.get(topics.ZONES, then=self._look)

    # The map.

    def _load(self, pose: Pose2D | None, found: dict[tuple[str, ...], Zones]) -> None:
        self._zones_before = found.get(())
        self._ask_to_load(pose)

    def _ask_to_load(self, pose: Pose2D | None) -> None:
        params = LoadMap(name=self._follow.map, pose=pose)
        self._service.request(requests.MAP_LOAD, params, partial(self._loaded, pose))

    def _loaded(self, pose: Pose2D | None, result: object) -> None:
        if not isinstance(result, Refused):
            self._next()
        elif result.code == codes.TIMEOUT:
            self._waits_until_ns = self._service.monotonic_ns + LOAD_NS
        elif result.code in NO_ROOM and pose is not None:
            self._problems.append("the robot stands where the new map leaves it no room.")
            self._ask_to_load(None)
        else:
            self._problems.append(result.message)
            self._next()

    def _look(self, found: dict[tuple[str, ...], Zones]) -> None:
        if self._waits_until_ns is None:
            return
        zones = found.get(())
        if zones is not None and zones.map == self._follow.map and zones != self._zones_before:
            self._waits_until_ns = None
            self._next()
        elif self._service.monotonic_ns > self._waits_until_ns:
            self._waits_until_ns = None
            self._problems.append(f"the localizer has not loaded {self._follow.map}.")
            self._next()

    # What lies on it.

    def _next(self) -> None:
        if self._todo:
            request, params = self._todo[0]
            self._service.request(request, params, self._told)
            return
        if not self._problems:
            self._service.work(partial(map_edit.forget, self._service.state.path))
        for problem in self._problems:
            self._service.log.error("A change of the map did not go through", why=problem)
        self._done(self._problems[0] if self._problems else "")

    def _told(self, result: object) -> None:
        self._tries += 1
        is_refused = isinstance(result, Refused)
        if is_refused and result.code in LATE and self._tries < TRIES:
            self._next()
            return
        if is_refused and result.code != codes.UNKNOWN_NAME:
            self._problems.append(result.message)
        self._tries = 0
        self._todo.pop(0)
        self._next()
