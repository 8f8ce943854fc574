"""Editing as a part of the service: changes stored maps, and lets the robot switch to them."""

from collections.abc import Callable
from functools import partial
from typing import Any

import msgspec

from trolley import codes, requests, topics
from trolley.codes import Refused
from trolley.config import RobotConfig
from trolley.messages import EditMap, MapEdited
from trolley.runtime.service import Later, Service, answers, every
from trolley.under_way import what_is_under_way
from trolley_mapper.edit.map_edit import Edited, Situation, edit
from trolley_mapper.edit.map_switch import MapSwitch, SwitchPlan, pending_plan
from trolley_mapper.edit.map_versions import MapVersions
from trolley_mapper.map_names import configured_file

WANTED: tuple[Any, ...] = (
    topics.POSE,
    topics.ZONES,
    topics.POSES,
    topics.TOURS,
    topics.GOAL,
    topics.TOUR,
)
"""What an edit has to know of the robot."""
Facts = dict[str, Any]
ANSWER_NS = 1_400_000_000
"""Local time after which a request is answered that the edit takes longer [ns]."""
MAX_REMEMBERED = 8
"""Number of edits whose outcome can still be asked for."""


class EditTask:
    """An edit that is under way or done, and who waits for what comes of it."""

    def __init__(self, params: EditMap) -> None:
        self.params = params
        self._result: MapEdited | Refused | None = None
        self._waiting: list[tuple[int, Later[MapEdited]]] = []

    def wait(self, reply: Later[MapEdited], until_ns: int) -> None:
        """Answer when it is done, or at a local time say that it is not."""
        self._waiting.append((until_ns, reply))
        self.answer(0)

    def finish(self, result: MapEdited | Refused) -> None:
        """Answer with what came of it."""
        self._result = result
        self.answer(0)

    def answer(self, now_ns: int) -> None:
        """Answer those that have waited long enough, and all once it is done."""
        waiting, self._waiting = self._waiting, []
        for until_ns, reply in waiting:
            if isinstance(self._result, Refused):
                reply.refuse(self._result)
            elif self._result is not None:
                reply.reply(self._result)
            elif now_ns > until_ns:
                message = "Still working; send the same request with the same id for the result."
                name = self.params.as_name or self.params.name
                reply.reply(MapEdited(state="working", name=name, message=message))
            else:
                self._waiting.append((until_ns, reply))


class MapEditor:
    """Answers `map/edit`.

    Args:
        check_idle: raises `Refused` while a map is being made.
    """

    def __init__(
        self, service: Service, config: RobotConfig, check_idle: Callable[[], None]
    ) -> None:
        self._service, self._config, self._check_idle = service, config, check_idle
        self._remembered: dict[str, EditTask] = {}
        self._task: EditTask | None = None
        self._switch: MapSwitch | None = None
        self._last_switch: MapSwitch | None = None

    @property
    def is_editing(self) -> bool:
        """Whether a map is being changed, or the robot does not know of it yet."""
        return self._task is not None or self._switch is not None

    def start(self) -> None:
        """Finish the switch that the last run did not."""
        find = partial(pending_plan, self._service.state.path, self._versions())
        self._service.work(find, self._resume)

    @answers(requests.MAP_EDIT)
    def edit_map(self, params: EditMap) -> Later[MapEdited]:
        """Change a stored map; the previous version is kept."""
        task = None if params.id is None else self._remembered.get(params.id)
        if task is None:
            task = self._begin(params)
        elif task.params != params:
            raise Refused(codes.BAD_REQUEST, "This id belongs to another edit.")
        reply: Later[MapEdited] = self._service.later()
        task.wait(reply, self._service.monotonic_ns + ANSWER_NS)
        return reply

    @every(0.2, clock="local", when=lambda editor: editor.is_editing)
    def _tick(self) -> None:
        """Answer in time, and see whether the map is there."""
        if self._task is not None:
            self._task.answer(self._service.monotonic_ns)
        if self._switch is not None:
            self._switch.check_loaded()

    # One edit: gather, change, switch, finish.

    def _versions(self) -> MapVersions:
        return MapVersions(self._service.maps.path)

    def _begin(self, params: EditMap) -> EditTask:
        """Begin an edit.

        Raises:
            Refused: `mapping`, or `busy` while another one is being made.
        """
        self._check_idle()
        if self.is_editing:
            raise Refused(codes.BUSY, "Another map edit is under way; wait for it.")
        self._task = task = EditTask(params)
        if params.id is not None:
            self._remembered[params.id] = task
            for one in list(self._remembered)[:-MAX_REMEMBERED]:
                del self._remembered[one]
        self._gather(partial(self._change, task))
        return task

    def _gather(self, then: Callable[[Facts], None]) -> None:
        """Ask the other services for what is wanted; one that is not there knows nothing."""
        facts: Facts = {}

        def heard(name: str, found: dict[tuple[str, ...], Any]) -> None:
            facts[name] = next(iter(found.values()), None)
            if len(facts) == len(WANTED):
                then(facts)

        for topic in WANTED:
            self._service.get(topic, then=partial(heard, topic.name))

    def _change(self, task: EditTask, facts: Facts) -> None:
        params = task.params
        estimate, zones = facts["pose"], facts["zones"]
        # Its zones are published with each map, a pose only once the lidar has seen something.
        is_on = params.name in [one.map for one in (estimate, zones) if one is not None]
        if is_on and (zones is None or zones.map != params.name):
            why = "The zones of the map are not known yet."
            self._finish(task, Refused(codes.NOT_READY, why))
            return
        situation = Situation(
            configured=configured_file(self._config),
            is_on=is_on,
            under_way=what_is_under_way(facts["goal"], facts["tour"]),
            zones=tuple(zones.zones) if is_on and zones is not None else (),
            places=None if facts["poses"] is None else tuple(facts["poses"].poses),
            tours=None if facts["tours"] is None else tuple(facts["tours"].tours),
            state=self._service.state.path,
            now=self._service.utc_now(),
            untold=None if self._last_switch is None else self._last_switch.untold(zones),
        )
        self._service.work(
            partial(edit, self._versions(), params, situation), partial(self._changed, task)
        )

    def _changed(self, task: EditTask, result: Edited | Refused) -> None:
        if isinstance(result, Refused):
            self._finish(task, result)
            return
        if not task.params.preview:
            self._service.log.info("Map edited", map=result.reply.name, what=result.reply.message)
        if result.plan is None:
            self._finish(task, result.reply)
            return
        done = partial(self._switched, task, result.reply)
        self._switch = self._last_switch = switch = MapSwitch(self._service, result.plan, done)
        # Where the robot is by now.
        self._service.get(topics.POSE, then=lambda found: switch.begin(found.get(())))

    def _switched(self, task: EditTask, reply: MapEdited, problem: str) -> None:
        message = reply.message if not problem else f"{reply.message} {problem}"
        self._finish(task, msgspec.structs.replace(reply, message=message))

    def _finish(self, task: EditTask, result: MapEdited | Refused) -> None:
        self._task = self._switch = None
        task.finish(result)

    # After a restart.

    def _resume(self, plan: SwitchPlan | str | None) -> None:
        if plan is None:
            return
        if isinstance(plan, str):
            self._service.log.error(plan)
            return
        self._service.log.warning("Finishing an edit of the run before", map=plan.map)
        self._switch = self._last_switch = MapSwitch(self._service, plan, self._resumed)
        self._switch.begin()

    def _resumed(self, _problem: str) -> None:
        self._switch = None
