"""`trolley go` and `trolley follow`: what they print, and what an interrupt leaves behind."""

import contextlib
from types import SimpleNamespace
from typing import Any

import click
import pytest
from click.testing import CliRunner
from msgspec import structs

from trolley.cli import go
from trolley.codes import Refused
from trolley.messages import GoalStatus


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


def test_how_a_drive_ended_is_printed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    driving = GoalStatus(stamp_ns=1, id="g1", state="driving", elapsed=1.0)
    arrived = structs.replace(driving, state="arrived", elapsed=4.0)
    robot = SimpleNamespace(
        ask=lambda request, params: driving, follow=lambda goal, timeout: iter((driving, arrived))
    )
    monkeypatch.setattr(go, "one_robot", lambda: contextlib.nullcontext(robot))
    result = CliRunner().invoke(go.go_command, ["kitchen"])
    assert result.output.splitlines() == ["driving, 1 s so far", "arrived after 4 s"]
    assert result.exit_code == 0


def test_a_drive_that_a_stop_has_paused_names_the_commands_that_continue_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    why = "The robot was stopped; once it may drive again, resume the goal to go on."
    paused = GoalStatus(stamp_ns=1, id="g1", state="paused", reason="stopped", message=why)
    arrived = structs.replace(paused, state="arrived", elapsed=4.0)
    robot = SimpleNamespace(
        ask=lambda request, params: paused, follow=lambda goal, timeout: iter((paused, arrived))
    )
    monkeypatch.setattr(go, "one_robot", lambda: contextlib.nullcontext(robot))
    output = CliRunner().invoke(go.go_command, ["kitchen"]).output
    assert "drive again (`trolley resume`), `trolley ask goal/resume` continues it" in output


def test_a_goal_that_was_only_sent_is_left_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    robot = Silent(KeyboardInterrupt())
    monkeypatch.setattr(go, "one_robot", lambda: contextlib.nullcontext(robot))
    CliRunner().invoke(go.go_command, ["kitchen", "--no-wait"])
    assert (len(robot.sent), robot.canceled) == (1, [])
