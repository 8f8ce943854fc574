"""The zones of the map in use: store, publish, and let mirrors and panes count."""

from functools import partial

from trolley import codes, requests, topics
from trolley.codes import Refused
from trolley.messages import Zone, Zones
from trolley.messages.request_params import Named
from trolley.runtime.service import Later, Service, answers, gets, on, on_delete
from trolley.zones import ZoneFile, check_zone, with_zone, without_zone
from trolley_localizer.map_server import LoadedMap, MapServer
from trolley_localizer.mapper_lease import MapperLease
from trolley_localizer.zone_rules import mirror_lines, state_file


class ZoneStore:
    """Keeps the zones of one map at a time, each map's in a file of its own.

    While a map is made, wishes are passed on to the mapper: zones move with that map.
    """

    def __init__(self, service: Service, maps: MapServer, lease: MapperLease) -> None:
        self._service = service
        self._maps = maps
        self._lease = lease
        self.zones: list[Zone] = []
        """What the file holds, sorted by name."""
        self._wanted: list[Zone] = []
        """The same with the changes that are still being written."""
        self._unsaved: list[tuple[Zone, Later[Zone] | None]] = []
        """Changes that could not be written, but are in the write that follows."""

    def open(self, loaded: LoadedMap) -> None:
        """Change to the zones of another map: saved ones, else those that came with the map."""
        self.zones = self._wanted = self._read(loaded)
        loaded.localizer.set_mirrors(mirror_lines(self.zones))

    def publish(self) -> None:
        """Publish all zones, unless the map is the mapper's."""
        current, service = self._maps.current, self._service
        if current is not None and not self._lease.is_held:
            zones = Zones(stamp_ns=service.stamp_ns, map=current.name, zones=self.zones)
            service.publish(topics.ZONES, zones)

    @on(topics.ZONE)
    def put_wish(self, zone: Zone, name: str) -> None:
        """Store a zone that was put on its key."""
        self._put(check_zone(zone, name), None)

    @on_delete(topics.ZONE)
    def delete_wish(self, name: str) -> None:
        """Delete a zone whose key was deleted."""
        self._delete(name, None)

    @gets(topics.ZONE)
    def get_zones(self, _: dict[str, str]) -> dict[tuple[str, ...], Zone]:
        """Give each zone under its key; none while the map is another's."""
        if self._lease.is_held:
            return {}
        return {(zone.name,): zone for zone in self.zones}

    @answers(requests.ZONES_PUT)
    def put(self, zone: Zone) -> Later[Zone]:
        """Store a zone."""
        reply: Later[Zone] = self._service.later()
        self._put(check_zone(zone, zone.name), reply)
        return reply

    @answers(requests.ZONES_DELETE)
    def delete(self, params: Named) -> Later[Zone]:
        """Delete a zone."""
        reply: Later[Zone] = self._service.later()
        self._delete(params.name, reply)
        return reply

    def _put(self, zone: Zone, reply: Later[Zone] | None) -> None:
        if self._lease.is_held:
            self._service.request(requests.MAP_ZONES_PUT, zone, partial(self._answered, reply))
            return
        loaded = self._maps.ready()
        self._change(loaded, with_zone(self._wanted, zone), zone, reply)

    def _delete(self, name: str, reply: Later[Zone] | None) -> None:
        if self._lease.is_held:
            named = Named(name=name)
            self._service.request(requests.MAP_ZONES_DELETE, named, partial(self._answered, reply))
            return
        loaded = self._maps.ready()
        zones, zone = without_zone(self._wanted, name)
        self._change(loaded, zones, zone, reply)

    def _answered(self, reply: Later[Zone] | None, result: Zone | Refused) -> None:
        """Pass on what the mapper has answered."""
        if isinstance(result, Refused):
            self._service.log.limited("zone", "The mapper refused a zone", why=result.message)
            if reply is not None:
                reply.refuse(result)
        elif reply is not None:
            reply.reply(result)

    def _change(
        self, loaded: LoadedMap, zones: list[Zone], zone: Zone, reply: Later[Zone] | None
    ) -> None:
        """Save changed zones, then publish them; what is not saved does not hold."""
        self._wanted = zones

        def saved(error: OSError | None) -> None:
            self._unsaved.append((zone, reply))
            is_current = self._maps.current is loaded
            if error is not None and is_current and self._wanted is not zones:
                return  # the next write holds this change, too
            unsaved, self._unsaved = self._unsaved, []
            if is_current and error is None:
                self.zones = zones
                loaded.localizer.set_mirrors(mirror_lines(zones))
                self.publish()
            elif is_current:
                self._wanted = self.zones
            for one, waits in unsaved:
                self._tell(one, waits, error)

        self._service.save(state_file(loaded.name), ZoneFile(zones=zones), saved)

    def _tell(self, zone: Zone, reply: Later[Zone] | None, error: OSError | None) -> None:
        """Say what came of a change."""
        if error is not None:
            self._service.log.error("A zone was not saved", zone=zone.name, why=error.strerror)
        if reply is None:
            return
        if error is None:
            reply.reply(zone)
        else:
            why = f"The zone could not be written to disk: {error.strerror}."
            reply.refuse(Refused(codes.NOT_SAVED, why))

    def _read(self, loaded: LoadedMap) -> list[Zone]:
        service = self._service
        stored = service.state.read(state_file(loaded.name), ZoneFile)
        if stored is not None:
            return self._usable(stored.zones)
        if isinstance(loaded.seeds, str):
            service.log.error("The zones that came with the map cannot be used", why=loaded.seeds)
            return []
        if loaded.seeds:
            service.save(state_file(loaded.name), ZoneFile(zones=loaded.seeds))
        return sorted(loaded.seeds, key=lambda zone: zone.name)

    def _usable(self, zones: list[Zone]) -> list[Zone]:
        """Leave out, and report, what somebody broke by editing the file."""
        usable: dict[str, Zone] = {}
        for zone in zones:
            try:
                usable[zone.name] = check_zone(zone, zone.name)
            except Refused as refused:
                self._service.log.warning(
                    "A stored zone is left out", zone=zone.name, why=refused.message
                )
        return sorted(usable.values(), key=lambda zone: zone.name)
