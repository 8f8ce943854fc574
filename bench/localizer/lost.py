"""Does the localizer know when it is lost? Kidnappings and normal driving in the apartment.

    python -m bench.localizer.lost [--kidnappings 12] [--minutes 4] [--full]

All services in lock-step; the robot drives to random goals and may turn in place to find itself. A
kidnapping puts it where the map explains less than 60 % of what it sees from where it believes to
be: anywhere in the flat, up to 0.5 m and 60 degrees away (a slip), or anywhere with people about
and a third of the furniture moved since the map was made. Normal driving is with three people
about and a third of the furniture moved, other pieces for each drive; every time that the robot is
stopped by `lost` or `searching`, once it has known where it is, is a false alarm. Lost unnoticed:
an error over 0.5 m or 20 degrees for 2 s while `localized`.
"""

import argparse
import math
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from bench.harness.figures import Figure, at_least, at_most, show
from bench.harness.houses import free_poses
from bench.harness.wandering import IN_THE_WAY, Track, Wanderer, write_world

from trolley.geometry import Pose2D, angle_difference
from trolley.gridmap import FREE

RIGHT_M, RIGHT_RAD = 0.3, math.radians(10.0)
EXPLAINED_SHARE = 0.6
SLIP_M, SLIP_RAD = 0.5, math.radians(60.0)
NOTICE_S, RECOVER_S, UNNOTICED_S = 3.0, 60.0, 2.0
DRIVE_S = 300.0


@dataclass(frozen=True)
class Kidnapping:
    """The outcome of one; times count from the moment that the robot was moved."""

    doubted_s: float
    """Until it was not `localized` any more, or right again; infinite if never."""
    stopped_s: float
    """Until it was `lost` or `searching`, which stops the robot, or right again."""
    recovered_s: float
    """Until it was `localized` where it is; infinite if never."""
    fooled_s: float
    """How long at a time it was `localized` elsewhere after it had noticed."""


def kidnap(robot: Wanderer, place: Pose2D) -> Kidnapping:
    """Move the robot and see how it reacts."""
    began, began_s = len(robot.poses), robot.lockstep.now_s
    robot.lift(place)
    times: dict[str, float] = {}

    def look() -> bool:
        since_s = robot.lockstep.now_s - began_s
        state = robot.latest.state
        is_right = robot.is_known and _is_right(robot) and len(robot.poses) > began + 1
        if state != "localized" or is_right:
            times.setdefault("doubted", since_s)
        if state in ("lost", "searching") or is_right:
            times.setdefault("stopped", since_s)
        if is_right:
            times.setdefault("recovered", since_s)
        return "recovered" in times and since_s - times["recovered"] > UNNOTICED_S

    robot.run_until(look, RECOVER_S)
    stopped_s = times.get("stopped", math.inf)
    after = _later(robot.track(), robot.poses[began - 1].stamp_ns * 1e-9 + stopped_s)
    return Kidnapping(
        times.get("doubted", math.inf),
        stopped_s,
        times.get("recovered", math.inf),
        max(after.episodes(after.is_far & after.is_known), default=0.0),
    )


def _is_right(robot: Wanderer) -> bool:
    pose, true = robot.latest.pose, robot.true_pose
    if pose is None:
        return False
    turned = abs(angle_difference(pose.yaw, true.yaw))
    return pose.distance_to(true) <= RIGHT_M and turned <= RIGHT_RAD


def _later(track: Track, from_s: float) -> Track:
    chosen = track.stamps_s > from_s
    return Track(
        track.stamps_s[chosen],
        track.error_m[chosen],
        track.error_rad[chosen],
        track.states[chosen],
    )


def kidnappings(count: int, seed: int, is_slip: bool, is_moved: bool) -> list[Kidnapping]:
    """Kidnap a robot repeatedly, with people about where the furniture has been moved."""
    rng = np.random.default_rng(seed)
    found: list[Kidnapping] = []
    with tempfile.TemporaryDirectory() as folder:
        moved_seed = seed if is_moved else None
        robot = Wanderer(write_world(Path(folder), moved_seed=moved_seed, people=is_moved), seed)
        while len(found) < count:
            robot.run_until(lambda: robot.is_known, 30.0)
            robot.run(float(rng.uniform(4.0, 8.0)))
            place = choose_place(robot, is_slip, rng)
            if place is None:
                continue
            found.append(kidnap(robot, place))
            if math.isinf(found[-1].recovered_s):
                robot.set_pose(robot.true_pose)
        robot.close()
    return found


