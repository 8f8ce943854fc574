"""The part of the service that changes stored maps, and lets the robot follow."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import msgspec

from trolley import codes, requests, topics
from trolley.codes import Refused
from trolley.config import RobotConfig
from trolley.messages import EditMap, MapEdited
from trolley.runtime.service import Later, Service, answers, every
from trolley_mapper.edit import map_edit
from trolley_mapper.edit.map_edit import Follow, Outcome, Situation
from trolley_mapper.edit.map_switch import Following
from trolley_mapper.edit.map_versions import MapVersions

UNDER_WAY = ("planning", "driving", "recovering", "paused")
WANTED: tuple[Any, ...] = (topics.POSE, topics.ZONES, topics.POSES, topics.TOURS, topics.GOAL)
Facts = dict[str, Any]
ANSWER_NS = 1_400_000_000
"""Local time after which who asked hears that it takes longer."""
MAX_REMEMBERED = 8
"""Changes of which one can still ask what came of them."""


class Edit:
    """A change of a map that is being made or was, and who waits for what comes of it."""

    def __init__(self, params: EditMap) -> None:
        self.params = params
        self._outcome: MapEdited | Refused | None = None
        self._waiting: list[tuple[int, Later[MapEdited]]] = []

    def wait(self, reply: Later[MapEdited], until_ns: int) -> None:
        """Answer when it is done, or at a local time say that it is not."""
        self._waiting.append((until_ns, reply))
        self.tell(0)

    def settle(self, outcome: MapEdited | Refused) -> None:
        """Tell what came of it."""
        self._outcome = outcome
        self.tell(0)

    def tell(self, now_ns: int) -> None:
        """Answer those that have waited long enough, and all once it is done."""
        waiting, self._waiting = self._waiting, []
        for until_ns, reply in waiting:
            if isinstance(self._outcome, Refused):
                reply.refuse(self._outcome)
            elif self._outcome is not None:
                reply.reply(self._outcome)
            elif now_ns > until_ns:
                message = "It takes longer; ask the same with the same id to hear what comes of it."
                name = self.params.as_name or self.params.name
                reply.reply(MapEdited(state="working", name=name, message=message))
            else:
                self._waiting.append((until_ns, reply))


class MapEditor(Service):
    """Answers `map/edit`; the subclass makes maps."""

    config: RobotConfig

    def __init__(self) -> None:
        self._edits: dict[str, Edit] = {}
        self._edit: Edit | None = None
        self._following: Following | None = None

    @property
    def is_editing(self) -> bool:
        """Whether a map is being changed, or the robot does not know of it yet."""
        return self._edit is not None or self._following is not None

    def check_idle(self) -> None:
        """Raise `Refused` while a map is being made."""

    def finish_edits(self) -> None:
        """Let follow what could not before the last run ended."""
        store = self._store()
        self.work(partial(map_edit.pending, self.state.path, store), self._found_pending)

    @answers(requests.MAP_EDIT)
    def edit_map(self, params: EditMap) -> Later[MapEdited]:
        """Change a stored map; the version before is kept."""
        edit = None if params.id is None else self._edits.get(params.id)
        if edit is None:
            edit = self._begin_edit(params)
        elif edit.params != params:
            raise Refused(codes.BAD_REQUEST, "This id is that of another change.")
        reply: Later[MapEdited] = self.later()
        edit.wait(reply, self.monotonic_ns + ANSWER_NS)
        return reply

    @every(0.2, clock="local")
    def _follow_on(self) -> None:
        """Answer in time, and see whether the map is there."""
        if self._edit is not None:
            self._edit.tell(self.monotonic_ns)
        if self._following is not None:
            self._following.look()

    # Inside.

    def _store(self) -> MapVersions:
        return MapVersions(self.maps.path)

    def _begin_edit(self, params: EditMap) -> Edit:
        """Begin a change.

        Raises:
            Refused: `mapping`, or `busy` while another one is being made.
        """
        self.check_idle()
        if self.is_editing:
            raise Refused(codes.BUSY, "Another change of a map is being made; wait for it.")
        self._edit = edit = Edit(params)
        if params.id is not None:
            self._edits[params.id] = edit
            for one in list(self._edits)[:-MAX_REMEMBERED]:
                del self._edits[one]
        self._gather(partial(self._change, edit))
        return edit

    def _settle(self, edit: Edit, outcome: MapEdited | Refused) -> None:
        self._edit = self._following = None
        edit.settle(outcome)

    def _gather(self, then: Callable[[Facts], None]) -> None:
        """Ask the other services what is; who is not there knows nothing."""
        facts: Facts = {}

        def heard(name: str, found: dict[tuple[str, ...], Any]) -> None:
            facts[name] = next(iter(found.values()), None)
            if len(facts) == len(WANTED):
                then(facts)

        for topic in WANTED:
            self.get(topic, then=partial(heard, topic.name))

    def _change(self, edit: Edit, facts: Facts) -> None:
        params = edit.params
        estimate, zones, goal = facts["pose"], facts["zones"], facts["goal"]
        file: Any = self.config.map.file
        is_on = estimate is not None and estimate.map == params.name
        if is_on and (zones is None or zones.map != params.name):
            why = "The zones of the map are not known yet."
            self._settle(edit, Refused(codes.NOT_READY, why))
            return
        situation = Situation(
            configured=None if file is None else Path(self.config.path(file)),
            is_on=is_on,
            is_driving=goal is not None and goal.state in UNDER_WAY,
            zones=tuple(zones.zones) if is_on and zones is not None else (),
            places=None if facts["poses"] is None else tuple(facts["poses"].poses),
            tours=None if facts["tours"] is None else tuple(facts["tours"].tours),
            state=self.state.path,
            now=self.utc_now(),
        )
        self.work(
            partial(map_edit.edit, self._store(), params, situation), partial(self._edited, edit)
        )

    def _edited(self, edit: Edit, result: Outcome | Refused) -> None:
        if isinstance(result, Refused):
            self._settle(edit, result)
            return
        self.log.info("Map edited", map=result.reply.name, what=result.reply.message)
        if result.follow is None:
            self._settle(edit, result.reply)
            return
        following = Following(self, result.follow, partial(self._followed, edit, result.reply))
        self._following = following
        # Where the robot is by now.
        self.get(topics.POSE, then=lambda found: following.begin(found.get(())))

    def _followed(self, edit: Edit, done: MapEdited, problem: str) -> None:
        message = done.message if not problem else f"{done.message} But: {problem}"
        self._settle(edit, msgspec.structs.replace(done, message=message))

    def _found_pending(self, follow: Follow | None) -> None:
        if follow is None:
            return
        self.log.warning("Finishing an edit of the run before", map=follow.map)
        self._following = Following(self, follow, self._caught_up)
        self._following.begin()

    def _caught_up(self, _problem: str) -> None:
        self._following = None
