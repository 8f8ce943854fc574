"""docs/drawing.md: each example is understood, and says the same from Python and as a command."""

import re
import shlex
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from trolley import topics
from trolley.messages import Marker, Overlay, OverlayRule, Pose2D
from trolley.runtime import codec
from trolley_viz.graphics.icons import known_icon
from trolley_viz.overlays.source import parse_source

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "drawing.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"```(python|sh)\n(.*?)```", PAGE, re.DOTALL)

Puts = dict[str, Any]


class Drawn:
    """Stands for `Robot`; remembers what was put and deleted."""

    def __init__(self) -> None:
        self.puts: Puts = {}

    def put_marker(self, namespace: str, name: str, marker: Marker) -> None:
        self.puts[f"put markers/{namespace}/{name}"] = marker

    def put_overlay(self, name: str, overlay: Overlay) -> None:
        self.puts[f"put overlays/{name}"] = overlay

    def delete_marker(self, namespace: str, name: str) -> None:
        self.puts[f"delete markers/{namespace}/{name}"] = None


def of_python() -> Puts:
    robot = Drawn()
    names: Any = SimpleNamespace(
        robot=robot, Marker=Marker, Overlay=Overlay, OverlayRule=OverlayRule, Pose2D=Pose2D
    )
    for language, text in BLOCKS:
        if language == "python" and "subscribe" not in text:
            exec(compile(text, "drawing.md", "exec"), vars(names))
    return robot.puts


def of_commands() -> Puts:
    puts: Puts = {}
    for language, text in BLOCKS:
        for line in text.splitlines() if language == "sh" else []:
            if line.startswith("zenoh"):
                command = shlex.split(line)
                key = command[command.index("-k") + 1]
                found = topics.find(key)
                assert found is not None, key
                what = "put" if "put" in command else "delete"
                payload = command[command.index("-v") + 1].encode() if what == "put" else b""
                message = codec.decode_strict(found[0].message, payload) if payload else None
                puts[f"{what} {key.removeprefix('trolley/trolley/')}"] = message
    return puts


def test_python_and_commands_say_the_same() -> None:
    python, commands = of_python(), of_commands()
    assert commands.pop("delete overlays/mode", ...) is None
    assert python == commands
    assert len(python) > 10


@pytest.mark.parametrize("name", [name for name in of_python() if name.startswith("put")])
def test_each_example_can_be_shown(name: str) -> None:
    message = of_python()[name]
    if isinstance(message, Overlay):
        assert not message.source or parse_source(message.source)
    elif message.kind == "icon":
        assert known_icon(message.icon) is not None


def test_the_commands_of_trolley_are_there() -> None:
    said = {line for language, text in BLOCKS if language == "sh" for line in text.splitlines()}
    assert {line for line in said if line.startswith("trolley")} == {
        "trolley topic echo choices/mode",
        "trolley tf base_link map",
        "trolley tf base_link map --json",
    }
