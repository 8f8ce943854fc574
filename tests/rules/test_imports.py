"""Who may import what: services know the wire, not each other."""

import functools
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from support.members import MEMBERS, SERVICES, WITHOUT_SERVICE

if TYPE_CHECKING:
    from .conftest import Source

RUNTIME = Path("common/trolley/runtime")


def owner_of(path: Path) -> str:
    """`common`, or the name of the service that the file belongs to."""
    return path.parts[1] if path.parts[0] == "services" else "common"


def importers(sources: list["Source"], package: str, allowed: Path) -> list[str]:
    """Where `package` is imported by files that are neither `allowed` nor below it."""
    return [
        place
        for source in sources
        if source.path != allowed and allowed not in source.path.parents
        for place in source.imports_of(package)
    ]


@pytest.mark.parametrize("service", MEMBERS)
def test_nobody_imports_a_service_but_itself(sources: list["Source"], service: str) -> None:
    places = [
        place
        for source in sources
        if owner_of(source.path) != service
        for place in source.imports_of(f"trolley_{service}")
    ]
    assert places == []


@pytest.mark.parametrize(
    ("package", "allowed"),
    [
        ("zenoh", RUNTIME),
        ("numba", Path("common/trolley/jit.py")),
        ("serial", Path("services/base/trolley_base")),
        ("viser", Path("services/viz/trolley_viz")),
        ("mcap", Path("common/trolley/recording")),
        ("paho", Path("services/mqtt/trolley_mqtt")),
        ("mcp", Path("services/mcp/trolley_mcp")),
        ("mcp_types", Path("services/mcp/trolley_mcp")),
        ("rosbags", Path("services/ros2/trolley_ros2")),
    ],
)
def test_library_is_imported_in_one_place_only(
    sources: list["Source"], package: str, allowed: Path
) -> None:
    assert importers(sources, package, allowed) == []


COSTLY = ("numba", "PIL", "serial", "foxglove", "mcap")


@functools.cache
def loaded_by(modules: str) -> frozenset[str]:
    """The costly libraries that a process loads with some modules."""
    program = f"import sys, {modules}; print(*{{*{COSTLY}}} & {{*sys.modules}})"
    loaded = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=False, timeout=60
    )
    assert loaded.returncode == 0, loaded.stderr
    return frozenset(loaded.stdout.split())


@pytest.mark.programs
@pytest.mark.parametrize(
    "module",
    [
        "trolley",
        "trolley_base.service",
        "trolley_mapper.service",
        "trolley_tour.service",
        "trolley_viz.service",
    ],
)
def test_what_needs_no_kernels_does_not_load_the_compiler(module: str) -> None:
    # viser brings PIL along for its images.
    allowed = {"PIL"} if "viz" in module else set[str]()
    assert loaded_by(module) & {"numba", "PIL", "serial"} <= allowed


@pytest.mark.programs
@pytest.mark.parametrize(
    ("module", "libraries"),
    [
        ("trolley.cli.record, trolley.cli.replay", {"foxglove", "mcap"}),
        ("trolley_base.service, trolley_base.recording.recorded_device", {"foxglove", "mcap"}),
        ("trolley_viz.service", {"foxglove", "mcap"}),
        ("trolley.recording.drive", {"foxglove"}),
    ],
)
def test_what_records_nothing_does_not_load_the_recorder(module: str, libraries: set[str]) -> None:
    assert not loaded_by(module) & libraries


def project_of(root: Path, member: str) -> dict[str, Any]:
    """The `project` table of a member's pyproject.toml."""
    return tomllib.loads((root / member / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def test_a_pc_that_only_views_installs_neither_serial_nor_the_compiler(root: Path) -> None:
    needed = " ".join(
        dependency
        for member in ("common", "services/viz")
        for dependency in project_of(root, member)["dependencies"]
    )
    assert "pyserial" not in needed
    assert "numba" not in needed


def test_only_the_viewer_installs_viser(root: Path) -> None:
    members = ["common", *(f"services/{name}" for name in MEMBERS)]
    wanting = [
        member
        for member in members
        if any(item.startswith("viser") for item in project_of(root, member)["dependencies"])
    ]
    assert wanting == ["services/viz"]


@pytest.mark.parametrize("service", SERVICES)
def test_each_service_is_registered_under_its_name(root: Path, service: str) -> None:
    registered = project_of(root, f"services/{service}")["entry-points"]["trolley.services"]
    assert list(registered) == [service]
    assert registered[service].startswith(f"trolley_{service}.service:")


@pytest.mark.parametrize("member", WITHOUT_SERVICE)
def test_what_is_no_service_is_a_command(root: Path, member: str) -> None:
    registered = project_of(root, f"services/{member}")["entry-points"]
    assert "trolley.services" not in registered
    assert member in registered["trolley.commands"]
