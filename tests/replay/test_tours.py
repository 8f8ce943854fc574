"""The demo's tour in lock-step: all services, simulated time, judged by the truth."""

from collections.abc import Callable

import msgspec
import pytest
from bench.harness.drives import CORRIDOR, ENTRANCE, KITCHEN, Drive, drive_tour, simulated
from bench.harness.paths import WORLDS
from bench.localizer.mirror import MIRROR, ON_MIRROR_M, Ear, from_mirror_m

from trolley.geometry import Pose2D
from trolley.runtime.lockstep import Lockstep
from trolley_base.service import BaseService
from trolley_base.simulation.simulated_hardware import SimulatedChassis
from trolley_base.world.faulty_wheels import BOTH, Trouble

START = Pose2D(0.549, 0.218, 0.2579)
STOPS = {"corridor": CORRIDOR, "entrance": ENTRANCE, "kitchen": KITCHEN}


def drive(
    seed: int,
    without_zones: tuple[str, ...] = (),
    on_ready: Callable[[Lockstep], None] | None = None,
    world: str = "apartment.toml",
) -> Drive:
    config = simulated(WORLDS / world, WORLDS / "apartment.yaml", START, seed)
    return drive_tour(config, seed, STOPS, without_zones=without_zones, on_ready=on_ready)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(100, 105))
def test_tour_arrives_past_mirror_and_obstacles(seed: int) -> None:
    ears: list[Ear] = []
    found = drive(seed, on_ready=lambda lockstep: ears.append(Ear(lockstep)))
    assert ears[0].lines == [], "a mirror with its zone is not suspected"
    assert found.arrived, found.why
    assert found.collisions == 0
    assert found.closest > 0.05
    assert found.localized_s is not None
    assert found.localized_s < 10.0
    assert found.position_errors.max() < 0.10


@pytest.mark.parametrize(
    "seed", [100, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(101, 105))]
)
def test_tour_arrives_with_real_motors_lidar_floor_and_people(seed: int) -> None:
    found = drive(seed, world="real.toml")
    assert found.arrived, found.why
    assert found.collisions == 0
    assert found.position_errors.max() < 0.15


@pytest.mark.parametrize(
    "seed", [101, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (100, 102, 103))]
)
def test_tour_arrives_without_encoders(seed: int) -> None:
    config = simulated(WORLDS / "real.toml", WORLDS / "apartment.yaml", START, seed)
    odometry = msgspec.structs.replace(config.base.odometry, source="lidar")
    base = msgspec.structs.replace(config.base, odometry=odometry)
    config = msgspec.structs.replace(config, base=base)

    def cut_encoders(lockstep: Lockstep) -> None:
        service = lockstep.nodes["base"].service
        assert isinstance(service, BaseService)
        chassis = service.hardware.chassis
        assert isinstance(chassis, SimulatedChassis)
        chassis.wheels.trouble = Trouble(stuck_encoders=BOTH)

    found = drive_tour(config, seed, STOPS, on_ready=cut_encoders)
    assert found.arrived, found.why
    assert found.collisions == 0
    assert found.position_errors.max() < 0.15


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(100, 103))
def test_unmarked_mirror_causes_no_collision_and_no_hang(seed: int) -> None:
    found = drive(seed, without_zones=("hall mirror",))
    assert found.collisions == 0
    assert found.state != "hung"
    assert found.arrived or found.why


def test_unmarked_mirror_is_suspected_and_nothing_else() -> None:
    ears: list[Ear] = []
    found = drive(3, (MIRROR,), lambda lockstep: ears.append(Ear(lockstep)))
    (ear,) = ears
    assert found.arrived, found.why
    assert ear.found_mirror
    assert max(from_mirror_m(point) for line in ear.lines for point in line) <= ON_MIRROR_M
    assert 0.0 < ear.left_out < 0.1
    assert found.position_errors.max() < 0.10


@pytest.mark.slow
def test_same_seed_gives_the_same_drive() -> None:
    config = simulated(WORLDS / "real.toml", WORLDS / "apartment.yaml", START, 7)
    first, second = (drive_tour(config, 7, {"corridor": CORRIDOR}) for _ in range(2))
    assert first.seconds > 5.0, "it did drive"
    assert first.seconds == second.seconds
    assert first.closest == second.closest
    assert first.position_errors.tolist() == second.position_errors.tolist()
