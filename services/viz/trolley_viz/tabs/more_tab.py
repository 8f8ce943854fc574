"""The tab for engineers: what else there is to see, folded away until it is wanted."""

from collections.abc import Callable, Sequence

import numpy as np

from trolley import topics
from trolley.messages import PoseEstimate
from trolley_viz.controls.controls import Check, Container, Controls
from trolley_viz.controls.markup import note, row, swatches, table
from trolley_viz.features.diagnosis.frames import FrameTreePanel
from trolley_viz.features.diagnosis.measuring import FramesPanel, PlotPanel
from trolley_viz.features.diagnosis.proposals import ProposalPanel
from trolley_viz.features.diagnosis.streams import StreamPanel
from trolley_viz.features.people.links import add_links
from trolley_viz.features.people.panel import PeoplePanel
from trolley_viz.features.settings.panel import SettingsPanel
from trolley_viz.features.settings.requests import RobotSettings
from trolley_viz.languages.catalogue import ENGLISH, catalogues
from trolley_viz.robots.view import View
from trolley_viz.scene.layer import Group, Layer
from trolley_viz.scene.places import (
    APPEARED_COLOUR,
    GONE_COLOUR,
    SUSPECT_COLOUR,
    ZONE_COLOURS,
)
from trolley_viz.scene.pose_accuracy import error_of
from trolley_viz.scene.scan_and_particles import BEAM_COLOURS
from trolley_viz.session.robot_scene import follow_values
from trolley_viz.session.scene import LAYERS
from trolley_viz.session.session import Session
from trolley_viz.tabs.shortcuts import add_shortcuts
from trolley_viz.words.sentences import StatusLine, age_text, percent, pose_text

GROUPS: tuple[Group, ...] = ("Robot", "Sensing", "Driving", "Map")
BEAMS = [
    ("echo of something on the map", 0),
    ("not on the map", 1),
    ("behind a mirror or glass", 2),
    ("suspected reflection", 3),
    ("not used", 4),
]
PERIOD_NS = 1_000_000_000
AS_DEVICE, LIGHT, DARK = "as this device", "light", "dark"
"""The looks."""

DOUBTS = [("mirror?", SUSPECT_COLOUR), ("new?", APPEARED_COLOUR), ("gone?", GONE_COLOUR)]
"""What is asked on the map."""


class MoreTab:
    """Layers, position, frames, services, streams, people, settings, keys.

    Args:
        show_link: shows a link for somebody who is let in.
    """

    def __init__(
        self, gui: Controls, tab: Container, session: Session, show_link: Callable[[str], None]
    ) -> None:
        self.tab = tab
        self._due_ns = 0
        self._proposals = ProposalPanel(gui, session.actions, may_dismiss=session.may_drive)
        fit = gui.add_button("Show the whole map", icon="maximize")
        fit.on_press(session.window.fit)
        chosen = session.preferences.choices
        now = DARK if chosen.dark else LIGHT if chosen.light else AS_DEVICE
        look = gui.add_list("Look", (AS_DEVICE, LIGHT, DARK), value=now)
        look.on_change(lambda one: session.choose_look(dark=one == DARK, light=one == LIGHT))
        _add_languages(gui, session)
        self._layers = {group: LayerPanel(gui, session, group) for group in GROUPS}
        with session.folder("Position"):
            self._position = gui.add_html("")
        with session.folder("Frames"):
            self._frames = FrameTreePanel(
                gui, lambda: session.preferences.frames, session.preferences.switch_frame
            )
        with session.folder("Services and streams"):
            self._streams = StreamPanel(gui)
        self._relation = FramesPanel(gui, session.folder)
        self._plot = PlotPanel(
            gui,
            session.folder,
            lambda robot: follow_values(session.hub.service, robot),
            session.save_file,
        )
        self._notes = gui.add_html("")
        self._robot_scene = lambda: session.hub.scenes.of(session.robot)
        self._people = PeoplePanel(
            gui,
            session.folder,
            session.hub.people,
            session.hub.robots,
            session.number,
            session.visitor,
            session.tell,
        )
        self._settings: SettingsPanel | None = None
        if session.may_drive:
            asked = RobotSettings(session.hub.service, session.actions, lambda: session.robot)
            self._settings = SettingsPanel(gui, session.folder, asked)
            add_links(gui, session.folder, session.hub.links, show_link)
        with session.folder("State"):
            self._state = gui.add_html("")
        with session.folder("Keys"):
            gui.add_html(add_shortcuts(gui, session))

    def follow(self, view: View) -> None:
        """Plot, also while nobody looks: what is plotted has no gaps."""
        self._plot.update(view)

    def update(self, view: View, lines: Sequence[StatusLine]) -> None:
        """Say what is: what is for reading once a second; `lines` are of the robot's state."""
        self._state.content = "".join(map(row, lines))
        self._people.update(view.now_ns)
        if self._settings is not None:
            self._settings.update(view)
        self._relation.update(view)
        if view.now_ns < self._due_ns:
            return
        self._due_ns = view.now_ns + PERIOD_NS
        self._proposals.update(view)
        for panel in self._layers.values():
            panel.update(view)
        self._position.content = table(position_rows(view))
        self._frames.update(view)
        self._streams.update(view)
        self._notes.content = "".join(map(note, self._robot_scene().notes))

    def close_plot(self) -> None:
        """Stop following what is plotted."""
        self._plot.close()


