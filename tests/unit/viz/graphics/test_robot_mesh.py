"""A robot's own body: what is taken, and what is said of what is not."""

import json
import struct
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from support.pages import page_of

from trolley import topics
from trolley_viz.graphics.glb import icon_glb, png
from trolley_viz.graphics.robot_mesh import BROKEN, mesh_problem

if TYPE_CHECKING:
    from ..conftest import Stage


def body(length_m: float = 0.5, scale: float = 1.0) -> bytes:
    """A box as a glb, +y up and +z ahead."""
    scene = trimesh.Scene()
    placed = np.diag([scale, scale, scale, 1.0])
    scene.add_geometry(trimesh.creation.box((0.4, 0.2, length_m)), transform=placed)
    glb = scene.export(file_type="glb")
    assert isinstance(glb, bytes)
    return glb


def changed(glb: bytes, **parts: Any) -> bytes:
    """A glb with other parts in its document."""
    (length,) = struct.unpack_from("<I", glb, 12)
    document = {**json.loads(glb[20 : 20 + length]), **parts}
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    data = struct.pack("<2I", len(text), 0x4E4F534A) + text + glb[20 + length :]
    return struct.pack("<3I", 0x46546C67, 2, 12 + len(data)) + data


def test_a_box_is_a_body() -> None:
    assert mesh_problem(body()) == ""
    assert mesh_problem(changed(body())) == ""
    assert mesh_problem(icon_glb(png(np.zeros((2, 2, 3), np.uint8)))) == ""


@pytest.mark.parametrize(
    ("glb", "said"),
    [
        (b"", BROKEN),
        (b"glTF", BROKEN),
        (body()[:-1], BROKEN),
        (body()[:200], BROKEN),
        (changed(body(), meshes=[]), BROKEN),
        (changed(body(), nodes=[{"children": [0]}]), BROKEN),
        (changed(body(), scenes=[{"nodes": []}]), BROKEN),
        (changed(body(), buffers=[{"byteLength": 1 << 40}]), BROKEN),
        (changed(body(), bufferViews=[]), BROKEN),
        (changed(body(), images=[{"uri": "http://example.com/a.png"}]), "Its body is in several"),
        (changed(body(), extensionsRequired=["KHR_draco_mesh_compression"]), "Its body needs “KHR"),
        (body(length_m=400.0), "Its body is 400 m long"),
        (body(scale=1000.0), "Its body is 500 m long"),
        (body(scale=1e-4), "Its body is 5e-05 m long"),
    ],
)
def test_it_is_said_why_a_file_is_none(glb: bytes, said: str) -> None:
    assert mesh_problem(glb).startswith(said)


@given(st.data())
def test_no_file_does_harm(data: st.DataObject) -> None:
    glb = bytearray(body())
    for _ in range(data.draw(st.integers(1, 4))):
        glb[data.draw(st.integers(0, len(glb) - 1))] = data.draw(st.integers(0, 255))
    assert isinstance(mesh_problem(bytes(glb)), str)


def test_a_broken_body_is_replaced_by_the_footprint_and_said(stage: "Stage") -> None:
    stage.browse()
    robot = stage.hub.robots.get("trolley")
    assert robot is not None

    def put(mesh: bytes) -> None:
        stage.robot.publish(topics.ROBOT, msgspec.structs.replace(robot, mesh=mesh))
        stage.runtime.run(1.5)

    put(body())
    assert stage.layer("robot")._body is None
    assert stage.layer("robot")._parts[-1].wxyz == pytest.approx((0.5, 0.5, 0.5, 0.5))
    assert BROKEN not in page_of(stage).text()
    put(b"not a glb")
    assert stage.layer("robot")._body is not None
    assert BROKEN in page_of(stage).text()
