"""Pages that claim something link to the tests of it: `[words](../tests/x/test_y.py "test_z")`."""

import re
from pathlib import Path

import pytest

LINK = re.compile(r'\]\(([^)\s]*tests/[^)\s]+\.py) "(test_\w+)"\)')
COMMENT = re.compile(r"<!--.*?-->", re.DOTALL)
TABLES = {"docs/safety.md": "## Hazards", "SECURITY.md": "## What is trusted"}
NOBODY = "| – |"
"""The last cell of a line that nothing covers."""


def rows(text: str, heading: str) -> list[str]:
    """The lines of the table below a heading, without its head."""
    section = text.partition(f"{heading}\n")[2].partition("\n## ")[0]
    return [line for line in section.splitlines() if line.startswith("|")][2:]


@pytest.fixture
def pages(root: Path) -> dict[str, str]:
    """All pages without what is commented out."""
    found = [*root.glob("*.md"), *root.glob("docs/**/*.md")]
    return {str(one.relative_to(root)): COMMENT.sub("", one.read_text("utf-8")) for one in found}


def test_a_test_that_a_page_links_to_exists(pages: dict[str, str], root: Path) -> None:
    wrong = [
        f"{page}: {path} {name}"
        for page, text in pages.items()
        for path, name in LINK.findall(text)
        for file in [(root / page).parent / path]
        if not file.exists() or not re.search(rf"def {name}\(", file.read_text("utf-8"))
    ]
    assert wrong == []


@pytest.mark.parametrize("page", TABLES)
def test_each_line_of_hazards_and_threats_links_to_a_test(pages: dict[str, str], page: str) -> None:
    found = rows(pages[page], TABLES[page])
    assert len(found) > 5
    bare = [
        line
        for line in found
        if not LINK.search(line) and not (line.endswith(NOBODY) and "nothing" in line)
    ]
    assert bare == []
