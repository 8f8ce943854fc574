"""Markers from programs: drawn in their frames, changed, gone, moving, too many, and nonsense."""

import math
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, cast

import msgspec
import numpy as np
import pytest

from trolley import topics
from trolley.geometry import Pose2D
from trolley.messages import Marker, Transform
from trolley_tour.service import TourService
from trolley_viz.scene.map_layers import NUM_NAMES, OLD_NS, DrawnMap, MapModel
from trolley_viz.scene.markers.groups import MAX_MOVING, Grouping, Name
from trolley_viz.scene.markers.icons import MAX_PICTURES, Icon, Icons, orientation
from trolley_viz.scene.markers.motion import JUMP_S, TURN_S, is_moving, placed
from trolley_viz.scene.markers.nodes import segments
from trolley_viz.scene.markers.solids import SOLIDS, multiplied, unit_mesh

if TYPE_CHECKING:
    from ..conftest import Stage

S = 10**9


def put(stage: "Stage", marker: Marker, name: str = "0", ns: str = "start") -> None:
    stage.runtime.publish(topics.MARKER, marker, ns, name)


def layer(stage: "Stage") -> Any:
    return stage.layer("markers")


def nodes(stage: "Stage", sort: str) -> list[Any]:
    """The scene nodes of a sort of markers."""
    return [node for group, node in layer(stage)._nodes.items() if group.sort == sort]


def number_drawn(stage: "Stage") -> int:
    return sum(len(one) for one in layer(stage)._grouping.members.values())


def test_the_article_s_sphere_is_drawn_where_it_says(stage: "Stage") -> None:
    stage.browse()
    pose = Pose2D(5.315, 1.366, -1.04)
    put(stage, Marker(kind="sphere", frame="map", pose=pose, color=(0.0, 0.0, 1.0, 1.0)))
    stage.runtime.run(0.3)
    (batch,) = nodes(stage, "sphere")
    np.testing.assert_allclose(batch._node.batched_positions, [[5.315, 1.366, 0.0]])
    np.testing.assert_array_equal(batch._node.batched_colors, [[0, 0, 255]])
    np.testing.assert_allclose(batch._node.batched_scales, [[0.2, 0.2, 0.2]])
    assert batch._node.batched_opacities is None


@pytest.mark.parametrize("kind", SOLIDS)
def test_each_solid_fills_its_size(kind: Any) -> None:
    for fine in (True, False):
        vertices, faces = unit_mesh(kind, fine=fine)
        expected = [1.0, 0.98, 0.98] if kind == "arrow" else [1.0, 1.0, 1.0]
        np.testing.assert_allclose(np.ptp(vertices, axis=0), expected, atol=0.09)
        assert faces.max() < len(vertices)
        # Wound outwards: the volume within is positive.
        a, b, c = (vertices[faces[:, i]].astype(np.float64) for i in range(3))
        assert np.einsum("ij,ij->i", a, np.cross(b, c)).sum() > 0.0
    assert unit_mesh("arrow")[0][:, 0].min() == 0.0


def test_a_marker_of_the_robot_rides_on_it_without_being_sent_again(stage: "Stage") -> None:
    stage.browse()
    put(stage, Marker(kind="cube", frame="base_link", pose=Pose2D(1.0, 0.0, 0.0), z=0.5))
    stage.runtime.run(0.3)
    (batch,) = nodes(stage, "cube")
    before = batch._node.batched_positions
    frame = layer(stage)._frames["base_link"]
    np.testing.assert_allclose(frame.position, [1.5, 0.0, 0.0])
    moved = Transform(stamp_ns=0, parent="map", child="odom", pose=Pose2D(2.0, 1.0, math.pi / 2))
    stage.runtime.kill("base")
    stage.runtime.publish(topics.TF, moved, "odom")
    stage.runtime.run(0.3)
    assert layer(stage)._frames["base_link"] is frame
    np.testing.assert_allclose(frame.position, [2.0, 1.5, 0.0], atol=1e-6)
    assert batch._node.batched_positions is before


