"""Making a map: start, pause, undo, save or discard."""

from typing import Any

from trolley import requests, topics
from trolley.messages import MappingStatus
from trolley.messages.request_params import (
    ExploreMap,
    MapNamed,
    Nothing,
    PauseMap,
    SaveMap,
    UndoMap,
)
from trolley_viz.controls.controls import Controls
from trolley_viz.controls.markup import note, row
from trolley_viz.controls.shared import AddFolder
from trolley_viz.features.driving.aiming import LEAVE, POINT_POSE, SET_POSE, Aiming
from trolley_viz.features.driving.robot_actions import RobotActions
from trolley_viz.robots.view import View
from trolley_viz.words.sentences import StatusLine, aged, mapping_line

SURE_NS = 6_000_000_000
"""How long a second press discards the map."""
HOW = (
    "Put the robot where its home will be. Then drive it through every room, slowly around "
    "corners, and come back to where you started; or let it explore by itself while you stay near, "
    "where no mirror, glass door or stairs can mislead it."
)


class MappingPanel:
    """The map that is being made, or how to begin one."""

    def __init__(
        self, gui: Controls, add_folder: AddFolder, actions: RobotActions, aiming: Aiming
    ) -> None:
        self._ask, self._tell = actions.ask, actions.tell
        self._aiming = aiming
        self._status: MappingStatus | None = None
        self._map_name = ""
        self._now_ns = 0
        self._sure_until_ns = 0
        with add_folder("Make a map", is_open=True):
            self._how = gui.add_html(note(HOW))
            self._state = gui.add_html("", visible=False)
            self._name = gui.add_text("Map name", "home")
            with gui.add_tiles():
                self._new = gui.add_button("New map", icon="plus", colour="green")
                self._extend = gui.add_button("Extend this map", icon="map-2", colour="teal")
                self._save = gui.add_button("Save map", icon="device-floppy", colour="green")
                self._explore = gui.add_button("Explore", icon="compass")
                self._pause = gui.add_button("Pause", icon="player-pause", colour="teal")
                self._undo = gui.add_button("Undo last minute", icon="arrow-back-up")
                self._join = gui.add_button(POINT_POSE, icon="current-location", colour="teal")
                self._drop = gui.add_button("Remove loose part", icon="eraser")
                self._cancel = gui.add_button("Discard", icon="trash")
        self._new.on_press(self._begin)
        self._extend.on_press(self._extend_map)
        self._save.on_press(self._save_map)
        self._explore.on_press(self._explore_or_stand)
        self._pause.on_press(self._pause_or_go_on)
        self._undo.on_press(self._take_back)
        self._join.on_press(lambda: self._aiming.toggle(SET_POSE))
        self._drop.on_press(self._drop_loose)
        self._cancel.on_press(self._give_up)

    def update(self, view: View) -> None:
        """Show what can be done now."""
        before, status = self._extends, view.streams.latest(topics.MAPPING)
        self._status = status
        self._map_name = "" if view.map is None else view.map.name
        self._now_ns = view.now_ns
        state = "idle" if status is None else status.state
        words = mapping_line(status)
        if status is None:
            words = StatusLine("The mapper is not running", "idle")
        elif words is not None:
            words = aged(words, view.overdue_s(topics.MAPPING))
        self._state.visible = words is not None
        self._state.content = "" if words is None else row(words)
        is_making = state in ("mapping", "paused")
        is_idle = status is not None and state == "idle"
        self._how.visible = self._new.visible = is_idle
        if self._extends is not None and self._extends != before:
            self._name.value = self._extends
        self._name.visible = is_idle or (is_making and self._extends is not None)
        self._extend.visible = is_idle and bool(self._map_name)
        self._save.visible = self._pause.visible = self._undo.visible = is_making
        self._explore.visible = state == "mapping"
        self._explore.label = "Stop exploring" if self._is_exploring else "Explore by itself"
        self._explore.colour = "amber" if self._is_exploring else "green"
        self._explore.disabled = view.is_halted and not self._is_exploring
        self._pause.label = "Continue" if state == "paused" else "Pause"
        self._join.visible = self._drop.visible = (
            is_making and status is not None and status.loose > 0
        )
        self._join.label = LEAVE if self._aiming.armed == SET_POSE else POINT_POSE
        is_asking = self._now_ns < self._sure_until_ns
        self._cancel.visible = (  # release 0.2.0 never says that it may be discarded
            is_making or state == "starting" or (status is not None and status.may_discard)
        )
        self._cancel.label = "Really discard it?" if is_asking else "Discard"
        self._cancel.colour = "amber" if is_asking else "grey"

    # Inside.
    def _begin(self) -> None:
        name = self._name.value.strip()
        if not name:
            self._tell("Not started", "Give the map a name first.", "warn")
            return
        self._ask(requests.MAP_NEW, MapNamed(name=name), "No map was started")

    def _extend_map(self) -> None:
        self._ask(requests.MAP_EXTEND, MapNamed(name=self._map_name), "The map cannot be extended")

    def _save_map(self) -> None:
        def saved(_: Any) -> None:
            self._tell("Saved", "The map is saved. The robot uses it from now on.", "good")

        name = None if self._extends is None else self._name.value.strip() or None
        self._ask(requests.MAP_SAVE, SaveMap(name=name), "Not saved", saved)

    @property
    def _extends(self) -> str | None:
        """The map that is extended now, if one is."""
        status = self._status
        return None if status is None or status.state == "idle" else status.extends

    @property
    def _is_exploring(self) -> bool:
        return self._status is not None and self._status.exploring in ("exploring", "homing")

    def _explore_or_stand(self) -> None:
        self._ask(requests.MAP_EXPLORE, ExploreMap(on=not self._is_exploring), "Not done")

    def _pause_or_go_on(self) -> None:
        is_paused = self._status is not None and self._status.state == "paused"
        self._ask(requests.MAP_PAUSE, PauseMap(on=not is_paused), "Not done")

    def _take_back(self) -> None:
        self._ask(requests.MAP_UNDO, UndoMap(), "Not undone")

    def _drop_loose(self) -> None:
        self._ask(requests.MAP_DROP, Nothing(), "Not removed")

    def _give_up(self) -> None:
        if self._now_ns >= self._sure_until_ns:
            self._sure_until_ns = self._now_ns + SURE_NS
            return
        self._sure_until_ns = 0
        self._ask(requests.MAP_CANCEL, Nothing(), "Not discarded")
