"""Arguments that may be negative numbers."""

import contextlib
from types import SimpleNamespace

import pytest
from click.testing import CliRunner

from trolley.cli import config, maps
from trolley.messages import Settings


def test_a_setting_may_be_negative(monkeypatch: pytest.MonkeyPatch) -> None:
    changes: list[dict[str, object]] = []

    def note(_section: str, *, save: bool, **values: object) -> Settings:
        changes.append(values)
        return Settings(settings=[], message="")

    robot = SimpleNamespace(set_config=note)
    monkeypatch.setattr(config, "one_robot", lambda: contextlib.nullcontext(robot))
    for words in (["-1.5"], ["--bogus"], ["2", "--no-save"]):
        CliRunner().invoke(config.config_command, ["set", "base.yaw", *words])
    assert changes == [{"yaw": -1.5}, {"yaw": 2}]


def test_a_map_is_loaded_at_a_pose(monkeypatch: pytest.MonkeyPatch) -> None:
    robot = SimpleNamespace(load_map=lambda name, at: SimpleNamespace(name=f"{name} {at}"))
    monkeypatch.setattr(maps, "one_robot", lambda: contextlib.nullcontext(robot))
    result = CliRunner().invoke(maps.map_command, ["load", "home", "--at", "1", "-2", "0"])
    assert result.output == "The robot now uses the map home (1.0, -2.0, 0.0).\n"
