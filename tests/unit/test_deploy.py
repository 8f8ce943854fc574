"""The systemd units, the example configuration and the list of packages to install."""

import importlib.util
import json
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tomllib
from importlib.metadata import entry_points
from pathlib import Path
from types import ModuleType

import pytest

from trolley.config import load_config
from trolley.runtime.open_files import MANY

ROOT = Path(__file__).resolve().parents[2]
DEPLOY = ROOT / "deploy"
SYSTEMD = DEPLOY / "systemd"
SERVICES = sorted(SYSTEMD.glob("trolley-*.service"))
COMMON = SYSTEMD / "trolley-.service.d" / "trolley.conf"
BY_COMMAND = {"router", "ros2"}
"""Programs with a unit that are no services of `trolley run`."""
RETRY = SYSTEMD / "trolleyretry@.service"
MOST_EXPOSURE = 2.0
MB = {"M": 1, "G": 1024}

needs_systemd = pytest.mark.skipif(
    shutil.which("systemd-analyze") is None, reason="systemd is not installed"
)


def values(unit: Path, key: str) -> list[str]:
    """What a unit says for a key, words of all its lines."""
    lines = unit.read_text(encoding="utf-8").splitlines()
    found = [line.partition("=")[2] for line in lines if line.startswith(f"{key}=")]
    return " ".join(found).split()


def megabytes(unit: Path, key: str) -> int:
    """A size that a unit gives."""
    (value,) = values(unit, key)
    return int(value[:-1]) * MB[value[-1]]


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The units as systemd finds them, with a program that is there."""
    folder = tmp_path_factory.mktemp("units")
    shutil.copytree(SYSTEMD, folder, dirs_exist_ok=True)
    for unit in folder.glob("*.service"):
        # The program is not installed here, and verify insists on one that is.
        text = re.sub(r"(?m)^ExecStart=/opt/.*$", "ExecStart=/bin/true", unit.read_text("utf-8"))
        unit.write_text(text, encoding="utf-8")
    template = folder / RETRY.name
    shutil.copy(template, folder / "trolleyretry@trolley-base.service")
    return folder


def analyze(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Ask systemd about units in a folder and no others."""
    return subprocess.run(
        ["systemd-analyze", *arguments],
        env={**os.environ, "SYSTEMD_UNIT_PATH": f"{folder}:"},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )


@pytest.mark.programs
@needs_systemd
def test_units_pass_systemd_analyze_without_a_word(installed: Path) -> None:
    units = [*installed.glob("*.target"), *installed.glob("*.service")]
    names = sorted(str(unit) for unit in units if "@." not in unit.name)
    checked = analyze(installed, "verify", "--man=no", *names)
    # It returns 0 for keys that it does not know and only says so.
    assert (checked.returncode, checked.stderr.strip()) == (0, "")


@pytest.mark.programs
@needs_systemd
@pytest.mark.parametrize(
    "name", [*(unit.name for unit in SERVICES), "trolleyretry@trolley-base.service"]
)
def test_a_unit_is_hardly_exposed(installed: Path, name: str) -> None:
    path = str(installed / name)
    checked = analyze(installed, "security", "--offline=true", "--no-pager", path)
    (exposure,) = re.findall(r"Overall exposure level for \S+: ([0-9.]+)", checked.stdout)
    assert float(exposure) <= MOST_EXPOSURE, checked.stdout
    json_text = analyze(installed, "security", "--offline=true", "--json=short", path).stdout
    assert json.loads(json_text)  # it was read, not skipped


def test_every_service_has_a_unit_and_so_have_router_and_ros_bridge() -> None:
    services = {entry.name for entry in entry_points(group="trolley.services")} | BY_COMMAND
    assert {unit.stem for unit in SERVICES} == {f"trolley-{name}" for name in services}


@pytest.mark.parametrize("unit", SERVICES, ids=lambda unit: unit.stem)
def test_a_unit_runs_its_service_and_says_what_it_may_use(unit: Path) -> None:
    name = unit.stem.removeprefix("trolley-")
    command = [name] if name in BY_COMMAND else ["run", name]
    assert values(unit, "ExecStart") == ["/opt/trolley/current/.venv/bin/trolley", *command]
    assert values(unit, "Type") == ["notify"]
    assert values(unit, "WatchdogSec")
    assert values(unit, "OnFailure") == ["trolleyretry@%N.service"]
    assert megabytes(unit, "MemoryHigh") < megabytes(unit, "MemoryMax") <= 640
    if name != "router":
        assert "trolley-router.service" in values(unit, "After")
    # What all have in common stands in one place and is not said again, or otherwise.
    own = {line.partition("=")[0] for line in unit.read_text("utf-8").splitlines() if "=" in line}
    shared = {line.partition("=")[0] for line in COMMON.read_text("utf-8").splitlines()}
    assert own & shared <= {"Environment", "#"} | {key for key in own if key.startswith("#")}


def test_the_router_may_open_all_the_files_that_it_asks_for() -> None:
    # Its sandbox would not let it raise the limit itself.
    assert values(SYSTEMD / "trolley-router.service", "LimitNOFILE") == [str(MANY)]


