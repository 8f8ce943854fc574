"""Messages given as JSON on the command line."""

import math

import click
import pytest

from trolley.cli.json_argument import read_json
from trolley.messages import Scan, floats_from_bytes
from trolley.messages.request_params import Nothing, SendGoal
from trolley.suggestions import did_you_mean


def test_what_is_left_out_is_the_wire_s_default() -> None:
    goal = read_json('{"pose": {"x": 1, "y": 2, "yaw": 0}}', SendGoal, "goal/send")
    assert goal.pose is not None
    assert (goal.pose.x, goal.xy_tolerance) == (1.0, 0.05)


def test_arrays_are_lists_as_echo_prints_them() -> None:
    text = (
        '{"stamp_ns": 1, "frame": "laser", "angle_min": 0, "angle_increment": 0.1, '
        '"time_increment": 0, "range_min": 0.1, "range_max": 8, "ranges": [1, null, 0]}'
    )
    scan = read_json(text, Scan, "scan")
    assert floats_from_bytes(scan.ranges).tolist() == [1.0, math.inf, 0.0]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("kitchen", "'kitchen' is not JSON"),
        ("[1]", "goal/send takes a JSON object in {}, not [1]"),
        ('{"nane": "kitchen"}', "goal/send has no field 'nane'. Did you mean name?"),
        ('{"name": 5}', "goal/send: `name`: text or nothing is needed, not a whole number"),
        (
            '{"pose": {"x": "1", "y": 2, "yaw": 0}}',
            "goal/send: `pose.x`: a number is needed, not text",
        ),
        ('{"pose": {"x": 1, "y": 2}}', "goal/send: `pose`: `yaw` is missing"),
        (
            '{"name": "a", "xy_tolerance": 0}',
            "goal/send: `xy_tolerance`: it must be at least 0.005",
        ),
        ('{"pose": {"x": NaN, "y": 2, "yaw": 0}}', "NaN is not a number there"),
        ("{}", "goal/send: give either pose or name"),
        ("[" * 100_000, "is not JSON"),
    ],
)
def test_what_is_wrong_is_said_in_words(text: str, said: str) -> None:
    with pytest.raises(click.BadParameter) as refused:
        read_json(text, SendGoal, "goal/send")
    assert said in refused.value.message


def test_a_request_without_parameters_takes_none() -> None:
    assert read_json("{}", Nothing, "base/stop") == Nothing()
    with pytest.raises(click.BadParameter, match="It takes nothing"):
        read_json('{"hard": true}', Nothing, "base/stop")


def test_the_nearest_names_are_suggested_else_those_that_there_are() -> None:
    assert did_you_mean("kichen", ["kitchen", "hall"]) == "Did you mean kitchen?"
    assert did_you_mean("KITCHEN", ["kitchen"]) == "Did you mean kitchen?"
    assert did_you_mean("attic", ["hall", "den"]) == "There are den, hall."
    assert did_you_mean("attic", ["den"]) == "There is only den."
    assert did_you_mean("attic", []) == "There are none."
    many = did_you_mean("zzz", [f"place {i}" for i in range(20)])
    assert many.endswith("and others.")
