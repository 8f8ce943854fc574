"""AnchoredPlaces that were saved on a map move with it."""

import pytest

from trolley.geometry import Pose2D
from trolley.messages import SavedPose
from trolley_mapper.anchored_places import AnchoredPlaces
from trolley_mapper.slam.estimate import Anchor


class Moving:
    """A map that moves as a whole."""

    def __init__(self) -> None:
        self.by = Pose2D.identity()

    def anchor(self, map_T_pose: Pose2D) -> Anchor:
        return Anchor(0, self.by.inverse() @ map_T_pose)

    def moved(self, anchor: Anchor) -> Pose2D:
        return self.by @ anchor.keyframe_T_pose


def place(name: str = "sofa", x: float = 1.0, on: str = "home") -> SavedPose:
    return SavedPose(name=name, map=on, pose=Pose2D(x, 0.0, 0.0), note="soft")


def test_a_place_goes_where_its_part_of_the_map_goes() -> None:
    core, places = Moving(), AnchoredPlaces()
    places.update([place(), place("away", on="other")], "home", core)
    assert places.moved(core) == []
    core.by = Pose2D(0.0, 0.5, 0.0)
    (moved,) = places.moved(core)
    assert (moved.name, moved.map, moved.note) == ("sofa", "home", "soft")
    assert moved.pose.y == pytest.approx(0.5)
    assert places.moved(core) == [moved]  # as long as it is not stored
    core.by = Pose2D(0.0, 0.6, 0.0)
    places.update([moved], "home", core)
    places.stored(moved)
    (moved,) = places.moved(core)
    assert moved.pose.y == pytest.approx(0.6)


def test_a_place_goes_back_to_where_it_was_stored_if_a_person_puts_it_there() -> None:
    core, places = Moving(), AnchoredPlaces()
    places.update([place()], "home", core)
    core.by = Pose2D(0.0, 0.5, 0.0)
    (moved,) = places.moved(core)
    places.stored(moved)
    places.update([place(x=3.0)], "home", core)
    places.update([moved], "home", core)
    assert places.moved(core) == []


def test_a_hair_is_no_move() -> None:
    core, places = Moving(), AnchoredPlaces()
    places.update([place()], "home", core)
    core.by = Pose2D(0.004, 0.0, 0.001)
    assert places.moved(core) == []
    core.by = Pose2D(0.012, 0.0, 0.0)
    assert len(places.moved(core)) == 1


def test_what_a_person_moves_stays_where_it_was_put() -> None:
    core, places = Moving(), AnchoredPlaces()
    places.update([place(x=1.0)], "home", core)
    core.by = Pose2D(0.0, 0.5, 0.0)
    places.update([place(x=3.0)], "home", core)
    assert places.moved(core) == []


def test_what_was_deleted_is_not_brought_back() -> None:
    core, places = Moving(), AnchoredPlaces()
    places.update([place()], "home", core)
    places.update([], "home", core)
    core.by = Pose2D(0.0, 0.5, 0.0)
    assert places.moved(core) == []
    assert places.anchors == {}


def test_anchors_outlive_the_process() -> None:
    core, places = Moving(), AnchoredPlaces()
    places.update([place()], "home", core)
    core.by = Pose2D(0.0, 0.5, 0.0)
    again = AnchoredPlaces(places.anchors)
    again.update([place()], "home", core)
    (moved,) = again.moved(core)
    assert moved.pose.y == pytest.approx(0.5)


def test_all_go_along_to_a_map_of_another_name() -> None:
    core, places = Moving(), AnchoredPlaces()
    places.update([place(), place("desk", 2.0)], "home", core)
    moved = places.moved(core, "home2")
    assert [(one.name, one.map) for one in moved] == [("sofa", "home2"), ("desk", "home2")]
    for one in moved:
        places.stored(one)
    assert places.moved(core, "home2") == []
