"""The choice to see overlays; they lie over the scene, so nothing of them is in it."""

from trolley import topics
from trolley_viz.robots.view import View
from trolley_viz.scene.layer import Layer


class OverlayLayer(Layer):
    """Panels of programs: `OverlaySet` follows their values, `OverlayPages` sends them to pages."""

    key, title = "overlays", "Panels of programs"
    group = "Map"
    needs = (topics.OVERLAY,)

    def draw(self, view: View) -> None:
        """Leave the scene alone."""
