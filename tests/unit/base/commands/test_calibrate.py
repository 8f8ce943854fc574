"""`trolley calibrate`: what it asks."""

import math
from datetime import UTC, datetime, timedelta

import click
import pytest
from click.testing import CliRunner

from trolley.geometry import Pose2D
from trolley.messages.proposals import Proposal
from trolley_base.commands.calibrate import ask_end, calibrate_command, right_until_text


def answered(*answers: str) -> tuple[Pose2D, float]:
    ends: list[tuple[Pose2D, float]] = []
    ask = click.Command("ask", callback=lambda: ends.append(ask_end(0.6)))
    result = CliRunner().invoke(ask, input="".join(f"{one}\n" for one in answers))
    assert result.exit_code == 0, result.output
    return ends[0]


def test_what_cannot_be_is_asked_again() -> None:
    """Centimetres, and slips of the finger: a drive of minutes was lost by them."""
    end, error_rad = answered("12", "0.12", "0,03", "-0.03", "abc", "270", "-3")
    assert (end.x, end.y) == (0.12, -0.03)
    assert end.yaw == pytest.approx(math.radians(-3.0))
    assert error_rad < 0.1


def test_a_robot_does_not_drive_off_while_it_is_put_back_on_its_mark() -> None:
    result = CliRunner().invoke(calibrate_command, ["square", "--by-hand", "--yes"])
    assert result.exit_code == 2
    assert "back on its mark" in result.output


def test_a_heading_need_not_be_measured() -> None:
    assert answered("0.1", "0", "") == (Pose2D(0.1, 0.0, 0.0), math.inf)


def test_until_when_it_was_right_is_told_by_this_computers_clock() -> None:
    """Robot time goes on as it began, as where a Raspberry Pi hears the time only later."""
    began_ns = 1_000_000_000
    one = Proposal(id="turning", message="", right_until=began_ns)
    an_hour_ago = (datetime.now(UTC) - timedelta(hours=1)).astimezone()
    minutes = {f"{an_hour_ago + timedelta(minutes=n):%Y-%m-%d %H:%M}" for n in (0, 1)}
    text = right_until_text(one, began_ns + 3_600_000_000_000)
    assert any(text == f" It was right until {minute}." for minute in minutes)
    assert right_until_text(one, None) == ""
