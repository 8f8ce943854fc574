"""What engineers see: layers with ages, the frame tree, services, certainty and truth."""

from typing import TYPE_CHECKING

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.pages import PageOf, page_of

from trolley import topics
from trolley.geometry import Pose2D, Twist2D
from trolley.geometry.frames import FrameTree
from trolley.messages import (
    Health,
    OccupancyGrid,
    ParticleCloud,
    PoseEstimate,
    Truth,
    floats_to_bytes,
)
from trolley_viz.features.diagnosis.frames import tree
from trolley_viz.features.diagnosis.streams import service_line
from trolley_viz.graphics.glb import floor_glb
from trolley_viz.graphics.shapes import CHI2_95, ellipse
from trolley_viz.scene.pose_accuracy import pose_error
from trolley_viz.tabs.more_tab import position_rows
from trolley_viz.words.sentences import age_text

from ..conftest import transform

if TYPE_CHECKING:
    from ..conftest import Stage

POSE = Pose2D(1.5, 0.0, 0.0)


def truth(stamp_ns: int, pose: Pose2D) -> Truth:
    still = Twist2D(0.0, 0.0, 0.0)
    return Truth(
        stamp_ns=stamp_ns, world="room", pose=pose, twist=still, collisions=0, clearance=1.0
    )


def estimate(stamp_ns: int, pose: Pose2D = POSE) -> PoseEstimate:
    covariance = [0.01, 0.0, 0.0, 0.0, 0.04, 0.0, 0.0, 0.0, 0.0003]
    return PoseEstimate(
        stamp_ns=stamp_ns,
        map="room",
        pose=pose,
        covariance=covariance,
        state="localized",
        match=0.93,
        spread=0.05,
    )


@given(st.floats(0.0, 2.0), st.floats(0.0, 2.0), st.floats(-3.0, 3.0))
def test_the_ellipse_is_where_the_squared_distance_is_its_bound(
    a: float, b: float, turn: float
) -> None:
    axes = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    spread = axes @ np.diag([(a + 0.01) ** 2, (b + 0.01) ** 2]) @ axes.T
    points = ellipse(spread, 0.0)
    distances = np.einsum("ni,ij,nj->n", points, np.linalg.inv(spread), points)
    np.testing.assert_allclose(distances, CHI2_95, rtol=1e-6)


def test_an_ellipse_without_extent_can_still_be_seen() -> None:
    for spread in (np.zeros((2, 2)), np.diag([-1e-9, 0.0])):
        np.testing.assert_allclose(np.hypot(*ellipse(spread, 0.005).T), 0.005)


def test_the_error_is_taken_at_the_time_of_the_estimate() -> None:
    truths = [truth(0, Pose2D(1.0, 0.0, 3.1)), truth(100, Pose2D(1.2, 0.0, -3.1))]
    found = pose_error(estimate(50, Pose2D(1.1, 0.03, 3.14159265)), truths)
    assert found is not None
    assert found.text == "3 cm, 0.0°"
    assert pose_error(estimate(150), truths) is None
    assert pose_error(estimate(50), truths[:1]) is None


def test_the_tree_lists_children_below_their_parents() -> None:
    frames = FrameTree()
    for parent, child in (("odom", "base_link"), ("map", "odom"), ("base_link", "laser")):
        frames.set(parent, child, POSE, 1)
    frames.set("base_link", "camera", POSE)
    frames.set("lost", "found", POSE)
    assert [(one.depth, one.frame) for one in tree(frames)] == [
        (0, "lost"),
        (1, "found"),
        (0, "map"),
        (1, "odom"),
        (2, "base_link"),
        (3, "camera"),
        (3, "laser"),
    ]


@pytest.mark.parametrize(
    ("age_s", "words"),
    [(None, "no data"), (0.3, "now"), (1.6, "2 s"), (59.7, "60 s"), (200.0, "3 min")],
)
def test_ages_are_coarse(age_s: float | None, words: str) -> None:
    assert age_text(age_s) == words


def test_a_service_that_is_silent_is_said_to_be() -> None:
    health = Health(stamp_ns=0, state="ok", message="Fine.", cpu=0.05, rss=50 << 20)
    said = service_line("tour", health, 0.5)
    assert (said.headline, said.detail) == ("tour: ok", "Fine. 5 % of a core, 50 MB")
    assert service_line("tour", health, 12.0).headline == "tour: silent"


def later(stage: "Stage") -> PageOf:
    """The tab, brought up to date."""
    stage.runtime.run(2.0)
    return page_of(stage).within("More")


def test_layers_tell_how_old_they_are(stage: "Stage") -> None:
    stage.browse()
    stage.session.preferences.switch_layer("costmap", is_on=True)
    page = later(stage)
    assert page.is_shown("Laser scan · now")
    assert page.is_shown("Costmap near the robot · no data")
    assert page.is_shown("Costmap of the whole map")  # off: nothing is known of it
    assert not any("truth" in label.casefold() for label in page.labels)  # the robot is a real one
    stage.runtime.kill("base")
    stage.runtime.run(5.4)
    assert page.is_shown("Laser scan · 5 s")


