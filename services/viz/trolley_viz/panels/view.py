"""The tab of the view (layers, look, legend) and the tab of details (frames, services)."""

from typing import TYPE_CHECKING

import viser

from trolley.geometry.frames import BASE, LASER
from trolley.messages import Health
from trolley_viz.panels.control import GREY, handler
from trolley_viz.panels.markup import note, swatches, table
from trolley_viz.placement import Placement
from trolley_viz.scene.places import ZONE_COLOURS
from trolley_viz.scene.scene import LAYERS
from trolley_viz.scene.sensing import BEAM_COLOURS
from trolley_viz.words import duration

if TYPE_CHECKING:
    from trolley_viz.session import Session

LEGEND = [
    ("echo of something on the map", 0),
    ("not on the map", 1),
    ("behind a mirror or glass", 2),
    ("suspected reflection", 3),
    ("not used", 4),
]


class ViewPanel:
    """Which layers are shown."""

    def __init__(self, gui: viser.GuiApi, session: "Session") -> None:
        post, shown = session.post, session.layers()
        fit = gui.add_button("Show the whole map", icon=viser.Icon.MAXIMIZE, color=GREY)
        fit.on_click(handler(post, lambda _, __: session.fit_view()))
        for kind in LAYERS:
            box = gui.add_checkbox(kind.title, shown[kind.key])
            key = kind.key
            box.on_update(
                handler(
                    post, lambda _, is_on, key=key: session.switch_layer(key, is_on=bool(is_on))
                )
            )
        look = gui.add_checkbox("Dark background", session.choices.dark)
        look.on_update(handler(post, lambda _, is_dark: session.set_dark(is_dark=bool(is_dark))))
        beams = [(text, _rgb(BEAM_COLOURS[i].tolist())) for text, i in LEGEND]
        zones = [(f"zone: {kind}", colour) for kind, colour in ZONE_COLOURS.items()]
        gui.add_html(note("Laser scan and zones") + swatches(beams + zones))


class DetailPanel:
    """Frames with the age of their links, and the health of the services."""

    def __init__(self, gui: viser.GuiApi) -> None:
        self._frames = gui.add_html("")
        self._health = gui.add_html("")

    def update(
        self, placement: Placement, robot_ns: int | None, health: dict[tuple[str, ...], Health]
    ) -> None:
        """Show both; `robot_ns` is robot time, None while unknown."""
        self._frames.content = note("Frames") + frame_table(placement, robot_ns)
        rows = [
            (name, one.state, f"{100 * one.cpu:.0f} % · {one.rss / 2**20:.0f} MB", one.message)
            for (name,), one in sorted(health.items())
        ]
        self._health.content = note("Services") + table(rows)


def frame_table(placement: Placement, robot_ns: int | None) -> str:
    """Each frame with its parent, pose and age, and what is missing."""
    rows: list[tuple[str, ...]] = []
    for frame in placement.tree.frames():
        link = placement.tree.link(frame)
        if link is None:
            continue
        age = "" if robot_ns is None or link.stamp_ns is None else _age(robot_ns - link.stamp_ns)
        where = f"{link.pose.x:.2f}, {link.pose.y:.2f}, {link.pose.yaw:.2f}"
        rows.append((frame, f"in {link.parent}", where, age))
    missing = [text for frame in (BASE, LASER) if (text := placement.missing(frame))]
    return table(rows) + "".join(note(text) for text in missing)


def _age(age_ns: int) -> str:
    return f"{duration(max(age_ns, 0) * 1e-9)} old"


def _rgb(values: list[int]) -> tuple[int, int, int]:
    red, green, blue = values
    return red, green, blue
