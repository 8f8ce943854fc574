"""The pages for those who change the code name what is there."""

import re
from pathlib import Path

import pytest

QUOTED = re.compile(r"`([^`\n]+)`")
MADE = {"robot.toml"}
"""What people or programs write."""
NAME_IN_FILE = re.compile(r"`([A-Za-z_][\w.]*)(?:\([^`]*\))?` \(`([\w/.]+\.py)`")
FILE_WITH_NAME = re.compile(r"`([\w/.]+\.py)` \(`([A-Za-z_][\w.]*)`")
FILE = re.compile(r"(?:[\w.\-]+/)*[\w.\-]+(?:\.(?:py|toml|md|js|sh)|/)")


def test_architecture_names_every_folder_of_a_service(root: Path) -> None:
    page = (root / "docs/architecture.md").read_text(encoding="utf-8")
    named = {quoted.rstrip("/") for quoted in QUOTED.findall(page) if quoted.endswith("/")}
    rooms = {
        module.parent.name
        for module in root.glob("services/*/trolley_*/*/*.py")
        if module.parent.name != "__pycache__"
    }
    assert sorted(rooms - named) == []


@pytest.mark.parametrize("page", ["CONTRIBUTING.md", "docs/architecture.md"])
def test_every_file_that_a_guide_names_exists(
    page: str, repository_files: list[Path], root: Path
) -> None:
    paths = [f"/{path.relative_to(root).as_posix()}" for path in repository_files]
    folders = {f"{path.rsplit('/', depth)[0]}/" for path in paths for depth in range(1, 9)}
    text = (root / page).read_text(encoding="utf-8")
    named = {quoted for quoted in QUOTED.findall(text) if FILE.fullmatch(quoted)}
    there = [*paths, *folders]
    absent = {name for name in named if not any(path.endswith(f"/{name}") for path in there)}
    assert absent <= MADE


@pytest.mark.parametrize("page", ["CONTRIBUTING.md", "docs/architecture.md"])
def test_what_a_guide_says_is_in_a_file_is_there(
    page: str, repository_files: list[Path], root: Path
) -> None:
    """As in `Layer` (`layer.py`), or the other way round."""
    text = " ".join((root / page).read_text(encoding="utf-8").split())
    pairs = NAME_IN_FILE.findall(text)
    pairs += [(name, file) for file, name in FILE_WITH_NAME.findall(text)]
    assert pairs
    absent = [
        f"{name} in {file}"
        for name, file in pairs
        if not any(
            path.as_posix().endswith(f"/{file}")
            and re.search(rf"\b{name.rpartition('.')[2]}\b", path.read_text(encoding="utf-8"))
            for path in repository_files
        )
    ]
    assert absent == []
