"""A picture as a binary glTF: one rectangle, unlit.

viser's own image nodes are drawn as transparent, so that what lies flat on them may vanish; and
they are blurred. Written by hand, since it is one fixed scene.

Source:
    Khronos Group, glTF 2.0 specification (2021), sections 3 and 4; KHR_materials_unlit.
"""

import json
import struct
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

_MAGIC, _VERSION, _JSON, _BIN = 0x46546C67, 2, 0x4E4F534A, 0x004E4942
_FLOAT, _USHORT, _CLAMP = 5126, 5123, 33071
_NEAREST, _LINEAR, _SMALLER = 9728, 9729, 9987
"""How a picture is read where it is drawn larger or smaller; the last takes one made smaller."""


def png(picture: NDArray[np.uint8]) -> bytes:
    """Encode an RGB picture (h, w, 3) as PNG."""
    height, width = picture.shape[:2]
    lines = np.zeros((height, 1 + 3 * width), np.uint8)  # each line begins with filter type 0
    lines[:, 1:] = picture.reshape(height, 3 * width)
    header = struct.pack(">2I5B", width, height, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        for kind, data in (
            (b"IHDR", header),
            (b"IDAT", zlib.compress(lines.tobytes(), 6)),
            (b"IEND", b""),
        )
    )


def floor_glb(picture: NDArray[np.uint8], width: float, height: float) -> bytes:
    """Lay a picture (h, w, 3), row 0 at +y, on the rectangle from (0, 0) to (width, height) [m].

    It is sharp at every zoom.
    """
    return _glb(png(picture), (0.0, 0.0, width, height), {}, {"magFilter": _NEAREST})


def icon_glb(picture: bytes) -> bytes:
    """Put a PNG on a square of 1 m around the origin, its upper edge at +y, seen from +z."""
    filters = {"magFilter": _LINEAR, "minFilter": _SMALLER}
    return _glb(picture, (-0.5, -0.5, 0.5, 0.5), {"alphaMode": "BLEND"}, filters)


def _glb(
    picture: bytes,
    rectangle: tuple[float, float, float, float],
    alpha: dict[str, str],
    filters: dict[str, int],
) -> bytes:
    left, bottom, right, top = rectangle
    positions = np.array(
        [[left, bottom, 0], [right, bottom, 0], [right, top, 0], [left, top, 0]], "<f4"
    )
    corners = np.array([[0, 1], [1, 1], [1, 0], [0, 0]], "<f4")
    faces = np.array([0, 1, 2, 0, 2, 3], "<u2")
    parts = [positions.tobytes(), corners.tobytes(), faces.tobytes(), picture]
    views: list[dict[str, int]] = []
    binary = b""
    for part in parts:
        views.append({"buffer": 0, "byteOffset": len(binary), "byteLength": len(part)})
        binary += part + b"\0" * (-len(part) % 4)
    document: dict[str, Any] = {
        "asset": {"version": "2.0"},
        "extensionsUsed": ["KHR_materials_unlit"],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [
            {
                "primitives": [
                    {"attributes": {"POSITION": 0, "TEXCOORD_0": 1}, "indices": 2, "material": 0}
                ]
            }
        ],
        "accessors": [
            {
                "bufferView": 0,
                "componentType": _FLOAT,
                "count": 4,
                "type": "VEC3",
                "min": [left, bottom, 0],
                "max": [right, top, 0],
            },
            {"bufferView": 1, "componentType": _FLOAT, "count": 4, "type": "VEC2"},
            {"bufferView": 2, "componentType": _USHORT, "count": 6, "type": "SCALAR"},
        ],
        "materials": [
            {
                "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}, "metallicFactor": 0},
                "extensions": {"KHR_materials_unlit": {}},
                "doubleSided": True,
                **alpha,
            }
        ],
        "textures": [{"source": 0, "sampler": 0}],
        "samplers": [{"wrapS": _CLAMP, "wrapT": _CLAMP, **filters}],
        "images": [{"bufferView": 3, "mimeType": "image/png"}],
        "bufferViews": views,
        "buffers": [{"byteLength": len(binary)}],
    }
    return _packed(document, binary)


def _packed(document: dict[str, Any], binary: bytes) -> bytes:
    """Put a document and its data into one file."""
    text = json.dumps(document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<2I", len(text), _JSON) + text
    chunks += struct.pack("<2I", len(binary), _BIN) + binary
    return struct.pack("<3I", _MAGIC, _VERSION, 12 + len(chunks)) + chunks
