"""The pages that are generated from the code, and what others tell people to type."""

import re
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path

import click
import pytest

from trolley import topics
from trolley.cli import cli
from trolley.codes import SENTENCES
from trolley.config.load import checked
from trolley.requests import REQUESTS

DOCS = Path(__file__).resolve().parents[2] / "docs"
PAGES = [DOCS.parent / "README.md", *DOCS.rglob("*.md")]
COMMAND = re.compile(
    r"^(?:\$ |sudo )*(trolley [a-z].*)$|`(?:sudo )?(trolley\s[a-z][^`]*)`", re.MULTILINE
)
TOML = re.compile(r"```toml\n(.*?)```", re.DOTALL)
ROBOT = {"name": "kiwi", "footprint": {"radius_m": 0.2}}


@pytest.mark.programs
def test_generated_pages_are_up_to_date() -> None:
    done = subprocess.run(
        [sys.executable, str(DOCS / "make_wire.py"), "--check"],
        capture_output=True,
        text=True,
        timeout=240,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, "")


def test_the_wire_page_names_every_topic_request_and_code() -> None:
    page = (DOCS / "wire.md").read_text(encoding="utf-8")
    names = [topic.name.replace("{", "<").replace("}", ">") for topic in topics.TOPICS]
    names += [request.name for request in REQUESTS] + list(SENTENCES)
    assert [name for name in names if f"`{name}`" not in page] == []


def unknown_in(words: list[str]) -> str:
    """Which command or option of a line there is not; "" if all are there."""
    command: click.Command = cli
    context = click.Context(cli)
    while words and isinstance(command, click.Group) and not words[0].startswith("-"):
        found = command.get_command(context, words[0].partition("|")[0])
        if found is None:
            return words[0]
        command, words = found, words[1:]
        context = click.Context(found, parent=context)
    options = {name for one in command.get_params(context) for name in one.opts}
    given = {word.partition("=")[0] for word in words if word.startswith("--")}
    return " ".join(given - options - {"--robot", "--connect", "--help"})


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_the_commands_of_a_page_are_there(page: Path) -> None:
    lines = [" ".join((a or b).split()) for a, b in COMMAND.findall(page.read_text("utf-8"))]
    typed = [line for line in lines if not line.startswith("trolley ssh-")]
    wrong = {line: unknown_in(shlex.split(line, comments=True)[1:]) for line in typed}
    assert {line: what for line, what in wrong.items() if what} == {}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_the_settings_of_a_page_are_allowed(page: Path) -> None:
    for block in TOML.findall(page.read_text("utf-8")):
        plain = tomllib.loads(block)
        if not plain.keys() & {"project", "texts"}:  # of a package, of a language
            checked({**plain, "robot": {**ROBOT, **plain.get("robot", {})}}, page)
