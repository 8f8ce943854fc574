"""Reads the `GoalPoints` list of a ROS script: [(x, y, z), (quaternion x, y, z, w)] per goal.

The text is only parsed, never run.
"""

import ast
import dataclasses
import io
import re
import tokenize
from collections.abc import Iterator
from typing import Any, cast

from trolley.geometry import Pose2D, pose_from_quaternion
from trolley.messages import Stop, Tour
from trolley.names import MAX_NAME_LENGTH, canonical, name_problem

MAX_CHARACTERS = 1_000_000
"""Greatest length of a file [characters]."""
MAX_GOALS = 1000
"""Greatest number of stops of a tour."""
_OPENERS, _CLOSERS = "([{", ")]}"


class GoalPointsError(ValueError):
    """The text holds no list of goals that could be read; the sentence says why."""


@dataclasses.dataclass(frozen=True)
class GoalPoint:
    """One goal: its name from the comment behind it, else `goal-<number>`; its pose on the map."""

    name: str
    pose: Pose2D


def read_goal_points(text: str) -> list[GoalPoint]:
    """Read a script that assigns `GoalPoints`, or just the list.

    Raises:
        GoalPointsError: With a sentence for people.
    """
    if len(text) > MAX_CHARACTERS:
        raise GoalPointsError(f"The file is longer than {MAX_CHARACTERS} characters.")
    text = text.removeprefix("\ufeff").lstrip()
    lists = list(_lists(text))
    wanted = [found for found in lists if found[0] == "GoalPoints"] or lists
    if not wanted or (len(wanted) > 1 and wanted is lists):
        raise GoalPointsError(
            "There is no list called GoalPoints in the file, or a bracket is missing."
        )
    start, source = wanted[-1][1:]
    elements = _elements(source)
    if not 1 <= len(elements) <= MAX_GOALS:
        raise GoalPointsError(
            f"GoalPoints holds {len(elements)} goals; 1 to {MAX_GOALS} can be read."
        )
    names = _names(elements, _comments(text, start, source))
    return [
        GoalPoint(name, _pose(element, f"Goal {number} ({name})"))
        for number, (name, element) in enumerate(zip(names, elements, strict=True), start=1)
    ]


def tour_of(points: list[GoalPoint], name: str) -> Tour:
    """A tour through the goals by their names."""
    return Tour(name=name, stops=[Stop(name=point.name) for point in points])


def _lists(text: str) -> Iterator[tuple[str, int, str]]:
    """Each list that is assigned or begins a line: the variable's name, its start and its text."""
    end = 0
    for match in re.finditer(r"^(?:[ \t]*([A-Za-z_]\w*)[ \t]*=[ \t]*)?(\[)", text, re.MULTILINE):
        start = match.start(2)
        source = _enclosed(text, start) if start >= end else ""
        if source:
            end = start + len(source)
            yield match.group(1) or "", start, source


def _enclosed(text: str, start: int) -> str:
    """The text from the bracket at `start` to the one that closes it, "" if none does.

    Brackets in comments do not count.
    """
    depth, position = 0, start
    while position < len(text):
        character = text[position]
        if character == "#":
            end = text.find("\n", position)
            position = len(text) if end < 0 else end
            continue
        depth += (character in _OPENERS) - (character in _CLOSERS)
        position += 1
        if depth == 0:
            return text[start:position]
    return ""


def _elements(source: str) -> list[ast.expr]:
    try:
        tree = ast.parse(source, mode="eval")
    except SyntaxError as error:
        raise GoalPointsError(
            f"The list of goals is not valid Python: {error.msg}, line {error.lineno} of the list."
        ) from error
    except (RecursionError, MemoryError, ValueError) as error:
        raise GoalPointsError("The list of goals is nested too deeply or holds bytes.") from error
    return tree.body.elts if isinstance(tree.body, ast.List) else []


def _comments(text: str, start: int, source: str) -> dict[int, str]:
    """The comments in the list and behind its last bracket, by their line in it, from 1."""
    end = text.find("\n", start + len(source))
    found: dict[int, str] = {}
    try:
        lines = io.StringIO(text[start : end if end >= 0 else len(text)]).readline
        for token in tokenize.generate_tokens(lines):
            if token.type == tokenize.COMMENT:
                found[token.start[0]] = token.string
    except (tokenize.TokenError, IndentationError, SyntaxError):
        pass  # what follows the list is not Python; the comments before it count
    return found


def _names(elements: list[ast.expr], comments: dict[int, str]) -> list[str]:
    """A name for each goal: of the goals that end in one line, the last has the comment."""
    owners = {element.end_lineno: index for index, element in enumerate(elements)}
    taken: set[str] = set()
    names: list[str] = []
    for index, element in enumerate(elements):
        line = element.end_lineno or 0
        wanted = _cleaned(comments.get(line, "")) if owners[line] == index else ""
        wanted = wanted or f"goal-{index + 1}"
        name, copy = wanted, 1
        while name in taken:
            copy += 1
            name = f"{wanted[: MAX_NAME_LENGTH - 5]}-{copy}"
        taken.add(name)
        names.append(name)
    return names


def _cleaned(comment: str) -> str:
    """What of a comment can be a name, "" if nothing."""
    text = canonical(comment.lstrip("#"))
    kept = (one if name_problem(f"a{one}") is None else " " for one in text)
    name = " ".join("".join(kept).split()).lstrip(".-_ ")[:MAX_NAME_LENGTH].strip()
    return name if name_problem(name) is None else ""


def _pose(element: ast.expr, title: str) -> Pose2D:
    try:
        value = ast.literal_eval(element)
    except (ValueError, TypeError, SyntaxError, RecursionError, MemoryError) as error:
        raise GoalPointsError(f"{title}: only numbers are read, no expressions.") from error
    pair = _sequence(value, (2,), title)
    position = [_number(one, title) for one in _sequence(pair[0], (2, 3), title)]
    turn = [_number(one, title) for one in _sequence(pair[1], (4,), title)]
    try:
        return pose_from_quaternion(position[0], position[1], turn)
    except ValueError as error:
        raise GoalPointsError(f"{title}: {error}.") from error


def _sequence(value: object, lengths: tuple[int, ...], title: str) -> list[Any]:
    items = cast("list[Any]", list(value)) if isinstance(value, list | tuple) else []  # pyrefly: ignore[implicit-any-type-argument]
    if len(items) not in lengths:
        raise GoalPointsError(f"{title}: a goal is written [(x, y, z), (x, y, z, w)].")
    return items


def _number(value: object, title: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise GoalPointsError(f"{title}: {value!r} is not a number.")
    try:
        return float(value)
    except OverflowError as error:
        raise GoalPointsError(f"{title}: a number is too large.") from error
