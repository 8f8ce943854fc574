"""The top of the panel: which robot, what it is doing, and its state in plain words."""

from collections.abc import Callable, Mapping, Sequence

import viser

from trolley_viz.panels.markup import chips, sentence
from trolley_viz.sentences import StatusLine
from trolley_viz.threads import Post, handler

NO_ROBOT: str = "…"


class StatusPanel:
    """A list of robots where there are several, one sentence, and the state in a few words."""

    def __init__(self, gui: viser.GuiApi, select: Callable[[str], None], post: Post) -> None:
        self._names: dict[str, str] = {}
        self._robot = gui.add_dropdown("Robot", (NO_ROBOT,), visible=False)
        self._lines = gui.add_html("")
        self._robot.on_update(handler(post, lambda _, label: self._chosen(label, select)))

    def update(
        self,
        labels: Mapping[str, str],
        selected: str,
        doing: StatusLine,
        lines: Sequence[StatusLine],
    ) -> None:
        """Show the robots (label to name), the selected one, what it is doing and its state."""
        self._names = dict(labels)
        options = tuple(labels)
        if self._robot.options != options:
            self._robot.options = options
        label = next(label for label, name in labels.items() if name == selected)
        if self._robot.value != label:
            self._robot.value = label
        self._robot.visible = len(options) > 1
        self._lines.content = sentence(doing) + chips(lines)

    def _chosen(self, label: str, select: Callable[[str], None]) -> None:
        name = self._names.get(label)
        if name is not None:
            select(name)