def choose_place(robot: Wanderer, is_slip: bool, rng: np.random.Generator) -> Pose2D | None:
    """A place that looks different from where the robot believes to be; None if there is none."""
    believed = robot.latest.pose
    assert believed is not None
    for place in free_poses(robot.floor, 0.3, 4000, rng):
        turned = abs(angle_difference(place.yaw, believed.yaw))
        far_m = place.distance_to(believed)
        is_near = far_m <= SLIP_M and turned <= SLIP_RAD
        is_same = far_m <= RIGHT_M and turned <= RIGHT_RAD
        on_map = robot.map.values_at(np.array([[place.x, place.y]]))[0]
        if (
            is_near is not is_slip
            or is_same
            or on_map != FREE
            or any(math.hypot(place.x - x, place.y - y) < reach for x, y, reach in IN_THE_WAY)
        ):
            continue
        if robot.explained_share(believed, place) < EXPLAINED_SHARE:
            return place
    return None


def report_kidnappings(name: str, found: list[Kidnapping]) -> None:
    """Print how many were noticed in time and recovered."""
    count = len(found)
    stopped = np.array([one.stopped_s for one in found])
    recovered = np.array([one.recovered_s for one in found])
    known = recovered[np.isfinite(recovered)]
    doubted = np.array([one.doubted_s for one in found])
    show(
        [
            Figure(f"{name}: kidnappings", str(count)),
            at_least(
                f"{name}: noticed and stopped in 3 s", _below(stopped, NOTICE_S), count, digits=0
            ),
            Figure(f"{name}: doubted (unsure) in 3 s", f"{_below(doubted, NOTICE_S):.0f}"),
            Figure(f"{name}: stopped, median and latest", _median_and_most(stopped)),
            Figure(f"{name}: recovered in 10 s", f"{_below(recovered, 10.0):.0f}"),
            at_least(f"{name}: recovered in {RECOVER_S:g} s", float(known.size), count, digits=0),
            Figure(f"{name}: recovered, median and latest", _median_and_most(known)),
            at_most(
                f"{name}: sure of a wrong place for 2 s after that",
                sum(one.fooled_s >= UNNOTICED_S for one in found),
                0,
                digits=0,
            ),
        ]
    )


def _below(times_s: np.ndarray, limit_s: float) -> float:
    return float(np.count_nonzero(times_s <= limit_s + 1e-6))


def _median_and_most(times_s: np.ndarray) -> str:
    return f"{np.median(times_s):.1f}, {times_s.max():.1f} s" if times_s.size else "-"


def normal_driving(minutes: float) -> None:
    """Drive about with people and moved furniture."""
    tracks: list[Track] = []
    goals = collisions = 0
    for seed in range(math.ceil(minutes * 60.0 / DRIVE_S)):
        with tempfile.TemporaryDirectory() as folder:
            robot = Wanderer(write_world(Path(folder), moved_seed=seed, people=True), seed)
            robot.run(min(DRIVE_S, minutes * 60.0 - seed * DRIVE_S))
            tracks.append(_since_known(robot.track()))
            goals, collisions = goals + robot.goals, collisions + robot.truths[-1].collisions
            robot.close()
    alarms = [e for t in tracks for e in t.episodes(np.isin(t.states, ("lost", "searching")))]
    unsure = [e for t in tracks for e in t.episodes(t.states == "unsure")]
    unnoticed = [e for t in tracks for e in t.episodes(t.is_known & t.is_far, UNNOTICED_S)]
    errors = np.concatenate([t.error_m for t in tracks])
    sure = np.concatenate([t.is_known for t in tracks])
    show(
        [
            Figure("normal: minutes, goals, collisions", f"{minutes:g}, {goals}, {collisions}"),
            at_most("normal: false alarms (lost or searching)", len(alarms), 0, digits=0),
            Figure("normal: times unsure", str(len(unsure))),
            Figure("normal: share not localized", f"{100.0 * (1.0 - sure.mean()):.1f} %"),
            at_most("normal: lost but sure for 2 s", len(unnoticed), 0, digits=0),
            Figure(
                "normal: error, median, 95 % and greatest",
                ", ".join(f"{value:.3f}" for value in np.quantile(errors, [0.5, 0.95, 1.0])) + " m",
            ),
        ]
    )


def _since_known(track: Track) -> Track:
    """Leave out the start, until the robot first knew where it was."""
    first = int(np.argmax(track.is_known))
    return _later(track, float(track.stamps_s[first]) - 1e-3)


def main() -> None:
    """Kidnap, drive, and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kidnappings", type=int, default=12)
    parser.add_argument("--minutes", type=float, default=4.0)
    parser.add_argument("--full", action="store_true", help="100 kidnappings, 30 minutes")
    options = parser.parse_args()
    count = 100 if options.full else options.kidnappings
    for name, part, is_slip, is_moved in (
        ("anywhere", 1, False, False),
        ("slip", 2, True, False),
        ("anywhere, moved", 2, False, True),
    ):
        found = kidnappings(max(1, count // part), 1, is_slip, is_moved)
        report_kidnappings(name, found)
    normal_driving(30.0 if options.full else options.minutes)


if __name__ == "__main__":
    main()
