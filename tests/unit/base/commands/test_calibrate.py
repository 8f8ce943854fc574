"""`trolley calibrate`: what it asks."""

import math

import click
import pytest
from click.testing import CliRunner

from trolley.geometry import Pose2D
from trolley_base.commands.calibrate import ask_end, calibrate_command


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
