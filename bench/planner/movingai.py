"""Files of the MovingAI benchmarks: grid maps (`.map`) and queries with their optimum (`.scen`).

Formats: https://movingai.com/benchmarks/formats.html; Sturtevant, Benchmarks for Grid-Based
Pathfinding, IEEE Transactions on Computational Intelligence and AI in Games 4 (2012). Steps are
8-connected, a diagonal one is as long as the square root of 2 and needs both cells beside it.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import takewhile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

BLOCKED, GROUND, WATER = 0, 1, 2
KINDS = dict.fromkeys(".GS", GROUND) | {"W": WATER} | dict.fromkeys("@OT", BLOCKED)
"""Swamp is passable from the ground; water only from water. Trees and what is outside never are."""


@dataclass(frozen=True)
class Query:
    """One line of a `.scen` file."""

    map_name: str
    """May hold folders, with slashes."""
    start: tuple[int, int]
    """Column and row, from the upper left."""
    goal: tuple[int, int]
    optimum: float
    """Length of the shortest path [cells]."""
    shape: tuple[int, int] | None = field(default=None, compare=False)
    """Rows and columns that the map should have, None where the file does not say."""
    place: str = field(default="", compare=False)
    """File and line it was read from."""

    def check(self, cells: NDArray[np.uint8], path: Path) -> None:
        """Make sure that the query belongs to a map.

        Raises:
            ValueError: naming the line and what is wrong with it.
        """
        rows, cols = cells.shape
        if self.shape is not None and self.shape != (rows, cols):
            raise ValueError(
                f"{self.place}: is for a map of {self.shape[1]} x {self.shape[0]} cells, but "
                f"{path} has {cols} x {rows}; maps are not scaled: take the one that belongs here"
            )
        for what, (x, y) in (("start", self.start), ("goal", self.goal)):
            if not (0 <= x < cols and 0 <= y < rows) or cells[y, x] == BLOCKED:
                raise ValueError(
                    f"{self.place}: the {what} ({x}, {y}) is not a free cell of {path}; "
                    "do the two belong together?"
                )


def read_map(path: Path) -> NDArray[np.uint8]:
    """What the cells (rows, cols) of a `.map` file are, the upper row first: see `KINDS`.

    Raises:
        ValueError: naming the file and what is wrong with it.
    """
    lines = path.read_text(encoding="latin-1").splitlines()
    head: dict[str, str] = {}
    first = next((k for k, line in enumerate(lines) if line.strip() == "map"), len(lines)) + 1
    for line in lines[: first - 1]:
        key, _, value = line.strip().partition(" ")
        head[key] = value.strip()
    if head.get("type") != "octile":
        raise ValueError(f"{path}: the type is {head.get('type')!r}, not octile")
    try:
        rows, cols = int(head["height"]), int(head["width"])
    except (KeyError, ValueError) as error:
        raise ValueError(f"{path}: height or width is missing or no number") from error
    body = [line.rstrip() for line in lines[first : first + rows]]
    for number, line in enumerate(body, first + 1):
        if len(line) != cols:
            raise ValueError(
                f"{path}, line {number}: {len(line)} cells, not {cols}; is the file complete?"
            )
        unknown = set(line) - set(KINDS)
        if unknown:
            raise ValueError(
                f"{path}, line {number}: cells {sorted(unknown)} are none of {''.join(KINDS)}"
            )
    if len(body) != rows or rows < 1 or cols < 1:
        raise ValueError(f"{path}: {len(body)} rows after 'map', not {rows}; is the file complete?")
    cells = np.frombuffer("".join(body).encode("ascii"), np.uint8).reshape(rows, cols)
    table = np.zeros(256, np.uint8)
    for letter, kind in KINDS.items():
        table[ord(letter)] = kind
    return table[cells]


def read_scen(path: Path) -> list[Query]:
    """The queries of a `.scen` file.

    Raises:
        ValueError: naming the file and the line that cannot be read.
    """
    queries: list[Query] = []
    for number, line in enumerate(path.read_text(encoding="latin-1").splitlines(), 1):
        place = f"{path}, line {number}"
        if number == 1 and line.startswith("version"):
            if line.split()[1:] not in (["1"], ["1.0"]):
                raise ValueError(f"{place}: {line.strip()!r}, but only version 1 can be read")
            continue
        if not line.strip():
            continue
        fields = line.split("\t") if "\t" in line else line.split()
        try:
            _, name, cols, rows, *places, optimum = fields
            start_x, start_y, goal_x, goal_y = (int(one) for one in places)
            length, shape = float(optimum), (int(rows), int(cols))
        except ValueError as error:
            raise ValueError(
                f"{place}: expected nine fields (bucket, map, its width and height, x and y of "
                f"start and goal, optimal length), found {line.strip()!r}; is the file complete?"
            ) from error
        if not 0.0 <= length < math.inf:
            raise ValueError(f"{place}: the optimal length {optimum.strip()!r} is not a length")
        start, goal = (start_x, start_y), (goal_x, goal_y)
        name = name.strip().replace("\\", "/")
        # HOG writes 1 x 1 where it does not say.
        queries.append(Query(name, start, goal, length, shape if shape != (1, 1) else None, place))
    return queries


def find_map(query: Query, scen: Path, maps: Sequence[Path]) -> Path:
    """The map of a query: beside its file, or else with the most folders of its name in common.

    Args:
        query: which names the map.
        scen: the file it was read from.
        maps: that are there.

    Raises:
        ValueError: there is none, or more than one.
    """
    wanted = Path(query.map_name)
    named = [path for path in maps if path.name == wanted.name]
    if not named:
        raise ValueError(f"{query.place}: there is no {wanted.name}; put it beside the .scen files")
    beside = [path for path in named if path.parent == scen.parent]

    def in_common(path: Path) -> int:
        pairs = zip(reversed(path.parts), reversed(wanted.parts), strict=False)
        return len(list(takewhile(lambda pair: pair[0] == pair[1], pairs)))

    most = max(in_common(path) for path in named)
    best = beside or [path for path in named if in_common(path) == most]
    if len(best) > 1:
        raise ValueError(
            f"{query.place}: which {wanted.name} is meant, {best[0]} or {best[1]}? "
            "Put the right one beside the .scen file"
        )
    return best[0]


def write_map(path: Path, passable: NDArray[np.bool_]) -> None:
    """Write a `.map` file."""
    rows, cols = passable.shape
    body = ["".join(line) for line in np.where(passable, ".", "@")]
    text = "\n".join(["type octile", f"height {rows}", f"width {cols}", "map", *body])
    path.write_text(text + "\n", encoding="ascii")


def write_scen(path: Path, queries: list[Query], shape: tuple[int, int]) -> None:
    """Write a `.scen` file for a map of so many rows and columns."""
    lines = ["version 1"]
    for one in queries:
        places = (*one.start, *one.goal)
        fields = (int(one.optimum) // 4, one.map_name, shape[1], shape[0], *places)
        lines.append("\t".join([*map(str, fields), f"{one.optimum:.8f}"]))
    path.write_text("\n".join(lines) + "\n", encoding="ascii")
