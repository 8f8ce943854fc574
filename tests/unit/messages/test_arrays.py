"""Arrays as bytes, and messages that refuse what does not fit."""

import msgspec
import numpy as np
import pytest
from support.samples import make_scan

from trolley.geometry import Pose2D
from trolley.messages import (
    OccupancyGrid,
    ParticleCloud,
    Path,
    Robot,
    Scan,
    Stop,
    floats_from_bytes,
    floats_to_bytes,
)
from trolley.messages.arrays import arrays_of
from trolley.messages.motion import MAX_MESH_BYTES
from trolley.runtime import codec


def test_floats_survive_as_bytes():
    poses = np.array([[1.0, -2.0, np.inf], [0.5, np.nan, 0.0]])
    data = floats_to_bytes(poses)
    assert len(data) == 24
    np.testing.assert_array_equal(floats_from_bytes(data, 3), poses.astype(np.float32))
    assert not floats_from_bytes(data).flags.writeable
    np.testing.assert_array_equal(floats_from_bytes(floats_to_bytes(poses.T)), poses.T.ravel())


def test_an_array_is_little_endian():
    assert bytes(floats_to_bytes(np.array([1.0], dtype=">f4"))) == b"\x00\x00\x80\x3f"


def test_echoes_at_infinity_survive_json():
    ranges = floats_to_bytes(np.array([np.inf, 0.0, 1.5, np.nan]))
    scan = msgspec.structs.replace(make_scan(1), ranges=ranges)
    back = codec.decode(Scan, codec.encode(scan, "json"))
    np.testing.assert_array_equal(arrays_of(back)["ranges"], [np.inf, 0.0, 1.5, np.nan])


def test_a_grid_reads_row_by_row():
    cells = np.arange(6, dtype=np.int8) - 1
    grid = OccupancyGrid(
        stamp_ns=0, name="m", frame="map", resolution=0.05, width=3, height=2,
        origin=Pose2D.identity(), cells=memoryview(cells.tobytes()),
    )  # fmt: skip
    np.testing.assert_array_equal(arrays_of(grid)["cells"], cells.reshape(2, 3))


def bad_grid() -> OccupancyGrid:
    return OccupancyGrid(
        stamp_ns=0, name="m", frame="map", resolution=0.05, width=3, height=2,
        origin=Pose2D.identity(), cells=memoryview(bytes(5)),
    )  # fmt: skip


def bad_robot() -> Robot:
    return Robot(
        stamp_ns=0, name="r", title="", footprint=[(0.0, 0.0)] * 3, drive="differential",
        max_speed=1.0, max_wz=1.0, deceleration=1.0, mesh=bytes(MAX_MESH_BYTES + 1),
    )  # fmt: skip


@pytest.mark.parametrize(
    ("make", "told"),
    [
        (bad_grid, "5 bytes for 3 x 2 cells"),
        (bad_robot, "mesh"),
        (lambda: Path(stamp_ns=0, frame="map", poses=memoryview(bytes(16))), "Path.poses"),
        (
            lambda: ParticleCloud(
                stamp_ns=0, poses=memoryview(bytes(24)), weights=memoryview(bytes(4))
            ),
            "1 values for 2 poses",
        ),
        (
            lambda: msgspec.structs.replace(make_scan(0, 3), intensities=memoryview(bytes(8))),
            "2 values for 3 ranges",
        ),
        (lambda: Stop(), "pose or name"),
        (lambda: Stop(pose=Pose2D.identity(), name="kitchen"), "pose or name"),
    ],
)
def test_what_does_not_fit_is_refused(make, told: str):
    with pytest.raises(ValueError, match=told):
        make()


def small_grid(**changes: object) -> OccupancyGrid:
    fields = {
        "stamp_ns": 0,
        "name": "home",
        "frame": "map",
        "resolution": 0.1,
        "width": 1,
        "height": 1,
        "origin": Pose2D.identity(),
        "cells": memoryview(b"\0"),
    }
    return msgspec.structs.replace(OccupancyGrid(**fields), **changes)


def test_a_small_grid_is_taken() -> None:
    assert codec.decode(OccupancyGrid, codec.encode(small_grid(), "msgpack")).width == 1


@pytest.mark.parametrize(
    "changes",
    [
        {"width": 0, "height": 0, "cells": memoryview(b"")},
        {"width": 0, "cells": memoryview(b"")},
        {"height": -1, "width": -1},
        {"resolution": 5e-324},
        {"resolution": 1e300},
    ],
)
def test_a_grid_that_is_none_is_refused(changes: dict[str, object]) -> None:
    payload = codec.encode(small_grid(**changes), "msgpack")
    with pytest.raises(codec.BadPayload):
        codec.decode(OccupancyGrid, payload)


def test_a_grid_out_of_this_world_is_refused() -> None:
    payload = msgspec.msgpack.decode(codec.encode(small_grid(), "msgpack"))
    payload["origin"]["x"] = 1e308
    with pytest.raises(codec.BadPayload, match="origin"):
        codec.decode(OccupancyGrid, msgspec.msgpack.encode(payload))
