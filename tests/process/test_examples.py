"""The programs of `examples/`, as they are, with a scripted robot."""

import io
import json
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import zenoh
from support.examples import EXAMPLES, load_example
from support.waiting import PATIENCE_S, wait_until

from trolley import Refused, Robot, RobotUnreachable, topics
from trolley.messages.types import floats_from_bytes

from .test_python import MAP, SCAN, publish

SAYS = {
    "where": "one is at Pose2D(x=1.0, y=2.0, yaw=0.5)",
    "go": "arrived",
    "places": "kitchen on the map home, 1.4 m away",
    "nearest": "2 echoes, the nearest at 1.00 m",
    "watch": "battery: None\nok",
    "picture": "",
    "turn": "",
    "mark": "",
    "everybody": "one: localized",
    "at_once": "arrived after 0 s",
}
ELSEWHERE = {"own_planner", "own_base", "bare_base", "keep_away", "depth", "oak", "photograph"}
"""Programs that go on until they are ended; what they do is tested in tests/service/planner and
base, of bare_base in test_own_base.py, of depth and oak in tests/unit."""


@pytest.fixture
def robot(
    add_robot: Callable, endpoint: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A robot where `Robot()` finds it."""
    file = tmp_path / "robot.toml"
    file.write_text(
        '[robot]\nname = "one"\nfootprint = { radius_m = 0.2 }\n'
        f'[zenoh]\nconnect = ["{endpoint}"]\n'
    )
    monkeypatch.setenv("TROLLEY_CONFIG", str(file))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.argv", ["example"])
    scripted = add_robot("one")
    publish(scripted, topics.MAP, MAP)
    scripted.call_soon(lambda: scripted.publish(topics.SCAN, SCAN))


@pytest.mark.parametrize("name", SAYS)
def test_an_example_does_what_it_says(
    robot: None, name: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    if name == "nearest":  # the scripted robot has one scan only
        monkeypatch.setattr("itertools.islice", lambda scans, _: [next(scans)])
    said = [""]

    def does_it() -> bool:
        try:
            load_example(name)
        except (Refused, RobotUnreachable):  # the scripted robot was late for a second
            return False
        said[0] += capsys.readouterr().out
        return SAYS[name] in said[0]

    wait_until(does_it, lambda: f"{SAYS[name]!r} in {said[0]!r}")
    if name == "picture":
        assert Path("map.png").read_bytes().startswith(b"\x89PNG")


def test_costs_are_published_until_the_program_ends(robot: None, endpoint: str) -> None:
    program = [sys.executable, str(EXAMPLES / "keep_away.py"), "kitchen"]
    with (
        Robot(connect=endpoint) as watcher,
        watcher.subscribe(topics.COSTS) as heard,
        subprocess.Popen(program) as running,
    ):
        first, second = heard.next(PATIENCE_S), heard.next(PATIENCE_S)
        running.terminate()
    assert first is not None
    assert second is not None
    assert first.parts == ("keep_away",)
    assert max(first.message.cells) > 90
    assert (first.message.name, first.message.frame) == ("home", "map")


def test_a_place_that_is_not_there_is_said_in_a_sentence(robot: None) -> None:
    program = [sys.executable, str(EXAMPLES / "keep_away.py"), "crib"]
    done = subprocess.run(program, capture_output=True, text=True, check=False, timeout=PATIENCE_S)
    assert done.stderr == "There is no place 'crib'; there are kitchen.\n"


def test_depth_images_on_the_wire_become_scans(robot: None, endpoint: str) -> None:
    program = [
        *(sys.executable, str(EXAMPLES / "depth.py"), "front"),
        *("--focal", "110", "110", "--centre", "80", "40", "--height", "0.5"),
    ]
    wall = io.BytesIO()
    np.save(wall, np.full((80, 160), 1200, np.uint16))
    settings = zenoh.Config()
    settings.insert_json5("mode", '"client"')
    settings.insert_json5("connect/endpoints", f'["{endpoint}"]')
    with (
        Robot(connect=endpoint) as watcher,
        watcher.subscribe(topics.EXTRA_SCAN) as heard,
        zenoh.open(settings) as session,
        subprocess.Popen(program, stdout=subprocess.PIPE, text=True) as running,
    ):
        scan, until_s = None, time.monotonic() + PATIENCE_S
        while scan is None and time.monotonic() < until_s:
            session.put("trolley/one/depth/front", b"no image")
            session.put("trolley/one/depth/front", wall.getvalue())
            scan = heard.next(0.2)
        running.terminate()
    assert scan is not None
    assert scan.parts == ("front",)
    ranges = floats_from_bytes(scan.message.ranges)
    assert ranges[len(ranges) // 2] == pytest.approx(1.2, abs=0.01)


def test_a_picture_is_published_once_it_is_whole(
    robot: None, endpoint: str, tmp_path: Path
) -> None:
    file = tmp_path / "camera.jpg"
    file.write_bytes(b"\xff\xd8\xff\xe0 half")
    program = [sys.executable, str(EXAMPLES / "photograph.py"), str(file)]
    with (
        Robot(connect=endpoint) as watcher,
        watcher.subscribe(topics.CAMERA) as heard,
        subprocess.Popen(program) as running,
    ):
        file.write_bytes(b"\xff\xd8\xff\xe0 whole\xff\xd9")
        first = heard.next(PATIENCE_S)
        running.terminate()
    assert first is not None
    assert first.message.jpeg == b"\xff\xd8\xff\xe0 whole\xff\xd9"


def test_the_notebook_runs(robot: None) -> None:
    notebook = json.loads((EXAMPLES / "notebook.ipynb").read_text("utf-8"))
    scope: dict[str, object] = {}
    for cell in notebook["cells"]:
        assert not cell.get("outputs")
        if cell["cell_type"] == "code":
            exec("".join(cell["source"]), scope)
    assert "closed" in repr(scope["robot"])


def test_each_example_is_tested() -> None:
    assert {file.stem for file in EXAMPLES.glob("*.py")} == SAYS.keys() | ELSEWHERE
