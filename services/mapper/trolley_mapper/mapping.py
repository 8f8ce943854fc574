"""The map session at work: scans in; pose, map, saved places and status out."""

import importlib
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

from trolley import codes, requests, topics
from trolley.codes import Refused
from trolley.config import RobotConfig
from trolley.geometry import Pose2D
from trolley.gridmap import GridMap
from trolley.messages import (
    MappingState,
    MappingStatus,
    PoseEstimate,
    Suspects,
    Zones,
)
from trolley.messages.request_params import JoinPart, Nothing, UndoMap, WhichGoal, Yield
from trolley.runtime.service import Service, answers, every
from trolley.scanning import Reject, ScanInput
from trolley.slices import do_aside
from trolley_mapper import checkpoint as checkpoints
from trolley_mapper.anchored_places import AnchoredPlaces
from trolley_mapper.checkpoint import Checkpoint, Checkpointer, LastScan
from trolley_mapper.explore import sentences
from trolley_mapper.inputs import RobotInputs
from trolley_mapper.map_session import MapSession
from trolley_mapper.saved_places import SavedPlaces, discard_places
from trolley_mapper.saved_tours import SavedTours
from trolley_mapper.wire import odom_transform, pose_message

if TYPE_CHECKING:  # with numba and SciPy: a robot that has its map need not load them
    from trolley_mapper.slam.back_end import MapJob
    from trolley_mapper.slam.finishing import FinishJob
    from trolley_mapper.slam.mapper import Mapper

ANSWER_NS = 1_500_000_000
"""Local time after which a request is answered with the progress so far; requests are given up
after 2 s [ns]."""
BESIDE_MAP_M = 20.0
"""Distance from the map within which a loose part may be joined to it [m]."""
_ENVELOPE_BYTES = 4096
"""Part of the largest message that is left for everything beside the cells [bytes]."""
_NOTHING_PUBLISHED = -1
MAY_BE_MISSING = "What was mapped in the half minute before may be missing."


