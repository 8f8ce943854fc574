"""`trolley config get`: what it prints of one setting."""

import contextlib
from types import SimpleNamespace

import pytest
from click.testing import CliRunner

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
