"""All layers, in the order in which they are listed."""

from collections.abc import Mapping
from typing import Any

import viser

from trolley import topics
from trolley.topics import Topic
from trolley_viz.scene.body import FrameLayer, RobotLayer
from trolley_viz.scene.ground import CostmapLayer, MapLayer
from trolley_viz.scene.layer import Layer, View
from trolley_viz.scene.places import PlaceLayer, ZoneLayer
from trolley_viz.scene.routes import GoalLayer, PathLayer, PreviewLayer, TrajectoryLayer
from trolley_viz.scene.sensing import CandidateLayer, ParticleLayer, ScanLayer

LAYERS: tuple[type[Layer], ...] = (
    MapLayer,
    ZoneLayer,
    PlaceLayer,
    RobotLayer,
    ScanLayer,
    ParticleLayer,
    CandidateLayer,
    GoalLayer,
    PathLayer,
    TrajectoryLayer,
    PreviewLayer,
    CostmapLayer,
    FrameLayer,
)

ALWAYS: tuple[Topic[Any], ...] = (
    topics.BASE,
    topics.TF,
    topics.ODOM,
    topics.MAP,
    topics.POSE,
    topics.GOAL,
    topics.POSES,
    topics.TOURS,
    topics.TOUR,
    topics.HEALTH,
)
"""What the panels and several layers need whatever is switched off."""


class Scene:
    """The layers of one server."""

    def __init__(self, server: viser.ViserServer, shown: Mapping[str, bool]) -> None:
        self.layers = [kind(server) for kind in LAYERS]
        for layer in self.layers:
            if layer.key in shown:
                layer.switch(shown[layer.key])

    def wanted(self) -> list[Topic[Any]]:
        """The streams that what is shown needs."""
        return [*ALWAYS, *(topic for one in self.layers if one.is_on for topic in one.needs)]

    def update(self, view: View) -> None:
        """Draw what changed."""
        for layer in self.layers:
            layer.update(view)

    def forget(self) -> None:
        """Draw everything anew."""
        for layer in self.layers:
            layer.forget()

    def choices(self) -> dict[str, bool]:
        """Which layers are shown, by key."""
        return {layer.key: layer.is_on for layer in self.layers if layer.is_listed}
