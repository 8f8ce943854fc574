"""All layers, in the order in which they are listed."""

from collections.abc import Mapping, Set
from typing import Any

import viser

from trolley import topics
from trolley.topics import Topic
from trolley_viz.features.tours.layer import TripLayer, TroubleLayer
from trolley_viz.robots.view import View
from trolley_viz.scene.layer import Layer
from trolley_viz.scene.map_layers import CostmapLayer, GlobalCostmapLayer, MapLayer
from trolley_viz.scene.markers.layer import MarkerLayer
from trolley_viz.scene.other_robots import OthersLayer
from trolley_viz.scene.overlays import OverlayLayer
from trolley_viz.scene.places import PlaceLayer, ZoneLayer
from trolley_viz.scene.pose_accuracy import CovarianceLayer, TruthLayer
from trolley_viz.scene.robot_body import RobotLayer
from trolley_viz.scene.routes import GoalLayer, PathLayer, TrajectoryLayer
from trolley_viz.scene.scan_and_particles import CandidateLayer, ParticleLayer, ScanLayer

LAYERS: tuple[type[Layer], ...] = (
    MapLayer,
    ZoneLayer,
    PlaceLayer,
    RobotLayer,
    OthersLayer,
    CovarianceLayer,
    TruthLayer,
    ScanLayer,
    ParticleLayer,
    CandidateLayer,
    GoalLayer,
    PathLayer,
    TrajectoryLayer,
    MarkerLayer,
    OverlayLayer,
    TripLayer,
    TroubleLayer,
    CostmapLayer,
    GlobalCostmapLayer,
)

ALWAYS: tuple[Topic[Any], ...] = (
    topics.BASE,
    topics.TF,
    topics.ODOM,
    topics.MAP,
    topics.POSE,
    topics.GOAL,
    topics.POSES,
    topics.ZONES,
    topics.SUSPECTS,
    topics.MAPPING,
    topics.CHANGES,
    topics.TOURS,
    topics.TOUR,
    topics.HEALTH,
    topics.CONFIG,
    topics.PROPOSALS,
    topics.SETUP,
)
"""What the panels and several layers need whatever is switched off."""


ROOT = "/robots"


class Scene:
    """The layers of one robot."""

    def __init__(self, server: viser.ViserServer, robot: str) -> None:
        self.root = f"{ROOT}/{robot}"
        self._frame = server.scene.add_frame(self.root, show_axes=False)
        self._layers = [kind(server, self.root) for kind in LAYERS]

    def wanted(self, shown: Set[str]) -> list[Topic[Any]]:
        """The streams that what is shown needs."""
        needed = (topic for one in self._layers if one.key in shown for topic in one.needs)
        return [*ALWAYS, *needed]

    def update(self, view: View, shown: Set[str]) -> None:
        """Draw what changed of the layers that somebody sees."""
        for layer in self._layers:
            if layer.key in shown:
                layer.update(view)

    def remove(self) -> None:
        """Take everything out of the scene."""
        self._frame.remove()

    def layer(self, key: str) -> Layer:
        """Return a layer."""
        return next(one for one in self._layers if one.key == key)


def shown_layers(choices: Mapping[str, bool]) -> dict[str, bool]:
    """Which layers are shown, by key: as chosen, else as it is by default."""
    return {kind.key: choices.get(kind.key, kind.on_by_default) for kind in LAYERS}
