"""What a robot's glb body lacks to be shown; whatever it holds, the page fetches nothing for it.

Only what the page's loader relies on is read: the file's frame, where its data lie, and how large
the body is.

Source:
    Khronos Group, glTF 2.0 specification (2021), sections 3 and 4.
"""

import struct
from collections.abc import Sequence
from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta, Struct
from numpy.typing import NDArray
from viser.transforms import SO3

_MAGIC, _VERSION, _JSON, _BIN = 0x46546C67, 2, 0x4E4F534A, 0x004E4942
_HEADER, _CHUNK = struct.Struct("<3I"), struct.Struct("<2I")
MAX_NODES = 2000
HARMLESS = ("KHR_materials_", "KHR_texture_transform")
"""How the names of extensions begin that need no further file and change no place."""
MIN_SIZE_M, MAX_SIZE_M = 0.01, 10.0
BROKEN = "The file of its body is broken, so its outline is shown."

Index = Annotated[int, Meta(ge=0)]


class _Buffer(Struct):
    byteLength: Index  # noqa: N815, as glTF calls it
    uri: str | None = None


class _View(Struct):
    buffer: Index
    byteLength: Index  # noqa: N815
    byteOffset: Index = 0  # noqa: N815


class _Image(Struct):
    uri: str | None = None


class _Accessor(Struct):
    bufferView: Index | None = None  # noqa: N815
    min: list[float] = []
    max: list[float] = []


class _Primitive(Struct):
    attributes: dict[str, Index]
    indices: Index | None = None


class _Mesh(Struct):
    primitives: list[_Primitive]


class _Node(Struct):
    mesh: Index | None = None
    children: list[Index] = []
    matrix: list[float] | None = None
    translation: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rotation: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)
    scale: tuple[float, float, float] = (1.0, 1.0, 1.0)

    def transform(self) -> NDArray[np.float64]:
        """Where it stands in the node above, (4, 4)."""
        if self.matrix is not None:
            return np.array(self.matrix, np.float64).reshape(4, 4).T
        x, y, z, w = self.rotation
        placed = np.eye(4)
        placed[:3, :3] = SO3(np.array([w, x, y, z])).as_matrix() * np.array(self.scale)
        placed[:3, 3] = self.translation
        return placed


class _Scene(Struct):
    nodes: list[Index] = []


class _Document(Struct):
    scenes: list[_Scene] = []
    nodes: list[_Node] = []
    meshes: list[_Mesh] = []
    accessors: list[_Accessor] = []
    bufferViews: list[_View] = []  # noqa: N815
    buffers: list[_Buffer] = []
    images: list[_Image] = []
    scene: Index = 0
    extensionsRequired: list[str] = []  # noqa: N815


def mesh_problem(glb: bytes) -> str:
    """Say why a glb cannot be a robot's body; "" if it can."""
    try:
        document, data = _parts(glb)
        needed = [one for one in document.extensionsRequired if not one.startswith(HARMLESS)]
        if needed:
            return f"Its body needs “{needed[0][:40]}”: export the file without it."
        if any(one.uri is not None for one in (*document.buffers, *document.images)):
            return "Its body is in several files: export it as one glb."
        _check_places(document, len(data))
        corners = np.array(_corners(document), np.float64).reshape(-1, 3)
    except (ValueError, IndexError, struct.error, msgspec.MsgspecError, RecursionError):
        return BROKEN
    if not len(corners) or not np.isfinite(corners).all():
        return BROKEN
    size_m = float(np.ptp(corners, axis=0).max())
    if not MIN_SIZE_M <= size_m <= MAX_SIZE_M:
        return f"Its body is {size_m:.3g} m long in the file; glb files are in metres."
    return ""


def _parts(glb: bytes) -> tuple[_Document, bytes]:
    """The document and the data behind it."""
    magic, version, length = _HEADER.unpack_from(glb)
    if (magic, version, length) != (_MAGIC, _VERSION, len(glb)):
        raise ValueError
    text, rest = _chunk(glb[_HEADER.size :], _JSON)
    data = _chunk(rest, _BIN)[0] if rest else b""
    return msgspec.json.decode(text, type=_Document), data


def _chunk(data: bytes, kind: int) -> tuple[bytes, bytes]:
    length, found = _CHUNK.unpack_from(data)
    end = _CHUNK.size + length
    if found != kind or end > len(data):
        raise ValueError
    return data[_CHUNK.size : end], data[end:]


def _check_places(document: _Document, num_bytes: int) -> None:
    """Raise where something lies outside the data."""
    for buffer in document.buffers:
        if buffer.byteLength > num_bytes:
            raise ValueError
    for view in document.bufferViews:
        if view.byteOffset + view.byteLength > document.buffers[view.buffer].byteLength:
            raise ValueError
    viewed = [one.bufferView for one in document.accessors if one.bufferView is not None]
    pieces = [one for mesh in document.meshes for one in mesh.primitives]
    used = [index for one in pieces for index in one.attributes.values()]
    used += [one.indices for one in pieces if one.indices is not None]
    if max(viewed, default=-1) >= len(document.bufferViews):
        raise ValueError
    if max(used, default=-1) >= len(document.accessors):
        raise ValueError


def _corners(document: _Document) -> list[Sequence[float]]:
    """The corners of the boxes around all that is seen, in metres."""
    found: list[Sequence[float]] = []
    coming = [(index, np.eye(4)) for index in document.scenes[document.scene].nodes]
    num_seen = 0
    while coming:
        index, above = coming.pop()
        num_seen += 1
        if num_seen > min(len(document.nodes), MAX_NODES):  # it is a tree: each is there once
            raise ValueError
        node = document.nodes[index]
        here = above @ node.transform()
        coming += [(child, here) for child in node.children]
        if node.mesh is not None:
            for one in document.meshes[node.mesh].primitives:
                corners = _box(document, one)
                found.extend((corners @ here[:3, :3].T + here[:3, 3]).tolist())
    return found


def _box(document: _Document, primitive: _Primitive) -> NDArray[np.float64]:
    """The corners (8, 3) of the box around one piece."""
    place = primitive.attributes.get("POSITION")
    if place is None:
        raise ValueError
    accessor = document.accessors[place]
    low_high = np.array([accessor.min, accessor.max], np.float64).reshape(2, 3)
    return low_high[np.indices((2, 2, 2)).reshape(3, 8).T, np.arange(3)]
