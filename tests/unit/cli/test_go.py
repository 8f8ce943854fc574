"""`trolley go` and `trolley follow`: what an interrupt leaves behind."""

import contextlib
from typing import Any

import click
import pytest
from click.testing import CliRunner

from trolley.cli import go
from trolley.codes import Refused


class Silent:
    """A robot whose planner takes a goal and does not answer before something else comes."""

    def __init__(self, instead: BaseException) -> None:
        self.sent: list[str] = []
        self.canceled: list[str] = []
        self._instead = instead

    def ask(self, _request: Any, goal: Any) -> Any:
        self.sent.append(goal.id)
        raise self._instead

    def cancel(self, goal: str) -> None:
        self.canceled.append(goal)


@pytest.mark.parametrize("instead", [KeyboardInterrupt(), Refused("timeout")], ids=["C-c", "late"])
@pytest.mark.parametrize(
    ("command", "words"),
    [(go.go_command, ["1", "2"]), (go.follow_command, [])],
    ids=["go", "follow"],
)
def test_a_goal_that_is_not_answered_yet_is_canceled(
    command: click.Command,
    words: list[str],
    instead: BaseException,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    robot = Silent(instead)
    monkeypatch.setattr(go, "one_robot", lambda: contextlib.nullcontext(robot))
    assert CliRunner().invoke(command, words).exit_code == 1
    assert robot.canceled == robot.sent
    assert len(robot.sent) == 1


def test_a_goal_that_was_only_sent_is_left_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    robot = Silent(KeyboardInterrupt())
    monkeypatch.setattr(go, "one_robot", lambda: contextlib.nullcontext(robot))
    CliRunner().invoke(go.go_command, ["kitchen", "--no-wait"])
    assert (len(robot.sent), robot.canceled) == (1, [])