def test_it_is_changed_and_deleted_by_name_and_by_namespace(stage: "Stage") -> None:
    stage.browse()
    for i in range(3):
        put(stage, Marker(kind="sphere", pose=Pose2D(float(i), 0.0, 0.0)), str(i))
    put(stage, Marker(kind="cube"), "0", "other")
    stage.runtime.run(0.3)
    assert number_drawn(stage) == 4
    put(stage, Marker(kind="cube", pose=Pose2D(9.0, 0.0, 0.0)), "1")
    stage.runtime.run(0.3)
    assert len(nodes(stage, "sphere")[0]._node.batched_positions) == 2
    assert len(nodes(stage, "cube")[0]._node.batched_positions) == 2
    stage.runtime.delete(topics.MARKER.key("trolley", "start", "0"))
    stage.runtime.run(0.3)
    assert len(nodes(stage, "sphere")[0]._node.batched_positions) == 1
    stage.runtime.delete(topics.MARKER.key("trolley", "start", "*"))
    stage.runtime.run(0.3)
    assert nodes(stage, "sphere") == []
    assert number_drawn(stage) == 1


def test_an_equal_marker_that_is_put_again_is_not_drawn_again(stage: "Stage") -> None:
    stage.browse()
    put(stage, Marker(kind="sphere", motion="jump_once"))
    stage.runtime.run(2.0)
    put(stage, Marker(kind="sphere", motion="jump_once"))
    layer(stage)._grouping.dirty.clear()
    stage.runtime.run(0.3)
    (drawn,) = layer(stage)._grouping._drawn.values()
    assert drawn.group.sort == "sphere"  # it has jumped, and does not begin anew


def test_its_time_ends(stage: "Stage") -> None:
    stage.browse()
    put(stage, Marker(kind="sphere", lifetime=1.0))
    put(stage, Marker(kind="sphere"), "forever")
    stage.runtime.run(0.8)
    assert number_drawn(stage) == 2
    stage.runtime.run(0.5)
    assert number_drawn(stage) == 1
    put(stage, Marker(kind="sphere", lifetime=1.0))
    stage.runtime.run(0.8)
    put(stage, Marker(kind="sphere", lifetime=1.0))  # put again, it begins anew
    stage.runtime.run(0.8)
    assert number_drawn(stage) == 2


def test_who_looks_later_sees_what_is_kept(stage: "Stage") -> None:
    stage.runtime.add(TourService(stage.config))
    put(stage, Marker(kind="sphere", frame="/map"))
    put(stage, Marker(kind="sphere", lifetime=3.0), "short")
    stage.runtime.run(2.0)
    stage.browse()
    assert number_drawn(stage) == 2
    stage.runtime.run(1.0)
    assert number_drawn(stage) == 1


def test_without_a_place_it_is_hidden_and_the_missing_link_is_named(stage: "Stage") -> None:
    stage.browse()
    put(stage, Marker(kind="sphere", frame="gripper"))
    put(stage, Marker(kind="icon", icon="home", frame="place:attic"), "attic")
    stage.runtime.run(0.3)
    assert not layer(stage)._frames["gripper"].visible
    assert layer(stage).icons == []
    gripper, attic = layer(stage).notes
    assert gripper.startswith("One marker is not drawn. Frames 'map' and 'gripper'")
    assert "tf/gripper" in gripper
    assert attic.endswith("There is no saved place “attic” on this map.")  # but on another
    link = Transform(stamp_ns=0, parent="base_link", child="gripper", pose=Pose2D(1.0, 0.0, 0.0))
    stage.runtime.publish(topics.TF, link, "gripper")
    stage.runtime.run(0.3)
    assert layer(stage)._frames["gripper"].visible
    np.testing.assert_allclose(layer(stage)._frames["gripper"].position, [2.5, 0.0, 0.0])