class Mapping:
    """Makes one map at a time, in place of the localizer.

    Args:
        on_end: called when a map is finished or given up, while everything still runs.
    """

    def __init__(self, service: Service, config: RobotConfig, on_end: Callable[[], None]) -> None:
        self.phase: MappingState = "idle"
        self.session: MapSession | None = None
        self.inputs: RobotInputs | None = None
        self.do_zones_wait = False
        """Whether a saved map's zones wait for a localizer that is not running."""
        self._service, self._config, self._on_end = service, config, on_end
        self._checkpointer = Checkpointer(service)
        self._is_reading = False
        """Whether it is not known yet if the run before left a map."""
        self._places: SavedPlaces | None = None
        self._tours: SavedTours | None = None
        self._published_version = _NOTHING_PUBLISHED
        # Said as long as nothing is the matter.
        self._note = ""

    # Life.

    def start(self) -> None:
        """Continue the map of the previous run, if it was not finished."""
        self.publish_status()
        self._is_reading = True
        self._service.work(partial(checkpoints.read, self._service.state.path), self._resume)

    def _resume(self, checkpoint: Checkpoint | str | None) -> None:
        self._is_reading = False
        if isinstance(checkpoint, str):
            self._service.log.error(checkpoint)
            self.announce(checkpoint)
        elif checkpoint is not None:
            self._service.log.info("Continuing a map", map=checkpoint.name)
            note = f"Continuing the map {checkpoint.name}. {MAY_BE_MISSING}"
            if checkpoint.is_exploring:
                note += f" {sentences.PAUSES[codes.RESTARTED]}"
            session = MapSession(self._config.mapper, checkpoint.name, checkpoint.extends)
            session.places = AnchoredPlaces(saved_at=checkpoint.saved_at, older=checkpoint.older)
            self.begin(session, note)
            self.load(session, checkpoint)

    def save_checkpoint(self) -> None:
        """Write the map as it is now to disk, so that a new process can continue it."""
        session = self.session
        is_growing = self.phase in ("mapping", "paused")
        if session is not None and session.core is not None and is_growing:
            last_scan = self._last_scan(session)
            self._checkpointer.save(session.revision, partial(session.checkpoint, last_scan))

    def _last_scan(self, session: MapSession) -> LastScan | None:
        """Return the newest scan in the present run of base; None where it was not on the map."""
        estimate, inputs, epoch_ns = session.estimate, self.inputs, self._service.epoch_ns
        if estimate is None or inputs is None or estimate.stamp_ns < epoch_ns:
            return None
        if estimate.state != "mapping":
            return None
        map_T_odom = estimate.map_T_odom @ inputs.run_T_odom
        return LastScan(
            epoch_ns=epoch_ns,
            stamp_ns=estimate.stamp_ns,
            odom_T_base=map_T_odom.inverse() @ estimate.pose,
        )

    def discard_checkpoint(self) -> None:
        """Remove the checkpoint: the map is saved or canceled."""
        self._checkpointer.discard()

    def epoch_began(self) -> None:
        """Take note that the odometry starts over; the robot itself has not moved."""
        if self.inputs is not None:
            self.inputs.begin_epoch()
        if self.session is not None and self.session.core is not None:
            self.session.core.begin_epoch()

    def check_idle(self) -> None:
        """Refuse while a map is being made or handed over, or may be about to be continued.

        Raises:
            Refused: `mapping` or `not_ready`.
        """
        if self.phase == "saving":
            raise Refused(codes.MAPPING, self._note)
        if self.session is not None:
            raise Refused(
                codes.MAPPING,
                f"The map {self.session.name} is being made; save or cancel it first.",
            )
        if self._is_reading:
            raise Refused(codes.NOT_READY, "The mapper is starting; try again in a moment.")

    def check_may_change(self) -> MapSession:
        """Return the map in the making.

        Raises:
            Refused: `not_mapping`, or `not_ready` while it is being saved.
        """
        if self.session is None:
            raise Refused(codes.NOT_MAPPING)
        if self.phase == "saving":
            raise Refused(codes.NOT_READY, self._note)
        return self.session

    # Beginning and end.

    def listen(self) -> None:
        """Hear lidar and odometry from now on."""
        if self.inputs is None:
            self.inputs = RobotInputs(self._service, self._process_scans)

    def stop_listening(self) -> None:
        """Hear nothing any more."""
        if self.inputs is not None:
            self.inputs.close()
            self.inputs = None

    def begin(self, session: MapSession, note: str = "") -> MappingStatus:
        """Make this map from now on; `load` follows."""
        self.session, self.phase, self._note = session, "starting", note
        self.listen()
        return self.publish_status()

    def load(self, session: MapSession, checkpoint: Checkpoint | None = None) -> None:
        """Get ready to map, then take the shared topics from the localizer.

        The imports hold up the service's own thread for seconds: who waits for an answer must
        have it before.
        """
        self._service.work(partial(_load, self._config, checkpoint), partial(self._loaded, session))

    def _loaded(self, session: MapSession, result: MapSession | ValueError | None) -> None:
        if self.session is not session:
            return  # canceled meanwhile
        if isinstance(result, ValueError):
            why = checkpoints.put_aside(self._service.state.path, result)
            self._service.log.error(why)
            self.end(why)
            return
        self.session = result or session
        if session.is_paused:  # by somebody, while it was loaded
            self.session.pause(is_on=True)
        self._service.request(
            requests.LOCALIZER_YIELD, Yield(), partial(self._take_topics, self.session)
        )

    def _take_topics(self, session: MapSession, _result: PoseEstimate | Refused) -> None:
        """Own the shared topics; a localizer that does not answer owns nothing either."""
        if self.session is not session:
            return
        self.phase = "paused" if session.is_paused else "mapping"
        self._published_version = _NOTHING_PUBLISHED
        self._checkpointer.restart()
        self._places = SavedPlaces(self._service, session)
        is_new = session.core is None and session.extends is None
        self._tours = SavedTours(self._service, may_be_unheard=not is_new)
        self.publish_zones(session)
        self._service.log.info("Mapping", map=session.name, extends=session.extends or "nothing")
        self.publish_status()

    def give_topics_back(self) -> None:
        """Leave the shared topics to the localizer."""
        self._on_end()
        self.stop_listening()
        for topic in (topics.MAP, topics.ZONES, topics.SUSPECTS, topics.POSE):
            self._service.withdraw(topic)
        self._service.withdraw(topics.TF, "odom")

    def end(self, note: str) -> MappingStatus:
        """Give the shared topics back and make no map any more."""
        self.give_topics_back()
        for saved in (self._places, self._tours):
            if saved is not None:
                saved.close()
        self.session = self._places = self._tours = None
        self.phase, self._note = "idle", note
        self.discard_checkpoint()
        return self.publish_status()

    # What people ask for.

    def pause(self, *, is_on: bool) -> MappingStatus:
        """Stop the map from growing, or let it grow again."""
        self.check_may_change().pause(is_on=is_on)
        if self.phase in ("mapping", "paused"):
            self.phase = "paused" if is_on else "mapping"
        return self.announce("")

    @answers(requests.MAP_UNDO)
    def undo(self, params: UndoMap) -> MappingStatus:
        """Remove what was mapped last."""
        session = self.check_may_change()
        is_left = session.undo(params.seconds)
        if is_left:
            return self.announce("")
        if session.extends:
            return self.announce("Everything that was added to the map has been removed.")
        return self.announce("Everything has been removed except where the map began.")

    @answers(requests.MAP_JOIN)
    def join(self, params: JoinPart) -> MappingStatus:
        """Join the part that the robot is in to the map, where a person says that it is."""
        core = self.check_may_change().core
        if core is None or not core.is_loose:
            raise Refused(codes.NOT_LOOSE)
        if not _is_about_map(core.grid(), params.pose):
            raise Refused(codes.OUTSIDE_MAP)
        core.join(params.pose)
        return self.announce("")

    @answers(requests.MAP_DROP)
    def drop(self, _: Nothing) -> MappingStatus:
        """Forget the parts that hang loose."""
        session = self.check_may_change()
        num = session.num_loose
        if num == 0:
            raise Refused(codes.NOT_LOOSE)
        session.drop_loose()
        what = "1 scan that hung loose has" if num == 1 else f"{num} scans that hung loose have"
        return self.announce(f"{what} been removed.")

    def cancel(self) -> MappingStatus:
        """Discard the map; the localizer goes back to the previous one."""
        session = self.check_may_change()
        self._service.log.info("The map was canceled", map=session.name)
        self._service.request(requests.LOCALIZER_YIELD, Yield(on=False), lambda _: None)
        if session.extends:
            return self.end(f"What was added to the map {session.name} was discarded.")
        note = f"The map {session.name} was discarded."
        discard_places(self._service, session, partial(self._not_discarded, note))
        return self.end(note)

    def _not_discarded(self, note: str, problem: str) -> None:
        """Say which places are left of a map that was discarded."""
        self._service.log.error(problem)
        if self.session is None:
            self.announce(f"{note} {problem}")

    def begin_saving(self) -> None:
        """Let the map rest while it is written and handed over."""
        self.phase, self._note = "saving", "The map is being saved."
        self.do_zones_wait = False

    def saving_failed(self, problem: str) -> MappingStatus:
        """Continue after the map could not be written."""
        paused = self.session is not None and self.session.is_paused
        self.phase = "paused" if paused else "mapping"
        return self.announce(problem)

    def saved(self, session: MapSession, name: str, job: "FinishJob", doubt: str) -> None:
        """Turn the session and its places as the map was, and give them the name it has now.

        Args:
            session: whose map was saved.
            name: of the map.
            job: that made it ready.
            doubt: where it may be wrong, in a sentence; empty if nowhere.
        """
        if job.new_T_old.yaw != 0.0:
            # A goal under way is a pose on the map as it lay before. A refusal means there is none.
            self._service.request(requests.GOAL_CANCEL, WhichGoal(), lambda _: None)
            session.turn(job)
            self._publish_map(session)
        if (name != session.name or job.new_T_old.yaw != 0.0) and self._tours is not None:
            self._tours.go_along(session.name, name, job.new_T_old.inverse())
        session.name = name
        if self._places is not None:
            self._places.go_along(name)
        self.publish_zones(session)
        self._note = f"The map {name} is saved; the localizer takes over. {doubt}".rstrip()

    def finish_places(self, then: Callable[[str], object]) -> None:
        """Call back once all places and tours are stored, or with what was not, and why."""
        places, tours = self._places, self._tours
        if places is None or tours is None:
            then("")
        else:
            places.finish(lambda problem: tours.finish(lambda more: then(problem + more)))

    # Scans.

    @every(0.05, when=lambda mapping: mapping.inputs is not None)
    def _process_late_scans(self) -> None:
        """Let no scan wait for odometry that does not come."""
        self._process_scans()

    def _process_scans(self) -> None:
        """Take the scans that are complete by now, once it is known which run of base it is."""
        if self.inputs is None or self._service.now_ns is None:
            return
        for scan in self.inputs.take():
            if self.session is not None and self.phase in ("mapping", "paused", "saving"):
                self._process(scan, self.session, self.inputs)

    def _process(self, scan: ScanInput, session: MapSession, inputs: RobotInputs) -> None:
        session.go_on(scan, self._service.epoch_ns)
        estimate = session.step(scan)
        if isinstance(estimate, Reject):
            self._service.count(f"scan/{estimate.name.lower()}")
            return
        if estimate.state != "lost":
            transform = odom_transform(estimate.stamp_ns, estimate.map_T_odom @ inputs.run_T_odom)
            self._service.publish(topics.TF, transform, "odom")
        self._service.publish(topics.POSE, pose_message(estimate, session.name))
        if self._published_version == _NOTHING_PUBLISHED:
            if self._places is not None:
                self._places.update_from_latest()
            self._publish_map(session)
            self.save_checkpoint()  # that a map was begun is not forgotten, whatever happens
        job = None if session.core is None else session.core.take_job()
        if session.core is not None and job is not None:
            self._work_on(job, session.core)

    def _work_on(self, job: "MapJob", core: "Mapper") -> None:
        """Do a job aside, as long as it is wanted."""

        def is_wanted() -> bool:
            return self.session is not None and self.session.core is core and core.wants(job)

        do_aside(self._service.work, job.slices(), lambda: core.finish(job), is_wanted)

    # Each second.

    @every(1.0, clock="local")
    def _tick(self) -> None:
        """Renew the lease of the shared topics, and publish what has changed."""
        if self.session is not None and self.phase in ("mapping", "paused"):
            self._service.request(requests.LOCALIZER_YIELD, Yield(), lambda _: None)
            self._publish_map(self.session)
            if self._checkpointer.is_due:
                self.save_checkpoint()
        if self._places is not None:
            self._places.store_moved()
        if self._tours is not None:
            self._tours.store()
        if self.phase != "idle":
            self.publish_status()

    def publish_zones(self, session: MapSession) -> None:
        """Publish the zones of the map, and where mirrors are suspected."""
        stamp_ns, shown = self._service.stamp_ns, session.zones_shown
        zones = Zones(stamp_ns=stamp_ns, map=session.name, zones=shown)
        self._service.publish(topics.ZONES, zones)
        suspects = Suspects(stamp_ns=stamp_ns, lines=session.suspects)
        self._service.publish(topics.SUSPECTS, suspects)

    def _publish_map(self, session: MapSession) -> None:
        """Publish the map if it has changed, and zones that have moved with it."""
        if session.core is None or session.core.version == self._published_version:
            return
        self._published_version = session.core.version
        if session.zones.follow(session.core):
            self.publish_zones(session)
        message = session.map_message(self._service.stamp_ns)
        if message is None or len(message.cells) + _ENVELOPE_BYTES > topics.MAP.max_bytes:
            self._note = "The map has become too large to be shown; save it."
            return
        self._service.publish(topics.MAP, message)

    # Status.

    def announce(self, note: str) -> MappingStatus:
        """Publish the status with something to say as long as nothing is the matter."""
        self._note = note
        return self.publish_status()

    def publish_status(self) -> MappingStatus:
        """Publish what is being done."""
        status = self.status()
        self._service.publish(topics.MAPPING, status)
        return status

    def status(self) -> MappingStatus:
        """Return what is being done."""
        session = self.session
        core = None if session is None else session.core
        explorer = None if session is None else session.explorer
        return MappingStatus(
            stamp_ns=self._service.stamp_ns,
            state=self.phase,
            name=None if session is None else session.name,
            extends=None if session is None else session.extends,
            message=self._message(),
            seconds=0.0 if session is None else round(session.seconds, 1),
            scans=0 if core is None else core.num_keyframes,
            loops=0 if session is None else session.loops,
            exploring="off" if explorer is None else explorer.state,
            area=0.0 if explorer is None else round(explorer.area_m2, 1),
            loose=0 if session is None else session.num_loose,
            may_discard=session is not None and (self.phase != "saving" or self.do_zones_wait),
        )

    def _message(self) -> str:
        if self._checkpointer.problem:
            return self._checkpointer.problem
        if self.phase not in ("mapping", "paused") or self.inputs is None or self.session is None:
            return self._note
        silent = self.inputs.silent()
        if silent is not None:
            return silent
        estimate, explorer = self.session.estimate, self.session.explorer
        matter = "" if estimate is None or self.phase == "paused" else estimate.message
        if matter:
            matter = f"{matter[:1].upper()}{matter[1:].rstrip('.')}."
        rest = self._note if explorer is None else explorer.message or self._note
        return f"{matter} {rest}".strip()

    def pose_now(self) -> Pose2D | None:
        """Return map_T_base by the newest odometry."""
        if self.session is None or self.session.estimate is None:
            return None
        newest = None if self.inputs is None else self.inputs.newest()
        if newest is None:
            return self.session.estimate.pose
        return (self.session.estimate.map_T_odom @ newest).wrapped()


def _is_about_map(grid: GridMap, pose: Pose2D) -> bool:
    """Say whether a pose lies on the map or not far off it: a part may hang on its edge."""
    corners = grid.corners()
    low, high = corners.min(axis=0) - BESIDE_MAP_M, corners.max(axis=0) + BESIDE_MAP_M
    return bool(low[0] <= pose.x <= high[0] and low[1] <= pose.y <= high[1])


def _load(config: RobotConfig, checkpoint: Checkpoint | None) -> MapSession | ValueError | None:
    """Import and compile what mapping needs (aside: it takes seconds), and restore a map."""
    from trolley_mapper.warmup import warm_up

    warm_up()
    importlib.import_module("trolley_mapper.slam.mapper")
    if checkpoint is None:
        return None
    try:
        return MapSession.restore(config.mapper, checkpoint)
    except ValueError as error:
        return error
