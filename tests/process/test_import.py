"""`trolley import linorobot` as a program, on files that would end or hang a careless one."""

import os
from collections.abc import Callable
from pathlib import Path

from trolley.config import load_config

DEEP = 100_000


def test_no_file_ends_or_hangs_the_command(tmp_path: Path, trolley: Callable) -> None:
    folder = tmp_path / "linorobot"
    launch, param = folder / "launch", folder / "param" / "navigation"
    launch.mkdir(parents=True)
    param.mkdir(parents=True)
    footprint = "footprint: [[-0.16, -0.11], [-0.16, 0.11], [0.16, 0.11], [0.16, -0.11]]\n"
    (param / "costmap_common_params.yaml").write_text(footprint)
    (launch / "bringup.launch").write_text("<launch>" + "<group>" * DEEP + "</group>" * DEEP)
    os.mkfifo(launch / "navigate.launch")
    (param / "base_local_planner_default_params.yaml").symlink_to("/dev/zero")
    output = tmp_path / "robot.toml"
    done = trolley(
        *("import", "linorobot", str(folder), "-o", str(output)),
        *("--base", "2wd", "--lidar", "xv11"),
    )
    assert done.returncode == 0, done.stderr
    said = done.stdout + done.stderr
    assert "Traceback" not in said
    assert "launch/bringup.launch:1 is nested more than 100 deep" in said
    assert "launch/navigate.launch cannot be read: " in said
    assert "base_local_planner_default_params.yaml cannot be read: " in said
    assert load_config(output).robot.drive == "differential"
