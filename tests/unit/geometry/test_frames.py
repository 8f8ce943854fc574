import math

import pytest

from trolley.geometry import FrameTree, MissingLink, Pose2D


@pytest.fixture
def tree() -> FrameTree:
    """The robot's tree, with a second frame on the base."""
    tree = FrameTree()
    tree.set("map", "odom", Pose2D(1.0, 0.0, math.pi / 2), stamp_ns=100)
    tree.set("odom", "base_link", Pose2D(2.0, 0.0, 0.0), stamp_ns=200)
    tree.set("base_link", "laser", Pose2D(0.1, 0.0, math.pi))
    tree.set("base_link", "camera", Pose2D(0.2, 0.0, 0.0))
    return tree


def test_down_the_tree(tree: FrameTree) -> None:
    map_T_laser = tree.lookup("map", "laser")
    assert map_T_laser.as_array() == pytest.approx([1.0, 2.1, -math.pi / 2])


def test_up_the_tree_is_the_inverse(tree: FrameTree) -> None:
    both = tree.lookup("map", "laser") @ tree.lookup("laser", "map")
    assert both.as_array() == pytest.approx([0.0, 0.0, 0.0], abs=1e-12)


def test_across_the_common_ancestor(tree: FrameTree) -> None:
    laser_T_camera = tree.lookup("laser", "camera")
    assert laser_T_camera.as_array() == pytest.approx([-0.1, 0.0, math.pi], abs=1e-12)


def test_a_frame_in_itself_is_the_identity(tree: FrameTree) -> None:
    assert tree.lookup("laser", "laser") == Pose2D.identity()
    assert tree.chain("laser", "laser") == []


def test_chain_lists_the_links_with_their_stamps(tree: FrameTree) -> None:
    stamps = [(link.child, link.stamp_ns) for link in tree.chain("map", "laser")]
    assert stamps == [("odom", 100), ("base_link", 200), ("laser", None)]
    assert [link.child for link in tree.chain("laser", "camera")] == ["laser", "camera"]


def test_leading_slash_is_dropped(tree: FrameTree) -> None:
    tree.set("/map", "/dock", Pose2D(5.0, 0.0, 0.0))
    assert tree.lookup("/map", "dock") == Pose2D(5.0, 0.0, 0.0)
    assert "dock" in tree.frames()


def test_newer_link_replaces_the_older(tree: FrameTree) -> None:
    tree.set("map", "odom", Pose2D.identity(), stamp_ns=300)
    link = tree.link("odom")
    assert link is not None
    assert link.stamp_ns == 300


def test_missing_root_link_is_named() -> None:
    tree = FrameTree()
    tree.set("odom", "base_link", Pose2D.identity())
    with pytest.raises(MissingLink, match=r"'odom' has no parent.*tf/odom") as caught:
        tree.lookup("map", "base_link")
    assert (caught.value.parent, caught.value.child) == ("map", "base_link")
    assert caught.value.missing == "odom"
    with pytest.raises(MissingLink) as caught:
        tree.lookup("base_link", "map")
    assert caught.value.missing == "odom"


def test_unknown_frame_is_named_with_those_that_are_known(tree: FrameTree) -> None:
    with pytest.raises(MissingLink, match=r"nothing is known of 'gripper'.*base_link, camera"):
        tree.lookup("map", "gripper")
    tree.lookup("map", "laser")


def test_empty_tree_says_so() -> None:
    with pytest.raises(MissingLink, match="known frames: none"):
        FrameTree().lookup("map", "laser")


def test_removed_link_is_missing(tree: FrameTree) -> None:
    tree.remove("odom")
    with pytest.raises(MissingLink):
        tree.lookup("map", "laser")
    tree.clear()
    assert tree.frames() == []


@pytest.mark.parametrize(
    ("parent", "child", "sentence"),
    [
        ("laser", "laser", "its own parent"),
        ("laser", "map", "cannot be a child"),
        ("laser", "base_link", "cannot be a child"),
        ("", "laser", "name"),
        ("map", "/", "name"),
    ],
)
def test_loops_and_nameless_frames_are_refused(
    tree: FrameTree, parent: str, child: str, sentence: str
) -> None:
    before = tree.lookup("map", "laser")
    with pytest.raises(ValueError, match=sentence):
        tree.set(parent, child, Pose2D.identity())
    assert tree.lookup("map", "laser") == before
