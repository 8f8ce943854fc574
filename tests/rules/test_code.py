"""Rules for the code of the packages that the linter has no word for."""

import ast
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .conftest import Source

RUNTIME = Path("common/trolley/runtime")
BROAD = {"Exception", "BaseException"}
VAGUE_NAMES = {"utils", "util", "helpers", "helper", "misc"}

# The tables that keys are built from, and the runtime that builds them.
KEY_PLACES = {Path("common/trolley/topics.py"), Path("common/trolley/requests.py")}


def caught(handler: ast.ExceptHandler) -> Iterator[str]:
    """The names in an `except` clause; a bare one counts as BaseException."""
    if handler.type is None:
        yield "BaseException"
        return
    for node in handler.type.elts if isinstance(handler.type, ast.Tuple) else [handler.type]:
        if isinstance(node, ast.Name):
            yield node.id


def test_only_the_runtime_catches_everything(sources: list["Source"]) -> None:
    places = [
        f"{source.path}:{node.lineno}"
        for source in sources
        if RUNTIME not in source.path.parents
        for node in ast.walk(source.tree)
        if isinstance(node, ast.ExceptHandler) and BROAD.intersection(caught(node))
    ]
    assert places == []


def test_no_key_is_built_by_hand(sources: list["Source"]) -> None:
    places = [
        f"{source.path}:{node.lineno}"
        for source in sources
        if source.path not in KEY_PLACES and RUNTIME not in source.path.parents
        for node in ast.walk(source.tree)
        # The literal parts of an f-string are constants too.
        if isinstance(node, ast.Constant)
        and isinstance(node.value, str)
        and node.value.startswith("trolley/")
    ]
    assert places == []


def test_modules_say_what_they_hold(sources: list["Source"]) -> None:
    vague = [
        str(source.path)
        for source in sources
        if VAGUE_NAMES.intersection(source.path.with_suffix("").parts)
    ]
    assert vague == []
