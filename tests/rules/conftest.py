"""The source files that the rules are about, parsed once."""

import ast
import gc
import subprocess
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import pytest

ROOT = Path(__file__).resolve().parents[2]
Node = TypeVar("Node", bound=ast.AST)


@dataclass(frozen=True)
class Source:
    """One Python file of the packages: its path below the root, its text, tree and nodes."""

    path: Path
    text: str
    tree: ast.Module
    by_kind: dict[type[ast.AST], list[Any]]

    def nodes(self, kind: type[Node]) -> list[Node]:
        """Every node of exactly this kind."""
        return self.by_kind.get(kind, [])

    def imports(self) -> Iterator[tuple[str, int]]:
        """Every imported module by its dotted name, with the line."""
        for node in self.nodes(ast.Import):
            for alias in node.names:
                yield alias.name, node.lineno
        for node in self.nodes(ast.ImportFrom):
            if node.level == 0:
                yield node.module or "", node.lineno

    def imports_of(self, package: str) -> list[str]:
        """The places where `package` or a module of it is imported, as `path:line`."""
        return [
            f"{self.path}:{line}" for name, line in self.imports() if name.split(".")[0] == package
        ]


def read(path: Path) -> Source:
    """Parse a file, and walk through its tree once for all rules."""
    text = path.read_text(encoding="utf-8")
    tree = ast.parse(text, str(path))
    by_kind: dict[type[ast.AST], list[Any]] = defaultdict(list)
    for node in ast.walk(tree):
        by_kind[type(node)].append(node)
    return Source(path.relative_to(ROOT), text, tree, by_kind)


@pytest.fixture(scope="session")
def root() -> Path:
    """The root of the workspace."""
    return ROOT


@pytest.fixture(scope="session")
def sources() -> list[Source]:
    """Every Python file of common and the services."""
    found: list[Source] = []
    # To look for rubbish among so many new nodes takes longer than to make them.
    gc.disable()
    try:
        for member in ("common", "services"):
            for path in sorted((ROOT / member).rglob("*.py")):
                found.append(read(path))
    finally:
        gc.enable()
    assert found
    return found


@pytest.fixture(scope="session")
def repository_files() -> list[Path]:
    """Every file that git keeps or would keep; outside a clone there is nothing to ask."""
    listing = subprocess.run(
        ["git", "-c", "safe.directory=*", "ls-files", "-z", "-co", "--exclude-standard"],
        cwd=ROOT,
        capture_output=True,
        check=False,
    )
    if listing.returncode != 0:
        pytest.skip("not a git clone")
    names = [name for name in listing.stdout.decode("utf-8").split("\0") if name]
    return [ROOT / name for name in names if (ROOT / name).is_file()]
