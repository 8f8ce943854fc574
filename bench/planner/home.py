"""How well the robot drives at home: doors, corners, corridors, dead ends and people.

    python -m bench.planner.home [--row door wall] [--seeds 3] [--full] [--lidar 360] [--each]
        [--stop-field] [--localizer] [--off-grid] [--turned] [--draw-all] [--knows tracks]
        [--recording FILE ...] [--per-second 1]

Base (simulated) and planner run in lock-step; map and true pose are given to the planner, so that
only it is judged, unless `--localizer` has the localizer find the pose. The base's stop field is
off, unless `--stop-field` is given: the planner must not need it. Unless a row says otherwise the
robot is 0.35 x 0.30 m with its axle in the middle, and drives at up to 0.5 m/s and turns at up to
1.5 rad/s on a map of 5 cm cells, with the settings of a fresh robot.toml. Goals are kept to 5 cm
and 3 degrees. Walls lie on borders of the map's cells; `--off-grid` moves the cells by a random
part of one, as they lie on a map that a robot has made, `--turned` turns them as well: every wall
and door is then at an angle. The seed draws where things and robot are,
and the errors of wheels and lidar.

Places (`situations.py`):

    group     row                         what it is
    door      door +5, +10, +15 cm        two rooms of 3 x 3 m and a door so much wider than the
                                          robot; to a random pose in the other room, and back
    doors     door +10 cm in a corner     one side of the door is the wall of both rooms
              after a corridor            0.9 m wide and 1.5 m long, the door off its middle
              axle at the rear            robot 0.60 x 0.42 m, axle 0.10 m from its back
    square    0.60 x 0.60, door 0.70      the same with a robot of 0.60 x 0.60 m
    wall      2-5 cm beside a wall        a goal so near to a wall, along it; and away again
    corner    corner, 5 cm                front and side 5 cm from walls; and away again
    dead-end  dead end 0.55, facing out   1.2 m deep: in, looking out at its end; and out
              dead end 0.55, from its end looking in; to a goal outside, looking away
              dead end 0.40, out again    too narrow to turn: in, looking in; and out
    behind    goal behind it in a         0.8 to 2.0 m wide, 7 to 10 m long; there and back
              corridor
    bend      L, Z, axle at the rear      a corridor 0.60, 0.65 or 0.70 m wide with one bend or two,
                                          robot 0.60 x 0.42 m, axle 0.10 m from its back; in and
                                          back. Only where an exhaustive search keeps 3 cm

People (`among_people.py`), 0.2 m in radius, as discs or as two swinging legs:

    oncoming  1.0, 1.2, 1.5, 2.0 m wide   at 0.8 m/s along a corridor of 8 m, and does not see the
                                          robot. 1.0 m: with a niche; being walked into there
                                          while standing is forgiven
    polite    polite oncoming             sees the robot; walks on at the right, waits there, or
                                          stands still in the middle; corridors of 1.0 to 2.0 m
    ahead     ahead at 0.25 m/s           in the same direction, corridors of 1.0 to 2.0 m
    crowd     sparse, along, across,      a hall of 10 x 6 m and what is around it, 8 to 28 walkers
              cross, dense                by social forces who do not see the robot (in the last
                                          row they do); each seed is one crossing; contacts are
                                          counted, not failures
    movers    easy, medium, hard          18 m across 20 x 20 m in frame `odom`, 5-8, 10-14, 18-24
                                          movers of 0.5 m radius, up to 1, 1.5, 2 m/s, to and fro
                                          along polynomials (as DynaBARN); `blind`: how many a
                                          robot gets through that drives straight on
    far       20-30 m ahead in odom       among pillars
    recorded  `--recording FILE`          people as recorded, discs and legs: a line `t id x y` for
                                          each sight of somebody, as ETH's and UCY's recordings
                                          are passed on; t grows by `--per-second` (ETH, UCY: 25)
    strangers two rooms, corridor, flat,  people by JuPedSim who see the robot and go from place to
              hall                        place for ever; if it is installed (see `strangers.py`)
    odd       goal in a door +20 cm       to its middle, and back (a place)
              arm ahead, door +15 cm      robot 0.65 x 0.30 m, axle 0.175 m from its back (a place)
              stands in the door, 15 s    the only one, 0.9 m wide
              stands there close before   the robot begins 0.7 m before them
              it
              ten come through the door   the same, one after the other
              walks up to the robot       wherever it goes, for 15 s; a room of 5 x 5 m

Time / ideal: for places, the ideal is the shortest time of the footprint at full speed, turning
included, by an exhaustive search over poses (`all_poses.py`), for `far` that of the straight line.
For people it is this robot's time in the same world without anybody, and no shorter than what the
people take by themselves: who walks ahead or stands in the door.

What is the lidar's fault, the prediction's or the controller's among people is told by `--knows`:
`tracks`, what the planner makes of its scans; `truth`, where everybody within 6 m is and how they
move, so that only what they do next is unknown; `future`, where they will be for 8 s, which the
planner is told as other robots tell it, where people do not see the robot.

A row is met if enough drives succeed, none of them took longer than wanted, and the robot itself
never closed in. A drive fails that does not reach all its goals within 120 s each, stands elsewhere
than it says, or touches anything. People walk on through a robot that is in their way: each contact
counts once, `moving` or `standing` (slower than 0.02 m/s), and as the robot's own fault (`closed`)
where it came nearer by more than 0.1 m/s. `way`: metres driven, as a multiple of those without
people. `near`: share of the time with somebody's body within 0.45 m of the footprint. Each failure
is drawn into out/home/: walls grey, the map's cells light, the robot once a second from blue
(early) to red (late), goals green, people small dots, contacts rings.
"""

