"""Making a map: start, pause, undo, save or discard."""

from typing import Any

import viser

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
from trolley_viz.panels.controls import AMBER, GREEN, GREY, TEAL, show
from trolley_viz.panels.markup import note, row
from trolley_viz.panels.tiles import MARK, SMALL
from trolley_viz.robots.view import View
from trolley_viz.sentences import StatusLine, mapping_line
from trolley_viz.session.session import Session
from trolley_viz.threads import handler

SURE_NS = 6_000_000_000
"""How long a second press discards the map."""
HOW = (
    "Put the robot where its home will be. Then drive it through every room, slowly around "
    "corners, and come back to where you started; or let it explore by itself while you stay near, "
    "where no mirror, glass door or stairs can mislead it."
)


class MappingPanel:
    """The map that is being made, or how to begin one."""

    def __init__(self, gui: viser.GuiApi, session: Session) -> None:
        self._ask = session.actions.ask
        self._tell = session.tell
        self._status: MappingStatus | None = None
        self._map_name = ""
        self._now_ns = 0
        self._sure_until_ns = 0
        post = session.post
        with session.folder("Make a map"):
            gui.add_html(MARK + SMALL)
            self._how = gui.add_html(note(HOW))
            self._state = gui.add_html("", visible=False)
            self._name = gui.add_text("Map name", "home")
            self._new = gui.add_button("New map", icon=viser.Icon.PLUS, color=GREEN)
            self._extend = gui.add_button("Extend this map", icon=viser.Icon.MAP_2, color=TEAL)
            self._save = gui.add_button("Save map", icon=viser.Icon.DEVICE_FLOPPY, color=GREEN)
            self._explore = gui.add_button("Explore", icon=viser.Icon.COMPASS, color=GREEN)
            self._pause = gui.add_button("Pause", icon=viser.Icon.PLAYER_PAUSE, color=TEAL)
            self._undo = gui.add_button(
                "Undo last minute", icon=viser.Icon.ARROW_BACK_UP, color=GREY
            )
            self._cancel = gui.add_button("Discard", icon=viser.Icon.TRASH, color=GREY)
        self._new.on_click(handler(post, lambda _, __: self._begin()))
        self._extend.on_click(handler(post, lambda _, __: self._extend_map()))
        self._save.on_click(handler(post, lambda _, __: self._save_map()))
        self._explore.on_click(handler(post, lambda _, __: self._explore_or_stand()))
        self._pause.on_click(handler(post, lambda _, __: self._pause_or_go_on()))
        self._undo.on_click(handler(post, lambda _, __: self._take_back()))
        self._cancel.on_click(handler(post, lambda _, __: self._give_up()))

    def update(self, view: View) -> None:
        """Show what can be done now."""
        status = self._status = view.streams.latest(topics.MAPPING)
        self._map_name = "" if view.map is None else view.map.name
        self._now_ns = view.now_ns
        state = "idle" if status is None else status.state
        words = mapping_line(status)
        if status is None:
            words = StatusLine("The mapper is not running", "idle")
        show(self._state, content="" if words is None else row(words), visible=words is not None)
        is_making = state in ("mapping", "paused")
        is_idle = status is not None and state == "idle"
        show(self._how, visible=is_idle)
        show(self._name, visible=is_idle)
        show(self._new, visible=is_idle)
        show(self._extend, visible=is_idle and bool(self._map_name))
        show(self._save, visible=is_making)
        explores = self._is_exploring
        show(
            self._explore,
            visible=state == "mapping",
            label="Stop exploring" if explores else "Explore by itself",
            color=AMBER if explores else GREEN,
        )
        is_paused = state == "paused"
        show(self._pause, visible=is_making, label="Continue" if is_paused else "Pause")
        show(self._undo, visible=is_making)
        is_asking = self._now_ns < self._sure_until_ns
        show(
            self._cancel,
            visible=is_making or state == "starting",
            label="Really discard it?" if is_asking else "Discard",
            color=AMBER if is_asking else GREY,
        )

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

        self._ask(requests.MAP_SAVE, SaveMap(), "Not saved", saved)

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

    def _give_up(self) -> None:
        if self._now_ns >= self._sure_until_ns:
            self._sure_until_ns = self._now_ns + SURE_NS
            return
        self._sure_until_ns = 0
        self._ask(requests.MAP_CANCEL, Nothing(), "Not discarded")
