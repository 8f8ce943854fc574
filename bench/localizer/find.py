"""How well and how fast the localizer finds itself from nothing.

    TROLLEY_DATA=/path/to/recordings python -m bench.localizer.find [--scans 40] [--full]

Random scans of the recordings: the robot stands there and must find itself; where it is not sure,
it continues the drive for up to 2 m. An answer counts once it is `localized`; it is right within
0.3 m and 10 degrees. Then the time of a search in houses of 20 × 20 m and 60 × 60 m, one thread.
"""

import argparse
import dataclasses
import math
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from bench.harness.figures import Figure, at_least, at_most, recordings_folder, show
from bench.harness.houses import draw_house, free_poses, seen_from
from bench.harness.recorded import CREATE3, FREIBURG, MAPS, Recording, read_recording

from trolley.config.localizer import LocalizerConfig
from trolley.geometry import Pose2D, angle_difference
from trolley.gridmap import load_map
from trolley.scanning import ScanInput
from trolley_localizer.core import Localizer
from trolley_localizer.estimate import Estimate

RIGHT_M, RIGHT_RAD = 0.3, math.radians(10.0)
MORE_M = 2.0
# A standing robot has taken so many scans when it is asked for its answer.
STANDING_SCANS = 8
STANDING_PERIOD_NS = 100_000_000


@dataclass(frozen=True)
class Attempt:
    """One search."""

    best_is_right: bool
    """The best place of the first search is the right one, however sure the robot is of it."""
    listed: bool
    """The right place is among those that the first search came up with."""
    at_once: bool | None
    """Right, wrong or no answer, standing."""
    moving: bool | None
    """The same after up to `MORE_M` of the drive."""
    is_wrong: bool
    """At some time it said that it was localized, and was not."""
    search_s: float


class Trial:
    """A localizer that is told to find itself in a recorded drive, over and over."""

    def __init__(self, recording: Recording, map_file: Path) -> None:
        self._recording = recording
        self._localizer = Localizer(load_map(map_file), [], LocalizerConfig(), 0)
        self._way_m = recording.way_m()

    def begin_at(self, index: int) -> Attempt:
        """Find the robot at a scan, from nothing."""
        localizer, scan = self._localizer, self._recording.scan(index)
        localizer.search()
        localizer.restart_odometry()
        began_ns = scan.stamp_ns - STANDING_SCANS * STANDING_PERIOD_NS
        places: list[Pose2D] = []
        search_s = math.nan
        answer: Pose2D | None = None
        is_wrong = False
        for k in range(STANDING_SCANS):
            stamp_ns = began_ns + k * STANDING_PERIOD_NS
            answer = self._look(dataclasses.replace(scan, stamp_ns=stamp_ns))
            is_wrong = is_wrong or self._is_right(answer, index) is False
            job = localizer.take_job()
            if job is None:
                continue
            began_s = time.thread_time()
            job.run()
            if k == 0:
                search_s = time.thread_time() - began_s
                places = [localizer.field.to_map(place.pose) for place in job.places]
            localizer.finish(job)
        at_once = moving = self._is_right(answer, index)
        if at_once is None:
            moving = self._go_on(index)
        return Attempt(
            best_is_right=bool(places) and self._is_right(places[0], index) is True,
            listed=any(self._is_right(place, index) for place in places),
            at_once=at_once,
            moving=moving,
            is_wrong=is_wrong or moving is False,
            search_s=search_s,
        )

    def _go_on(self, begin: int) -> bool | None:
        """Drive on until there is an answer, and judge it."""
        for index in range(begin, len(self._way_m)):
            if self._way_m[index] > self._way_m[begin] + MORE_M:
                break
            answer = self._look(self._recording.scan(index))
            if answer is not None:
                return self._is_right(answer, index)
            job = self._localizer.take_job()
            if job is not None:
                self._localizer.finish(job.run())
        return None

    def _look(self, scan: ScanInput) -> Pose2D | None:
        """Take a scan; the pose if the robot is sure of it."""
        estimate = self._localizer.step(scan)
        assert isinstance(estimate, Estimate)
        return estimate.map_T_base if estimate.state == "localized" else None

    def _is_right(self, pose: Pose2D | None, index: int) -> bool | None:
        """Compare an answer with the truth; None without one."""
        if pose is None:
            return None
        true = self._recording.reference_at(index)
        turned = abs(angle_difference(pose.yaw, true.yaw))
        return pose.distance_to(true) <= RIGHT_M and turned <= RIGHT_RAD


def recorded_scans(folder: Path, fields: tuple[str, str, str], count: int) -> list[Attempt]:
    """Search from random scans of a recording."""
    recording = read_recording(folder, *fields)
    trial = Trial(recording, folder / MAPS[fields[0]])
    way_m = recording.way_m()
    last = int(np.searchsorted(way_m, way_m[-1] - MORE_M))
    chosen = np.random.default_rng(7).choice(last, count, replace=count > last)
    return [trial.begin_at(int(index)) for index in chosen]


