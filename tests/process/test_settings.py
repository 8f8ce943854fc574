"""Settings while the robot runs: the real command, Python and base over a real router."""

import json
import sys
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from support.processes import Process
from support.read_only import READ_ONLY
from support.waiting import PATIENCE_S, wait_until

from trolley import codes, topics
from trolley.client import Robot
from trolley.codes import Refused
from trolley.connection import Connection

FILE = """\
# The cat's robot.
[robot]
name = "haro"   # as on its collar
footprint = {{ radius_m = 0.15 }}

[map]
file = "{map}"

[zenoh]
connect = ["{endpoint}"]

[base.simulated]
world = "room"

[planner]
# max_speed_mps = 0.5  # number above 0 and at most 5
"""
ROOM = Path(__file__).parents[2] / "worlds" / "room.yaml"


@pytest.fixture
def file(router_endpoint: str, tmp_path: Path) -> Path:
    """A robot.toml that `/etc` would link to."""
    kept = tmp_path / "kept"
    kept.mkdir()
    target, link = kept / "robot.toml", tmp_path / "linked.toml"
    target.write_text(FILE.format(map=ROOM, endpoint=router_endpoint))
    link.symlink_to(target)
    return link


def test_a_setting_is_read_changed_and_saved(
    service_process: Callable, trolley: Callable, router_endpoint: str, file: Path
) -> None:
    endpoint = router_endpoint
    service_process("trolley_base", config=file)
    with Connection([endpoint], PATIENCE_S) as connection:
        robot = Robot.over(connection, "haro")
        wait_until(lambda: robot.latest(topics.CONFIG), "base tells its settings")
        done = trolley("config", "get", "planner.max_speed_mps", "--connect", endpoint)
        assert done.returncode == 0, done.stderr
        assert "planner.max_speed_mps = 0.5 m/s" in done.stdout
        assert "A change counts at once" in done.stdout

        done = trolley("config", "set", "planner.max_speed_mps", "0.3", "--connect", endpoint)
        assert done.returncode == 0, done.stderr
        assert "It counts at once. Saved in" in done.stdout
        assert file.is_symlink()
        text = file.read_text()
        assert text.startswith("# The cat's robot.\n")
        assert "# as on its collar" in text
        assert tomllib.loads(text)["planner"] == {"max_speed_mps": 0.3}

        (speed,) = robot.config("planner", "max_speed_mps")
        assert (speed.value, speed.saved) == (0.3, True)
        later = robot.set_config("start", pose={"x": 0.0, "y": 0.0, "yaw": 0.0})
        assert later.message == (
            f"It counts after a restart of the localizer. Saved in {file.resolve()}."
        )
        with pytest.raises(Refused) as refused:
            robot.set_config("viz", host="0.0.0.0")
        assert refused.value.code == codes.ONLY_IN_FILE

        done = trolley("config", "set", "planner.max_speed_mps", "9", "--connect", endpoint)
        assert done.returncode == 1
        assert done.stdout == ""
        assert "[planner] max_speed_mps cannot be 9. Allowed: number above 0" in done.stderr
        assert trolley("config", "set", "speed", "9", "--connect", endpoint).returncode == 2
        listed = trolley("config", "get", "base.limits", "--json", "--connect", endpoint)
        assert {one["key"]: one["acts"] for one in json.loads(listed.stdout)} == {
            "max_speed_mps": "at_once",
            "max_wz_radps": "at_once",
            "acceleration_mps2": "at_once",
            "deceleration_mps2": "file",
            "angular_acceleration_radps2": "file",
            "slope": "file",
        }


@pytest.fixture
def start_installed(file: Path, tmp_path: Path) -> Iterator[Callable[[], Process]]:
    """Starts base as systemd does: the folder of its robot.toml is read-only to it."""
    started: list[Process] = []
    state = {"TROLLEY_STATE": str(tmp_path / "state")}

    def start() -> Process:
        folder = file.resolve().parent
        base = [sys.executable, "-m", "trolley_base", "--config", str(file.resolve())]
        log = tmp_path / f"installed-{len(started)}.log"
        started.append(Process(["-c", READ_ONLY, str(folder), *base], log, state))
        return started[-1]

    yield start
    for process in started:
        process.kill()
    file.resolve().parent.chmod(0o755)


def test_an_installed_robot_keeps_what_is_set_in_its_state(
    start_installed: Callable[[], Process],
    trolley: Callable,
    router_endpoint: str,
    file: Path,
    tmp_path: Path,
) -> None:
    text, kept = file.read_text(), tmp_path / "state" / "haro" / "settings.toml"
    base = start_installed()
    with Connection([router_endpoint], PATIENCE_S) as connection:
        robot = Robot.over(connection, "haro")
        wait_until(lambda: robot.latest(topics.CONFIG), "base tells its settings")
        done = robot.set_config("planner", max_speed_mps=0.3)
        assert done.message.startswith(f"It counts at once. Saved in {kept}, since ")
        assert "cannot be written" in done.message
        assert robot.set_config("start", pose="kitchen").settings[0].saved
        assert file.read_text() == text
        assert tomllib.loads(kept.read_text())["set"]["start"] == {"pose": "kitchen"}

        assert base.terminate() == 0
        wait_until(lambda: robot.latest(topics.CONFIG) is None, "base is gone")
        start_installed()
        wait_until(lambda: robot.latest(topics.CONFIG), "base tells its settings")
        (speed,) = robot.config("planner", "max_speed_mps")
        assert (speed.value, speed.saved, speed.source) == (0.3, True, "settings_toml")
        told = trolley("config", "get", "start.pose", "--connect", router_endpoint)
        assert 'start.pose = "kitchen"' in told.stdout
        assert "overrides robot.toml" in told.stdout
