"""The compiled ray caster against a slow and obvious twin, in random worlds."""

import math
from dataclasses import dataclass

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from support.cases import cases

from trolley.geometry import Pose2D
from trolley_base.world.rays import (
    GLASS,
    MAX_BOUNCES,
    MIRROR_LEFT,
    OPAQUE,
    Scene,
    beam_range,
    grid_range,
)

GOLDEN = 0.6180339887498949


@dataclass
class Face:
    """A straight piece of anything: its ends, its kind and what it sends back."""

    a: np.ndarray
    b: np.ndarray
    kind: int = OPAQUE
    echo: tuple[float, float] = (0.0, 0.0)
    index: int = -1
    only_reflected: bool = False


def random_scene(rng: np.random.Generator) -> tuple[Scene, Pose2D]:
    origin = Pose2D.from_array(rng.uniform([-2.0, -2.0, -3.1], [2.0, 2.0, 3.1]))
    solid = (rng.random((14, 18)) < rng.choice([0.0, 0.03, 0.1])).astype(np.uint8)
    frame = np.array([origin.x, origin.y, math.cos(origin.yaw), math.sin(origin.yaw), 0.25])
    count = int(rng.integers(0, 6))
    segments = rng.uniform(-4.0, 4.0, (count, 4))
    kinds = rng.integers(0, 4, count).astype(np.uint8)
    echoes = np.stack([rng.choice([0.0, 0.3], count), rng.choice([0.0, 0.2], count)], axis=1)
    circles = np.hstack([rng.uniform(-4, 4, (2, 2)), rng.uniform(0.05, 0.5, (2, 1))])
    angles = np.sort(rng.uniform(0, 2 * math.pi, 5))
    body = rng.uniform(-1, 1, 2) + 0.3 * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return Scene(frame, solid, segments, kinds, echoes, circles, body), origin


def cell_faces(scene: Scene, origin: Pose2D) -> list[Face]:
    """The four sides of each solid cell, in `map`."""
    faces, edge = [], scene.frame[4]
    for row, col in np.argwhere(scene.solid):
        corners = np.array([[col, row], [col + 1, row], [col + 1, row + 1], [col, row + 1]])
        corners = origin.transform_points(corners * edge)
        faces += [Face(corners[i], corners[(i + 1) % 4]) for i in range(4)]
    return faces


def all_faces(scene: Scene, origin: Pose2D) -> list[Face]:
    faces = cell_faces(scene, origin)
    for i, (segment, kind, echo) in enumerate(
        zip(scene.segments, scene.kinds, scene.echoes, strict=True)
    ):
        faces.append(Face(segment[:2], segment[2:], int(kind), tuple(echo), i))
    for i in range(len(scene.body)):
        ends = scene.body[i], scene.body[(i + 1) % len(scene.body)]
        faces.append(Face(*ends, only_reflected=True))
    return faces


def distance_along(face: Face, start: np.ndarray, direction: np.ndarray) -> float:
    """Solve start + t * direction = a + s * (b - a)."""
    matrix = np.stack([direction, face.a - face.b], axis=1)
    if abs(np.linalg.det(matrix)) < 1e-14:
        return math.inf
    t, s = np.linalg.solve(matrix, face.a - start)
    return float(t) if t >= 0.0 and 0.0 <= s <= 1.0 else math.inf


def circle_distance(circle: np.ndarray, start: np.ndarray, direction: np.ndarray) -> float:
    offset = start - circle[:2]
    if np.hypot(*offset) <= circle[2]:
        return 0.0
    along, outside = float(offset @ direction), float(offset @ offset - circle[2] ** 2)
    roots = np.roots([1.0, 2.0 * along, outside])
    ahead = [float(root.real) for root in roots if abs(root.imag) < 1e-12 and root.real > 0]
    return min(ahead, default=math.inf)


