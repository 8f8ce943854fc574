import math

import numpy as np
import pytest
from msgspec import structs
from support import ros2

from trolley.geometry import Pose2D, Twist2D
from trolley.messages import (
    OccupancyGrid,
    Odometry,
    Path,
    PoseEstimate,
    Scan,
    Transform,
    floats_to_bytes,
)
from trolley_ros2 import cdr, to_ros

STAMP_NS = 1_700_000_000_123_456_789
SCAN = Scan(
    stamp_ns=5,
    frame="laser",
    angle_min=-1.5,
    angle_increment=0.5,
    time_increment=0.001,
    range_min=0.1,
    range_max=12.0,
    ranges=floats_to_bytes(np.array([1.0, np.inf, 0.0, np.nan, 2.5])),
)
ESTIMATE = PoseEstimate(
    stamp_ns=5,
    map="home",
    pose=Pose2D(1.0, 2.0, math.pi / 2),
    covariance=[1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0],
    state="localized",
    match=0.9,
    spread=0.1,
)

# Published hashes: of `ros2 topic info --verbose` and of programs that speak to rmw_zenoh.
HASHES = {
    cdr.LASER_SCAN: "64c191398013af96509d518dac71d5164f9382553fce5c1f8cca5be7924bd828",
    cdr.ODOMETRY: "3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0",
    cdr.TF_MESSAGE: "e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087",
    cdr.OCCUPANCY_GRID: "8d348150c12913a31ee0ec170fbf25089e4745d17035792a1ba94d6f0bc0cfc7",
    cdr.POSE_WITH_COVARIANCE: "26432f9803e43727d3c8f668d1fdb3c630f548af631e2f4e31382371bfea3b6e",
    cdr.PATH: "1957a5bb3cee5da65c4e52e52b65a93df227efce4c20f8458b36e73066ca334b",
    cdr.POSE: "10f3786d7d40fd2b54367835614bff85d4ad3b5dab62bf8bca0cc232d73b4cd8",
    cdr.TWIST: "9c45bf16fe0983d80e3cfe750d6835843d265a9a6c46bd2e609fcddde6fb8d2a",
    cdr.TWIST_STAMPED: "5f0fcd4f81d5d06ad9b4c4c63e3ea51b82d6ae4d0558f1d475229b1121db6f64",
}


@pytest.mark.parametrize("type_name", HASHES)
def test_a_types_hash_is_the_published_one(type_name: str) -> None:
    assert cdr.type_hash(type_name, "jazzy") == f"RIHS01_{HASHES[type_name]}"
    assert cdr.type_hash(type_name, "humble") == "TypeHashNotSupported"


def test_a_scan_is_read_by_others() -> None:
    seen = ros2.read(cdr.LASER_SCAN, cdr.write(to_ros.laser_scan(SCAN, STAMP_NS)))
    assert (seen.header.stamp.sec, seen.header.stamp.nanosec) == (1_700_000_000, 123_456_789)
    assert seen.header.frame_id == "laser"
    assert (seen.angle_min, seen.angle_max, seen.angle_increment) == (-1.5, 0.5, 0.5)
    assert seen.scan_time == pytest.approx(0.005)
    assert seen.range_max == 12.0
    assert list(seen.ranges)[:2] == [1.0, math.inf]
    assert np.isnan(list(seen.ranges)[2:4]).all()
    assert list(seen.ranges)[4] == 2.5
    assert list(seen.intensities) == []


def test_the_bytes_of_a_twist_are_those_of_a_hand_made_one() -> None:
    vector = [
        cdr.make("geometry_msgs/msg/Vector3", *xyz) for xyz in ((0.5, 0.0, 0.0), (0.0, 0.0, -1.0))
    ]
    # The header of little-endian CDR, then six doubles.
    by_hand = bytes.fromhex(
        "00010000"
        "000000000000e03f" "0000000000000000" "0000000000000000"
        "0000000000000000" "0000000000000000" "000000000000f0bf"
    )  # fmt: skip
    assert cdr.write(cdr.make(cdr.TWIST, *vector)) == by_hand