def test_all_units_come_back_for_ever_but_not_in_a_frenzy() -> None:
    assert values(COMMON, "Restart") == ["on-failure"]
    assert values(COMMON, "RestartSec") == ["1"]
    (limit,), (burst,) = values(COMMON, "StartLimitIntervalSec"), values(COMMON, "StartLimitBurst")
    assert int(limit) > int(burst)  # a second apart, so many starts fit into the interval
    assert values(RETRY, "ExecStart") == ["/bin/sleep", "60"]  # a second would follow a stop
    assert "%i.service" in values(RETRY, "PartOf")
    assert values(RETRY, "SuccessExitStatus") == ["SIGTERM"]
    assert values(COMMON, "StateDirectory") == ["trolley"]


@pytest.mark.parametrize(
    ("code", "asked"),
    [(0, ["is-failed", "reset-failed", "start"]), (1, ["is-failed"])],
    ids=["failed for good", "running again, or stopped meanwhile"],
)
def test_only_what_is_still_failed_is_started_after_its_rest(
    tmp_path: Path, code: int, asked: list[str]
) -> None:
    systemctl = tmp_path / "systemctl"
    systemctl.write_text(f'#!/bin/sh\necho "$1"\n[ "$1" != is-failed ] || exit {code}\n')
    systemctl.chmod(0o755)
    found = re.search(r"sh -c '(.*?)'", RETRY.read_text(), re.DOTALL)
    assert found is not None
    script = found[1].replace("\\\n", "").replace("%i", "trolley-tour")
    done = subprocess.run(
        ["/bin/sh", "-c", script],
        env={"PATH": f"{tmp_path}:/usr/bin:/bin"},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.split() == asked


def test_base_survives_its_devices_and_may_use_those_that_come_later() -> None:
    base = SYSTEMD / "trolley-base.service"
    devices = {r"dev-trolley\x2dchassis.device", r"dev-trolley\x2dlidar.device"}
    assert devices == set(values(base, "Wants"))
    assert devices < set(values(base, "After"))
    for key in ("BindsTo", "Requires", "Requisite", "PrivateDevices"):
        assert values(base, key) == []
    for device in devices:
        timeout = SYSTEMD / f"{device}.d" / "trolley.conf"
        assert values(timeout, "JobRunningTimeoutSec") == ["2"]
    # By number: a name is looked up when base starts, and its driver may be loaded later.
    allowed = set(values(base, "DeviceAllow")) - {"rw"}
    assert allowed == {f"char-{major}" for major in (188, 166, 204, 4)}


@pytest.mark.parametrize("unit", SERVICES, ids=lambda unit: unit.stem)
def test_only_services_with_kernels_may_make_code(unit: Path) -> None:
    name = unit.stem.removeprefix("trolley-")
    package = ROOT / "services" / name / f"trolley_{name}"
    has_kernels = (package / "warmup.py").exists()
    assert values(unit, "MemoryDenyWriteExecute") == ["no" if has_kernels else "yes"]
    assert bool(values(unit, "Environment")) == has_kernels


@pytest.mark.parametrize(
    ("target", "services"),
    [
        ("robot", {"router", "base", "localizer", "mapper", "planner", "tour"}),
        ("pc", {"router", "viz"}),
        ("router", {"router"}),
    ],
)
def test_a_target_pulls_in_what_its_host_needs(target: str, services: set[str]) -> None:
    path = SYSTEMD / f"trolley-{target}.target"
    assert set(values(path, "Wants")) == {f"trolley-{name}.service" for name in services}
    for name in services:  # and takes it along when it is stopped
        assert path.name in values(SYSTEMD / f"trolley-{name}.service", "PartOf")
    assert path.name in values(RETRY, "PartOf")


def test_the_example_configuration_loads() -> None:
    config = load_config(DEPLOY / "robot.toml")
    assert config.robot.name == "trolley"
    assert config.path(config.map.file or "") == DEPLOY / "maps" / "home.yaml"


@pytest.mark.programs
def test_what_is_installed_is_pinned_and_no_tool_of_developers() -> None:
    printed = subprocess.run(
        [sys.executable, str(DEPLOY / "runtime_requirements.py")],
        capture_output=True,
        text=True,
        check=True,
        timeout=60,
    ).stdout
    lock = (ROOT / "requirements.lock").read_text("utf-8")
    entries = re.split(r"\n(?! )", printed.strip())
    names = {entry.partition("==")[0] for entry in entries}
    assert {"eclipse-zenoh", "msgspec", "numba", "viser", "pyserial", "hatchling"} <= names
    assert not {"pytest", "ruff", "pyrefly", "playwright", "hypothesis", "uv"} & names
    for entry in entries:
        assert "--hash=sha256:" in entry
        assert entry in lock


def bill_of_materials() -> ModuleType:
    spec = importlib.util.spec_from_file_location("bill", DEPLOY / "bill_of_materials.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_a_bill_of_materials_tells_what_a_robot_needs_from_developers_tools() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    site = Path(sysconfig.get_path("purelib"))
    bill = bill_of_materials()
    found = bill.needed(site, project["project"]["dependencies"])
    libraries = {"eclipse-zenoh", "numba", "llvmlite", "viser", "foxglove-sdk"}
    assert found >= {"trolley-robot-base", *libraries}
    assert not found & {"pytest", "hypothesis", "ruff", "pyrefly", "uv", "playwright"}
    components = [{"name": "Eclipse_Zenoh"}, {"name": "pytest"}]
    marked = bill.with_scopes({"components": components}, found)["components"]
    assert [one["scope"] for one in marked] == ["required", "excluded"]
