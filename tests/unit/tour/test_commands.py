"""`trolley tour import` without a robot: what it reads and shows."""

import json

import pytest
from click.testing import CliRunner

from trolley_tour.commands import import_tour

SCRIPT = """
GoalPoints = [ [(5.3, 1.4, 0.0), (0.0, 0.0, 0.0, 1.0)], #corridor
    [(2.1, -2.7, 0.0), (0.0, 0.0, 0.7071068, 0.7071068)]] #kitchen
"""


@pytest.fixture
def script(tmp_path):
    path = tmp_path / "MoveTBtoGoalPoints.py"
    path.write_text(SCRIPT)
    return str(path)


def run(*arguments: str, stdin: str | None = None):
    return CliRunner().invoke(import_tour, ["--dry-run", *arguments], input=stdin)


def test_dry_run_shows_places_and_tour(script: str):
    result = run(script)
    assert result.exit_code == 0, result.output
    assert "corridor" in result.output
    assert "The tour MoveTBtoGoalPoints with 2 stops would be saved." in result.output


def test_json_holds_poses_and_tour(script: str):
    result = run(script, "--json", "--name", "evening")
    body = json.loads(result.output)
    assert body["tour"]["name"] == "evening"
    assert [stop["name"] for stop in body["tour"]["stops"]] == ["corridor", "kitchen"]
    assert body["poses"][1]["pose"]["yaw"] == pytest.approx(1.5707963, abs=1e-6)


def test_standard_input_is_read():
    assert "The tour imported with 2 stops" in run("-", stdin=SCRIPT).output


@pytest.mark.parametrize(
    ("arguments", "why"),
    [(["-"], "no list called GoalPoints"), (["nowhere.py"], "No such file")],
)
def test_what_cannot_be_read_is_told(arguments: list[str], why: str):
    result = run(*arguments, stdin="x = 1")
    assert result.exit_code != 0
    assert why in result.output


def test_bad_name_is_refused(script: str):
    assert "give another with --name" in run(script, "--name", "../x").output
