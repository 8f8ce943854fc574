"""SE(2) is a group, arcs are exact, and both encodings keep poses."""

import math

import msgspec
import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from trolley.geometry import (
    FrameTree,
    Pose2D,
    Twist2D,
    angle_difference,
    exp_twist,
    integrate_twist,
    interpolate,
    interpolate_straight,
    log_pose,
    pose_from_quaternion,
    wrap_angle,
    wrap_angles,
)

lengths = st.floats(-100.0, 100.0)
angles = st.floats(-math.pi, math.pi, exclude_min=True)
poses = st.builds(Pose2D, lengths, lengths, angles)
any_angles = st.floats(-1e6, 1e6)
velocities = st.floats(-2.0, 2.0)
twists = st.builds(Twist2D, velocities, velocities, velocities)


def assert_same(a: Pose2D, b: Pose2D, tolerance: float = 1e-9) -> None:
    """Both are within a tolerance [m], [rad] of each other, and their yaws are wrapped."""
    assert math.hypot(a.x - b.x, a.y - b.y) <= tolerance
    assert abs(angle_difference(a.yaw, b.yaw)) <= tolerance
    assert -math.pi < a.yaw <= math.pi


@given(any_angles)
def test_wrapping_stays_in_range_and_keeps_the_direction(angle: float) -> None:
    wrapped = wrap_angle(angle)
    assert -math.pi < wrapped <= math.pi
    assert math.isclose(math.cos(wrapped), math.cos(angle), abs_tol=1e-9)
    assert math.isclose(math.sin(wrapped), math.sin(angle), abs_tol=1e-9)
    assert wrap_angle(wrapped) == wrapped


@given(any_angles)
def test_arrays_are_wrapped_like_numbers(angle: float) -> None:
    (wrapped,) = wrap_angles(np.array([angle]))
    assert -math.pi < wrapped <= math.pi
    assert abs(angle_difference(wrapped, wrap_angle(angle))) <= 1e-9


@given(any_angles, any_angles)
def test_difference_leads_from_one_angle_to_the_other(to: float, start: float) -> None:
    assert abs(wrap_angle(start + angle_difference(to, start) - to)) <= 1e-9


@given(poses, poses, poses)
def test_products_are_associative(a: Pose2D, b: Pose2D, c: Pose2D) -> None:
    assert_same((a @ b) @ c, a @ (b @ c))


@given(poses)
def test_identity_and_inverse(a: Pose2D) -> None:
    assert_same(a @ Pose2D.identity(), a)
    assert_same(Pose2D.identity() @ a, a)
    assert_same(a @ a.inverse(), Pose2D.identity())
    assert_same(a.inverse() @ a, Pose2D.identity())


@given(poses, poses)
def test_inverse_of_a_product_turns_the_order_round(a: Pose2D, b: Pose2D) -> None:
    assert_same((a @ b).inverse(), b.inverse() @ a.inverse())


@given(poses, poses, lengths, lengths)
def test_product_acts_like_one_after_the_other(a: Pose2D, b: Pose2D, x: float, y: float) -> None:
    points = np.array([[x, y]])
    np.testing.assert_allclose(
        (a @ b).transform_points(points),
        a.transform_points(b.transform_points(points)),
        atol=1e-9,
    )


@given(poses)
def test_array_and_quaternion_come_back(a: Pose2D) -> None:
    assert Pose2D.from_array(a.as_array()) == a
    assert_same(pose_from_quaternion(a.x, a.y, a.as_quaternion()), a)


@given(poses, st.floats(0.01, 100.0), st.booleans())
def test_length_and_sign_of_a_quaternion_do_not_matter(
    a: Pose2D, length: float, flipped: bool
) -> None:
    factor = -length if flipped else length
    orientation = [factor * value for value in a.as_quaternion()]
    assert_same(pose_from_quaternion(a.x, a.y, orientation), a)


@given(poses)
def test_both_encodings_keep_every_bit(a: Pose2D) -> None:
    for codec in (msgspec.json, msgspec.msgpack):
        assert codec.decode(codec.encode(a), type=Pose2D) == a


@given(poses)
def test_log_and_exp_undo_each_other(a: Pose2D) -> None:
    assert_same(exp_twist(log_pose(a)), a, tolerance=1e-8)


@given(poses, twists, st.floats(0.0, 5.0), st.floats(0.0, 5.0))
def test_two_steps_along_an_arc_are_one(a: Pose2D, twist: Twist2D, t: float, u: float) -> None:
    stepwise = integrate_twist(integrate_twist(a, twist, t), twist, u)
    assert_same(integrate_twist(a, twist, t + u), stepwise)


@given(poses, twists)
def test_small_steps_approach_the_arc(a: Pose2D, twist: Twist2D) -> None:
    x, y, yaw = a.x, a.y, a.yaw
    num_steps = 2000
    for _ in range(num_steps):
        # Midpoint rule: the error falls with the square of the step.
        middle = yaw + 0.5 * twist.wz / num_steps
        x += (math.cos(middle) * twist.vx - math.sin(middle) * twist.vy) / num_steps
        y += (math.sin(middle) * twist.vx + math.cos(middle) * twist.vy) / num_steps
        yaw += twist.wz / num_steps
    assert_same(integrate_twist(a, twist, 1.0), Pose2D(x, y, yaw), tolerance=1e-6)


@given(poses, poses)
def test_interpolation_begins_and_ends_where_asked(a: Pose2D, b: Pose2D) -> None:
    for between in (interpolate, interpolate_straight):
        assert between(a, b, 0.0) == a
        assert between(a, b, 1.0) == b


@given(poses, twists, st.floats(0.0, 1.0))
def test_interpolation_follows_the_arc(a: Pose2D, twist: Twist2D, fraction: float) -> None:
    end = integrate_twist(a, twist, 1.0)
    assert_same(interpolate(a, end, fraction), integrate_twist(a, twist, fraction), tolerance=1e-7)


@given(poses, poses, poses, st.floats(0.0, 1.0))
def test_interpolation_does_not_depend_on_the_frame(
    a: Pose2D, b: Pose2D, frame: Pose2D, fraction: float
) -> None:
    relative = a.inverse() @ b
    if math.pi - abs(relative.yaw) < 1e-3:
        return  # exactly opposite headings: either way round is as short
    moved = interpolate(frame @ a, frame @ b, fraction)
    assert_same(moved, frame @ interpolate(a, b, fraction), tolerance=1e-6)


@given(st.lists(poses, min_size=1, max_size=6), st.data())
def test_tree_gives_the_product_of_its_links(links: list[Pose2D], data: st.DataObject) -> None:
    tree = FrameTree()
    root_T_frames = [Pose2D.identity()]
    for index, pose in enumerate(links):
        parent = data.draw(st.integers(0, index))
        tree.set(f"f{parent}", f"f{index + 1}", pose, stamp_ns=index)
        root_T_frames.append(root_T_frames[parent] @ pose)
    for i, root_T_i in enumerate(root_T_frames):
        for j, root_T_j in enumerate(root_T_frames):
            assert_same(tree.lookup(f"f{i}", f"f{j}"), root_T_i.inverse() @ root_T_j, 1e-7)
