"""A mapper's state as bytes, so that one that was killed goes on where it was."""

import zlib

import msgspec
import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from trolley.geometry import Pose2D
from trolley.gridmap import GridMap
from trolley_mapper.slam.anchors import Anchors
from trolley_mapper.slam.estimate import Anchor
from trolley_mapper.slam.keyframe import Keyframe
from trolley_mapper.slam.keyframe_store import KeyframeStore
from trolley_mapper.slam.pose_graph import Edge
from trolley_mapper.slam.prior_map import prior_keyframe

_FORMAT = "trolley-mapper-1"
_STEPS_PER_RAD = 32767.0 / np.pi


class StoredPrior(Struct, frozen=True):
    """The map that was extended."""

    name: str
    resolution: float
    origin: Pose2D
    shape: tuple[int, int]
    cells: bytes


class StoredKeyframes(Struct, frozen=True):
    """All scans: points in steps of `step` metres, normals as angles, 0 for none."""

    numbers: list[int]
    stamps_ns: list[int]
    sizes: list[int]
    step: float
    points: bytes
    angles: bytes
    lasers: bytes
    poses: bytes


class StoredEdges(Struct, frozen=True):
    """All edges of the pose graph."""

    ends: bytes
    steps: bytes
    information: bytes


class StoredState(Struct, frozen=True):
    """All that a mapper needs to go on."""

    format: str
    next_number: int
    pose: Pose2D
    keyframes: StoredKeyframes
    edges: StoredEdges
    used: list[int]
    successors: dict[int, tuple[int, Pose2D]]
    prior: StoredPrior | None
    num_loops: int


class State(Struct, frozen=True):
    """What was stored, in the forms that the mapper works with."""

    store: KeyframeStore
    anchors: Anchors
    prior: GridMap | None
    pose: Pose2D
    next_number: int
    num_loops: int


def pack(state: State) -> bytes:
    """Return a state as compressed bytes."""
    prior, store = state.prior, state.store
    stored = StoredState(
        _FORMAT,
        state.next_number,
        state.pose,
        _pack_keyframes(store),
        _pack_edges([edge.settled(store.scale) for edge in store.edges]),
        sorted(state.anchors.used),
        {n: (a.keyframe, a.keyframe_T_pose) for n, a in state.anchors.successors.items()},
        None
        if prior is None
        else StoredPrior(
            prior.name, prior.resolution, prior.origin, prior.cells.shape, prior.cells.tobytes()
        ),
        state.num_loops,
    )
    return zlib.compress(msgspec.msgpack.encode(stored), 1)


def unpack(data: bytes) -> State:
    """Return the state that `pack` was given, points to a fraction of a millimetre.

    Raises:
        ValueError: the bytes are none of a mapper, or damaged.
    """
    try:
        stored = msgspec.msgpack.decode(zlib.decompress(data), type=StoredState)
        if stored.format != _FORMAT:
            raise ValueError(f"the mapper's state is of another version: {stored.format!r}")
        return _revive(stored)
    except (zlib.error, msgspec.MsgspecError, KeyError, IndexError) as error:
        raise ValueError(f"the mapper's state cannot be read: {error}") from error


def _revive(stored: StoredState) -> State:
    prior = None
    if stored.prior is not None:
        cells = np.frombuffer(stored.prior.cells, np.int8).reshape(stored.prior.shape).copy()
        prior = GridMap(stored.prior.name, stored.prior.resolution, stored.prior.origin, cells)
    anchors = Anchors()
    anchors.used = set(stored.used)
    anchors.successors = {n: Anchor(k, pose) for n, (k, pose) in stored.successors.items()}
    return State(
        _unpack_atlas(stored, prior), anchors, prior, stored.pose, stored.next_number,
        stored.num_loops,
    )  # fmt: skip


def _pack_keyframes(store: KeyframeStore) -> StoredKeyframes:
    rows = [row for row, one in enumerate(store.keyframes) if not one.is_prior]
    some = [store.keyframes[row] for row in rows]
    points = np.vstack([np.zeros((1, 2), np.float32), *(one.points for one in some)])[1:]
    normals = np.vstack([np.zeros((1, 2), np.float32), *(one.normals for one in some)])[1:]
    step = max(float(np.abs(points).max(initial=0.0)) / 32767.0, 1e-4)
    angles = np.round(np.arctan2(normals[:, 1], normals[:, 0]) * _STEPS_PER_RAD)
    # The angle 0 stands for no normal; a normal at exactly 0 becomes the next step.
    angles = np.where(np.any(normals != 0.0, axis=1), np.where(angles == 0, 1, angles), 0)
    return StoredKeyframes(
        [one.number for one in some],
        [one.stamp_ns for one in some],
        [len(one.points) for one in some],
        step,
        np.round(points / step).astype("<i2").tobytes(),
        angles.astype("<i2").tobytes(),
        np.array([one.laser for one in some], "<f4").tobytes(),
        store.poses[rows].astype("<f8").tobytes(),
    )


def _pack_edges(edges: list[Edge]) -> StoredEdges:
    ends = np.array([(e.first, e.second, e.kind) for e in edges], "<i4")
    steps = np.array([e.step for e in edges], "<f8")
    information = np.array([e.information for e in edges], "<f8")
    return StoredEdges(ends.tobytes(), steps.tobytes(), information.tobytes())


def _unpack_atlas(stored: StoredState, prior: GridMap | None) -> KeyframeStore:
    store, kept = KeyframeStore(), stored.keyframes
    if prior is not None:
        store.add(prior_keyframe(0, prior), np.zeros(3), [])
    count = sum(kept.sizes)
    points = np.frombuffer(kept.points, "<i2").reshape(count, 2).astype(np.float32)
    angles = np.frombuffer(kept.angles, "<i2").astype(np.float64)
    normals = np.column_stack([np.cos(angles / _STEPS_PER_RAD), np.sin(angles / _STEPS_PER_RAD)])
    normals[angles == 0] = 0.0
    lasers = np.frombuffer(kept.lasers, "<f4").reshape(-1, 2).copy()
    poses = np.frombuffer(kept.poses, "<f8").reshape(-1, 3)
    bounds = np.cumsum([0, *kept.sizes])
    for row, number in enumerate(kept.numbers):
        part = np.s_[bounds[row] : bounds[row + 1]]
        one = Keyframe(
            number,
            kept.stamps_ns[row],
            points[part] * np.float32(kept.step),
            normals[part].astype(np.float32),
            lasers[row],
        )
        store.add(one, poses[row], [])
    for edge in _unpack_edges(stored.edges):
        store.link(edge)
    return store


def _unpack_edges(stored: StoredEdges) -> list[Edge]:
    ends: NDArray[np.int32] = np.frombuffer(stored.ends, "<i4").reshape(-1, 3)
    steps = np.frombuffer(stored.steps, "<f8").reshape(-1, 3)
    information = np.frombuffer(stored.information, "<f8").reshape(-1, 3, 3)
    return [
        Edge(int(first), int(second), step, info, int(kind))
        for (first, second, kind), step, info in zip(ends, steps, information, strict=True)
    ]
