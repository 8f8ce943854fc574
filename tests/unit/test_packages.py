"""The distributions: their names, and that all of one release belong together."""

import re
import tomllib
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]
MEMBERS = [ROOT / "common", *sorted(path.parent for path in ROOT.glob("services/*/pyproject.toml"))]
OURS = "trolley-robot"
"""The distribution `trolley` is a stranger's: whoever asked for it would run its set-up."""


def project(member: Path) -> dict[str, Any]:
    return tomllib.loads((member / "pyproject.toml").read_text("utf-8"))["project"]


VERSION = project(ROOT / "common")["version"]


@pytest.mark.parametrize("member", MEMBERS, ids=lambda path: path.name)
def test_a_member_asks_for_no_strangers_trolley_and_for_others_of_its_release_only(
    member: Path,
) -> None:
    found = project(member)
    expected = OURS if member.name == "common" else f"{OURS}-{member.name}"
    assert (found["name"], found["version"]) == (expected, VERSION)
    extras = found.get("optional-dependencies", {})
    for text in [*found["dependencies"], *(one for extra in extras.values() for one in extra)]:
        match = re.fullmatch(r"(trolley[\w-]*)(\[[\w,]+\])?(==.+)?", text)
        if match is None:
            assert not text.startswith("trolley")
            continue
        name, _, pin = match.groups()
        assert name == OURS or name.startswith(f"{OURS}-")
        assert pin == f"=={VERSION}" or name == found["name"], "itself, with other extras"


@pytest.mark.parametrize("member", MEMBERS, ids=lambda path: path.name)
def test_a_member_brings_licence_page_and_types(member: Path) -> None:
    for name in ("LICENSE", "README.md"):
        assert (member / name).read_text("utf-8")
    (package,) = (path.parent for path in member.glob("*/__init__.py"))
    assert (package / "py.typed").is_file()


def test_every_member_is_in_an_extra() -> None:
    extras = project(ROOT / "common")["optional-dependencies"]
    named = {one.partition("==")[0] for extra in extras.values() for one in extra}
    assert {f"{OURS}-{member.name}" for member in MEMBERS[1:]} <= named