def test_icons_stand_at_frames_and_places_and_face_the_camera(stage: "Stage") -> None:
    browser = stage.browse()
    put(stage, Marker(kind="icon", icon="fa-robot", frame="base_link", z=0.5), "robot")
    put(stage, Marker(kind="icon", icon="home", frame="place:kitchen", z=0.5), "kitchen")
    put(stage, Marker(kind="icon", icon="no-such-thing"), "odd")
    stage.runtime.run(0.3)
    where = {one.name: one.position for one in layer(stage).icons}
    assert where["fa-robot"] == pytest.approx((1.5, 0.0, 0.5))
    assert where["home"] == pytest.approx((2.0, 1.0, 0.5))
    assert layer(stage).notes == ["There is no icon “no-such-thing”."]
    shown = stage.drawn()._icons._nodes
    assert len(shown) == 3
    browser.camera.wxyz = np.array([math.sqrt(0.5), -math.sqrt(0.5), 0.0, 0.0])  # to +y
    stage.runtime.run(0.2)
    turned = next(iter(shown.values())).batched_wxyzs[0].tolist()
    assert rotated(turned, (0.0, 0.0, 1.0)) == pytest.approx((0.0, -1.0, 0.0), abs=1e-6)
    assert rotated(turned, (0.0, 1.0, 0.0)) == pytest.approx((0.0, 0.0, 1.0), abs=1e-6)
    stage.session.preferences.switch_layer("markers", is_on=False)
    stage.runtime.run(0.2)
    assert shown == {}


def rotated(wxyz: Any, point: tuple[float, float, float]) -> tuple[float, float, float]:
    w, x, y, z = wxyz
    found = multiplied(multiplied((w, x, y, z), (0.0, *point)), (w, -x, -y, -z))
    return found[1], found[2], found[3]


def test_a_turning_icon_stands_upright_and_looks_along_its_heading() -> None:
    icon = Icon("home", (1, 1, 1, 1), 1.0, (0, 0, 0), yaw=math.pi / 2, turn=(1.0, 0.0, 0.0, 0.0))
    wxyz = orientation(icon, np.zeros(4))
    assert rotated(wxyz, (0.0, 0.0, 1.0)) == pytest.approx((0.0, 1.0, 0.0))
    assert rotated(wxyz, (0.0, 1.0, 0.0)) == pytest.approx((0.0, 0.0, 1.0))


@pytest.mark.parametrize(("motion", "axis"), [("rotate_x", 1), ("rotate_y", 2), ("rotate_z", 3)])
def test_turns_go_round_once_about_their_axis(motion: Any, axis: int) -> None:
    marker = Marker(kind="cube", motion=motion)
    quarter = placed(marker, TURN_S / 4).turn
    assert quarter is not None
    assert quarter[0] == pytest.approx(math.cos(math.pi / 4))
    assert quarter[axis] == pytest.approx(math.sin(math.pi / 4))
    assert placed(marker, 7 * TURN_S).turn == pytest.approx(placed(marker, 0.0).turn)


def test_jumps_go_up_and_down_for_ever_or_once() -> None:
    always = Marker(kind="cube", motion="jump", size=(1.0, 1.0, 1.0))
    once = Marker(kind="cube", motion="jump_once", size=(1.0, 1.0, 1.0))
    assert placed(always, 0.0).lift == 0.0
    assert placed(always, 0.5 * JUMP_S).lift == pytest.approx(0.8)
    assert placed(always, 9.5 * JUMP_S).lift == pytest.approx(0.8)
    assert placed(once, 0.5 * JUMP_S).lift == pytest.approx(0.8)
    assert placed(once, 9.5 * JUMP_S).lift == 0.0
    assert [is_moving(one, 2.0) for one in (always, once, Marker(kind="cube"))] == [1, 0, 0]


def test_what_moves_is_sent_at_ten_hertz_and_what_stands_is_not(stage: "Stage") -> None:
    stage.browse()
    put(stage, Marker(kind="cube", motion="jump"), "jumps")
    put(stage, Marker(kind="cube"), "stands")
    stage.runtime.run(0.3)
    (jumping,), (standing,) = nodes(stage, "moving cube"), nodes(stage, "cube")
    heights = set()
    before = standing._node.batched_positions
    for _ in range(10):
        stage.runtime.run(0.1)
        heights.add(round(float(jumping._node.batched_positions[0, 2]), 3))
    assert len(heights) > 3
    assert standing._node.batched_positions is before


