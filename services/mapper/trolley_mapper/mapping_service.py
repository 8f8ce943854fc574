"""The half of the service that makes the map: scans in; pose, map and state out."""

import importlib
from functools import partial
from typing import TYPE_CHECKING

from trolley import codes, requests, topics
from trolley.codes import Refused
from trolley.config import RobotConfig
from trolley.geometry import Pose2D
from trolley.messages import (
    MappingState,
    MappingStatus,
    PoseEstimate,
    SavedPose,
    SavedPoses,
    Zones,
)
from trolley.messages.request_params import Yield
from trolley.runtime.service import Watch, every
from trolley.scanning.front_end import Reject, ScanInput
from trolley_mapper import checkpoint as keeping
from trolley_mapper.checkpoint import Kept
from trolley_mapper.edit.editor import MapEditor
from trolley_mapper.explore import sentences
from trolley_mapper.map_session import Making
from trolley_mapper.senses import Senses
from trolley_mapper.wire import odom_transform, pose_message

if TYPE_CHECKING:  # with numba
    from trolley_mapper.explore.explorer import Explorer

KEEP_PERIOD_NS = 30_000_000_000
_ROOM_BYTES = 4096
"""Of the largest message, left for what stands beside the cells."""


class Maker(MapEditor):
    """Makes one map at a time, in place of the localizer."""

    def __init__(self, config: RobotConfig) -> None:
        super().__init__()
        self.config = config
        self.phase: MappingState = "idle"
        self.making: Making | None = None
        self.senses: Senses | None = None
        self.note = ""
        """What is to be said, as long as nothing is the matter."""
        self.explorer: Explorer | None = None
        self.hand_over: str | None = None
        """The saved map that the localizer is to take over."""
        self._places: Watch[SavedPoses] | None = None
        self._problem = ""
        self._drawn = -1
        self._kept_ns = 0
        self._kept_as: tuple[object, ...] = ()
        self._said: MappingStatus | None = None

    # Life.

    def start(self) -> None:
        """Go on with the map that was being made, if there is one."""
        self.say()
        self.work(partial(keeping.read, self.state.path), self._found)
        self.finish_edits()

    def stop(self) -> None:
        """Keep the map."""
        self._keep()

    def epoch_began(self) -> None:
        """Take note that the odometry begins anew; the robot itself has not moved."""
        if self.senses is not None:
            self.senses.begin_epoch()

    def check_idle(self) -> None:
        """Raise `Refused` while a map is being made or handed over."""
        if self.making is not None:
            raise Refused(codes.MAPPING)

    def _found(self, kept: Kept | str | None) -> None:
        if isinstance(kept, str):
            self.log.error(kept)
            self.note = kept
            self.say()
        elif kept is not None:
            self.log.info("Going on with a map", map=kept.name)
            self.note = f"Going on with the map {kept.name}."
            if kept.is_exploring:
                self.note += f" {sentences.PAUSES[codes.RESTARTED]}"
            making = Making(self.config.mapper, kept.name)
            self.begin(making)
            self.load(making, kept)

    # Beginning.

    def listen(self) -> Senses:
        """Hear the robot from now on."""
        if self.senses is None:
            self.senses = Senses(self, self._hear)
        return self.senses

    def begin(self, making: Making) -> MappingStatus:
        """Take a map for the one to be made; `load` follows."""
        self.making, self.phase = making, "starting"
        self.listen()
        return self.say()

    def load(self, making: Making, kept: Kept | None = None) -> None:
        """Get ready to make a map, then take the shared topics from the localizer.

        Importing what is needed holds up the service's own thread for seconds: who waits for an
        answer must have it before.
        """
        self.work(partial(_load, self.config, kept), partial(self._loaded, making))

    def _loaded(self, making: Making, result: Making | ValueError | None) -> None:
        if self.making is not making:
            return  # canceled meanwhile
        if isinstance(result, ValueError):
            why = keeping.put_aside(self.state.path)
            self.log.error(why, because=str(result))
            self.finish(why)
            return
        self.making = result or making
        self.request(requests.LOCALIZER_YIELD, Yield(), partial(self._may_begin, self.making))

    def _may_begin(self, making: Making, _result: PoseEstimate | Refused) -> None:
        """Begin; a localizer that does not answer owns nothing either."""
        if self.making is not making:
            return
        self.phase = "paused" if making.is_paused else "mapping"
        self._drawn, self._kept_ns = -1, self.monotonic_ns
        self._places = self.watch(topics.POSES, then=self._hear_places)
        zones = Zones(stamp_ns=self.stamp_ns, map=making.name, zones=list(making.zones))
        self.publish(topics.ZONES, zones)
        self.log.info("Mapping", map=making.name, extends=making.extends or "nothing")
        self.say()

    # Scans.

    def _hear(self) -> None:
        """Take the scans that are complete."""
        if self.senses is None:
            return
        for scan in self.senses.take():
            if self.phase in ("mapping", "paused", "saving"):
                self._take(scan)

    @every(0.05)
    def _look(self) -> None:
        """Let no scan wait for odometry that does not come."""
        if self.senses is not None:
            self._hear()

    def _take(self, scan: ScanInput) -> None:
        making, senses = self.making, self.senses
        if making is None or senses is None:
            return
        estimate = making.step(scan)
        if isinstance(estimate, Reject):
            self.count(f"scan/{estimate.name.lower()}")
            return
        if estimate.state != "lost":
            map_T_odom = estimate.map_T_odom @ senses.run_T_odom
            self.publish(topics.TF, odom_transform(estimate.stamp_ns, map_T_odom), "odom")
        self.publish(topics.POSE, pose_message(estimate, making.name))
        if self._drawn < 0:
            self._hear_places(self._places.latest if self._places is not None else None)
            self._draw()
        self._run_job(making)

    def _run_job(self, making: Making) -> None:
        """Run aside what the core asks for."""
        core = making.core
        job = None if core is None else core.take_job()
        if core is not None and job is not None:
            self.work(job.run, core.finish)

    # Each second.

    @every(1.0, clock="local")
    def _tell(self) -> None:
        """Renew the lease of the shared topics, and say how it goes."""
        if self.phase in ("mapping", "paused"):
            self.request(requests.LOCALIZER_YIELD, Yield(), lambda _: None)
            self._draw()
            self._put_places_right()
            if self.monotonic_ns - self._kept_ns >= KEEP_PERIOD_NS:
                self._keep()
        if self.phase != "idle":
            self.say()

    def _draw(self) -> None:
        """Publish the map where it has changed."""
        making = self.making
        if making is None or making.core is None or making.core.version == self._drawn:
            return
        self._drawn = making.core.version
        message = making.map_message(self.stamp_ns)
        if message is None or len(message.cells) + _ROOM_BYTES > topics.MAP.max_bytes:
            self.note = "The map has grown too large to be shown; save it."
            return
        self.publish(topics.MAP, message)

    # Places.

    def _hear_places(self, poses: SavedPoses | None) -> None:
        making = self.making
        if making is not None and making.core is not None and poses is not None:
            making.places.hear(poses.poses, making.name, making.core)

    def _put_places_right(self, map_name: str | None = None) -> None:
        """Store the places that have moved with the map; under another name of it if there is."""
        making = self.making
        if making is None or making.core is None:
            return
        for place in making.places.moved(making.core, map_name):
            self.request(requests.POSES_PUT, place, partial(self._put_right, place.name))

    def move_places_to(self, map_name: str) -> None:
        """Store the places where they are, as those of the saved map."""
        self._put_places_right(map_name)

    def _put_right(self, name: str, result: SavedPose | Refused) -> None:
        if isinstance(result, Refused):
            self.count("poses/not_put_right")
            self.log.warning("A place was not put right", name=name, why=result.message)

    # The map on disk.

    def _keep(self) -> None:
        """Keep the map as it is, so that a new process can go on with it."""
        making = self.making
        if making is None or making.core is None or self.phase not in ("mapping", "paused"):
            return
        self._kept_ns = self.monotonic_ns
        explores = self.explorer is not None and self.explorer.is_under_way
        core = making.core
        now = (making, core.version, core.num_keyframes, making.is_paused, explores)
        if now == self._kept_as:
            return
        make = making.to_keep(is_exploring=explores)
        if make is None:
            return
        write = partial(keeping.write, self.state.path, make)
        self.work(write, partial(self._kept, now))

    def _kept(self, now: tuple[object, ...], problem: str | None) -> None:
        self._kept_as = () if problem else now
        self.set_problem(
            f"The map cannot be kept on disk ({problem}); mapping goes on." if problem else ""
        )

    # What is said.

    def set_problem(self, problem: str) -> None:
        """Say what is wrong with the disk; nothing where all is well."""
        if problem and problem != self._problem:
            self.log.error(problem)
        self._problem = problem
        self.set_health("degraded" if problem else "ok", problem)

    def status(self) -> MappingStatus:
        """Return what is being done."""
        making = self.making
        core = None if making is None else making.core
        return MappingStatus(
            stamp_ns=self.stamp_ns,
            state=self.phase,
            name=None if making is None else making.name,
            extends=None if making is None else making.extends,
            message=self._message(),
            seconds=0.0 if making is None else round(making.seconds, 1),
            scans=0 if core is None else core.num_keyframes,
            loops=0 if making is None else making.loops,
            exploring="off" if self.explorer is None else self.explorer.state,
            area=0.0 if self.explorer is None else round(self.explorer.area_m2, 1),
        )

    def _message(self) -> str:
        if self._problem:
            return self._problem
        if self.phase in ("mapping", "paused") and self.senses is not None:
            silent = self.senses.silent()
            if silent is not None:
                return silent
            said = [self.explorer.message if self.explorer is not None else "", self.note]
            estimate = None if self.making is None else self.making.estimate
            matter = "" if estimate is None or self.phase == "paused" else estimate.message
            if matter:
                matter = f"{matter[:1].upper()}{matter[1:].rstrip('.')}."
            return f"{matter} {next(filter(None, said), '')}".strip()
        return self.note

    def say(self) -> MappingStatus:
        """Publish what is being done."""
        status = self.status()
        self.publish(topics.MAPPING, status)
        return status

    # The end.

    def pose_now(self) -> Pose2D | None:
        """Return map_T_base by the newest odometry."""
        making, senses = self.making, self.senses
        if making is None or making.estimate is None:
            return None
        newest = None if senses is None else senses.newest()
        if newest is None:
            return making.estimate.pose
        return (making.estimate.map_T_odom @ newest).wrapped()

    def finish(self, note: str) -> MappingStatus:
        """Own nothing any more and make no map."""
        if self.senses is not None:
            self.senses.close()
        if self._places is not None:
            self.close_watch(self._places)
        for topic in (topics.MAP, topics.ZONES, topics.POSE):
            self.withdraw(topic)
        self.withdraw(topics.TF, "odom")
        self.senses = self.making = self.hand_over = self._places = None
        self.phase, self.note, self._kept_as = "idle", note, ()
        self.work(partial(keeping.forget, self.state.path), self._forgotten)
        self.set_problem("")
        return self.say()

    def _forgotten(self, problem: str | None) -> None:
        if problem is not None:
            self.log.error("The finished map's working file was not removed", why=problem)


def _load(config: RobotConfig, kept: Kept | None) -> Making | ValueError | None:
    """Import and compile what mapping needs (aside: it takes seconds), and go on with a map."""
    from trolley_mapper.warmup import warm_up

    warm_up()
    importlib.import_module("trolley_mapper.slam.mapper")
    if kept is None:
        return None
    try:
        return Making.from_kept(config.mapper, kept)
    except ValueError as error:
        return error
