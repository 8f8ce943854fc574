"""Files of the MovingAI benchmarks: grid maps (`.map`) and queries with their optimum (`.scen`).

Formats: https://movingai.com/benchmarks/formats.html; Sturtevant, Benchmarks for Grid-Based
Pathfinding, IEEE Transactions on Computational Intelligence and AI in Games 4 (2012). Steps are
8-connected, a diagonal one is as long as the square root of 2 and needs both cells beside it.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

PASSABLE = ".GS"
"""Ground, ground, and swamp; walls, trees, water and what lies outside are not passable."""
KNOWN = PASSABLE + "@OTW"


@dataclass(frozen=True)
class Query:
    """One line of a `.scen` file."""

    map_name: str
    start: tuple[int, int]
    """Column and row, from the upper left."""
    goal: tuple[int, int]
    optimum: float
    """Length of the shortest way [cells]."""


def read_map(path: Path) -> NDArray[np.bool_]:
    """Which cells (rows, cols) of a `.map` file are passable, the upper row first.

    Raises:
        ValueError: naming the file and what is wrong with it.
    """
    lines = path.read_text(encoding="ascii").splitlines()
    head: dict[str, str] = {}
    first = next((k for k, line in enumerate(lines) if line.strip() == "map"), len(lines)) + 1
    for line in lines[: first - 1]:
        key, _, value = line.strip().partition(" ")
        head[key] = value
    if head.get("type") != "octile":
        raise ValueError(f"{path}: the type is {head.get('type')!r}, not octile")
    try:
        rows, cols = int(head["height"]), int(head["width"])
    except (KeyError, ValueError) as error:
        raise ValueError(f"{path}: height or width is missing or no number") from error
    body = lines[first : first + rows]
    if len(body) != rows or any(len(line) != cols for line in body):
        raise ValueError(f"{path}: there are not {rows} rows of {cols} cells after 'map'")
    unknown = set("".join(body)) - set(KNOWN)
    if unknown:
        raise ValueError(f"{path}: cells {sorted(unknown)} are none of {KNOWN}")
    cells = np.array([list(line) for line in body])
    return np.isin(cells, list(PASSABLE))


def read_scen(path: Path) -> list[Query]:
    """The queries of a `.scen` file.

    Raises:
        ValueError: naming the file and the line that cannot be read.
    """
    queries: list[Query] = []
    for number, line in enumerate(path.read_text(encoding="ascii").splitlines(), 1):
        if number == 1 and line.startswith("version"):
            continue
        if not line.strip():
            continue
        fields = line.split("\t") if "\t" in line else line.split()
        try:
            _, name, _, _, start_x, start_y, goal_x, goal_y, optimum = fields
            start, goal = (int(start_x), int(start_y)), (int(goal_x), int(goal_y))
            queries.append(Query(Path(name).name, start, goal, float(optimum)))
        except ValueError as error:
            raise ValueError(f"{path}, line {number}: it has not the nine fields") from error
    return queries


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
