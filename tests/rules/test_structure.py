"""How the code hangs together: what inherits what, which way imports point, where numbers live."""

import ast
import importlib.metadata
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING

import pytest
from support.members import MEMBERS, SERVICES

from trolley.runtime.service import Service

if TYPE_CHECKING:
    from .conftest import Source

PACKAGES = ("trolley", *(f"trolley_{name}" for name in MEMBERS))
APART_IN_BASE = tuple(
    f"trolley_base.{room}"
    for room in ("calibration", "commands", "detection", "emulators", "importers", "setup")
)
"""What prepares a robot or takes its place, and does not run on one that drives."""
FEW = (-1.0, 0.0, 0.5, 1.0, 2.0)
"""Numbers that mean something else each time they are written."""

Graph = Mapping[str, Iterable[str]]


def modules_of(sources: list["Source"], package: str) -> dict[str, "Source"]:
    """The modules of a package by their dotted names."""
    found: dict[str, Source] = {}
    for source in sources:
        parts = source.path.with_suffix("").parts
        if package in parts:
            dotted = parts[parts.index(package) :]
            found[".".join(dotted[:-1] if dotted[-1] == "__init__" else dotted)] = source
    return found


def imported(source: "Source", modules: Iterable[str]) -> Iterator[str]:
    """The modules among `modules` that a source imports, for its types only as well."""
    for node in ast.walk(source.tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in modules)
        elif isinstance(node, ast.ImportFrom) and node.module:
            for alias in node.names:
                whole = f"{node.module}.{alias.name}"
                yield whole if whole in modules else node.module


def circles(graph: Graph) -> list[list[str]]:
    """The groups of nodes that reach each other (Tarjan 1972)."""
    index: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    found: list[list[str]] = []

    def visit(node: str) -> None:
        index[node] = low[node] = len(index)
        stack.append(node)
        for other in graph.get(node, ()):
            if other not in index:
                visit(other)
                low[node] = min(low[node], low[other])
            elif other in stack:
                low[node] = min(low[node], index[other])
        if low[node] == index[node]:
            group: list[str] = []
            while not group or group[-1] != node:
                group.append(stack.pop())
            if len(group) > 1:
                found.append(sorted(group))

    for node in graph:
        if node not in index:
            visit(node)
    return found


def graph_of(sources: list["Source"], package: str) -> dict[str, set[str]]:
    """Who imports whom in a package."""
    modules = modules_of(sources, package)
    return {
        name: {other for other in imported(source, modules) if other in modules and other != name}
        for name, source in modules.items()
    }


def room_of(module: str, folder: str) -> str:
    """What holds a module directly in a folder, or the module itself."""
    return ".".join(module.split(".")[: folder.count(".") + 2])


@pytest.mark.parametrize("name", SERVICES)
def test_a_service_inherits_service_only(name: str) -> None:
    (entry,) = importlib.metadata.entry_points(group="trolley.services", name=name)
    assert entry.load().__bases__ == (Service,)


@pytest.mark.parametrize("package", PACKAGES)
def test_no_modules_import_each_other_in_a_circle(sources: list["Source"], package: str) -> None:
    assert circles(graph_of(sources, package)) == []


@pytest.mark.parametrize("package", PACKAGES)
def test_arrows_between_folders_point_one_way(sources: list["Source"], package: str) -> None:
    """Also between the folders in a folder."""
    graph = graph_of(sources, package)
    folders = {name.rpartition(".")[0] for name in graph} - {""}
    for folder in sorted(folders):
        rooms: dict[str, set[str]] = defaultdict(set)
        for module, others in graph.items():
            if module.startswith(f"{folder}."):
                room = room_of(module, folder)
                inside = (one for one in others if one.startswith(f"{folder}."))
                rooms[room] |= {room_of(other, folder) for other in inside} - {room}
        assert circles(rooms) == []


def test_what_drives_a_robot_imports_no_emulator_detection_calibration_or_import(
    sources: list["Source"],
) -> None:
    graph = graph_of(sources, "trolley_base")
    assert set(APART_IN_BASE) <= {room_of(module, "trolley_base") for module in graph}
    arrows = [
        f"{module} -> {other}"
        for module, others in graph.items()
        if room_of(module, "trolley_base") not in APART_IN_BASE
        for other in sorted(others)
        if room_of(other, "trolley_base") in APART_IN_BASE
    ]
    assert arrows == []


@pytest.mark.parametrize("package", PACKAGES)
def test_a_number_has_one_home(sources: list["Source"], package: str) -> None:
    homes: dict[tuple[str, float], list[str]] = defaultdict(list)
    for module, source in modules_of(sources, package).items():
        for name, value in _numbers(source.tree):
            if value not in FEW:
                homes[name.lstrip("_"), value].append(module)
    assert {name: where for (name, _), where in homes.items() if len(where) > 1} == {}


def _numbers(tree: ast.Module) -> Iterator[tuple[str, float]]:
    """The constants of a module that are numbers, by name."""
    for node in tree.body:
        targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
        value = getattr(node, "value", None)
        if isinstance(value, ast.Constant) and isinstance(value.value, int | float):
            for target in targets:
                if isinstance(target, ast.Name):
                    yield target.id, float(value.value)
