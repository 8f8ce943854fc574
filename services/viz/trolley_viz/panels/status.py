"""The top of the panel: which robot, and its state in plain words."""

from collections.abc import Callable, Mapping, Sequence

import viser

from trolley_viz.panels.control import Post, handler
from trolley_viz.panels.markup import row
from trolley_viz.words import Words

NO_ROBOT: str = "…"
SPACE = '<div style="height:0.5em"></div>'


class StatusPanel:
    """A list of robots where there are several, and a few lines of state."""

    def __init__(self, gui: viser.GuiApi, select: Callable[[str], None], post: Post) -> None:
        self._names: dict[str, str] = {}
        self._robot = gui.add_dropdown("Robot", (NO_ROBOT,), visible=False)
        self._lines = gui.add_html("")
        self._robot.on_update(handler(post, lambda _, label: self._chosen(label, select)))

    def update(self, labels: Mapping[str, str], selected: str, lines: Sequence[Words]) -> None:
        """Show the robots (label to name), the selected one and its state."""
        self._names = dict(labels)
        options = tuple(labels)
        if self._robot.options != options:
            self._robot.options = options
        self._robot.value = next(label for label, name in labels.items() if name == selected)
        self._robot.visible = len(options) > 1
        self._lines.content = "".join(map(row, lines)) + SPACE

    def _chosen(self, label: str, select: Callable[[str], None]) -> None:
        name = self._names.get(label)
        if name is not None:
            select(name)
