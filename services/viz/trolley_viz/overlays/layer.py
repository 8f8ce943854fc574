"""The choice to see overlays; they lie over the scene, so nothing of them is in it."""

from trolley import topics
from trolley_viz.scene.layer import Layer, View


class OverlayLayer(Layer):
    """Panels of programs; `Board` follows what they show and `InPages` puts them in the page."""

    key, title = "overlays", "Panels of programs"
    group = "Map"
    needs = (topics.OVERLAY,)

    def draw(self, view: View) -> None:
        """Leave the scene alone."""
