"""The choice to see overlays; they lie over the scene, so nothing of them is in it."""

from trolley import topics
from trolley_viz.robots.view import View
from trolley_viz.scene.layer import Layer


class OverlayLayer(Layer):
    """Panels of programs; see `OverlaySet` and `OverlayPages`: nothing of them is in the scene."""

    key, title = "overlays", "Panels from programs"
    group = "Map"
    needs = (topics.OVERLAY,)

    def draw(self, view: View) -> None:
        """Leave the scene alone."""
