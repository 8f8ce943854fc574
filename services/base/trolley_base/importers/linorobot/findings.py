"""What is gathered from a linorobot's files."""

from dataclasses import dataclass, field

from trolley_base.importers.findings import Findings, Value
from trolley_base.importers.linorobot.launch_files import Launch, Node


@dataclass(slots=True)
class LinorobotFindings(Findings):
    """What was found; `launch` is what the launch files of the package start."""

    launch: Launch = field(default_factory=Launch)


def first(nodes: list[Node], names: tuple[str, ...]) -> Value | None:
    """Return the first of these parameters that a node has."""
    values = (node.params.get(name) for node in nodes for name in names)
    return next((value for value in values if value is not None), None)