import argparse
import functools
import math
import multiprocessing
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import get_args

import numpy as np
from bench.harness.figures import table
from bench.planner.among_people import PEOPLE, is_free_blindly, recorded_rows
from bench.planner.draw_visit import draw
from bench.planner.known_people import Knows
from bench.planner.situations import CELL_M, SPEED_MPS, STATIC, Row, Scene
from bench.planner.strangers import STRANGERS
from bench.planner.visit import LIDARS, Setting, Visit, drive

OUT = Path(__file__).resolve().parents[2] / "out" / "home"
FULL_SEEDS = 20
STANDS_MPS, TURNS_RADPS = 0.05, 0.1
"""Slower is standing, and not turning."""


def rows_of(given: argparse.Namespace) -> list[Row]:
    """The rows that are asked for."""
    recorded = recorded_rows(given.recording, given.per_second)
    rows = (*STATIC, *PEOPLE, *STRANGERS, *recorded)
    return [row for row in rows if not given.row or row.group in given.row]


def scene_of(row: Row, seed: int, *, is_off_grid: bool, is_turned: bool = False) -> Scene:
    """The scene of a row and a seed."""
    scene, rng = row.scene(seed), np.random.default_rng((10, seed))
    x, y = rng.uniform(0.0, CELL_M, 2).tolist()
    turn = float(rng.uniform(0.1, 0.5 * math.pi - 0.1)) if is_turned else 0.0
    shift = (x, y) if is_off_grid or is_turned else (0.0, 0.0)
    return replace(scene, grid_shift=shift, grid_turn=turn)


def run(name: str, seed: int, given: argparse.Namespace) -> Visit:
    """Drive one scene, and draw it if it failed."""
    row = next(row for row in rows_of(given) if row.name == name)
    scene = scene_of(row, seed, is_off_grid=given.off_grid, is_turned=given.turned)
    setting = Setting(given.lidar, given.stop_field, given.localizer, given.knows)
    visit = drive(scene, seed, setting)
    if row in STATIC:
        visit.ideal_s = scene.ideal_s()
    elif scene.crowd is None:  # too wide for the exhaustive search, and open
        visit.ideal_s, visit.ideal_m = scene.straight()
    else:
        alone = replace(setting, knows="tracks")
        visit.ideal_s, visit.ideal_m = empty(replace(scene, crowd=None), seed, alone)
    if given.draw_all or not visit.is_success:
        OUT.mkdir(parents=True, exist_ok=True)
        label = "".join(sign if sign.isalnum() else "-" for sign in name)
        draw(visit, OUT / f"{label}-{given.lidar}-{seed}.png")
    visit.scene = replace(scene, crowd=None)  # which cannot be sent from process to process
    return visit


@functools.lru_cache(maxsize=256)
def empty(scene: Scene, seed: int, setting: Setting) -> tuple[float, float]:
    """Time [s] and way [m] without people; no less time than they take; NaN: not even then."""
    visit = drive(scene, seed, setting)
    if not visit.is_success:
        return math.nan, math.nan
    return max(visit.seconds, scene.least_s), visit.driven_m


