"""The source files that the rules are about, parsed once."""

import ast
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@dataclass(frozen=True)
class Source:
    """One Python file of the packages: its path below the root, its text and its tree."""

    path: Path
    text: str
    tree: ast.Module

    def imports(self) -> Iterator[tuple[str, int]]:
        """Every imported module by its dotted name, with the line."""
        for node in ast.walk(self.tree):
            if isinstance(node, ast.Import):
                for alias in node.names:
                    yield alias.name, node.lineno
            elif isinstance(node, ast.ImportFrom) and node.level == 0:
                yield node.module or "", node.lineno

    def imports_of(self, package: str) -> list[str]:
        """The places where `package` or a module of it is imported, as `path:line`."""
        return [
            f"{self.path}:{line}" for name, line in self.imports() if name.split(".")[0] == package
        ]


@pytest.fixture(scope="session")
def root() -> Path:
    """The root of the workspace."""
    return ROOT


@pytest.fixture(scope="session")
def sources() -> list[Source]:
    """Every Python file of common and the services."""
    found: list[Source] = []
    for member in ("common", "services"):
        for path in sorted((ROOT / member).rglob("*.py")):
            text = path.read_text(encoding="utf-8")
            found.append(Source(path.relative_to(ROOT), text, ast.parse(text, str(path))))
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
