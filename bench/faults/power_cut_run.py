"""Lets all services save all that they save: `power_cut.py` runs it under strace."""

import sys
from collections.abc import Callable
from itertools import count
from pathlib import Path

import numpy as np
from bench.faults.power_cut_readers import MAP, NEW_MAP, ROBOT
from bench.harness.drives import KITCHEN, simulated
from bench.harness.paths import WORLDS
from bench.harness.wandering import START

from trolley import requests, topics
from trolley.files import make_folder
from trolley.geometry import Pose2D
from trolley.gridmap import GridMap, save_map
from trolley.messages import SavedPose, Stop, Tour, Zone
from trolley.messages.request_params import LoadMap, Named, StartTour
from trolley.runtime.lockstep import Lockstep
from trolley.runtime.log import Log
from trolley.runtime.state import StateFolder
from trolley_base.service import BaseService
from trolley_localizer.service import LocalizerService
from trolley_planner.service import PlannerService
from trolley_tour.service import TourService
from trolley_viz.session.browser_choices import FILE, Choices, ViewerSettings

SQUARE = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0)]


def main() -> None:
    """Save everything, with a mark after each thing that is safe from then on."""
    state, marks = Path(sys.argv[1]), Path(sys.argv[2])
    numbers = count()
    config = simulated(WORLDS / "apartment.toml", WORLDS / "apartment.yaml", START, 3)
    lockstep = Lockstep(ROBOT, 3, state)

    def safe(act: Callable[[], object]) -> None:
        act()
        (marks / f"{next(numbers):04d}").mkdir()

    poses = lockstep.record(topics.POSE)
    for service in (BaseService, LocalizerService, PlannerService, TourService):
        safe(lambda service=service: lockstep.add(service(config)))
    safe(lambda: lockstep.run_until(lambda: bool(poses) and poses[-1].state == "localized", 20.0))
    for name in ("kitchen", "sofa"):
        place = SavedPose(name=name, map=MAP, pose=KITCHEN)
        safe(lambda place=place: lockstep.ask(requests.POSES_PUT, place))
    safe(lambda: lockstep.ask(requests.POSES_DELETE, Named(name="sofa")))
    tour = Tour(name="round", stops=[Stop(name="kitchen")])
    safe(lambda: lockstep.ask(requests.TOURS_PUT, tour))
    zone = Zone(name="stairs", kind="keepout", points=SQUARE)
    safe(lambda: lockstep.ask(requests.ZONES_PUT, zone))
    safe(lambda: lockstep.ask(requests.ZONES_DELETE, Named(name="stairs")))
    for request in (requests.BASE_STOP, requests.BASE_RESUME):
        safe(lambda request=request: lockstep.ask(request))
    for _ in range(3):
        safe(lambda: lockstep.ask(requests.TOUR_START, StartTour(name="round")))
        safe(lambda: lockstep.run(1.5))
        safe(lambda: lockstep.ask(requests.TOUR_STOP))
    safe(lambda: lockstep.ask(requests.MAP_LOAD, LoadMap(name=MAP)))
    lockstep.kill("base")
    safe(lambda: lockstep.add(BaseService(config)))
    safe(lambda: lockstep.run(2.5))
    viewer = StateFolder(state / ROBOT, Log("viz"))
    for is_dark in (False, True):
        settings = ViewerSettings(browsers={"tablet": Choices(dark=is_dark)})
        safe(lambda settings=settings: viewer.write(FILE, settings))
    maps = state / "maps"
    safe(lambda: make_folder(maps))
    grid = GridMap(NEW_MAP, 0.05, Pose2D.identity(), np.zeros((20, 30), np.int8))
    safe(lambda: save_map(grid, maps / f"{NEW_MAP}.yaml"))
    safe(lambda: lockstep.run(1.0))
    safe(lockstep.close)


if __name__ == "__main__":
    main()
