"""The mapper as a service: a map from one drive, in place of the localizer while it is made."""

import sys

from trolley import requests
from trolley.config import RobotConfig
from trolley.messages import MappingStatus
from trolley.messages.request_params import PauseMap
from trolley.runtime.service import Service, answers, every
from trolley_mapper.edit.editor import MapEditor
from trolley_mapper.explore_service import ExploreService
from trolley_mapper.handover import MapSaver
from trolley_mapper.mapping import Mapping
from trolley_mapper.preconditions import MapStarter
from trolley_mapper.zone_wishes import ZoneWishes

IDLE_NS = 30_000_000_000
"""Local time after a map or an edit until memory is given back: often another follows [ns]."""
LARGE = "numba"
"""What is imported for a map, and stays for good: with SciPy and compiled kernels some 140 MB."""


class MapperService(Service):
    """Makes, explores, extends, saves and edits maps, each by a part of its own."""

    name = "mapper"

    def __init__(self, config: RobotConfig) -> None:
        self._mapping = Mapping(self, config, on_end=lambda: self._explore.end())
        self._explore = ExploreService(self, config.mapper, self._mapping)
        self._idle_since_ns = 0
        self._starter = MapStarter(
            self,
            config,
            self._mapping,
            is_editing=lambda: self._editor.is_editing,
            explore=self._explore.begin_when_ready,
        )
        self._editor = MapEditor(self, config, check_idle=self._starter.check_idle)
        saver = MapSaver(self, config, self._mapping)
        wishes = ZoneWishes(self._mapping)
        self.parts = (self._starter, saver, wishes, self._explore, self._mapping, self._editor)

    def start(self) -> None:
        """Finish what the last run left: a map, an edit, a goal that was driven to."""
        self._mapping.start()
        self._editor.start()
        self._explore.start()

    def stop(self) -> None:
        """Keep the map in the making."""
        self._mapping.save_checkpoint()

    def epoch_began(self) -> None:
        """Take note of a restart of the base."""
        self._mapping.epoch_began()
        self._explore.epoch_began()

    @answers(requests.MAP_PAUSE)
    def pause_map(self, params: PauseMap) -> MappingStatus:
        """Stop the map from growing, and the robot if it explores; or let the map grow again."""
        self._mapping.check_may_change()
        if params.on:
            self._explore.stop()
        return self._mapping.pause(is_on=params.on)

    @every(1.0, clock="local")
    def give_memory_back(self) -> None:
        """Begin anew some time after a map is finished: nothing is lost, since all is saved."""
        is_busy = (
            self._mapping.session is not None or self._starter.is_waiting or self._editor.is_editing
        )
        if is_busy or LARGE not in sys.modules:
            self._idle_since_ns = self.monotonic_ns
        elif self.monotonic_ns - self._idle_since_ns >= IDLE_NS:
            self.log.info("Beginning anew to give memory back")
            self.is_spent = True
