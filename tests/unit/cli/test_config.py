"""`trolley config get`: what it prints of settings."""

import contextlib
from types import SimpleNamespace

import pytest
from click.testing import CliRunner
from msgspec import structs

from trolley.cli import config
from trolley.messages import Setting

SPEED = Setting(
    section="planner",
    key="max_speed_mps",
    value=0.5,
    next=0.5,
    default=0.5,
    meaning="Highest speed of the planner.",
    allowed="number above 0",
    unit="m/s",
    acts="at_once",
    source="default",
)


def test_all_that_is_said_of_one_setting_stands_on_lines_of_its_own(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    robot = SimpleNamespace(config=lambda section, key: [SPEED])
    monkeypatch.setattr(config, "one_robot", lambda: contextlib.nullcontext(robot))
    result = CliRunner().invoke(config.config_command, ["get", "planner.max_speed_mps"])
    assert result.output.splitlines() == [
        "planner.max_speed_mps = 0.5 m/s",
        "Highest speed of the planner.",
        "Allowed: number above 0. Default: 0.5. A change counts at once.",
        "It is the default.",
    ]


def test_a_list_says_what_a_setting_will_be_after_a_restart(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    later = structs.replace(SPEED, key="period_s", next=0.2, acts="restart", source="robot_toml")
    robot = SimpleNamespace(config=lambda section, key: [SPEED, later])
    monkeypatch.setattr(config, "one_robot", lambda: contextlib.nullcontext(robot))
    result = CliRunner().invoke(config.config_command, ["get", "planner"])
    rows = [line.split("  ") for line in result.output.splitlines()[1:]]
    assert [[cell.strip() for cell in row if cell][1] for row in rows] == ["0.5", "0.5, then 0.2"]
