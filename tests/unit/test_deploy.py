"""The systemd units and the example configuration."""

import os
import shutil
import subprocess
from importlib.metadata import entry_points
from pathlib import Path

import pytest

from trolley.config import load_config

DEPLOY = Path(__file__).resolve().parents[2] / "deploy"
UNITS = sorted((DEPLOY / "systemd").iterdir())
SERVICES = [unit for unit in UNITS if unit.suffix == ".service"]


def values(unit: Path, key: str) -> list[str]:
    """What a unit says for a key, words of all its lines."""
    lines = unit.read_text(encoding="utf-8").splitlines()
    found = [line.partition("=")[2] for line in lines if line.startswith(f"{key}=")]
    return " ".join(found).split()


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd is not installed")
def test_units_pass_systemd_analyze_without_a_word(tmp_path: Path) -> None:
    for unit in UNITS:
        # The program is not installed here, and verify insists on one that is.
        text = "\n".join(
            "ExecStart=/bin/true" if line.startswith("ExecStart=") else line
            for line in unit.read_text(encoding="utf-8").splitlines()
        )
        (tmp_path / unit.name).write_text(text + "\n", encoding="utf-8")
    checked = subprocess.run(
        ["systemd-analyze", "verify", "--man=no", *sorted(map(str, tmp_path.iterdir()))],
        env={**os.environ, "SYSTEMD_UNIT_PATH": f"{tmp_path}:"},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    # It returns 0 for keys that it does not know and only says so.
    assert (checked.returncode, checked.stderr.strip()) == (0, "")


def test_every_service_and_the_router_has_a_unit() -> None:
    services = {entry.name for entry in entry_points(group="trolley.services")} | {"router"}
    assert {unit.stem for unit in SERVICES} == {f"trolley-{name}" for name in services}


@pytest.mark.parametrize("unit", SERVICES, ids=lambda unit: unit.stem)
def test_a_unit_runs_its_service_and_comes_back(unit: Path) -> None:
    name = unit.stem.removeprefix("trolley-")
    command = ["router"] if name == "router" else ["run", name]
    assert values(unit, "ExecStart") == ["/opt/trolley/.venv/bin/trolley", *command]
    assert values(unit, "Type") == ["notify"]
    assert values(unit, "Restart") == ["on-failure"]
    assert values(unit, "StartLimitIntervalSec") == ["0"]
    assert values(unit, "WatchdogSec")
    assert values(unit, "StateDirectory") == ["trolley"]


@pytest.mark.parametrize(
    ("target", "services"),
    [
        ("robot", {"router", "base", "localizer", "planner", "tour"}),
        ("pc", {"router", "viz"}),
    ],
)
def test_a_target_pulls_in_what_its_host_needs(target: str, services: set[str]) -> None:
    wanted = values(DEPLOY / "systemd" / f"trolley-{target}.target", "Wants")
    assert set(wanted) == {f"trolley-{name}.service" for name in services}


def test_the_example_configuration_loads() -> None:
    config = load_config(DEPLOY / "robot.toml")
    assert config.robot.name == "trolley"
    assert config.path(config.map.file or "") == DEPLOY / "maps" / "home.yaml"