class LayerPanel:
    """The layers of one group, each with the age of what it shows."""

    def __init__(self, gui: Controls, session: Session, group: Group) -> None:
        self._session = session
        self._boxes: dict[type[Layer], Check] = {}
        shown, switch = session.preferences.layers, session.preferences.switch_layer
        with session.folder(f"Layers: {group}"):
            for kind in LAYERS:
                if kind.group == group:
                    box = self._boxes[kind] = gui.add_check(kind.title, shown[kind.key])
                    box.on_change(lambda is_on, key=kind.key: switch(key, is_on=is_on))
            if group == "Sensing":
                beams = [(text, _rgb(BEAM_COLOURS[i].tolist())) for text, i in BEAMS]
                gui.add_html(note("Laser scan") + swatches(beams))
            elif group == "Map":
                zones = [(kind, colour) for kind, colour in ZONE_COLOURS.items()]
                gui.add_html(note("Zones") + swatches([*zones, *DOUBTS]))

    def update(self, view: View) -> None:
        """Bring the ages up to date."""
        shown = self._session.preferences.layers
        for kind, box in self._boxes.items():
            is_aged = shown[kind.key] and kind.source is not None
            age = f" · {_age(view, kind)}" if is_aged else ""
            box.label = f"{kind.title}{age}"
            box.visible = kind.source is not topics.SIM_TRUTH or _is_simulated(view)


def position_rows(view: View) -> list[tuple[str, ...]]:
    """How well the robot knows where it is, in numbers."""
    streams = view.streams
    estimate, cloud = streams.latest(topics.POSE), streams.latest(topics.PARTICLES)
    if estimate is None:
        return [("position", "no data")]
    rows: list[tuple[str, ...]] = []
    if estimate.pose is not None and estimate.map is not None:
        rows.append(("pose", f"{pose_text(estimate.pose)}, {estimate.map}"))
    rows.append(("match", f"{percent(estimate.match)}, {estimate.state}"))
    count = "particles not shown" if cloud is None else f"{len(cloud.weights) // 4} particles"
    rows.append(("particles", f"{count}, spread {estimate.spread:.2f} m"))
    if estimate.covariance is not None:
        rows.append(("standard deviation", _deviations(estimate)))
    error = error_of(view)
    if error is not None:
        rows.append(("actual error", error.text))
    if view.robot_ns is not None:
        rows.append(("age", age_text((view.robot_ns - estimate.stamp_ns) * 1e-9)))
    return rows


def _add_languages(gui: Controls, session: Session) -> None:
    """Let the person choose a language, each of which is called as it calls itself."""
    codes = {AS_DEVICE: "", "English": ENGLISH}
    codes |= {catalogue.name: code for code, catalogue in catalogues().items()}
    now = session.preferences.choices.language
    chosen = next((name for name, code in codes.items() if code == now), None)
    language = gui.add_list("Language", tuple(codes), value=chosen, words=(AS_DEVICE,))
    language.on_change(lambda name: session.preferences.choose_language(codes[name]))


def _deviations(estimate: PoseEstimate) -> str:
    variances = np.array(estimate.covariance, np.float64)[[0, 4, 8]]
    x, y, yaw = np.sqrt(np.maximum(variances, 0.0)).tolist()
    return f"x {100 * x:.1f} cm, y {100 * y:.1f} cm, {np.degrees(yaw):.1f}°"


def _age(view: View, kind: type[Layer]) -> str:
    arrived_ns = None if kind.source is None else view.streams.arrived_ns(kind.source)
    return age_text(None if arrived_ns is None else (view.now_ns - arrived_ns) * 1e-9)


def _is_simulated(view: View) -> bool:
    return view.robot is not None and view.robot.simulated


def _rgb(values: list[int]) -> tuple[int, int, int]:
    red, green, blue = values
    return red, green, blue
