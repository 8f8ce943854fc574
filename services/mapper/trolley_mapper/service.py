"""The mapper as a service: a map from one drive, in place of the localizer while it is made."""

from trolley import requests
from trolley.config import RobotConfig
from trolley.messages import MappingStatus
from trolley.messages.request_params import PauseMap
from trolley.runtime.service import Service, answers
from trolley_mapper.edit.editor import MapEditor
from trolley_mapper.explore_service import ExploreService
from trolley_mapper.handover import MapSaver
from trolley_mapper.mapping import Mapping
from trolley_mapper.preconditions import MapStarter


class MapperService(Service):
    """Makes, explores, extends, saves and edits maps, each by a part of its own."""

    name = "mapper"

    def __init__(self, config: RobotConfig) -> None:
        self._mapping = Mapping(self, config, on_end=self._stop_exploring)
        self._explore = ExploreService(self, config.mapper, self._mapping)
        self._editor = MapEditor(self, config, check_idle=self._mapping.check_idle)
        starter = MapStarter(
            self,
            config,
            self._mapping,
            is_editing=lambda: self._editor.is_editing,
            explore=self._explore.begin_when_ready,
        )
        saver = MapSaver(self, config, self._mapping)
        self.parts = (starter, saver, self._explore, self._mapping, self._editor)

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

    def _stop_exploring(self) -> None:
        self._explore.end()