def main() -> None:
    """Drive, and print the tables."""
    given = arguments()
    rows = rows_of(given)
    count = FULL_SEEDS if given.full else given.seeds
    seeds = range(given.first_seed, given.first_seed + count)
    jobs = [(row.name, seed, given) for row in rows for seed in seeds]
    visits: dict[str, list[Visit]] = {row.name: [] for row in rows}
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(given.processes, mp_context=context) as pool:
        for job, visit in zip(jobs, pool.map(run, *zip(*jobs, strict=True)), strict=True):
            visits[job[0]].append(visit)
            if given.each:
                print(line(job[0], visit), flush=True)
    where = [f"lidar {given.lidar}", f"stop field {'on' if given.stop_field else 'off'}"]
    where += [] if given.knows == "tracks" else [f"knows the people's {given.knows}"]
    where += ["with the localizer"] * given.localizer + ["off the grid"] * given.off_grid
    where += ["turned against the grid"] * given.turned
    print(f"{', '.join(where)}, {count} seeds")
    for heads, cells, is_asked in (
        (PLACE_HEADS, place_cells, lambda row: row in STATIC),
        (PEOPLE_HEADS, people_cells, lambda row: row not in STATIC),
    ):
        asked = [row for row in rows if is_asked(row)]
        if asked:
            table(heads, [cells(row, visits[row.name]) for row in asked])
    for way in ("discs", "legs"):
        met = [visit for row in rows if row.name.endswith(way) for visit in visits[row.name]]
        if met:
            print(f"all crowds, {way}: {summary(met)}")


def arguments() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    groups = list(dict.fromkeys(row.group for row in (*STATIC, *PEOPLE)))
    parser.add_argument(
        "--row",
        nargs="*",
        choices=[*groups, "strangers", "recorded"],
        help="groups of rows; all if not given",
    )
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--full", action="store_true", help=f"{FULL_SEEDS} seeds")
    parser.add_argument("--lidar", choices=sorted(LIDARS), default="360")
    parser.add_argument("--stop-field", action="store_true")
    parser.add_argument("--knows", choices=get_args(Knows), default="tracks", help="of people")
    parser.add_argument("--localizer", action="store_true", help="it finds the pose")
    parser.add_argument("--off-grid", action="store_true", help="walls off the map's cells")
    parser.add_argument("--turned", action="store_true", help="walls askew to the map's cells")
    parser.add_argument("--recording", type=Path, nargs="*", default=[], help="t id x y")
    parser.add_argument("--per-second", type=float, default=1.0, help="how much t grows")
    parser.add_argument("--draw-all", action="store_true", help="pictures of successes, too")
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--each", action="store_true", help="a line for each drive")
    given = parser.parse_args()
    if "strangers" in (given.row or ()) and not STRANGERS:
        parser.error("--row strangers needs JuPedSim: pip install 'jupedsim>=1.4,<2'")
    if "recorded" in (given.row or ()) and not given.recording:
        parser.error("--row recorded needs --recording FILE")
    return given


COMMON_HEADS = ("", "reached", "time/ideal", "worst", "wanted", "", "recoveries", "closest m", "ms")
PLACE_HEADS = (*COMMON_HEADS, "contacts", "why not")
PEOPLE_HEADS = (*COMMON_HEADS, "way", "moving", "standing", "closed", "per km", "near", "why not")


def common_cells(row: Row, visits: Sequence[Visit]) -> list[str]:
    """What both tables begin with."""
    reached = [visit for visit in visits if visit.is_success]
    ratios = [visit.ratio for visit in reached]
    share = len(reached) / len(visits)
    wanted = "" if math.isinf(row.limit) else f"≤ {row.limit:g}"
    wanted = f"≥ {row.reached:.0%}" if row.reached < 1.0 else wanted
    # NaN, where not even the empty world was crossed, is not met.
    is_met = share >= row.reached and all(ratio <= row.limit for ratio in ratios)
    is_met = is_met and not any(hit.is_by_robot for visit in visits for hit in visit.hits)
    return [
        row.name,
        f"{len(reached)}/{len(visits)}",
        f"{np.mean(ratios):.2f}" if ratios else "-",
        f"{max(ratios):.2f}" if ratios else "-",
        wanted,
        "met" if is_met else "MISSED",
        f"{np.mean([visit.recoveries for visit in visits]):.1f}",
        f"{min(visit.closest_m for visit in visits):.3f}",
        f"{max(visit.longest_ms for visit in visits):.0f}",
    ]


