"""The robot in its world: contacts, people, other robots, and that a seed fixes everything."""

import math
from typing import TYPE_CHECKING

import numpy as np
import pytest

from trolley.geometry import Pose2D, Twist2D
from trolley_base.world import OtherRobot, RobotBody, Simulation, WorldError
from trolley_base.world.body import move_into
from trolley_base.world.gaps import outline_to_point, place_outline_into
from trolley_base.world.scanner import cast_beams_into
from trolley_base.world.warmup import warm_up
from trolley_base.world.world_file import load_world

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    MakeSimulation = Callable[..., Simulation]

FORWARD, BACK = Twist2D(0.3, 0.0, 0.0), Twist2D(-0.3, 0.0, 0.0)
FOOTPRINT = np.array([[0.15, -0.12], [0.15, 0.12], [-0.15, 0.12], [-0.15, -0.12]])


def drive(simulation: Simulation, command: Twist2D, seconds: float) -> None:
    for _ in range(round(seconds * 100)):
        simulation.step(command)


def test_an_arc_is_driven_exactly(simulate: "MakeSimulation") -> None:
    simulation = simulate()
    drive(simulation, Twist2D(0.3, 0.0, 0.6), 1.0)
    start = simulation.truth().pose
    drive(simulation, Twist2D(0.3, 0.0, 0.6), 2.0 * math.pi / 0.6)
    end = simulation.truth().pose
    # 2 pi / 0.6 s is no whole number of steps: 2 mm are left to the full circle.
    assert start.distance_to(end) < 0.004
    assert simulation.truth().twist == Twist2D(0.3, 0.0, 0.6)


def test_a_wall_stops_the_robot_and_is_one_collision(simulate: "MakeSimulation") -> None:
    simulation = simulate()
    drive(simulation, FORWARD, 12.0)
    truth = simulation.truth()
    assert truth.pose.x == pytest.approx(3.0 - 0.15, abs=0.001)
    assert truth.twist.is_zero
    assert (truth.collisions, truth.bumps) == (1, 0)
    contact = simulation.contacts[0]
    assert (contact.name, contact.is_collision) == ("map", True)
    assert contact.speed == pytest.approx(0.3)


def test_a_contact_counts_again_after_it_has_ended(simulate: "MakeSimulation") -> None:
    simulation = simulate()
    drive(simulation, FORWARD, 12.0)
    drive(simulation, BACK, 1.0)
    assert simulation.truth().clearance > 0.1
    drive(simulation, FORWARD, 3.0)
    assert simulation.truth().collisions == 2


def test_wheels_that_push_against_a_wall_spin(simulate: "MakeSimulation") -> None:
    simulation = simulate()
    drive(simulation, FORWARD, 20.0)
    assert simulation.take_motion().previous_T_base.x > 5.5


def test_creeping_against_a_wall_is_a_bump(simulate: "MakeSimulation") -> None:
    simulation = simulate(start=Pose2D(2.8, 0.0, 0.0))
    drive(simulation, Twist2D(0.015, 0.0, 0.0), 10.0)
    truth = simulation.truth()
    assert (truth.collisions, truth.bumps) == (0, 1)
    drive(simulation, FORWARD, 1.0)
    assert (simulation.truth().collisions, simulation.truth().bumps) == (1, 1)


def test_turning_into_a_wall_is_a_collision(simulate: "MakeSimulation") -> None:
    simulation = simulate(start=Pose2D(2.84, 0.0, 0.0))
    drive(simulation, Twist2D(0.0, 0.0, 1.0), 2.0)
    assert simulation.truth().collisions == 1
    assert simulation.truth().pose.yaw < 0.3


@pytest.mark.parametrize(
    "thing",
    [
        "[[box]]\nx = 1.0\ny = 0.0\nlength_m = 0.2\nwidth_m = 0.2\nname = 'it'",
        "[[circle]]\nx = 1.0\ny = 0.0\nradius_m = 0.1\nname = 'it'",
        "[[mirror]]\npoints = [[0.9, -1.0], [0.9, 1.0]]\nname = 'it'",
        "[[glass]]\npoints = [[0.9, -1.0], [0.9, 1.0]]\nname = 'it'",
        "[[person]]\npath = [[1.0, 0.0]]\nradius_m = 0.1\nname = 'it'",
    ],
)
def test_nothing_solid_lets_the_robot_through(simulate: "MakeSimulation", thing: str) -> None:
    simulation = simulate(thing)
    assert simulation.truth().clearance == pytest.approx(0.75, abs=1e-9)
    drive(simulation, FORWARD, 6.0)
    assert simulation.truth().pose.x == pytest.approx(0.75, abs=0.001)
    assert [(c.name, c.is_collision) for c in simulation.contacts] == [("it", True)]


