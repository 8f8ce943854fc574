"""The part of the service that changes stored maps, and lets the robot follow."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import msgspec

from trolley import codes, requests, topics
from trolley.codes import Refused
from trolley.config import RobotConfig
from trolley.geometry import Pose2D
from trolley.messages import EditMap, MapEdited
from trolley.messages.asking import LoadMap, Named
from trolley.runtime.service import Later, Service, answers
from trolley_mapper import editing
from trolley_mapper.editing import Follow, Outcome, Situation
from trolley_mapper.versions import MapVersions

LOAD_TIMEOUT_S = 20.0
KNOWN = ("localized", "unsure")
UNDER_WAY = ("planning", "driving", "recovering", "paused")
WANTED: tuple[Any, ...] = (topics.POSE, topics.ZONES, topics.POSES, topics.TOURS, topics.GOAL)
Facts = dict[str, Any]


class MapEditor(Service):
    """Answers `map/edit`; the subclass makes maps.

    A reply comes when all is done, which for large maps is later than after 2 s.
    """

    config: RobotConfig

    def check_idle(self) -> None:
        """Raise `Refused` while a map is being made."""

    def finish_edits(self) -> None:
        """Let follow what could not before the last run ended."""
        store = self._store()
        self.work(partial(editing.pending, self.state.path, store), self._found_pending)

    @answers(requests.MAP_EDIT)
    def edit_map(self, params: EditMap) -> Later[MapEdited]:
        """Change a stored map; the version before is kept."""
        self.check_idle()
        reply: Later[MapEdited] = self.later()
        self._gather(partial(self._edit, params, reply))
        return reply

    # Inside.

    def _store(self) -> MapVersions:
        return MapVersions(self.maps.path)

    def _gather(self, then: Callable[[Facts], None]) -> None:
        """Ask the other services what is; who is not there knows nothing."""
        facts: Facts = {}

        def heard(name: str, found: dict[tuple[str, ...], Any]) -> None:
            facts[name] = next(iter(found.values()), None)
            if len(facts) == len(WANTED):
                then(facts)

        for topic in WANTED:
            self.get(topic, then=partial(heard, topic.name))

    def _edit(self, params: EditMap, reply: Later[MapEdited], facts: Facts) -> None:
        estimate, zones, goal = facts["pose"], facts["zones"], facts["goal"]
        file: Any = self.config.map.file
        is_on = estimate is not None and estimate.map == params.name
        if is_on and (zones is None or zones.map != params.name):
            reply.refuse(Refused(codes.NOT_READY, "The zones of the map are not known yet."))
            return
        situation = Situation(
            configured=None if file is None else Path(self.config.path(file)),
            is_on=is_on,
            is_driving=goal is not None and goal.state in UNDER_WAY,
            zones=tuple(zones.zones) if is_on and zones is not None else (),
            places=() if facts["poses"] is None else tuple(facts["poses"].poses),
            tours=() if facts["tours"] is None else tuple(facts["tours"].tours),
            state=self.state.path,
            now=self.utc_now(),
        )
        self.work(
            partial(editing.edit, self._store(), params, situation), partial(self._edited, reply)
        )

    def _edited(self, reply: Later[MapEdited], result: Outcome | Refused) -> None:
        if isinstance(result, Refused):
            reply.refuse(result)
            return
        self.log.info("Map edited", map=result.reply.name, what=result.reply.message)
        if result.follow is None:
            reply.reply(result.reply)
            return
        following = Following(self, result.follow, partial(self._followed, reply, result.reply))
        self._gather(following.begin)  # where the robot is by now

    def _followed(self, reply: Later[MapEdited], done: MapEdited, problem: str) -> None:
        message = done.message if not problem else f"{done.message} But: {problem}"
        reply.reply(msgspec.structs.replace(done, message=message))

    def _found_pending(self, follow: Follow | None) -> None:
        if follow is not None:
            self.log.warning("Finishing an edit of the run before", map=follow.map)
            Following(self, follow, lambda _: None).begin()


class Following:
    """Tells localizer and tour of a changed map, one request after the other."""

    def __init__(self, service: MapEditor, follow: Follow, done: Callable[[str], None]) -> None:
        self._service, self._follow, self._done = service, follow, done
        self._problems: list[str] = []
        self._todo: list[tuple[requests.Request[Any, Any], Any]] = []

    def begin(self, facts: Facts | None = None) -> None:
        """Begin: with where the robot is now, or unknown to us after a restart."""
        follow = self._follow
        estimate = None if facts is None else facts["pose"]
        pose = None
        moves = follow.of != follow.map or follow.old_T_new != Pose2D.identity()
        if moves and estimate is not None and estimate.state in KNOWN:
            pose = follow.old_T_new.inverse() @ estimate.pose
        self._todo += [(requests.ZONES_DELETE, Named(name=name)) for name in follow.zones_gone]
        self._todo += [(requests.ZONES_PUT, zone) for zone in follow.zones]
        self._todo += [(requests.POSES_PUT, place) for place in follow.places]
        self._todo += [(requests.TOURS_PUT, tour) for tour in follow.tours]
        self._ask(
            requests.MAP_LOAD, LoadMap(name=follow.map, pose=pose), partial(self._loaded, pose)
        )

    def _loaded(self, pose: Pose2D | None, result: object) -> None:
        if (
            isinstance(result, Refused)
            and pose is not None
            and result.code
            in (
                codes.IN_OBSTACLE,
                codes.OUTSIDE_MAP,
            )
        ):
            self._problems.append("the robot stands where the new map leaves it no room.")
            name = self._follow.map
            self._ask(requests.MAP_LOAD, LoadMap(name=name), partial(self._loaded, None))
            return
        if isinstance(result, Refused):
            self._problems.append(result.message)
        self._next(None)

    def _next(self, result: object) -> None:
        if isinstance(result, Refused) and result.code != codes.UNKNOWN_NAME:
            self._problems.append(result.message)
        if self._todo:
            request, params = self._todo.pop(0)
            self._ask(request, params, self._next)
            return
        if not self._problems:
            self._service.work(partial(editing.forget, self._service.state.path))
        for problem in self._problems:
            self._service.log.error("A change of the map did not go through", why=problem)
        self._done(self._problems[0] if self._problems else "")

    def _ask(
        self, request: requests.Request[Any, Any], params: Any, then: Callable[[Any], None]
    ) -> None:
        self._service.request(request, params, then, timeout_s=LOAD_TIMEOUT_S)
