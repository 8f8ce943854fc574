"""Arguments that may be negative numbers."""

import contextlib
from types import SimpleNamespace

import click
import pytest
from click.testing import CliRunner

from trolley.cli import config, maps, record, replay
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


@pytest.mark.parametrize(
    ("command", "words"),
    [
        (replay.replay_command, [__file__, "--speed", "nan"]),
        (record.record_command, ["--seconds", "inf"]),
    ],
)
def test_what_is_no_number_is_refused(command: click.Command, words: list[str]) -> None:
    with pytest.raises(click.BadParameter, match="is not a finite number"):
        command.make_context("it", words)