def reasons(visits: Sequence[Visit]) -> str:
    """Why goals were not reached."""
    return ", ".join(sorted({visit.ending for visit in visits if not visit.is_success}))


def place_cells(row: Row, visits: Sequence[Visit]) -> list[str]:
    """A row of the table of places."""
    touched = sum(visit.touched for visit in visits)
    return [*common_cells(row, visits), str(touched), reasons(visits)]


def people_cells(row: Row, visits: Sequence[Visit]) -> list[str]:
    """A row of the table of people."""
    hits = [hit for visit in visits for hit in visit.hits]
    driven_km = 1e-3 * sum(visit.driven_m for visit in visits)
    ways = [visit.driven_m / visit.ideal_m for visit in visits if visit.is_success]
    why = [reasons(visits)]
    if row.group == "movers":
        why.append(f"blind {sum(is_free_blindly(row.scene(v.seed)) for v in visits)}/{len(visits)}")
    return [
        *common_cells(row, visits),
        f"{np.mean(ways):.2f}" if ways else "-",
        str(sum(visit.num_hits(moving=True) for visit in visits)),
        str(sum(visit.num_hits(moving=False) for visit in visits)),
        str(sum(hit.is_by_robot for hit in hits)),
        f"{len(hits) / max(driven_km, 1e-9):.0f}",
        f"{np.mean([visit.near_share for visit in visits]):.0%}",
        "; ".join(filter(None, why)),
    ]


def summary(visits: Sequence[Visit]) -> str:
    """All crossings of crowds together."""
    moving, standing = (sum(one.num_hits(moving=how) for one in visits) for how in (True, False))
    closed = sum(hit.is_by_robot for one in visits for hit in one.hits)
    ratio = np.mean([one.ratio for one in visits if one.is_success] or [math.nan])
    return (
        f"{len(visits)} crossings, contacts {moving} moving, {standing} standing, {closed} closed "
        f"by the robot, {moving / len(visits):.2f} moving for each, time / ideal {ratio:.2f}"
    )


def line(name: str, visit: Visit) -> str:
    """One drive."""
    moving, standing = visit.num_hits(moving=True), visit.num_hits(moving=False)
    goal = visit.scene.goals[-1]
    far = (f"{math.dist(hit.at, (goal.x, goal.y)):.1f}" for hit in visit.hits)
    hits = f", hits {moving} moving {standing} standing, {' '.join(far)} m from the goal"
    return (
        f"{name:27} seed {visit.seed:3} {visit.ending:20} {visit.seconds:6.1f} s of "
        f"{visit.ideal_s:5.1f}, {visit.driven_m:5.1f} m, {visit.recoveries} recoveries, "
        f"closest {visit.closest_m:.3f} m{hits if visit.hits else ''}; {doing(visit)}"
    )


def doing(visit: Visit) -> str:
    """What the robot did with its time."""
    if len(visit.trace) < 2:
        return "did not move"
    poses = np.array([(pose.x, pose.y, pose.yaw) for _, pose in visit.trace])
    times = np.maximum(np.diff([seconds for seconds, _ in visit.trace]), 1e-6)
    moves = np.diff(poses, axis=0)
    ahead = np.cos(poses[:-1, 2]) * moves[:, 0] + np.sin(poses[:-1, 2]) * moves[:, 1]
    speeds = ahead / times
    turns = np.abs((moves[:, 2] + math.pi) % (2.0 * math.pi) - math.pi) / times
    stands = np.abs(speeds) < STANDS_MPS
    shares = (
        ("stood", stands & (turns < TURNS_RADPS)),
        ("turned", stands & (turns >= TURNS_RADPS)),
        ("backed", speeds <= -STANDS_MPS),
        ("crept", (speeds >= STANDS_MPS) & (speeds < 0.5 * SPEED_MPS)),
    )
    total = float(times.sum())
    return ", ".join(f"{what} {float(times[when].sum()) / total:.0%}" for what, when in shares)


if __name__ == "__main__":
    main()
