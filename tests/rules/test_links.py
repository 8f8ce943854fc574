"""Links of the pages lead to what is there.

Those that claim something link to the tests of it: `[words](../tests/x/test_y.py "test_z")`.
"""

import re
from pathlib import Path

import pytest

LINK = re.compile(r'\]\(([^)\s]*tests/[^)\s]+\.py) "(test_\w+)"\)')
LOCAL = re.compile(r"\]\((?!https?:)([^)\s#]*)(?:#([^)\s]+))?")
BLOCK = re.compile(r"```.*?```", re.DOTALL)
HEADING = re.compile(r"^#+ (.*)$", re.MULTILINE)
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


def anchors(text: str) -> set[str]:
    """What can stand behind the # of a link to a page."""
    titles = [re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", one) for one in HEADING.findall(text)]
    return {re.sub(r"[^\w\- ]", "", one.lower()).replace(" ", "-") for one in titles}


def test_what_a_page_links_to_is_there(pages: dict[str, str], root: Path) -> None:
    texts = {(root / page).resolve(): BLOCK.sub("", text) for page, text in pages.items()}
    wrong = [
        f"{page.relative_to(root)}: {path}#{anchor}"
        for page, text in texts.items()
        for path, anchor in LOCAL.findall(text)
        for target in [(page.parent / path).resolve() if path else page]
        if not target.exists() or (anchor and anchor not in anchors(texts.get(target, "")))
    ]
    assert wrong == []


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