@pytest.mark.drives
def test_no_driving_gets_the_robot_into_a_wall_or_stuck(simulate: "MakeSimulation") -> None:
    boxes = "".join(
        f"[[box]]\nx = {x}\ny = {y}\nyaw = {x}\nlength_m = 0.4\nwidth_m = 0.3\n"
        for x, y in ((1.0, 0.5), (-1.0, -0.7), (1.5, -1.2), (-1.8, 1.0))
    )
    simulation = simulate(boxes, errors="")
    rng = np.random.default_rng(3)
    way, last = 0.0, simulation.truth().pose
    for _ in range(300):
        command = Twist2D(float(rng.uniform(-0.5, 0.5)), 0.0, float(rng.uniform(-2, 2)))
        for _ in range(50):
            simulation.step(command)
            assert simulation.truth().clearance > 0.0
        pose = simulation.truth().pose
        way, last = way + pose.distance_to(last), pose
        assert abs(pose.x) < 3.0
        assert abs(pose.y) < 2.0
    assert way > 10.0
    assert simulation.truth().collisions > 3


def test_a_person_who_walks_into_the_standing_robot_is_no_collision(
    simulate: "MakeSimulation",
) -> None:
    person = (
        "[[person]]\npath = [[2.0, 0.0], [-2.0, 0.0]]\nstarts_s = 0.0\nstops_for_robot_m = 0.0\n"
        "patience_s = 1.0\nradius_m = 0.2\n"
    )
    simulation = simulate(person)
    drive(simulation, Twist2D.zero(), 3.0)
    truth = simulation.truth()
    assert (truth.collisions, truth.bumps) == (0, 1)
    assert 0.0 <= truth.clearance < 0.01
    drive(simulation, Twist2D.zero(), 2.0)
    assert simulation.truth().clearance > 0.5, "who has waited long enough turns round"


def test_a_person_stops_for_the_robot(simulate: "MakeSimulation") -> None:
    simulation = simulate("[[person]]\npath = [[2.0, 0.0], [-2.0, 0.0]]\nstarts_s = 0.0\n")
    nearest = 10.0
    for _ in range(600):
        simulation.step(Twist2D.zero())
        nearest = min(nearest, simulation.truth().clearance)
    assert nearest == pytest.approx(0.35, abs=0.01)
    assert simulation.truth().bumps == 0


def test_another_robot_is_seen_and_met(simulate: "MakeSimulation") -> None:
    simulation = simulate()
    simulation.set_others([OtherRobot("rover", Pose2D(1.0, 0, 0).transform_points(FOOTPRINT))])
    drive(simulation, Twist2D.zero(), 0.1)
    ahead = simulation.take_scans()[0].ranges[180]
    assert ahead == pytest.approx(0.85, abs=0.001)
    drive(simulation, FORWARD, 4.0)
    assert [contact.name for contact in simulation.contacts] == ["rover"]
    simulation.set_others([])
    drive(simulation, FORWARD, 2.0)
    assert simulation.truth().pose.x > 1.0


def test_a_robot_that_drives_into_this_one_is_its_collision(simulate: "MakeSimulation") -> None:
    simulation = simulate()
    for step in range(100):
        x = max(0.25, 1.0 - 0.01 * step)
        outline = Pose2D(x, 0.0, 0.0).transform_points(FOOTPRINT)
        simulation.set_others([OtherRobot("rover", outline)])
        simulation.step(Twist2D.zero())
    assert (simulation.truth().collisions, simulation.truth().bumps) == (0, 1)
    drive(simulation, BACK, 1.0)
    assert simulation.truth().pose.x < -0.1, "it can leave an overlap"
    assert simulation.truth().collisions == 0