def test_layers_are_switched_and_the_look_too(stage: "Stage") -> None:
    stage.browse()
    page = later(stage)
    page.tick("Laser scan · now", is_on=False)
    page.choose("Look", "dark")
    stage.runtime.run(2.0)
    assert not page.value("Laser scan")
    assert not stage.session.preferences.layers["scan"]
    assert stage.session.preferences.choices.dark


def test_frames_are_switched_one_by_one(stage: "Stage") -> None:
    stage.browse()
    page = later(stage).within("Frames")
    assert page.labels == ["map", "odom", "base_link", "laser"]
    assert "base_link odom" in page.text()
    page.tick("laser")
    stage.runtime.run(1.2)
    axes = stage.drawn()._axes._axes
    assert list(axes) == ["laser"]
    assert axes["laser"].position[:2] == pytest.approx([1.6, 0.0])
    page.tick("laser", is_on=False)
    stage.runtime.run(0.2)
    assert axes == {}
    assert stage.session.preferences.choices.layers == {}


def test_the_missing_link_is_named(stage: "Stage") -> None:
    stage.browse()
    lone = transform("nowhere", "camera", POSE)
    stage.runtime.put(
        topics.TF.key("trolley", "camera"), msgspec.json.encode(lone), "application/json"
    )
    said = later(stage).within("Frames").text()
    assert "Missing: tf/nowhere." in said
    assert "tf/laser" not in said


def test_services_and_rates_are_listed(stage: "Stage") -> None:
    stage.browse()
    stage.runtime.run(4.0)
    said = later(stage).within("Services and streams").text()
    assert "base: ok" in said
    assert "scan 10.0 Hz" in said


def test_match_particles_and_error_are_numbers(stage: "Stage") -> None:
    stage.browse()
    poses = floats_to_bytes(np.zeros((400, 3)))
    cloud = ParticleCloud(stamp_ns=0, poses=poses, weights=floats_to_bytes(np.ones(400)))
    stage.robot.publish(topics.PARTICLES, cloud)
    stage.runtime.run(0.2)
    rows = {what: text for what, text in position_rows(stage.session.view)}  # noqa: C416 - pairs
    assert rows["match"] == "93 %, localized"
    assert rows["particles"] == "400 particles, spread 0.05 m"
    assert rows["age"] == "now"


def test_particles_of_the_map_before_are_gone_while_a_map_is_made(stage: "Stage") -> None:
    stage.browse()
    poses = floats_to_bytes(np.zeros((400, 3)))
    cloud = ParticleCloud(stamp_ns=0, poses=poses, weights=floats_to_bytes(np.ones(400)))
    stage.robot.publish(topics.PARTICLES, cloud)
    stage.runtime.run(1.0)
    arrows = stage.layer("particles")._arrows
    assert arrows.visible
    stage.robot.pose_state = "mapping"
    stage.runtime.run(1.0)
    assert not arrows.visible


def test_ellipse_and_truth_are_drawn(stage: "Stage") -> None:
    stage.browse()
    for key in ("covariance", "truth"):
        stage.session.preferences.switch_layer(key, is_on=True)
    stage.runtime.run(0.2)
    now_ns = stage.robot.monotonic_ns
    for i in range(3):
        pose = Pose2D(1.5, 0.02, 0.0)
        stage.robot.publish(topics.SIM_TRUTH, truth(now_ns + i * 50_000_000 - 50_000_000, pose))
    stage.robot.publish(topics.POSE, estimate(now_ns))
    stage.runtime.run(0.06)
    layer = stage.layer("truth")
    assert layer._frame.visible
    assert layer._label.text == "off by 2 cm, 0.0°"
    stage.runtime.run(3.0)
    assert not layer._frame.visible  # no truth comes any more


def test_the_costmap_of_the_map_is_a_layer_of_its_own(stage: "Stage") -> None:
    stage.browse()
    stage.session.preferences.switch_layer("costmap_global", is_on=True)
    stage.runtime.run(0.2)
    assert "costmap/global" in stage.streams()
    assert "costmap" not in stage.streams()
    grid = OccupancyGrid(
        stamp_ns=stage.robot.monotonic_ns,
        name="room",
        frame="map",
        resolution=0.1,
        width=60,
        height=40,
        origin=Pose2D(-3.0, -2.0, 0.0),
        cells=memoryview(bytes(2400)),
    )
    stage.robot.publish(topics.COSTMAP_GLOBAL, grid)
    stage.runtime.run(1.5)
    assert stage.layer("costmap_global")._node.visible
    assert stage.layer("costmap")._node is None


def test_a_mesh_takes_the_place_of_the_body(stage: "Stage") -> None:
    stage.browse()
    layer = stage.layer("robot")
    assert layer._body is not None
    robot = stage.hub.robots.get("trolley")
    assert robot is not None
    mesh = floor_glb(np.zeros((2, 2, 3), np.uint8), 0.4, 0.4)
    stage.robot.publish(topics.ROBOT, msgspec.structs.replace(robot, mesh=mesh))
    stage.runtime.run(0.5)
    assert layer._body is None
    assert [type(part).__name__ for part in layer._parts] == ["LineSegmentsHandle", "GlbHandle"]
