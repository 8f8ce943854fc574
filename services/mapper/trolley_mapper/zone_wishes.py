"""Zones that people draw while a map is being made."""

from trolley import requests
from trolley.messages import Zone
from trolley.messages.request_params import Named
from trolley.runtime.service import answers
from trolley.zones import check_zone
from trolley_mapper.mapping import Mapping


class ZoneWishes:
    """Answers the localizer, which passes on what is wanted of zones.

    Args:
        mapping: which has the map.
    """

    def __init__(self, mapping: Mapping) -> None:
        self._mapping = mapping

    @answers(requests.MAP_ZONES_PUT)
    def put(self, zone: Zone) -> Zone:
        """Lay a zone on the map."""
        session = self._mapping.check_may_change()
        core = session.mapped_core()
        zone = check_zone(zone, zone.name)
        session.zones.put(zone, core)
        self._mapping.publish_zones(session)
        return zone

    @answers(requests.MAP_ZONES_DELETE)
    def delete(self, params: Named) -> Zone:
        """Take a zone off the map."""
        session = self._mapping.check_may_change()
        zone = session.zones.delete(params.name)
        self._mapping.publish_zones(session)
        return zone