def test_odometry_is_read_by_others() -> None:
    message = Odometry(stamp_ns=5, pose=Pose2D(1.0, -2.0, math.pi), twist=Twist2D(0.3, 0.1, -0.2))
    seen = ros2.read(cdr.ODOMETRY, cdr.write(to_ros.odometry(message, STAMP_NS)))
    assert (seen.header.frame_id, seen.child_frame_id) == ("odom", "base_link")
    at = seen.pose.pose
    assert (at.position.x, at.position.y, at.position.z) == (1.0, -2.0, 0.0)
    assert (at.orientation.z, at.orientation.w) == pytest.approx((1.0, 0.0))
    twist = seen.twist.twist
    assert (twist.linear.x, twist.linear.y, twist.angular.z) == (0.3, 0.1, -0.2)
    assert len(list(seen.twist.covariance)) == 36


def test_transforms_are_read_by_others() -> None:
    mount = Transform(
        stamp_ns=5, parent="base_link", child="laser", pose=Pose2D(0.1, 0.0, 0.0), z=0.2
    )
    odom = to_ros.base_in_odom(
        Odometry(stamp_ns=7, pose=Pose2D(3.0, 0.0, 0.0), twist=Twist2D.zero())
    )
    message = to_ros.transforms([(mount, STAMP_NS), (odom, STAMP_NS + 1)])
    seen = ros2.read(cdr.TF_MESSAGE, cdr.write(message)).transforms
    assert [(one.header.frame_id, one.child_frame_id) for one in seen] == [
        ("base_link", "laser"),
        ("odom", "base_link"),
    ]
    shift = seen[0].transform.translation
    assert (shift.x, shift.y, shift.z) == (0.1, 0.0, 0.2)
    assert seen[1].header.stamp.nanosec == 123_456_790


def test_a_map_is_read_by_others() -> None:
    cells = np.array([[0, 100, -1], [50, 0, 0]], np.int8)
    grid = OccupancyGrid(
        stamp_ns=5,
        name="home",
        frame="map",
        resolution=0.05,
        width=3,
        height=2,
        origin=Pose2D(-1.0, -2.0, 0.0),
        cells=memoryview(cells.tobytes()),
    )
    seen = ros2.read(cdr.OCCUPANCY_GRID, cdr.write(to_ros.grid(grid, STAMP_NS)))
    assert (seen.info.width, seen.info.height) == (3, 2)
    assert seen.info.resolution == pytest.approx(0.05)
    assert (seen.info.origin.position.x, seen.info.origin.position.y) == (-1.0, -2.0)
    assert np.array(list(seen.data), np.int8).tolist() == cells.ravel().tolist()


def test_a_pose_is_amcls() -> None:
    seen = ros2.read(cdr.POSE_WITH_COVARIANCE, cdr.write(to_ros.pose(ESTIMATE, STAMP_NS)))
    assert seen.header.frame_id == "map"
    assert seen.pose.pose.orientation.w == pytest.approx(math.sqrt(0.5))
    covariance = np.reshape(list(seen.pose.covariance), (6, 6))
    assert covariance[[0, 0, 0, 1, 5], [0, 1, 5, 0, 5]].tolist() == [1.0, 2.0, 3.0, 4.0, 9.0]
    assert not covariance[2:5].any()


@pytest.mark.parametrize("unknown", [{"pose": None}, {"covariance": None}, {"state": "lost"}])
def test_a_pose_that_is_not_known_is_not_said(unknown: dict[str, object]) -> None:
    assert to_ros.pose(structs.replace(ESTIMATE, **unknown), STAMP_NS) is None


def test_a_path_is_read_by_others_and_none_is_empty() -> None:
    rows = np.array([[0.0, 0.0, 0.0], [1.0, 2.0, math.pi / 2]])
    line = Path(stamp_ns=5, frame="map", poses=floats_to_bytes(rows))
    seen = ros2.read(cdr.PATH, cdr.write(to_ros.path(line, STAMP_NS)))
    assert [(one.pose.position.x, one.pose.position.y) for one in seen.poses] == [(0, 0), (1, 2)]
    empty = structs.replace(line, poses=memoryview(b""))
    assert ros2.read(cdr.PATH, cdr.write(to_ros.path(empty, STAMP_NS))).poses == []


def test_what_no_field_holds_is_said_and_not_written() -> None:
    with pytest.raises(cdr.NotWritten):
        cdr.write(to_ros.laser_scan(structs.replace(SCAN, angle_min=1e300), STAMP_NS))
    # A stamp is no reason: its seconds stop at what a message can say.
    last = cdr.write(to_ros.laser_scan(SCAN, 2**63 - 1))
    assert ros2.read(cdr.LASER_SCAN, last).header.stamp.sec == to_ros.LAST_SECOND
