"""The robots on the network, as their `robot` messages and clocks tell of them."""

from collections.abc import Callable, Mapping

from trolley.messages import Robot


class Robots:
    """Which robots there are, and what they are called."""

    def __init__(self, own: str) -> None:
        self.own = own
        """The robot of the viewer's own configuration."""
        self._known: dict[str, Robot] = {}

    def update(self, heard: Mapping[tuple[str, ...], Robot]) -> None:
        """Take over the `robot` messages by name."""
        self._known = {parts[0]: robot for parts, robot in heard.items()}

    def get(self, name: str) -> Robot | None:
        """What a robot says that it is, None while it has not been heard of."""
        return self._known.get(name)

    def names(self, selected: str = "") -> list[str]:
        """All names, sorted; the robot of the own configuration and the selected one always."""
        return sorted({*self._known, self.own, selected or self.own})

    def labels(self, selected: str, is_away: Callable[[str], bool]) -> dict[str, str]:
        """What to call each robot in a list, to its name."""
        labels: dict[str, str] = {}
        for name in self.names(selected):
            known = self._known.get(name)
            title = known.title if known is not None else ""
            label = f"{title} ({name})" if title and title.lower() != name else title or name
            labels[label + (" – away" if is_away(name) else "")] = name
        return labels
