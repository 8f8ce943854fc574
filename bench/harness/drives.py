"""Whole drives in lock-step: all services on a simulated robot, compared with the truth.

The programs beside this file and the tests use it.
"""

import dataclasses
import math
import tempfile
from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

from trolley import codes, requests, topics
from trolley.config import RobotConfig, load_config
from trolley.geometry import Pose2D
from trolley.messages import PoseEstimate, StopResult, Tour, TourStatus, Truth
from trolley.messages.request_params import Named, StartTour
from trolley.messages.touring import Stop
from trolley.runtime.lockstep import Lockstep
from trolley_base.service import BaseService
from trolley_localizer.service import LocalizerService
from trolley_planner.service import PlannerService
from trolley_tour.service import TourService

CORRIDOR = Pose2D(5.315, 1.366, 2.0 * math.atan2(-0.49845, 0.86692))
ENTRANCE = Pose2D(5.775, -1.246, 2.0 * math.atan2(-0.95949, 0.28175))
KITCHEN = Pose2D(2.149, -2.706, 2.0 * math.atan2(-0.99147, 0.13033))
TRIP_ENDED = ("done", "failed", "stopped")

_ROBOT_TOML = """
[robot]
name = "trolley"
footprint = {{ length_m = 0.30, width_m = 0.24 }}
[map]
file = "{map}"
[start]
pose = {{ x = {x}, y = {y}, yaw = {yaw} }}
{rest}
"""


@dataclasses.dataclass(frozen=True)
class Drive:
    """The outcome of a trip."""

    seed: int
    state: str
    """The trip's last state, `hung` where it did not end in time."""
    results: list[StopResult]
    seconds: float
    """Simulated seconds from the start of the trip to its end."""
    localized_s: float | None
    """Simulated seconds until first localized."""
    collisions: int
    closest: float
    """Smallest distance between footprint and anything solid [m]."""
    position_errors: NDArray[np.float64]
    """Distance of each estimate from the truth at its stamp [m]."""

    @property
    def arrived(self) -> bool:
        """Whether every stop was reached."""
        return self.state == "done" and all(one.state == "reached" for one in self.results)

    @property
    def why(self) -> str:
        """The codes of the stops that were not reached."""
        return ", ".join(f"{one.name or one.stop}: {one.code}" for one in self.results if one.code)


def make_config(map_file: Path, start: Pose2D, rest: str = "") -> RobotConfig:
    """A robot of 0.30 x 0.24 m that starts at `start` on the map; `rest` is more TOML."""
    text = _ROBOT_TOML.format(
        map=map_file.resolve(), x=start.x, y=start.y, yaw=start.yaw, rest=rest
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "robot.toml"
        path.write_text(text)
        return load_config(path)


def simulated(world: Path, map_file: Path, start: Pose2D, seed: int) -> RobotConfig:
    """A simulated robot in `world`."""
    rest = f'[base.simulated]\nworld = "{world.resolve()}"\nseed = {seed}\n'
    return make_config(map_file, start, rest)


def open_robot(config: RobotConfig, seed: int) -> Lockstep:
    """All services but the viewer, started in lock-step."""
    lockstep = Lockstep(config.robot.name, seed)
    for service in (BaseService, LocalizerService, PlannerService, TourService):
        lockstep.add(service(config))
    return lockstep


def drive_tour(
    config: RobotConfig,
    seed: int,
    stops: dict[str, Pose2D],
    limit_s: float = 400.0,
    without_zones: tuple[str, ...] = (),
    on_ready: Callable[[Lockstep], None] | None = None,
) -> Drive:
    """Start everything, wait for `localized`, drive the stops, and judge by `sim/truth`."""
    with open_robot(config, seed) as lockstep:
        truths, poses = lockstep.record(topics.SIM_TRUTH), lockstep.record(topics.POSE)
        statuses = lockstep.record(topics.TOUR)
        is_localized = lockstep.run_until(lambda: _is_localized(poses), 30.0)
        localized_s = lockstep.now_s if is_localized else None
        for name in without_zones:
            lockstep.ask(requests.ZONES_DELETE, Named(name=name))
        if on_ready is not None:
            on_ready(lockstep)
        started_s = lockstep.now_s
        tour = Tour(name="trip", stops=[Stop(pose=pose) for pose in stops.values()])
        try:
            lockstep.ask(requests.TOUR_START, StartTour(tour=tour))
        except codes.Refused as refused:
            return _judge(
                seed,
                f"refused: {refused.code}",
                [],
                lockstep,
                started_s,
                localized_s,
                truths,
                poses,
            )
        lockstep.run_until(lambda: _has_ended(statuses), limit_s)
        state = statuses[-1].state if _has_ended(statuses) else "hung"
        results = [
            msgspec.structs.replace(result, name=tuple(stops)[result.stop])
            for result in statuses[-1].results
        ]
        return _judge(seed, state, results, lockstep, started_s, localized_s, truths, poses)


def position_errors(truths: list[Truth], poses: list[PoseEstimate]) -> NDArray[np.float64]:
    """Distance of each known estimate from the truth at its stamp [m]."""
    stamps = np.array([truth.stamp_ns for truth in truths], dtype=np.float64)
    known = [
        pose for pose in poses if pose.pose is not None and stamps[0] <= pose.stamp_ns <= stamps[-1]
    ]
    at = np.array([pose.stamp_ns for pose in known], dtype=np.float64)
    x = np.interp(at, stamps, [truth.pose.x for truth in truths])
    y = np.interp(at, stamps, [truth.pose.y for truth in truths])
    found = np.array(
        [(pose.pose.x, pose.pose.y) for pose in known if pose.pose is not None]
    ).reshape(-1, 2)
    return np.hypot(found[:, 0] - x, found[:, 1] - y)


def _is_localized(poses: list[PoseEstimate]) -> bool:
    return bool(poses) and poses[-1].state == "localized"


def _has_ended(statuses: list[TourStatus]) -> bool:
    return bool(statuses) and statuses[-1].state in TRIP_ENDED


def _judge(
    seed: int,
    state: str,
    results: list[StopResult],
    lockstep: Lockstep,
    started_s: float,
    localized_s: float | None,
    truths: list[Truth],
    poses: list[PoseEstimate],
) -> Drive:
    return Drive(
        seed,
        state,
        results,
        lockstep.now_s - started_s,
        localized_s,
        collisions=truths[-1].collisions if truths else 0,
        closest=min((truth.clearance for truth in truths), default=math.inf),
        position_errors=position_errors(truths, poses),
    )