def test_the_robot_does_not_start_in_a_wall(simulate: "MakeSimulation") -> None:
    with pytest.raises(WorldError, match="map"):
        simulate(start=Pose2D(2.95, 0.0, 0.0))
    with pytest.raises(WorldError, match="crate"):
        simulate("[[box]]\nname = 'crate'\nx = 0\ny = 0\nlength_m = 0.1\nwidth_m = 0.1\n")


@pytest.mark.parametrize("name", ["apartment", "office", "room"])
def test_the_same_seed_gives_the_same_bytes(worlds: "Path", name: str) -> None:
    world = load_world(worlds / f"{name}.toml")

    def run(seed: int) -> bytes:
        robot = RobotBody(FOOTPRINT, Pose2D(0.05, 0.0, 0.0))
        simulation = Simulation(world.spec, world.grid, robot, seed)
        seen = b""
        for step in range(300):
            simulation.step(Twist2D(0.2, 0.0, math.sin(0.03 * step)))
            seen += b"".join(scan.ranges.tobytes() for scan in simulation.take_scans())
        truth, motion = simulation.truth(), simulation.take_motion().previous_T_base
        return seen + truth.pose.as_array().tobytes() + motion.as_array().tobytes()

    assert run(7) == run(7)
    assert run(7) != run(8)


def test_warming_up_leaves_nothing_to_compile(simulate: "MakeSimulation") -> None:
    warm_up()
    kernels = (move_into, cast_beams_into, place_outline_into, outline_to_point)
    compiled = [len(kernel.signatures) for kernel in kernels]  # pyrefly: ignore[missing-attribute]
    simulation = simulate("[[person]]\npath = [[1.0, 1.0], [2.0, 1.0]]\n")
    simulation.set_others([OtherRobot("rover", Pose2D(1.0, 0, 0).transform_points(FOOTPRINT))])
    drive(simulation, FORWARD, 0.5)
    assert [len(kernel.signatures) for kernel in kernels] == compiled  # pyrefly: ignore[missing-attribute]


@pytest.mark.parametrize("thing", ["box", "circle"])
def test_what_no_beam_meets_is_solid_nevertheless(simulate: "MakeSimulation", thing: str) -> None:
    size = "length_m = 0.2\nwidth_m = 0.2" if thing == "box" else "radius_m = 0.1"
    text = f"[[{thing}]]\nx = 1.0\ny = 0.0\n{size}\nname = 'it'\nseen = false"
    simulation = simulate(text + "\n[[circle]]\nx = -1.0\ny = 0.0\nradius_m = 0.1\nname = 'seen'")
    drive(simulation, FORWARD, 0.2)
    ranges = simulation.take_scans()[0].ranges
    assert ranges[len(ranges) // 2] == pytest.approx(3.0, abs=0.05), "it looks past it"
    assert ranges[0] == pytest.approx(0.9, abs=0.05)
    drive(simulation, FORWARD, 6.0)
    assert [(c.name, c.is_collision) for c in simulation.contacts] == [("it", True)]


def test_a_dull_surface_gives_echoes_only_where_beams_meet_it_squarely(
    simulate: "MakeSimulation",
) -> None:
    text = "[[dull]]\npoints = [[1.0, -1.5], [1.0, 1.5]]\necho_share = 0.0\necho_within = 0.2"
    simulation = simulate(text)
    drive(simulation, Twist2D.zero(), 0.2)
    scan = simulation.take_scans()[0]
    angles = scan.angle_min + np.arange(len(scan.ranges)) * scan.angle_increment
    on_it = np.abs(angles) < 0.9
    assert np.all(np.isfinite(scan.ranges[np.abs(angles) < 0.19]))
    assert np.all(np.isinf(scan.ranges[on_it & (np.abs(angles) > 0.21)]))
    drive(simulation, FORWARD, 6.0)
    assert simulation.truth().collisions == 1


def test_on_a_rug_the_robot_comes_less_far_than_its_wheels_say(simulate: "MakeSimulation") -> None:
    rug = "[[rug]]\nx = 0.0\ny = 0.0\nlength_m = 5.0\nwidth_m = 3.0\nslip = 0.2\npull_per_m = 0.0"
    simulation = simulate(rug)
    drive(simulation, FORWARD, 5.0)
    reported = simulation.take_motion().previous_T_base.x
    assert simulation.truth().pose.x == pytest.approx(0.8 * reported)
