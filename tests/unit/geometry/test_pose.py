import math

import msgspec
import numpy as np
import pytest

from trolley.geometry import Pose2D, Twist2D, pose_from_quaternion, wrap_angle, wrap_angles

QUARTER = math.pi / 2


def test_chaining_turns_then_moves() -> None:
    map_T_base = Pose2D(1.0, 2.0, QUARTER)
    base_T_laser = Pose2D(0.5, 0.0, QUARTER)
    assert (map_T_base @ base_T_laser).as_array() == pytest.approx([1.0, 2.5, math.pi])


def test_yaw_of_a_product_is_wrapped() -> None:
    assert (Pose2D(0.0, 0.0, 3.0) @ Pose2D(0.0, 0.0, 3.0)).yaw == pytest.approx(6.0 - 2 * math.pi)


def test_points_go_from_child_to_parent() -> None:
    points_laser = np.array([[1.0, 0.0], [0.0, 1.0]], dtype=np.float32)
    points_map = Pose2D(1.0, 2.0, QUARTER).transform_points(points_laser)
    np.testing.assert_allclose(points_map, [[1.0, 3.0], [0.0, 2.0]], atol=1e-12)
    assert points_map.dtype == np.float64


def test_no_points_stay_no_points() -> None:
    assert Pose2D(1.0, 2.0, 3.0).transform_points(np.empty((0, 2))).shape == (0, 2)


def test_poses_are_transformed_like_products() -> None:
    a, b = Pose2D(1.0, -2.0, 2.5), Pose2D(0.3, 0.4, 1.5)
    out = a.transform_poses(b.as_array()[None, :])
    np.testing.assert_allclose(out[0], (a @ b).as_array(), atol=1e-12)


@pytest.mark.parametrize("bad", [[1.0, 2.0], [[1.0, 2.0, 3.0]], [1.0, 2.0, math.nan], []])
def test_what_is_no_pose_is_refused(bad: list[float]) -> None:
    with pytest.raises(ValueError, match="a pose needs"):
        Pose2D.from_array(bad)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1.1e12, -1.1e12, -1e308])
@pytest.mark.parametrize("kind", [Pose2D, Twist2D])
def test_decoding_refuses_what_is_not_finite_or_out_of_this_world(
    kind: type[msgspec.Struct], value: float
) -> None:
    good = msgspec.to_builtins(kind(1.0, 2.0, 3.0))
    for field in good:
        payload = msgspec.msgpack.encode({**good, field: value})
        with pytest.raises(msgspec.ValidationError, match=field):
            msgspec.msgpack.decode(payload, type=kind)


def test_decoding_refuses_missing_fields() -> None:
    with pytest.raises(msgspec.ValidationError, match="wz"):
        msgspec.json.decode(b'{"vx": 1.0, "vy": 0.0}', type=Twist2D)


def test_decoding_takes_whole_numbers_and_any_finite_yaw() -> None:
    pose = msgspec.json.decode(b'{"x": 1, "y": -2, "yaw": 7}', type=Pose2D)
    assert pose == Pose2D(1.0, -2.0, 7.0)
    assert pose.wrapped().yaw == pytest.approx(7.0 - 2 * math.pi)


def test_poses_are_values() -> None:
    assert len({Pose2D(1.0, 2.0, 3.0), Pose2D(1.0, 2.0, 3.0)}) == 1
    with pytest.raises(AttributeError):
        Pose2D(1.0, 2.0, 3.0).x = 4.0  # type: ignore[misc]


@pytest.mark.parametrize(
    ("angle", "wrapped"),
    [
        (0.0, 0.0),
        (math.pi, math.pi),
        (-math.pi, math.pi),
        (3 * math.pi, math.pi),
        (-3 * math.pi, math.pi),
        (math.nextafter(-math.pi, 0.0), math.nextafter(-math.pi, 0.0)),
        (7.0, 7.0 - 2 * math.pi),
        (-7.0, 2 * math.pi - 7.0),
    ],
)
def test_angles_are_wrapped_to_minus_pi_excluded_pi_included(angle: float, wrapped: float) -> None:
    assert wrap_angle(angle) == pytest.approx(wrapped, abs=1e-15)
    assert wrap_angles(np.array([angle]))[0] == pytest.approx(wrapped, abs=1e-15)


def test_float32_pi_stays_within_range() -> None:
    assert abs(wrap_angles(np.array([np.pi, -np.pi], dtype=np.float32))).max() <= math.pi


def test_nan_angles_stay_nan() -> None:
    assert math.isnan(wrap_angle(math.nan))
    assert np.isnan(wrap_angles(np.array([np.nan]))).all()


def test_quaternion_is_normalised() -> None:
    pose = pose_from_quaternion(2, -1, [0.0, 0.0, 5.0, 5.0])
    assert pose.as_array() == pytest.approx([2.0, -1.0, QUARTER])


def test_quaternion_of_either_sign_is_the_same_heading() -> None:
    forward = pose_from_quaternion(0.0, 0.0, [0.0, 0.0, 0.6, 0.8])
    assert pose_from_quaternion(0.0, 0.0, [0.0, 0.0, -0.6, -0.8]).yaw == pytest.approx(forward.yaw)


@pytest.mark.parametrize(
    ("orientation", "sentence"),
    [
        ([0.0, 0.0, 0.0, 0.0], "length zero"),
        ([0.5, 0.0, 0.0, 0.866], "tilted by 60 degrees"),
        ([1.0, 0.0, 0.0, 0.0], "tilted by 180 degrees"),
        ([0.0, 0.0, math.nan, 1.0], "finite"),
        ([0.0, 0.0, 1.0], "four numbers"),
    ],
)
def test_quaternion_that_is_no_heading_is_refused(orientation: list[float], sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        pose_from_quaternion(0.0, 0.0, orientation)


def test_position_that_is_not_finite_is_refused() -> None:
    with pytest.raises(ValueError, match="finite"):
        pose_from_quaternion(math.inf, 0.0, [0.0, 0.0, 0.0, 1.0])


def test_standing_and_moving_are_told_apart() -> None:
    assert Twist2D.zero().is_zero
    assert Twist2D(-0.0, 0.0, 0.0).is_zero
    assert not Twist2D(0.0, 0.0, 1e-9).is_zero
    assert Twist2D(3.0, 4.0, 1.0).speed == 5.0
    assert Twist2D(1.0, 0.0, -2.0).scaled(0.5) == Twist2D(0.5, 0.0, -1.0)
