"""The map in use: which maps there are, loading one, publishing it."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Protocol

import numpy as np
from msgspec import Struct

from trolley import codes, requests, topics
from trolley.codes import Refused
from trolley.config import RobotConfig
from trolley.config.localizer import LocalizerConfig
from trolley.geometry import Pose2D
from trolley.gridmap import GridMap, MapError, load_map
from trolley.gridmap.wire import map_message
from trolley.messages import MapInfo, Zone
from trolley.messages.mapping import MAP_NAME, MAP_NAME_RULE
from trolley.messages.request_params import LoadMap, Nothing
from trolley.runtime.service import Later, Service, answers
from trolley.suggestions import did_you_mean
from trolley_localizer.core import Localizer
from trolley_localizer.mapper_lease import MapperLease
from trolley_localizer.warmup import warm_up
from trolley_localizer.zone_rules import read_seeds

CHOSEN_MAP_FILE = "map.toml"
NO_MAP = "There is no map: make one (`trolley map new NAME`), or set [map] file."


class ChosenMap(Struct, frozen=True, kw_only=True):
    """The file `map.toml`: which map was loaded last, and what the configuration named then."""

    name: str
    configured: str | None = None


@dataclass(frozen=True, slots=True, eq=False)
class LoadedMap:
    """A map that is ready for use."""

    name: str
    localizer: Localizer
    seeds: list[Zone] | str
    """Zones from the file beside the map, or why they cannot be read."""


class MapStore:
    """The maps of the host's folder, and the one that the configuration names.

    Args:
        folder: `<state>/maps`.
        configured: the YAML file of `[map] file`, or None.
    """

    def __init__(self, folder: Path, configured: Path | None) -> None:
        self._folder = folder
        self._configured = configured

    @property
    def configured_name(self) -> str | None:
        """What the configured map is called."""
        return None if self._configured is None else self._configured.stem

    def problem(self) -> str | None:
        """Say in one sentence why the configured map cannot be used, or None."""
        file = self._configured
        if file is None:
            return None
        if MAP_NAME.fullmatch(file.stem) is None:
            return f"[map] file: {file.name!r} cannot name a map: {MAP_NAME_RULE}"
        twin = self._folder / f"{file.stem}.yaml"
        if twin.exists() and twin.resolve() != file.resolve():
            return (
                f"[map] file: there is another map called {file.stem!r} in {self._folder}; "
                f"rename one of them"
            )
        return None

    def names(self) -> list[str]:
        """Return the names of all maps, in order."""
        stems = (file.stem for file in self._folder.glob("*.yaml"))
        found = {stem for stem in stems if MAP_NAME.fullmatch(stem)}
        if self._configured is not None and self.problem() is None:
            found.add(self._configured.stem)
        return sorted(found)

    def file_of(self, name: str) -> Path | None:
        """Return the YAML file of a map, or None if there is no such map."""
        if self._configured is not None and name == self._configured.stem:
            return self._configured
        if MAP_NAME.fullmatch(name) is None:
            return None
        file = self._folder / f"{name}.yaml"
        return file if file.exists() else None


def read_map(file: Path, config: LocalizerConfig, seed: int) -> LoadedMap | MapError:
    """Read a map and prepare a localizer on it (to be run aside: it takes up to seconds)."""
    warm_up()
    try:
        grid = load_map(file)
    except MapError as error:
        return error
    return LoadedMap(grid.name, Localizer(grid, [], config, seed), read_seeds(file))


class MapUser(Protocol):
    """The one who locates the robot on the map in use."""

    def use_map(self, loaded: LoadedMap) -> None:
        """Locate on another map from now on; nothing is known of the pose on it."""

    def begin_on_map(self, loaded: LoadedMap) -> None:
        """Choose a start pose on the first map."""

    def pose_to_keep(self) -> Pose2D | None:
        """Return the pose that a change of map keeps where it fits."""
        ...

    def odometry_pose(self) -> Pose2D | None:
        """Return the newest odom_T_base."""
        ...


class MapServer:
    """Loads, lists and publishes maps; `current` is the one in use."""

    def __init__(
        self, service: Service, config: RobotConfig, lease: MapperLease, user: MapUser
    ) -> None:
        self._service = service
        self._config = config
        self._lease = lease
        self._user = user
        self._seed = 0
        self._failure = ""
        self._gone = ""
        """Says that the map of the last run is gone, until another is chosen."""
        self.current: LoadedMap | None = None
        self.is_gone = False
        """Whether others know of a map that is gone: of the last run, or discarded half made."""

    @property
    def _store(self) -> MapStore:
        file = self._config.map.file
        configured = None if file is None else self._config.path(file)
        return MapStore(self._service.maps.path, configured)

    def set_config(self, config: RobotConfig) -> None:
        """Locate by other settings, on this map and the next ones."""
        self._config = config
        if self.current is not None:
            self.current.localizer.set_config(config.localizer)

    def open(self, seed: int) -> None:
        """Load the map of the last run, or the configured one, unless one was asked for by now.

        Args:
            seed: of the random numbers of each localizer.
        """
        self._seed = seed
        if self.current is not None:
            return
        problem, name = self._store.problem(), self._first_map()
        if problem is not None:
            self._fail(problem)
        elif name is None:
            self._service.log.error(NO_MAP)
            self.say_health()
        else:
            self._read_map(name, self._first_map_read)

    def publish(self) -> None:
        """Publish the map in use."""
        if self.current is not None:
            grid = self.current.localizer.field.grid
            self._service.publish(topics.MAP, map_message(self._service.stamp_ns, grid))

    def say_health(self) -> None:
        """Say in `health` whether a map is missing."""
        if self._lease.is_held or self.current is not None:
            self._service.set_health("degraded" if self._gone else "ok", self._gone)
        elif self._failure:
            self._service.set_health("failed", f"{self._failure} {self._gone}".strip())
        else:
            self._service.set_health("degraded", self._gone or NO_MAP)

    def ready(self) -> LoadedMap:
        """Return the map in use.

        Raises:
            Refused: `not_ready` while no map is loaded, `mapping` while the mapper makes one.
        """
        self._lease.refuse_while_held()
        if self.current is None:
            raise Refused(codes.NOT_READY, "No map is loaded yet.")
        return self.current

    def _fail(self, message: str) -> None:
        self._service.log.error("No map can be used", why=message)
        self._failure = message
        self.say_health()

    def _first_map(self) -> str | None:
        """Return the map to begin with: the last loaded, unless the configuration changed."""
        chosen = self._service.state.read(CHOSEN_MAP_FILE, ChosenMap)
        configured = self._store.configured_name
        if chosen is None or chosen.configured != configured:
            return configured
        if self._store.file_of(chosen.name) is not None:
            return chosen.name
        self._gone = (
            f"The map {chosen.name!r} of the last run is gone from {self._service.maps.path}: put "
            "it back or choose another, and load it (`trolley map load NAME`)."
        )
        self._service.log.warning(self._gone)
        self.is_gone = True
        return configured

    def _read_map(self, name: str, then: Callable[[LoadedMap | MapError], None]) -> None:
        """Read a map aside.

        Raises:
            Refused: `unknown_name`.
        """
        file = self._store.file_of(name)
        if file is None:
            hint = did_you_mean(name, self._store.names())
            raise Refused(codes.UNKNOWN_NAME, f"There is no map {name!r}. {hint}")
        self._service.work(partial(read_map, file, self._config.localizer, self._seed), then)

    def _first_map_read(self, result: LoadedMap | MapError) -> None:
        if self.current is not None:  # it was asked for before
            return
        if isinstance(result, MapError):
            self._fail(str(result))
            return
        self._use(result)
        self._user.begin_on_map(result)

    def _use(self, loaded: LoadedMap) -> None:
        """Put a map to use, by the settings of now."""
        loaded.localizer.set_config(self._config.localizer)
        self.current, self.is_gone = loaded, False
        self._user.use_map(loaded)

    @answers(requests.MAP_LIST)
    def list_maps(self, _: Nothing) -> list[str]:
        """Name all maps."""
        return self._store.names()

    @answers(requests.MAP_LOAD)
    def load_map(self, params: LoadMap) -> Later[MapInfo]:
        """Change to another map: at a pose, at the present one where it fits, or searching."""
        self._lease.refuse_other_map(params.name)
        reply: Later[MapInfo] = self._service.later()
        before = self._service.epoch_ns, self._user.odometry_pose()
        self._read_map(params.name, partial(self._other_map_read, params, before, reply))
        return reply

    def _other_map_read(
        self,
        params: LoadMap,
        before: tuple[int, Pose2D | None],
        reply: Later[MapInfo],
        result: LoadedMap | MapError,
    ) -> None:
        """Change to a map that a request asked for.

        Args:
            params: of the request.
            before: the run of base at that time, and odom_T_base.
            reply: answers it.
            result: what was read.
        """
        if isinstance(result, MapError):
            reply.refuse(Refused(codes.BAD_REQUEST, str(result)))
            return
        given, odom_T_base = params.pose, self._user.odometry_pose()
        epoch_ns, odom_T_before = before
        is_known = given is not None and odom_T_before is not None and odom_T_base is not None
        if is_known and epoch_ns == self._service.epoch_ns:
            given = given @ odom_T_before.inverse() @ odom_T_base  # reading took a while
        try:
            self._lease.refuse_other_map(params.name)
            if given is not None:
                refuse_pose(result.localizer, given)
        except Refused as refused:
            reply.refuse(refused)
            return
        # On a map that was handed over without a pose, one's own old pose means nothing.
        pose = given or (None if self._lease.is_held else self._user.pose_to_keep())
        self._lease.end_with_map(params.name)
        self._gone = ""
        self._use(result)
        result.localizer.map_watch.suspect([np.array(line) for line in params.mirrors])
        if pose is not None and result.localizer.pose_problem(pose) is None:
            result.localizer.set_pose(pose)
        chosen = ChosenMap(name=result.name, configured=self._store.configured_name)
        self._service.save(CHOSEN_MAP_FILE, chosen)
        reply.reply(map_info(result.localizer.field.grid))


def refuse_pose(localizer: Localizer, pose: Pose2D) -> None:
    """Refuse a pose where the robot cannot be.

    Raises:
        Refused: `outside_map` or `in_obstacle`.
    """
    problem = localizer.pose_problem(pose)
    if problem == "outside_map":
        raise Refused(codes.OUTSIDE_MAP, x=pose.x, y=pose.y)
    if problem == "in_obstacle":
        raise Refused(codes.IN_OBSTACLE, x=pose.x, y=pose.y)


def map_info(grid: GridMap) -> MapInfo:
    """Return what a map is, without its cells."""
    return MapInfo(
        name=grid.name,
        frame="map",
        resolution=grid.resolution,
        width=grid.cols,
        height=grid.rows,
        origin=grid.origin,
    )
