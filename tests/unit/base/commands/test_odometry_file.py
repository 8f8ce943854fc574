"""Setting `[base.odometry]` in a robot.toml that somebody has written."""

from pathlib import Path

import pytest

from trolley.cli.init import render
from trolley.config import ConfigError, load_config
from trolley_base.commands.odometry_file import as_toml, settings_of, write_settings
from trolley_base.odometry.wheel_scales import WheelScales

FOUND = {"linear_scale": 0.9812, "angular_scale": 1.0123, "wheel_ratio": 1.0041}
HEAD = """\
# My robot.
[robot]
name = "mine"  # of the house
footprint = {radius_m = 0.2}
"""
TRACK = "[base.odometry]\n# measured with a ruler\ntrack_m = 0.21\n# not more\n"


@pytest.mark.parametrize(
    "rest",
    [
        TRACK,
        f"[base]\nstop_margin_m = 0.1 # w\n[base.limits]\nmax_speed_mps = 0.4\n{TRACK}[viz]\n",
        f"[base.limits]\nmax_speed_mps = 0.4\n[planner]\n# none\n{TRACK}\n[viz]\n",
        "[base]\nodometry = {track_m = 0.21}\n",
        "[base]\nodometry.track_m = 0.21\n",
        "base.odometry.track_m = 0.21\n",
    ],
)
def test_only_the_three_numbers_change(tmp_path: Path, rest: str) -> None:
    path = tmp_path / "robot.toml"
    text = rest + HEAD if rest.startswith("base.") else HEAD + rest
    path.write_text(text)
    before = load_config(path)
    write_settings(path, FOUND)
    after = load_config(path)
    found = after.base.odometry
    assert (found.linear_scale, found.angular_scale, found.wheel_ratio) == tuple(FOUND.values())
    assert found.track_m == 0.21
    assert (after.robot, after.base.limits, after.base.stop_margin_m) == (
        before.robot,
        before.base.limits,
        before.base.stop_margin_m,
    )
    for line in text.splitlines():
        if "#" in line:
            assert line[line.index("#") :] in path.read_text()


def test_what_init_wrote_as_a_comment_is_set_in_its_place(tmp_path: Path) -> None:
    path = tmp_path / "robot.toml"
    path.write_text(render({"robot.name": '"mine"', "robot.footprint": "{radius_m = 0.2}"}))
    old = path.read_text().splitlines()
    write_settings(path, FOUND)
    new = path.read_text().splitlines()
    changed = {now for was, now in zip(old, new, strict=True) if was != now}
    assert changed == {f"{name} = {value}" for name, value in FOUND.items()}
    assert load_config(path).base.odometry.wheel_ratio == FOUND["wheel_ratio"]


@pytest.mark.parametrize("rest", ["", "[planner]\n", "[base]\n", "[base.limits]\n"])
def test_a_missing_table_is_added(tmp_path: Path, rest: str) -> None:
    path = tmp_path / "robot.toml"
    path.write_text(HEAD + rest)
    write_settings(path, {**FOUND, "track_m": 0.3})
    assert load_config(path).base.odometry.track_m == 0.3


def test_what_would_be_no_valid_file_is_not_written(tmp_path: Path) -> None:
    path = tmp_path / "robot.toml"
    path.write_text(HEAD + TRACK)
    with pytest.raises(ConfigError, match="wheel_ratio"):
        write_settings(path, {**FOUND, "wheel_ratio": 1.9})
    assert path.read_text() == HEAD + TRACK
    assert list(tmp_path.iterdir()) == [path]


def test_a_file_that_is_not_there_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"robot\.toml"):
        write_settings(tmp_path / "robot.toml", FOUND)


def test_the_printed_table_is_that_of_the_file() -> None:
    scales = WheelScales(linear=0.98123, angular=1.0, wheel_ratio=1.00407, track_m=0.2)
    assert as_toml(settings_of(scales, with_track=True)) == (
        "[base.odometry]\nlinear_scale = 0.9812\nangular_scale = 1.0\nwheel_ratio = 1.0041\n"
        "track_m = 0.2"
    )