def foreign_map(folder: Path, count: int) -> Figure:
    """Search in the map of another building: there is nothing to be sure of."""
    trial = Trial(read_recording(folder, *FREIBURG), folder / MAPS[CREATE3[0]])
    chosen = np.random.default_rng(8).choice(4000, count, replace=False)
    attempts = [trial.begin_at(int(index)) for index in chosen]
    sure = sum(one.at_once is not None or one.moving is not None for one in attempts)
    return at_most(f"freiburg's scans on create3's map, of {count}: sure", sure, 0, digits=0)


def report_scans(name: str, attempts: list[Attempt], at_once: float) -> None:
    """Print the shares of right answers."""

    def percent(hits: list[bool]) -> float:
        return 100.0 * sum(hits) / len(hits)

    times_ms = np.array([one.search_s for one in attempts]) * 1e3
    show(
        [
            Figure(f"{name}: scans", str(len(attempts))),
            Figure(
                f"{name}: best place of a search is right",
                f"{percent([one.best_is_right for one in attempts]):.1f} %",
            ),
            Figure(
                f"{name}: right place among those found",
                f"{percent([one.listed for one in attempts]):.1f} %",
            ),
            at_least(
                f"{name}: right at once",
                percent([one.at_once is True for one in attempts]),
                at_once,
                "%",
                1,
            ),
            at_least(
                f"{name}: right within {MORE_M:g} m",
                percent([one.moving is True for one in attempts]),
                95.0,
                "%",
                1,
            ),
            at_most(f"{name}: wrong but sure", sum(one.is_wrong for one in attempts), 0, digits=0),
            Figure(
                f"{name}: search, median and longest",
                f"{np.nanmedian(times_ms):.0f}, {np.nanmax(times_ms):.0f} ms",
            ),
        ]
    )


def search_house(size_m: float, limit_s: float, count: int) -> list[Figure]:
    """Time searches in a house, for lidars that see 8 m and 25 m far."""
    figures: list[Figure] = []
    grid = draw_house(size_m, 11)
    for reach_m in (8.0, 25.0):
        localizer = Localizer(grid, [], LocalizerConfig(), 0)
        poses = free_poses(grid, 0.3, count, np.random.default_rng(13))
        times: list[float] = []
        right = 0
        for k, pose in enumerate(poses):
            localizer.search()
            localizer.restart_odometry()
            ranges = seen_from(grid, pose, 360, reach_m)
            noise = 0.01 * np.random.default_rng(k).standard_normal(360)
            estimate = localizer.step(_still(k + 1, (ranges + noise).astype(np.float32), reach_m))
            assert isinstance(estimate, Estimate)
            job = localizer.take_job()
            assert job is not None, "a robot in a furnished house is not blind"
            began_s = time.thread_time()
            job.run()
            times.append(time.thread_time() - began_s)
            found = [localizer.field.to_map(place.pose) for place in job.places]
            right += bool(found) and found[0].distance_to(pose) <= RIGHT_M
            localizer.finish(job)
        name = f"{size_m:g} × {size_m:g} m, lidar of {reach_m:g} m"
        figures += [
            Figure(f"{name}: first search, with the pyramid", f"{times[0]:.2f} s"),
            Figure(f"{name}: median search", f"{np.median(times):.2f} s"),
            at_most(f"{name}: longest search", max(times), limit_s, "s", 2),
            Figure(f"{name}: best place is right", f"{right} of {count}"),
        ]
    return figures


def _still(number: int, ranges: np.ndarray, reach_m: float) -> ScanInput:
    """The scan of a robot that stands."""
    return ScanInput(
        stamp_ns=number * STANDING_PERIOD_NS,
        ranges=ranges,
        angle_min=-math.pi,
        angle_increment=2.0 * math.pi / ranges.size,
        range_min=0.1,
        range_max=reach_m,
        base_T_laser=Pose2D.identity(),
        odom_T_base=Pose2D.identity(),
        odom_T_base_end=Pose2D.identity(),
    )


def main() -> None:
    """Search everywhere and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scans", type=int, default=40)
    parser.add_argument("--full", action="store_true", help="200 scans of each recording")
    options = parser.parse_args()
    houses = 30 if options.full else 6
    show([*search_house(20.0, 1.0, houses), *search_house(60.0, 10.0, houses)])
    folder = recordings_folder()
    if folder is not None:
        count = 200 if options.full else options.scans
        report_scans("freiburg", recorded_scans(folder, FREIBURG, count), 70.0)
        report_scans("create3", recorded_scans(folder, CREATE3, count), 90.0)
        show([foreign_map(folder, count // 2)])


if __name__ == "__main__":
    main()