def test_lines_and_texts(stage: "Stage") -> None:
    stage.browse()
    points = [(0.0, 0.0, 0.1), (1.0, 0.0, 0.1), (1.0, 1.0, 0.1)]
    put(stage, Marker(kind="line", points=points, color=(1.0, 0.0, 0.0, 1.0)), "line")
    put(stage, Marker(kind="line", points=points[:1]), "point")
    put(stage, Marker(kind="text", text="<b>" + "x" * 999, size=(1.0, 1.0, 0.3)), "text")
    stage.runtime.run(0.3)
    (lines,), (labels,) = nodes(stage, "line"), nodes(stage, "text")
    assert lines._node.points.shape == (2, 2, 3)
    assert lines._node.thickness == pytest.approx(0.2)
    (label,) = labels._nodes
    assert len(label.text) == 200
    assert label.font_scene_height == pytest.approx(0.3)
    turned = Marker(kind="line", points=points, pose=Pose2D(0.0, 0.0, math.pi / 2), z=1.0)
    np.testing.assert_allclose(segments(turned)[0], [[0, 0, 1.1], [0, 1, 1.1]], atol=1e-6)


@pytest.mark.parametrize(
    "payload",
    [
        {"kind": "sphere", "pose": {"x": "NaN", "y": 0, "yaw": 0}},
        {"kind": "sphere", "pose": {"x": None, "y": 0, "yaw": 0}},
        {"kind": "sphere", "size": [1, 1]},
        {"kind": "sphere", "color": [2, 0, 0, 1]},
        {"kind": "pyramid"},
        {"kind": "line", "points": [[0, 0, None]]},
    ],
)
def test_nonsense_is_dropped_and_counted(stage: "Stage", payload: Any) -> None:
    stage.browse()
    key = topics.MARKER.key("trolley", "start", "0")
    stage.runtime.put(key, msgspec.json.encode(payload), "application/json")
    stage.runtime.run(0.3)
    assert number_drawn(stage) == 0
    assert stage.runtime.counters("viz")["markers/invalid"] == 1


def test_nan_in_a_marker_is_dropped(stage: "Stage") -> None:
    stage.browse()
    for marker in (
        Marker(kind="sphere", pose=Pose2D(math.nan, 0.0, 0.0)),
        Marker(kind="sphere", z=math.inf),
        Marker(kind="line", points=[(0.0, 0.0, 0.0), (math.nan, 0.0, 0.0)]),
        Marker(kind="sphere", size=(math.nan, 1.0, 1.0)),
    ):
        put(stage, marker)
    stage.runtime.run(0.3)
    assert number_drawn(stage) == 0
    assert stage.runtime.counters("viz")["markers/invalid"] == 4


def test_huge_and_empty_markers_harm_nothing(stage: "Stage") -> None:
    stage.browse()
    put(stage, Marker(kind="sphere", pose=Pose2D(1e300, 0.0, 0.0), size=(1e300, 0.0, -1.0)), "a")
    put(stage, Marker(kind="line", points=[(1e300, 0.0, 0.0)] * 3, size=(1e300, 0.0, 0.0)), "b")
    put(stage, Marker(kind="line", points=[(0.0, 0.0, 0.0)] * 6000), "c")
    put(stage, Marker(kind="icon", icon="../../etc/passwd", size=(0.0, 0.0, 0.0)), "d")
    stage.runtime.run(0.3)
    assert (
        "One marker is not drawn: there are too many of their kind, or they are too long."
        in layer(stage).notes
    )


