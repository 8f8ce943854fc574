"""Exploring before a mirror that nobody marked, with all services in lock-step."""

from pathlib import Path

import numpy as np
import pytest
from bench.harness.drives import make_config
from bench.mapper.exploring import explore

from trolley import requests, topics
from trolley.geometry import Pose2D
from trolley.gridmap import FREE, OCCUPIED, GridMap, save_map
from trolley.messages import Zone
from trolley.messages.request_params import MapNamed, SaveMap
from trolley.runtime.lockstep import Lockstep
from trolley_base.service import BaseService
from trolley_localizer.service import LocalizerService
from trolley_mapper.service import MapperService
from trolley_planner.service import PlannerService

START = Pose2D(1.0, 1.1, 0.0)
MIRROR_X = 4.58


@pytest.fixture
def world(tmp_path: Path) -> Path:
    """A hall that ends in a mirror."""
    cells = np.full((44, 94), OCCUPIED, np.int8)
    cells[2:-2, 2:-2] = FREE
    cells[2:12, 30:44] = OCCUPIED
    save_map(GridMap("hall", 0.05, Pose2D.identity(), cells), tmp_path / "hall.yaml")
    world = tmp_path / "hall.toml"
    world.write_text(
        'map = "hall.yaml"\nstart = { x = 1.0, y = 1.1, yaw = 0.0 }\n'
        f'[[mirror]]\nname = "end"\npoints = [[{MIRROR_X}, 0.12], [{MIRROR_X}, 2.08]]\n'
        'side = "left"\n'
    )
    return world


def test_the_robot_stays_away_from_a_mirror_in_which_it_sees_itself(world: Path) -> None:
    outcome = explore(world, world.with_suffix(".yaml"), START, 1)
    assert outcome.state == "done"
    assert outcome.collisions == 0


def test_a_mirror_found_while_exploring_is_suspected_until_somebody_draws_it(world: Path) -> None:
    rest = f'[base.simulated]\nworld = "{world}"\nseed = 1\n'
    config = make_config(world.with_suffix(".yaml"), START, rest)
    with Lockstep(config.robot.name, 1) as bus:
        said, suspects = bus.record(topics.MAPPING), bus.record(topics.SUSPECTS)
        for service in (BaseService, PlannerService, MapperService, LocalizerService):
            bus.add(service(config))
        bus.run(2.0)
        bus.ask(requests.MAP_NEW, MapNamed(name="new", explore=True))
        bus.run_until(lambda: said[-1].exploring in ("done", "paused"), 300.0)
        (seen,) = suspects[-1].lines
        # x is 0 on the map where the robot began.
        assert [x for x, _ in seen.points] == pytest.approx([MIRROR_X - START.x] * 2, abs=0.25)
        bus.ask(requests.MAP_SAVE, SaveMap())
        bus.run_until(lambda: said[-1].state == "idle", 30.0)
        bus.run(2.0)
        (line,) = suspects[-1].lines
        assert [x for x, _ in line.points] == pytest.approx([MIRROR_X - START.x] * 2, abs=0.25)
        bus.ask(requests.ZONES_PUT, Zone(name="end", kind="mirror", points=line.points))
        bus.run(1.0)
        assert suspects[-1].lines == []
