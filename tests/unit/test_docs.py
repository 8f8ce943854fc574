"""The pages that are generated from the code."""

import subprocess
import sys
from pathlib import Path

import pytest

from trolley import topics
from trolley.codes import SENTENCES
from trolley.requests import REQUESTS

DOCS = Path(__file__).resolve().parents[2] / "docs"


@pytest.mark.programs
def test_generated_pages_are_up_to_date() -> None:
    checked = subprocess.run(
        [sys.executable, str(DOCS / "make_wire.py"), "--check"],
        capture_output=True,
        text=True,
        timeout=240,
        check=False,
    )
    assert (checked.returncode, checked.stderr) == (0, "")


def test_the_wire_page_names_every_topic_request_and_code() -> None:
    page = (DOCS / "wire.md").read_text(encoding="utf-8")
    names = [topic.name.replace("{", "<").replace("}", ">") for topic in topics.TOPICS]
    names += [request.name for request in REQUESTS] + list(SENTENCES)
    assert [name for name in names if f"`{name}`" not in page] == []