def ends_here(face: Face, start: np.ndarray, direction: np.ndarray, draw: float) -> bool:
    along = (face.b - face.a) / np.hypot(*(face.b - face.a))
    normal = np.array([-along[1], along[0]])
    if face.kind == OPAQUE or (draw + face.index * GOLDEN) % 1.0 < face.echo[0]:
        return True
    if face.kind == GLASS:
        incidence = math.acos(min(1.0, abs(float(direction @ normal))))
        return incidence <= face.echo[1]
    return face.kind == MIRROR_LEFT and float((start - face.a) @ normal) < 0.0


def naive_range(
    scene: Scene, origin: Pose2D, start: np.ndarray, direction: np.ndarray, draw: float
) -> float:
    """The length of a beam's way, without any limit."""
    travelled, came_from = 0.0, -1
    faces = all_faces(scene, origin)
    for bounce in range(MAX_BOUNCES + 1):
        best, hit = math.inf, None
        for circle in scene.circles:
            best = min(best, circle_distance(circle, start, direction))
        for face in faces:
            if (face.only_reflected and bounce == 0) or 0 <= face.index == came_from:
                continue
            t = distance_along(face, start, direction)
            if face.kind == GLASS and not ends_here(face, start, direction, draw):
                continue
            if t < best:
                best, hit = t, face
        if hit is None or ends_here(hit, start, direction, draw):
            return travelled + best
        travelled += best
        start = start + best * direction
        along = (hit.b - hit.a) / np.hypot(*(hit.b - hit.a))
        direction = 2.0 * float(direction @ along) * along - direction
        came_from = hit.index
    return math.inf


def stands_in_a_wall(scene: Scene, origin: Pose2D, start: np.ndarray) -> bool:
    x, y = origin.inverse().transform_points(start[None])[0] / scene.frame[4]
    rows, cols = scene.solid.shape
    inside = 0 <= x < cols and 0 <= y < rows
    return inside and bool(scene.solid[math.floor(y), math.floor(x)])


@settings(max_examples=cases(60))
@given(seed=st.integers(0, 2**32 - 1))
def test_a_beam_goes_as_far_as_the_obvious_way_says(seed: int) -> None:
    rng = np.random.default_rng(seed)
    scene, origin = random_scene(rng)
    reach = float(rng.uniform(2.0, 12.0))
    for _ in range(20):
        start = rng.uniform(-4.0, 4.0, 2)
        angle, draw = float(rng.uniform(-math.pi, math.pi)), float(rng.random())
        direction = np.array([math.cos(angle), math.sin(angle)])
        found = beam_range(scene, np.array([*start, *direction]), reach, draw)
        if stands_in_a_wall(scene, origin, start):
            assert found == 0.0
            continue
        expected = naive_range(scene, origin, start, direction, draw)
        if expected > reach:
            assert found == math.inf or abs(found - expected) < 1e-3
        else:
            # Each reflection starts a micrometre off its mirror.
            assert abs(found - expected) < 1e-3


@given(
    x=st.sampled_from([-0.5, 0.0, 0.25, 1.0, 3.0]),
    y=st.sampled_from([-0.5, 0.0, 0.25, 0.75, 3.0]),
    quarter=st.integers(0, 7),
)
def test_rays_along_cell_borders_and_through_corners_end(x: float, y: float, quarter: int) -> None:
    solid = np.zeros((8, 8), dtype=np.uint8)
    solid[3:5, 3:5] = 1
    frame = np.array([0.0, 0.0, 1.0, 0.0, 0.25])
    dx = float(round(math.cos(quarter * math.pi / 4) * 2) / 2)
    dy = float(round(math.sin(quarter * math.pi / 4) * 2) / 2)
    length = math.hypot(dx, dy)
    found = grid_range(frame, solid, x, y, dx / length, dy / length, 9.0)
    assert 0.0 <= found <= 9.0
    if found < 9.0:
        end = np.array([x, y]) + found * np.array([dx, dy]) / length
        assert (end >= 0.75 - 1e-9).all()
        assert (end <= 1.25 + 1e-9).all()
