"""Saving a map, and handing it over to the localizer."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from trolley import codes, requests
from trolley.codes import Refused
from trolley.config import RobotConfig
from trolley.geometry import Pose2D
from trolley.messages import MapInfo, MappingStatus, PoseEstimate, Zone
from trolley.messages.request_params import LoadMap, Named, Nothing, SaveMap, Yield
from trolley.messages.types import Point
from trolley.runtime.service import Later, Service, answers, every
from trolley.slices import do_aside
from trolley_mapper.edit.map_transform import moved_zones
from trolley_mapper.edit.map_versions import write_map
from trolley_mapper.map_names import check_name_is_free, why_not_overwritten
from trolley_mapper.map_session import MapSession
from trolley_mapper.mapping import ANSWER_NS, Mapping
from trolley_mapper.slam import sentences

if TYPE_CHECKING:  # with numba and SciPy: a robot that has its map need not load them
    from trolley_mapper.slam.finishing import FinishJob

LOAD_NS = 15_000_000_000
"""Local time after which the localizer is asked again to load the map [ns]."""
MAX_UNHEARD = 10
"""Number of requests without an answer after which the localizer counts as not running."""


class Handover:
    """Asks the localizer to take over a saved map, over and over until it has.

    Args:
        pose: where the robot is on it, map_T_base; None where that is not known.
        mirrors: where some are suspected on it.
        waits_for_ever: whether a localizer that is not running is waited for until it is.
        done: called at the end, with what came of it in a sentence.
    """

    def __init__(
        self,
        service: Service,
        name: str,
        pose: Callable[[], Pose2D | None],
        mirrors: list[list[Point]],
        waits_for_ever: bool,
        done: Callable[[str], None],
    ) -> None:
        self._service, self._name, self._pose, self._done = service, name, pose, done
        self._waits_for_ever = waits_for_ever
        self._mirrors = mirrors
        self._is_asking = self._is_given_up = False
        self._num_unheard = 0
        self._gives_pose = True
        self._load_again_ns = 0

    @property
    def is_unheard(self) -> bool:
        """Whether the localizer is not running."""
        return self._num_unheard >= MAX_UNHEARD

    def give_up(self) -> None:
        """Hand nothing over any more, whatever is answered yet."""
        self._is_given_up = True

    def ask(self) -> None:
        """Ask the localizer whether it may load the map; called once a second."""
        if not self._is_asking:
            self._is_asking = True
            params = Yield(hand_over=self._name)
            self._service.request(requests.LOCALIZER_YIELD, params, self._yielded)

    def _yielded(self, result: PoseEstimate | Refused) -> None:
        self._is_asking = False
        if self._is_given_up:
            return
        if isinstance(result, Refused):
            if result.code == codes.NOT_CURRENT:
                self._taken_over()
            else:
                self._unheard()
            return
        self._num_unheard = 0
        if self._service.monotonic_ns < self._load_again_ns:
            return  # it is loading
        self._is_asking = True
        self._load_again_ns = self._service.monotonic_ns + LOAD_NS
        pose = self._pose() if self._gives_pose else None
        params = LoadMap(name=self._name, pose=pose, mirrors=self._mirrors)
        self._service.request(requests.MAP_LOAD, params, self._loaded)

    def _loaded(self, result: MapInfo | Refused) -> None:
        self._is_asking = False
        if self._is_given_up:
            return
        if isinstance(result, MapInfo):
            self._taken_over()
        elif result.code in (codes.OUTSIDE_MAP, codes.IN_OBSTACLE):
            self._gives_pose = False  # then the localizer searches the map
            self._load_again_ns = 0
        elif result.code == codes.NOT_READY:
            self._load_again_ns = 0
            self._unheard()
        elif result.code != codes.TIMEOUT:  # a large map takes longer than an answer may
            self._service.log.error(
                "The localizer cannot use the map", map=self._name, why=result.message
            )
            self._service.request(requests.LOCALIZER_YIELD, Yield(on=False), lambda _: None)
            self._done(f"The map {self._name} is saved, but cannot be used: {result.message}")

    def _unheard(self) -> None:
        self._num_unheard += 1
        if self.is_unheard and not self._waits_for_ever:
            self._done(f"The map {self._name} is saved; the localizer is not running.")

    def _taken_over(self) -> None:
        self._service.log.info("The localizer has taken over", map=self._name)
        self._done(f"The map {self._name} is saved and in use.")


_Wish = tuple[requests.Request[Any, Zone], Zone | Named]


@dataclass(frozen=True, slots=True)
class _PendingReply:
    """Who waits for a save, and until when on the local clock."""

    reply: Later[MappingStatus]
    until_ns: int


class MapSaver:
    """Answers `map/save` and `map/cancel`: writes the map, and lets the localizer take over on it.

    Args:
        mapping: which has the map.
    """

    def __init__(self, service: Service, config: RobotConfig, mapping: Mapping) -> None:
        self._service, self._config, self._mapping = service, config, mapping
        self._pending: _PendingReply | None = None
        self._is_writing = False
        self._handover: Handover | None = None
        self._doubt = ""

    @answers(requests.MAP_SAVE)
    def save(self, params: SaveMap) -> Later[MappingStatus]:
        """Write the map."""
        session = self._mapping.check_may_change()
        name = params.name or session.name
        if name != session.extends:
            check_name_is_free(self._service.maps.path, self._config, name)
        elif why := why_not_overwritten(self._config, name):
            raise Refused(codes.EXISTS, why, name=name)
        core = session.mapped_core()
        session.zones.follow(core)
        # What is extended has its zones at the localizer; what was drawn since follows.
        zones = list(session.zones.all) if name != session.extends else []
        job = core.finishing()
        folder, state = self._service.maps.path, self._service.state.path
        write = partial(_write, job, folder, state, name, zones)
        if _wishes(session):  # until the localizer has them, only the working file does
            self._mapping.save_checkpoint()
        self._mapping.begin_saving()
        self._is_writing = True
        reply: Later[MappingStatus] = self._service.later()
        self._pending = _PendingReply(reply, self._service.monotonic_ns + ANSWER_NS)
        written = partial(self._written, session, name, job)
        work = self._service.work
        do_aside(work, job.slices(), partial(work, write, written))
        self._mapping.publish_status()
        return reply

    @answers(requests.MAP_CANCEL)
    def cancel(self, _: Nothing) -> MappingStatus:
        """Discard the map or, once it is saved, changes to its zones that no localizer takes."""
        session, handover = self._mapping.session, self._handover
        if session is None or handover is None or not handover.is_unheard:
            return self._mapping.cancel()
        names = ", ".join(params.name for _, params in _wishes(session))
        note = f"The map {session.name} is saved; changes to these zones were discarded: {names}."
        self._service.log.warning(note)
        handover.give_up()
        self._mapping.announce(note)
        self._finish(note, [])
        return self._mapping.status()

    @every(0.1, clock="local", when=lambda handover: handover._pending is not None)  # noqa: SLF001
    def _answer_in_time(self) -> None:
        """Answer who has waited long enough for a save."""
        if self._pending is not None and self._service.monotonic_ns > self._pending.until_ns:
            self._answer()

    @every(1.0, clock="local")
    def _hand_over(self) -> None:
        """Ask the localizer to take over, until it has; not before the map is written."""
        if self._is_writing:
            self._service.request(requests.LOCALIZER_YIELD, Yield(), lambda _: None)
        elif self._handover is not None:
            self._handover.ask()
            session = self._mapping.session
            is_unheard = self._handover is not None and self._handover.is_unheard
            self._mapping.do_zones_wait = is_unheard
            if is_unheard and session is not None:
                self._mapping.announce(
                    f"The map {session.name} is saved; its zones wait for the localizer, which is "
                    "not running. Start it, or discard these zones (`trolley map cancel`)."
                )

    def _written(
        self, session: MapSession, name: str, job: "FinishJob", problem: str | None
    ) -> None:
        self._is_writing = False
        if self._mapping.session is not session:
            return
        if problem is not None:
            self._service.log.error(problem, map=name)
            if self._pending is not None:
                self._pending.reply.refuse(Refused(codes.NOT_SAVED, problem))
            self._pending = None
            self._mapping.saving_failed(problem)
            return
        turned_deg = round(math.degrees(job.new_T_old.yaw), 2)
        self._service.log.info("Map saved", map=name, turned_deg=turned_deg)
        self._doubt = doubt = sentences.doubtful(job.doubtful)
        if doubt:
            self._service.log.warning(doubt, map=name)
        self._mapping.saved(session, name, job, doubt)
        if not _wishes(session):  # else only the working file has them until they are stored
            self._mapping.discard_checkpoint()
        self._handover = self._new_handover(session, self._pose)
        self._answer()
        self._handover.ask()

    def _new_handover(self, session: MapSession, pose: Callable[[], Pose2D | None]) -> Handover:
        has_wishes, mirrors = bool(_wishes(session)), [line.points for line in session.suspects]
        return Handover(self._service, session.name, pose, mirrors, has_wishes, self._handed_over)

    def _pose(self) -> Pose2D | None:
        """Return map_T_base; None while that is a guess: the localizer searches the map then."""
        session = self._mapping.session
        estimate = None if session is None else session.estimate
        return None if estimate is None or estimate.state == "lost" else self._mapping.pose_now()

    def _handed_over(self, note: str) -> None:
        session = self._mapping.session
        self._finish(note, [] if session is None else _wishes(session))

    def _finish(self, note: str, wishes: list[_Wish]) -> None:
        """Give the shared topics back, then store what is left of the map."""
        self._handover, self._mapping.do_zones_wait = None, False
        self._mapping.give_topics_back()
        self._hand_zones_over(wishes, f"{note} {self._doubt}".rstrip())

    def _hand_zones_over(self, wishes: list[_Wish], note: str) -> None:
        """Let the localizer store what an extended map's zones became, then finish the places."""
        if not wishes:
            self._mapping.finish_places(lambda problem: self._mapping.end(f"{note}{problem}"))
            return
        (request, params), *rest = wishes
        self._service.request(request, params, partial(self._zone_stored, params.name, rest, note))

    def _zone_stored(self, name: str, rest: list[_Wish], note: str, result: Zone | Refused) -> None:
        session = self._mapping.session
        is_silent = isinstance(result, Refused) and result.code in codes.UNANSWERED
        if is_silent and session is not None:  # it has died: the next one takes over from the start
            self._handover = self._new_handover(session, lambda: None)  # nothing is heard any more
            return
        if isinstance(result, Refused) and result.code != codes.UNKNOWN_NAME:
            self._service.log.error("A zone was not kept", zone=name, why=result.message)
            note += f" The zone {name} was not kept: {result.message}"
        elif session is not None:
            session.zones.settle(name)
        self._hand_zones_over(rest, note)

    def _answer(self) -> None:
        if self._pending is not None:
            self._pending.reply.reply(self._mapping.publish_status())
        self._pending = None


def _wishes(session: MapSession) -> list[_Wish]:
    """Return what the localizer must be told of the zones of an extended map that was saved."""
    if session.name != session.extends:
        return []
    gone: list[_Wish] = [(requests.ZONES_DELETE, Named(name=n)) for n in session.zones.deleted]
    return [*gone, *((requests.ZONES_PUT, zone) for zone in session.zones.drawn)]


def _write(
    job: "FinishJob", folder: Path, state: Path, name: str, zones: Sequence[Zone]
) -> str | None:
    """Write a map that is ready; returns why it could not be written, in a sentence."""
    lying = moved_zones(zones, job.new_T_old.inverse())
    return write_map(folder, name, job.grid, lying, job.start, state)
