"""The mapper as a service: a map from one drive, in place of the localizer while it is made."""

from functools import partial
from typing import Any

from trolley import codes, requests
from trolley.codes import Refused
from trolley.config import RobotConfig
from trolley.messages import MapInfo, MappingStatus, PoseEstimate
from trolley.messages.request_params import (
    LoadMap,
    MapNamed,
    Nothing,
    PauseMap,
    SaveMap,
    UndoMap,
    Yield,
)
from trolley.runtime.service import Later, answers, every
from trolley_mapper.edit.map_files import write_map
from trolley_mapper.explore_service import Exploring
from trolley_mapper.map_session import Making
from trolley_mapper.preconditions import Beginning

ANSWER_NS = 1_500_000_000
"""Local time after which a request is answered with how far it is."""
LOAD_NS = 15_000_000_000
"""Local time after which the localizer is asked again to load the map."""
MAX_UNHEARD = 10
"""So often the localizer is asked to take over before it counts as not running."""


class MapperService(Exploring):
    """Makes, extends and saves maps."""

    name = "mapper"

    def __init__(self, config: RobotConfig) -> None:
        super().__init__(config)
        self._beginning: Beginning | None = None
        self._saving: Later[MappingStatus] | None = None
        self._saving_until_ns = 0
        self._asks = False
        self._unheard = 0
        self._with_pose = True
        self._load_again_ns = 0

    # Beginning.

    @answers(requests.MAP_NEW)
    def new_map(self, params: MapNamed) -> Later[MappingStatus]:
        """Begin a map where the robot stands."""
        self._refuse_taken(params.name)
        making = Making(self.config.mapper, params.name)
        return self._begin(Beginning(self, making, None), params)

    @answers(requests.MAP_EXTEND)
    def extend_map(self, params: MapNamed) -> Later[MappingStatus]:
        """Go on with the map that the robot is on."""
        making = Making(self.config.mapper, params.name)
        making.extends = params.name
        return self._begin(Beginning(self, making, params.name), params)

    def _begin(self, beginning: Beginning, params: MapNamed) -> Later[MappingStatus]:
        making = self.making
        if making is not None or self._beginning is not None:
            called = f" {making.name}" if making is not None else ""
            raise Refused(codes.MAPPING, f"The map{called} is being made; save or cancel it first.")
        if self.is_editing:
            raise Refused(codes.NOT_READY, "A map is being changed; ask again when that is done.")
        self.listen()
        self._beginning = beginning
        self.wants_to_explore = params.explore
        beginning.until_ns = self.monotonic_ns + ANSWER_NS
        self._try_begin()
        return beginning.reply

    @every(0.1, clock="local")
    def _each_moment(self) -> None:
        """Begin once everything that is needed has come; answer who waits for a save."""
        self._try_begin()
        if self._saving is not None and self.monotonic_ns > self._saving_until_ns:
            self._answer_save()

    def _try_begin(self) -> None:
        beginning = self._beginning
        if beginning is None or self.senses is None:
            return
        missing = [*self.senses.missing(), *beginning.missing()]
        if missing and self.monotonic_ns < beginning.until_ns:
            return
        self._beginning = None
        try:
            beginning.check(missing)
        except Refused as refused:
            self.senses.close()
            self.senses = None
            self.wants_to_explore = False
            beginning.reply.refuse(refused)
            return
        self.note = ""
        beginning.reply.reply(self.begin(beginning.making))
        self.load(beginning.making)

    # While it is made.

    @answers(requests.MAP_PAUSE)
    def pause_map(self, params: PauseMap) -> MappingStatus:
        """Let the map be as it is, or go on with it."""
        making = self._made()
        making.pause(is_on=params.on)
        if params.on:
            self.stand()
        self.note = ""
        if self.phase in ("mapping", "paused"):
            self.phase = "paused" if params.on else "mapping"
        return self.say()

    @answers(requests.MAP_UNDO)
    def undo_map(self, params: UndoMap) -> MappingStatus:
        """Forget what was mapped last."""
        making = self._made()
        is_left = making.undo(params.seconds)
        what = "what was added to the map" if making.extends else "the map but where it began"
        self.note = "" if is_left else f"Nothing is left of {what}."
        return self.say()

    @answers(requests.MAP_CANCEL)
    def cancel_map(self, _: Nothing) -> MappingStatus:
        """Forget the map; the localizer goes on with the one of before."""
        making = self._made()
        self.log.info("The map was canceled", map=making.name)
        self.request(requests.LOCALIZER_YIELD, Yield(on=False), lambda _: None)
        what = "What was added to the map" if making.extends else "The map"
        return self.finish(f"{what} {making.name} was given up.")

    def _made(self) -> Making:
        """Return the map that is being made.

        Raises:
            Refused: `not_mapping`, or `not_ready` while it is being saved.
        """
        if self.making is None:
            raise Refused(codes.NOT_MAPPING)
        if self.phase == "saving":
            raise Refused(codes.NOT_READY, "The map is being saved.")
        return self.making

    # Saving.

    @answers(requests.MAP_SAVE)
    def save_map(self, params: SaveMap) -> Later[MappingStatus]:
        """Write the map, and let the localizer take over on it."""
        making = self._made()
        name = params.name or making.name
        if name != making.extends or name == self._configured_name():
            self._refuse_taken(name)
        core = making.core
        if core is None or (core.num_keyframes == 0 and making.extends is None):
            raise Refused(codes.NOT_READY, "Nothing is mapped yet.")
        zones = making.zones if name != making.extends else ()
        write = partial(write_map, self.maps.path, name, core.grid(), zones)
        self.phase = "saving"
        self._saving = self.later()
        self._saving_until_ns = self.monotonic_ns + ANSWER_NS
        self.work(write, partial(self._written, making, name))
        self.say()
        return self._saving

    def _written(self, making: Making, name: str, problem: str | None) -> None:
        if self.making is not making:
            return
        if problem is not None:
            self.phase = "paused" if making.is_paused else "mapping"
            self.note = problem
            self.log.error(problem, map=name)
            if self._saving is not None:
                self._saving.refuse(Refused(codes.NOT_SAVED, problem))
            self._saving = None
            self.say()
            return
        self.log.info("Map saved", map=name)
        self.move_places_to(name)
        making.name = self.hand_over = name
        self.note = f"The map {name} is saved; the localizer takes over."
        self._unheard, self._load_again_ns, self._with_pose = 0, 0, True
        self._answer_save()
        self._hand_over()

    def _answer_save(self) -> None:
        if self._saving is not None:
            self._saving.reply(self.say())
        self._saving = None

    # Handing over.

    @every(1.0, clock="local")
    def _hand_over(self) -> None:
        """Ask the localizer to take over, until it has."""
        if self.hand_over is None or self._asks:
            return
        self._asks = True
        params = Yield(hand_over=self.hand_over)
        self.request(requests.LOCALIZER_YIELD, params, partial(self._may_load, self.hand_over))

    def _may_load(self, name: str, result: PoseEstimate | Refused) -> None:
        self._asks = False
        if self.hand_over != name:
            return
        if isinstance(result, Refused):
            if result.code == codes.NOT_CURRENT:
                self._done(name)
            else:
                self._not_heard(name)
            return
        self._unheard = 0
        if self.monotonic_ns < self._load_again_ns:
            return  # it is at it
        self._asks = True
        self._load_again_ns = self.monotonic_ns + LOAD_NS
        pose = self.pose_now() if self._with_pose else None
        self.request(
            requests.MAP_LOAD, LoadMap(name=name, pose=pose), partial(self._taken_over, name)
        )

    def _taken_over(self, name: str, result: MapInfo | Refused) -> None:
        self._asks = False
        if self.hand_over != name:
            return
        if isinstance(result, MapInfo):
            self._done(name)
        elif result.code in (codes.OUTSIDE_MAP, codes.IN_OBSTACLE):
            self._with_pose = False  # then it looks for the place itself
            self._load_again_ns = 0
        elif result.code == codes.NOT_READY:
            self._load_again_ns = 0
            self._not_heard(name)
        elif result.code != codes.TIMEOUT:  # a large map takes longer than an answer may
            self.log.error("The localizer cannot use the map", map=name, why=result.message)
            self.request(requests.LOCALIZER_YIELD, Yield(on=False), lambda _: None)
            self.finish(f"The map {name} is saved, but cannot be used: {result.message}")

    def _not_heard(self, name: str) -> None:
        self._unheard += 1
        if self._unheard >= MAX_UNHEARD:
            self.finish(f"The map {name} is saved; the localizer is not running.")

    def _done(self, name: str) -> None:
        self.log.info("The localizer has taken over", map=name)
        self.finish(f"The map {name} is saved and in use.")

    # Names.

    def _configured_name(self) -> str | None:
        """What the map of the configuration is called, whose file is never written."""
        file: Any = self.config.map.file
        return None if file is None else self.config.path(file).stem

    def _refuse_taken(self, name: str) -> None:
        """Refuse a name that a map has.

        Raises:
            Refused: `exists`.
        """
        if (self.maps.path / f"{name}.yaml").exists() or name == self._configured_name():
            raise Refused(
                codes.EXISTS, f"There is a map {name!r} already: take another name.", name=name
            )
