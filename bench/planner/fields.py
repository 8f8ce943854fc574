"""Worlds to drive through: fields of cylinders, corridors, doors, moving people.

Everything lies in the frame of the start: the robot stands at the origin and looks along x; its
goal is `GOAL_M` ahead.

Source:
    Perille, Truong, Xiao, Stone, Benchmarking Metric Ground Navigation (2020): the fields of
    cylinders, their layout and their files.
"""

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from bench.planner.dwa_kernels import BLOCKED, navfn_into
from numpy.typing import NDArray

from trolley.gridmap import distance_transform

Floats = NDArray[np.float64]

GOAL_M = 10.0
RADIUS_M = 0.075
CELL_M = 2.0 * RADIUS_M
# The field is 30 x 30 cells; a pen of this length before it holds the robot (together 30 x 63).
FIELD_CELLS = 30
PEN_M, BEFORE_FIELD_M = 5.0, 2.0
# Only worlds are used that 5 x 5 free cells can be moved through: 0.75 m.
WAY_RADIUS_CELLS = 2
SETS, WORLDS_IN_A_SET = 12, 25
# Where the published runs start and end [m]: in the middle between the walls of the pen.
PUBLISHED_START, PUBLISHED_AHEAD = (-2.25, 3.0), (0.0, 1.0)
NOT_WORLDS = ("path_", "cspace_", "metrics_", "norm_metrics_")
"""Names of the other files that are published with the worlds begin so."""


@dataclass(frozen=True)
class Person:
    """A person who walks to and fro."""

    path: tuple[tuple[float, float], tuple[float, float]]
    speed_mps: float


@dataclass(frozen=True)
class World:
    """One world."""

    name: str
    circles: Floats
    """(n, 3) x, y, radius [m]."""
    boxes: tuple[tuple[float, float, float, float], ...] = ()
    """x, y of the centre, length along x, width along y [m]."""
    people: tuple[Person, ...] = ()
    published_m: float | None = field(default=None)
    """Length of the path that was published with the world [m]."""

    def shortest_m(self, radius_m: float) -> float:
        """Length of the shortest path for a circle [m], without the people.

        A published length comes first, so that scores can be compared.

        Raises:
            ValueError: there is no path.
        """
        if self.published_m is not None:
            return self.published_m
        length = _shortest_m(self, radius_m)
        if length is None:
            raise ValueError(f"{self.name}: there is no path for a robot of radius {radius_m} m")
        return length