def test_ten_thousand_markers(stage: "Stage") -> None:
    stage.browse()
    for i in range(10_000):
        pose = Pose2D(0.01 * i, 0.0, 0.0)
        put(stage, Marker(kind=SOLIDS[i % 4], pose=pose), str(i), f"ns{i // 1000}")
    stage.runtime.run(0.3)
    assert number_drawn(stage) == topics.MARKER.max_keys
    assert any("too many markers; the last ones" in one for one in layer(stage).notes)
    assert len(layer(stage)._nodes) == 4 * -(-1250 // 256)
    drawn = [one._node.batched_positions for kind in SOLIDS for one in nodes(stage, kind)]
    stage.runtime.run(0.3)
    after = [one._node.batched_positions for kind in SOLIDS for one in nodes(stage, kind)]
    assert len(drawn) == len(layer(stage)._nodes)
    assert all(one is other for one, other in zip(drawn, after, strict=True)), "not drawn again"
    stage.runtime.delete(topics.MARKER.key("trolley", "*", "*"))
    stage.runtime.run(0.3)
    assert layer(stage)._nodes == {}
    assert layer(stage).notes == []


def test_too_many_of_a_kind_wait_until_others_go() -> None:
    grouping = Grouping()
    known: dict[Name, Marker] = {("a", str(i)): Marker(kind="icon") for i in range(450)}
    grouping.take_over(known, lambda _: 0)
    assert len(grouping.left_out) == 50
    for i in range(60):
        del known["a", str(i)]
    grouping.take_over(known, lambda _: 0)
    assert len(grouping.left_out) == 0
    assert sum(map(len, grouping.members.values())) == 390


def test_the_points_of_all_lines_are_bounded() -> None:
    grouping = Grouping()
    line = Marker(kind="line", points=[(0.0, 0.0, 0.0)] * 5000)
    grouping.take_over({("a", str(i)): line for i in range(30)}, lambda _: 0)
    assert len(grouping.left_out) == 10
    grouping.take_over({}, lambda _: 0)
    grouping.take_over({("a", "0"): line}, lambda _: 0)
    assert len(grouping.left_out) == 0


def test_frames_of_strangers_are_bounded_and_so_is_what_moves() -> None:
    grouping = Grouping()
    known: dict[Name, Marker] = {
        ("a", str(i)): Marker(kind="cube", frame=f"f{i}") for i in range(100)
    }
    grouping.take_over(known, lambda _: 0)
    assert len(grouping.members) == 60
    known = {("a", str(i)): Marker(kind="cube", motion="jump") for i in range(300)}
    grouping.take_over(known, lambda _: 0)
    moving = [len(m) for g, m in grouping.members.items() if g.sort == "moving cube"]
    assert moving == [MAX_MOVING]


class NotedScene:
    """A scene that notes the names of its nodes."""

    def __init__(self) -> None:
        self.names: list[str] = []
        self.there: set[str] = set()

    def add(self, name: str, *_: object, **__: object) -> Any:
        assert name not in self.there
        self.names.append(name)
        self.there.add(name)
        node = SimpleNamespace(name=name, remove=lambda: self.there.discard(name))
        node.position, node.wxyz = np.zeros(3), np.zeros(4)
        return node

    add_glb = add_mesh_simple = add_batched_glb = add


def test_markers_that_come_and_go_have_ever_the_same_names(stage: "Stage") -> None:
    """viser keeps, and tells each new page, of every name that it was taken away."""
    stage.browse()
    names: set[str] = set()
    for _ in range(4):
        put(stage, Marker(kind="sphere", frame="map", lifetime=0.5))
        stage.runtime.run(0.4)
        names |= {node.name for node in layer(stage)._frames.values()}
        stage.runtime.run(0.6)
        assert layer(stage)._frames == {}
    assert len(names) == 1


def test_icons_whose_colour_changes_all_the_time_have_few_names() -> None:
    scene = NotedScene()
    icons = Icons(cast(Any, scene))
    for i in range(3 * MAX_PICTURES):
        colour = (i / 255.0, 0.0, 0.0, 1.0)
        icons.show([Icon("robot", colour, 0.2, (0.0, 0.0, 0.2))], np.array([1.0, 0.0, 0.0, 0.0]))
    assert len(scene.names) == 3 * MAX_PICTURES
    assert len(set(scene.names)) == 2 * MAX_PICTURES


def test_a_map_that_grows_has_few_names_and_none_that_was_just_taken_away() -> None:
    scene = NotedScene()
    drawn = DrawnMap(cast(Any, scene), "/map")
    model = MapModel(b"", None)
    for i in range(20):
        before, num_named = set(scene.there), len(scene.names)
        drawn.show(model, Pose2D.identity(), i * OLD_NS // 3)
        assert before.isdisjoint(scene.names[num_named:])
        drawn.update(i * OLD_NS // 3)
    assert len(set(scene.names)) == NUM_NAMES
