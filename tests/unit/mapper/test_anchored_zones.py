"""Zones that were drawn on a map in the making move with it."""

import pytest

from trolley.codes import Refused
from trolley.geometry import Pose2D
from trolley.messages import Zone
from trolley_mapper.anchored_zones import AnchoredZones
from trolley_mapper.slam.estimate import Anchor


class Moving:
    """A map that moves as a whole."""

    def __init__(self) -> None:
        self.by = Pose2D.identity()

    def anchor(self, map_T_pose: Pose2D) -> Anchor:
        return Anchor(0, self.by.inverse() @ map_T_pose)

    def moved(self, anchor: Anchor) -> Pose2D:
        return self.by @ anchor.keyframe_T_pose


def line(name: str, y: float = 0.0) -> Zone:
    return Zone(name=name, kind="mirror", points=[(0.0, y), (2.0, y)])


def test_a_zone_goes_where_its_part_of_the_map_goes_and_those_of_before_stay() -> None:
    core, zones = Moving(), AnchoredZones([line("old")])
    zones.put(line("new"), core)
    assert not zones.follow(core)
    for y in (0.5, 0.75):
        core.by = Pose2D(0.0, y, 0.0)
        assert zones.follow(core)
        assert zones.all == [line("new", y), line("old")]
        assert not zones.follow(core)


def test_zones_of_a_checkpoint_go_on_moving() -> None:
    core, before = Moving(), AnchoredZones()
    before.put(line("new"), core)
    core.by = Pose2D(0.0, 0.5, 0.0)
    before.follow(core)
    zones = AnchoredZones(before.all, before.ties, before.deleted)
    core.by = Pose2D(0.0, 0.25, 0.0)
    assert zones.follow(core)
    assert zones.all == [line("new", 0.25)]


def test_what_has_become_of_the_zones_of_before_is_known() -> None:
    core, zones = Moving(), AnchoredZones([line("gone"), line("kept"), line("moved")])
    zones.put(line("moved", 1.0), core)
    assert zones.delete("gone") == line("gone")
    with pytest.raises(Refused):
        zones.delete("gone")
    assert zones.drawn == [line("moved", 1.0)]
    assert zones.deleted == {"gone"}
    zones.put(line("gone", 2.0), core)
    assert zones.deleted == set()
