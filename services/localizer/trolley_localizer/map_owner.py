"""The half of the service that owns the map and its zones: load, list, store, publish."""

from functools import partial

import msgspec

from trolley import codes, requests, topics
from trolley.codes import Refused
from trolley.config import RobotConfig
from trolley.geometry import Pose2D
from trolley.gridmap import MapError
from trolley.gridmap.wire import map_message
from trolley.messages import MapInfo, Suspects, Zone, Zones
from trolley.messages.request_params import LoadMap, Named, Nothing
from trolley.runtime.service import Later, answers, gets, on, on_delete
from trolley_localizer.core import Localizer
from trolley_localizer.map_store import ChosenMap, LoadedMap, MapStore, read_map
from trolley_localizer.to_messages import map_info
from trolley_localizer.yielding import Yielding
from trolley_localizer.zone_store import (
    ZoneFile,
    check_zone,
    mirror_lines,
    state_file,
    with_zone,
    without_zone,
)

CHOSEN_MAP_FILE = "map.toml"
NO_MAP = "There is no map: make one (`trolley map new NAME`), or set [map] file."


class MapOwner(Yielding):
    """Owns the map and its zones; the subclass owns the pose."""

    _seed = 0

    def __init__(self, config: RobotConfig) -> None:
        self._config = config
        self._localizer: Localizer | None = None
        self._map_name: str | None = None
        self._zones: list[Zone] = []
        self._failure = ""

    def on_first_map(self, localizer: Localizer, name: str) -> None:
        """Called when the map of the start is in use."""

    def pose_to_keep(self) -> Pose2D | None:
        """Return the pose that a change of map keeps where it fits."""
        return None

    def on_map(self, localizer: Localizer, name: str) -> None:
        """Called when a map is put to use, before it is published."""

    def odometry_pose(self) -> Pose2D | None:
        """Return the newest odom_T_base."""
        return None

    def gave_way(self) -> None:
        """Miss no map."""
        self._say_no_map()

    def took_back(self) -> None:
        """Say again what the map is."""
        self._publish_map()
        self._say_no_map()

    # Maps.

    def open_maps(self) -> None:
        """Load the map of the last run, or the configured one."""
        configured = self._config.map.file
        self._store = MapStore(
            self.maps.path, None if configured is None else self._config.path(configured)
        )
        problem = self._store.problem()
        name = self._first_map()
        if problem is not None:
            self._fail(problem)
        elif name is None:
            self.log.error(NO_MAP)
            self._say_no_map()
        else:
            self._read_map(name, partial(self._first_map_read, name))

    def _fail(self, message: str) -> None:
        self.log.error("No map can be used", why=message)
        self._failure = message
        self._say_no_map()

    def _say_no_map(self) -> None:
        """Say in `health` whether a map is missed."""
        if self.is_yielding or self._localizer is not None:
            self.set_health("ok")
        elif self._failure:
            self.set_health("failed", self._failure)
        else:
            self.set_health("degraded", NO_MAP)

    def _first_map(self) -> str | None:
        """Return the map to begin with: the last loaded, unless the configuration changed."""
        chosen = self.state.read(CHOSEN_MAP_FILE, ChosenMap)
        configured = self._store.configured_name
        if (
            chosen is not None
            and chosen.configured == configured
            and self._store.file_of(chosen.name) is not None
        ):
            return chosen.name
        return configured

    def _read_map(self, name: str, then: "partial[None]") -> None:
        """Read a map aside.

        Raises:
            Refused: `unknown_name`.
        """
        file = self._store.file_of(name)
        if file is None:
            raise Refused(codes.UNKNOWN_NAME, f"There is no map {name!r}.")
        self.work(partial(read_map, file, self._config.localizer, self._seed), then)

    def _first_map_read(self, name: str, result: LoadedMap | MapError) -> None:
        """Begin on the first map."""
        if isinstance(result, MapError):
            self._fail(str(result))
            return
        self._use_map(result)
        self.on_first_map(result.localizer, name)

    def _use_map(self, loaded: LoadedMap) -> None:
        """Put a map to work with its zones and publish both."""
        self._localizer, self._map_name = loaded.localizer, loaded.name
        self._zones = self._read_zones(loaded)
        loaded.localizer.set_mirrors(mirror_lines(self._zones))
        self.on_map(loaded.localizer, loaded.name)
        self._publish_map()
        self.set_health("ok")
        self.log.info("Map loaded", map=loaded.name, zones=len(self._zones))

    def _publish_map(self) -> None:
        if self.is_yielding or self._localizer is None:
            return
        self.publish(topics.MAP, map_message(self.stamp_ns, self._localizer.field.grid))
        self._publish_zones()
        self.publish(topics.SUSPECTS, Suspects(stamp_ns=self.stamp_ns, lines=[]))

    @answers(requests.MAP_LIST)
    def list_maps(self, _: Nothing) -> list[str]:
        """Name all maps."""
        return self._store.names()

    @answers(requests.MAP_LOAD)
    def load_map(self, params: LoadMap) -> Later[MapInfo]:
        """Change to another map: at a pose, at the present one where it fits, or searching."""
        self.refuse_other_map(params.name)
        reply: Later[MapInfo] = self.later()
        odom_T_base = self.odometry_pose()
        self._read_map(params.name, partial(self._other_map_read, params, odom_T_base, reply))
        return reply

    def _other_map_read(
        self,
        params: LoadMap,
        odom_T_before: Pose2D | None,
        reply: Later[MapInfo],
        result: LoadedMap | MapError,
    ) -> None:
        """Change to a map that a request asked for when the robot was at `odom_T_before`."""
        if isinstance(result, MapError):
            reply.refuse(Refused(codes.BAD_REQUEST, str(result)))
            return
        given, odom_T_base = params.pose, self.odometry_pose()
        if given is not None and odom_T_before is not None and odom_T_base is not None:
            given = given @ odom_T_before.inverse() @ odom_T_base  # reading took a while
        try:
            self.refuse_other_map(params.name)
            if given is not None:
                refuse_pose(result.localizer, given)
        except Refused as refused:
            reply.refuse(refused)
            return
        # Of a map that was handed over without a pose, one's own old pose says nothing.
        pose = given or (None if self.is_yielding else self.pose_to_keep())
        self.end_yield_on(params.name)
        self._use_map(result)
        if pose is not None and result.localizer.pose_problem(pose) is None:
            result.localizer.set_pose(pose)
        chosen = ChosenMap(name=result.name, configured=self._store.configured_name)
        self.save(CHOSEN_MAP_FILE, chosen)
        reply.reply(map_info(result.localizer.field.grid))

    def ready(self) -> Localizer:
        """Return the localizer.

        Raises:
            Refused: `not_ready` while no map is loaded, `mapping` while the mapper makes one.
        """
        self.refuse_while_mapping()
        if self._localizer is None:
            raise Refused(codes.NOT_READY, "No map is loaded yet.")
        return self._localizer

    # Zones.

    @on(topics.ZONE)
    def put_zone_wish(self, zone: Zone, name: str) -> None:
        """Store a zone that was put on its key."""
        self._store_zone(check_zone(zone, name), None)

    @on_delete(topics.ZONE)
    def delete_zone_wish(self, name: str) -> None:
        """Delete a zone whose key was deleted."""
        self._delete_zone(name, None)

    @gets(topics.ZONE)
    def get_zones(self, _: dict[str, str]) -> dict[tuple[str, ...], Zone]:
        """Give each zone under its key; none while the map is another's."""
        if self.is_yielding:
            return {}
        return {(zone.name,): zone for zone in self._zones}

    @answers(requests.ZONES_PUT)
    def put_zone(self, zone: Zone) -> Later[Zone]:
        """Store a zone."""
        reply: Later[Zone] = self.later()
        self._store_zone(check_zone(zone, zone.name), reply)
        return reply

    @answers(requests.ZONES_DELETE)
    def delete_zone(self, params: Named) -> Later[Zone]:
        """Delete a zone."""
        reply: Later[Zone] = self.later()
        self._delete_zone(params.name, reply)
        return reply

    def _store_zone(self, zone: Zone, reply: Later[Zone] | None) -> None:
        self.ready()
        self._change_zones(with_zone(self._zones, zone), zone, reply)

    def _delete_zone(self, name: str, reply: Later[Zone] | None) -> None:
        self.ready()
        zones, zone = without_zone(self._zones, name)
        self._change_zones(zones, zone, reply)

    def _change_zones(self, zones: list[Zone], zone: Zone, reply: Later[Zone] | None) -> None:
        """Save changed zones, then publish them; what is not saved does not hold."""
        before, self._zones = self._zones, zones

        def saved(error: OSError | None) -> None:
            if error is None:
                self._apply_zones()
                if reply is not None:
                    reply.reply(zone)
                return
            if self._zones is zones:
                self._zones = before
            why = f"The zone could not be written to disk: {error.strerror}."
            self.log.error("A zone was not saved", zone=zone.name, why=error.strerror)
            if reply is not None:
                reply.refuse(Refused(codes.NOT_SAVED, why))

        name = state_file(self._map_name or "")
        self.work(partial(self._try_write, name, ZoneFile(zones=zones)), saved)

    def _apply_zones(self) -> None:
        """Let zones count from now on."""
        if self._localizer is not None:
            self._localizer.set_mirrors(mirror_lines(self._zones))
        self._publish_zones()

    def _publish_zones(self) -> None:
        if self._map_name is not None and not self.is_yielding:
            zones = Zones(stamp_ns=self.stamp_ns, map=self._map_name, zones=self._zones)
            self.publish(topics.ZONES, zones)

    def _read_zones(self, loaded: LoadedMap) -> list[Zone]:
        """Read the zones of a map: saved ones, else those that came with the map."""
        stored = self.state.read(state_file(loaded.name), ZoneFile)
        if stored is not None:
            return self._usable_zones(stored.zones)
        if isinstance(loaded.seeds, str):
            self.log.error("The zones that came with the map cannot be used", why=loaded.seeds)
            return []
        if loaded.seeds:
            self.save(state_file(loaded.name), ZoneFile(zones=loaded.seeds))
        return sorted(loaded.seeds, key=lambda zone: zone.name)

    def _usable_zones(self, zones: list[Zone]) -> list[Zone]:
        """Leave out, and report, what a person's hand broke in the file."""
        usable: dict[str, Zone] = {}
        for zone in zones:
            try:
                usable[zone.name] = check_zone(zone, zone.name)
            except Refused as refused:
                self.log.warning("A stored zone is left out", zone=zone.name, why=refused.message)
        return sorted(usable.values(), key=lambda zone: zone.name)

    # Files.

    def save(self, name: str, value: msgspec.Struct) -> None:
        """Write a state file aside; a failure is counted and logged."""

        def written(error: OSError | None) -> None:
            if error is not None:
                self.count("state/not_saved")
                self.log.limited(name, "Not saved", file=name, why=error.strerror)

        self.work(partial(self._try_write, name, value), written)

    def _try_write(self, name: str, value: msgspec.Struct) -> OSError | None:
        try:
            self.state.write(name, value)
        except OSError as error:
            return error
        return None


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