def cylinders(index: int) -> World:
    """The world `index`, 0 ... 299, which is also the seed, of 300 of rising density.

    12 sets of 25: filled to 15, 20, 25, 30 per cent, and smoothed 2, 3, 4 times.
    """
    which = index * SETS // (SETS * WORLDS_IN_A_SET)
    fill, rounds = 0.15 + 0.05 * (which // 3), 2 + which % 3
    rng = np.random.default_rng((2020, index))
    while True:
        cells = _automaton(rng, fill, rounds)
        if _has_way(cells):
            return World(f"cylinders {index}", _field_and_pen(cells))


def corridor(seed: int) -> World:
    """A corridor that bends and narrows."""
    rng = np.random.default_rng((1, seed))
    boxes = [(-1.1, 0.0, 0.2, 5.0)]
    x, middle = -1.0, 0.0
    width = float(rng.uniform(1.2, 1.6))
    end = GOAL_M - 0.6
    while x < end - 0.5:
        length = min(float(rng.uniform(1.5, 2.5)), end - x)
        if x > 0.8:
            before, width = width, float(rng.uniform(0.8, 1.5))
            # Where two pieces meet at least 0.75 m are open.
            middle += float(rng.uniform(-1.0, 1.0)) * (0.5 * (before + width) - 0.75)
        for side in (-1.0, 1.0):
            boxes.append((x + 0.5 * length, middle + side * (0.5 * width + 1.0), length, 2.0))
        x += length
    return World(f"corridor {seed}", np.empty((0, 3)), tuple(boxes))


def doors(seed: int) -> World:
    """Walls across the path, each with a door somewhere, 0.65 to 0.9 m wide."""
    rng = np.random.default_rng((2, seed))
    half, thick = 2.5, 0.12
    long = GOAL_M + 3.0
    boxes = [(0.5 * long - 1.5, side * (half + 0.5 * thick), long, thick) for side in (-1.0, 1.0)]
    for x in (2.0, 4.0, 6.0, 8.0):
        place, width = float(rng.uniform(-1.5, 1.5)), float(rng.uniform(0.65, 0.9))
        low, high = place - 0.5 * width, place + 0.5 * width
        boxes.append((x, 0.5 * (low - half), thick, low + half))
        boxes.append((x, 0.5 * (high + half), thick, half - high))
    return World(f"doors {seed}", np.empty((0, 3)), tuple(boxes))


def people(seed: int) -> World:
    """A hall 4 m wide in which five people cross the path or come towards the robot."""
    rng = np.random.default_rng((3, seed))
    half, long = 2.0, GOAL_M + 3.0
    boxes = tuple((0.5 * long - 1.5, side * (half + 0.1), long, 0.2) for side in (-1.0, 1.0))
    walking: list[Person] = []
    for index in range(5):
        x = 2.0 + 1.7 * index + float(rng.uniform(-0.3, 0.3))
        speed = float(rng.uniform(0.4, 1.0))
        if rng.random() < 0.6:
            ends = ((x, -1.6), (x + float(rng.uniform(-1.0, 1.0)), 1.6))
        else:
            y = float(rng.uniform(-1.3, 1.3))
            ends = ((x, y), (x + 2.0, y))
        walking.append(Person(ends, speed))
    return World(f"people {seed}", np.empty((0, 3)), boxes, tuple(walking))


KINDS = {"cylinders": cylinders, "corridors": corridor, "doors": doors, "people": people}


def load_worlds(folder: Path) -> Iterator[World]:
    """Read all worlds of a folder, in the order of the numbers in their names.

    `*.world` are Gazebo's, as published: a cylinder where each model stands, the robot at
    (-2.25, 3) looking along y. Where there are none, `grid_N.npy` (30 x 30 cells, 1 full) are the
    published fields, `*.npy` and `*.txt` else hold cylinders, (n, 2) x, y or (n, 3) with their
    radius [m], in the frame of the start. With `path_N.npy` beside a world, or in `path_files` here
    or one folder up, the path's length is the published one. The published folder may be given as
    a whole: its worlds lie in `world_files` or `grid_files`.

    Raises:
        ValueError: a file does not hold what its name says, or there is none.
    """
    for place in (folder, folder / "world_files", folder / "grid_files"):
        if files := _world_files(place):
            break
    else:
        raise ValueError(f"{folder}: no *.world, grid_*.npy, or *.npy and *.txt of cylinders there")
    for path in sorted(files, key=lambda path: (_number(path), path.name)):
        yield _load_gazebo(path) if path.suffix == ".world" else _load_table(path)


def _world_files(folder: Path) -> list[Path]:
    files = list(folder.iterdir()) if folder.is_dir() else []
    return [path for path in files if path.suffix == ".world"] or [
        path
        for path in files
        if path.suffix in (".npy", ".txt") and not path.name.startswith(NOT_WORLDS)
    ]


def _number(path: Path) -> int:
    found = re.search(r"\d+", path.stem)
    return int(found[0]) if found else -1


def _load_table(path: Path) -> World:
    try:
        table = np.load(path) if path.suffix == ".npy" else np.loadtxt(path, ndmin=2)
        table = np.asarray(table, dtype=np.float64)
    except (OSError, EOFError, ValueError) as error:
        raise ValueError(f"{path}: holds no table of numbers ({error})") from error
    if path.name.startswith("grid_") or table.shape == (FIELD_CELLS, FIELD_CELLS):
        if table.shape != (FIELD_CELLS, FIELD_CELLS) or not np.isin(table, (0.0, 1.0)).all():
            raise ValueError(
                f"{path}: expected {FIELD_CELLS} x {FIELD_CELLS} cells that are 0 or 1, "
                f"found {table.shape} from {table.min(initial=0.0):g} to {table.max(initial=0.0):g}"
            )
        # Its rows lie along x of the published world, to the right of the robot.
        circles = _field_and_pen(table[::-1] == 1.0)
        return World(path.stem, circles, published_m=_published_m(path))
    if table.ndim != 2 or table.shape[1] not in (2, 3) or not np.isfinite(table).all():
        raise ValueError(f"{path}: expected cylinders (n, 2) or (n, 3), found {table.shape}")
    if table.shape[1] == 2:
        table = np.column_stack([table, np.full(len(table), RADIUS_M)])
    return World(path.stem, table)


def _load_gazebo(path: Path) -> World:
    try:
        world = ElementTree.parse(path).getroot().find("world")
    except ElementTree.ParseError as error:
        raise ValueError(f"{path}: is not an SDF file: {error}") from error
    if world is None:
        raise ValueError(f"{path}: holds no <world>")
    # Where a model stands now comes before where it was put first.
    places = {model.get("name"): model.find("pose") for model in world.iterfind("state/model")}
    circles: list[tuple[float, float, float]] = []
    for model in world.iterfind("model"):
        name = f"{path}: model {model.get('name')!r}"
        shapes = [shape[0] for shape in model.iterfind("link/collision/geometry") if len(shape)]
        if all(shape.tag == "plane" for shape in shapes):
            continue
        if len(shapes) != 1 or shapes[0].tag != "cylinder":
            raise ValueError(f"{name}: only models of one cylinder can be driven round")
        for inner in ("link/pose", "link/collision/pose"):
            if any(_numbers(model.find(inner), name)):
                raise ValueError(f"{name}: its {inner} is not zero, which cannot be read")
        place = places.get(model.get("name"))
        pose = _numbers(model.find("pose") if place is None else place, name)
        (radius,) = _numbers(shapes[0].find("radius"), name) or (0.0,)
        if len(pose) != 6 or radius <= 0.0:
            raise ValueError(f"{name}: its pose or its radius is missing or broken")
        circles.append((pose[0], pose[1], radius))
    if not circles:
        raise ValueError(f"{path}: no models of cylinders")
    seen = np.array(circles)
    seen[:, :2] = _seen_from_start(seen[:, :2])
    return World(path.stem, seen, published_m=_published_m(path))


def _numbers(element: ElementTree.Element | None, name: str) -> tuple[float, ...]:
    """The numbers in an element, none where it is missing."""
    text = "" if element is None else element.text or ""
    try:
        numbers = tuple(float(word) for word in text.split())
    except ValueError as error:
        raise ValueError(f"{name}: {text.strip()!r} are not numbers") from error
    if not all(map(math.isfinite, numbers)):
        raise ValueError(f"{name}: {text.strip()!r} are not all finite")
    return numbers


def _seen_from_start(points: Floats) -> Floats:
    """Points (n, 2) of a published world, whose robot looks along y, in the frame of the start."""
    moved = points - PUBLISHED_START
    return np.column_stack([moved[:, 1], -moved[:, 0]])


def _published_m(world: Path) -> float | None:
    """Length of the published path from start to goal through the cells of the field."""
    name = f"path_{_number(world)}.npy"
    for folder in (world.parent, world.parent / "path_files", world.parent.parent / "path_files"):
        file = folder / name
        if file.exists():
            cells = np.load(file)
            if cells.ndim != 2 or cells.shape[1] != 2:
                raise ValueError(f"{file}: expected a path (n, 2) of cells, found {cells.shape}")
            shift = np.array([-RADIUS_M - FIELD_CELLS * CELL_M, RADIUS_M + PEN_M])
            inside = cells * CELL_M + shift
            goal = np.add(PUBLISHED_START, np.multiply(PUBLISHED_AHEAD, GOAL_M))
            path = np.vstack([PUBLISHED_START, inside, goal])
            return float(np.hypot(*np.diff(path, axis=0).T).sum())
    return None


def _automaton(rng: np.random.Generator, fill: float, rounds: int) -> NDArray[np.bool_]:
    """Cells (across, along): filled at random, then 5 full neighbours fill and 1 empties a cell."""
    cells = rng.random((FIELD_CELLS, FIELD_CELLS)) < fill
    cells[0] = cells[-1] = True
    for _ in range(rounds):
        around = np.pad(cells.astype(np.int8), ((1, 1), (0, 0)), constant_values=1)
        around = np.pad(around, ((0, 0), (1, 1)))
        count = sum(
            around[1 + i : 1 + i + FIELD_CELLS, 1 + j : 1 + j + FIELD_CELLS]
            for i in (-1, 0, 1)
            for j in (-1, 0, 1)
            if (i, j) != (0, 0)
        )
        cells = (cells | (count >= 5)) & (count > 1)
    return cells


def _has_way(cells: NDArray[np.bool_]) -> bool:
    """Whether 5 x 5 free cells can be moved from one end to the other."""
    reach = WAY_RADIUS_CELLS
    padded = np.pad(cells, reach)
    across, length = cells.shape
    free = ~np.any(
        [
            padded[i : i + across, j : j + length]
            for i in range(2 * reach + 1)
            for j in range(2 * reach + 1)
        ],
        axis=0,
    )
    reached = np.zeros_like(free)
    reached[:, 0] = free[:, 0]
    while True:
        grown = reached.copy()
        grown[1:] |= reached[:-1]
        grown[:-1] |= reached[1:]
        grown[:, 1:] |= reached[:, :-1]
        grown[:, :-1] |= reached[:, 1:]
        grown &= free
        if (grown == reached).all():
            return bool(reached[:, -1].any())
        reached = grown


def _field_and_pen(cells: NDArray[np.bool_]) -> Floats:
    """Cylinders (n, 3) of the outer cells of a field, and of the pen around the start."""
    padded = np.pad(cells, 1)
    hidden = np.ones_like(cells)
    for i in range(3):
        for j in range(3):
            hidden &= padded[i : i + cells.shape[0], j : j + cells.shape[1]]
    rows, cols = np.nonzero(cells & ~hidden)
    shift = -0.5 * (FIELD_CELLS - 1) * CELL_M
    inside = np.column_stack([BEFORE_FIELD_M + cols * CELL_M, shift + rows * CELL_M])
    back = BEFORE_FIELD_M - PEN_M
    along = np.arange(back, BEFORE_FIELD_M - RADIUS_M, CELL_M)
    sides = [np.column_stack([along, np.full(len(along), side * -shift)]) for side in (-1.0, 1.0)]
    ends = np.arange(shift + CELL_M, -shift - 0.5 * CELL_M, CELL_M)
    centres = np.vstack([inside, *sides, np.column_stack([np.full(len(ends), back), ends])])
    return np.column_stack([centres, np.full(len(centres), RADIUS_M)])


def _shortest_m(world: World, radius_m: float, cell_m: float = 0.02) -> float | None:
    """Length of the shortest path on a fine grid for a circle [m], with its corners cut."""
    low, high = np.array([-3.5, -6.0]), np.array([GOAL_M + 3.0, 6.0])
    shape = tuple(np.round((high - low)[::-1] / cell_m).astype(int).tolist())
    blocked = np.zeros(shape, dtype=np.bool_)
    x = low[0] + (np.arange(shape[1]) + 0.5) * cell_m
    y = low[1] + (np.arange(shape[0]) + 0.5) * cell_m
    for cx, cy, radius in world.circles:
        cols, rows = _span(x, cx, radius + radius_m), _span(y, cy, radius + radius_m)
        far = np.hypot(x[None, cols] - cx, y[rows, None] - cy)
        blocked[rows, cols] |= far < radius + radius_m
    solid = np.zeros(shape, dtype=np.uint8)
    for cx, cy, length, width in world.boxes:
        solid[_span(y, cy, 0.5 * width), _span(x, cx, 0.5 * length)] = 1
    if world.boxes:
        blocked |= distance_transform(solid, cell_m) < radius_m
    price = np.where(blocked, BLOCKED, 1.0).astype(np.float32)
    costs = np.empty_like(price)
    start = _cell(low, (0.0, 0.0), cell_m)
    navfn_into(costs, price, _cell(low, (GOAL_M, 0.0), cell_m))
    if not np.isfinite(costs[start]):
        return None
    return cell_m * _taut(blocked, costs, start)


def _span(values: Floats, centre: float, reach: float) -> slice:
    first, last = np.searchsorted(values, (centre - reach, centre + reach))
    return slice(int(first), int(last))


def _cell(low: Floats, point: tuple[float, float], cell_m: float) -> tuple[int, int]:
    col, row = np.floor((np.array(point) - low) / cell_m).astype(int).tolist()
    return row, col


def _taut(blocked: NDArray[np.bool_], costs: NDArray[np.float32], start: tuple[int, int]) -> float:
    """Length in cells of the path downhill, pulled taut: straight wherever that is free."""
    row, col = start
    way = [start]
    while costs[row, col] > 0.0:
        around = costs[row - 1 : row + 2, col - 1 : col + 2]
        i, j = divmod(int(around.argmin()), 3)
        row, col = row + i - 1, col + j - 1
        way.append((row, col))
    points = np.array(way, dtype=np.float64)
    length, here = 0.0, 0
    while here < len(points) - 1:
        seen = len(points) - 1
        while not _is_free(blocked, points[here], points[seen]):
            seen -= 1
        length += math.dist(points[here], points[seen])
        here = seen
    return length


def _is_free(blocked: NDArray[np.bool_], start: Floats, end: Floats) -> bool:
    count = math.ceil(2.0 * math.dist(start, end)) + 1
    cells = np.round(np.linspace(start, end, count)).astype(np.int64)
    return not blocked[cells[:, 0], cells[:, 1]].any()
