"""How well a robot measures itself: random robots in the world that is as houses are.

    python -m bench.base.setup [--robots N] [--seed N] [--view DEGREES] [--rugs] [--smooth]

Each robot has its lidar anywhere, at any angle, some turning the other way; wheels within 10 % and
a track within 15 % of what the board assumes, a delay of 0 to 0.3 s, wheels that turn the wrong way
round, sides that are swapped, a gyro in any position, one of three lidars, and some a post beside
the lidar. A person answers how the wheels turn in the air, and repairs what is wrong there. It
stands on a bare floor; with --rugs anywhere. With --smooth wheels do not slip, which shows what the
method itself errs by. With --view all lidars see so far round, with a beam each degree.

Nobody walks here, and nothing is wrong with the wheels once they are repaired. So a refusal is
right only if the lidar has no echo in some direction, which is asked of the world, or if wheels
slip on a rug; any other is counted as false, and so is what comes too near to a robot that stood
free.

Honest is the error by the deviation that is said, its root mean square: 1 is honest, below 1
cautious.
"""

import argparse
import math
import random
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal

import msgspec
import numpy as np
from bench.harness.figures import Figure, at_most, show, table

from trolley import worlds
from trolley.geometry import Pose2D, Twist2D, angle_difference, exp_twist, footprint_from_box
from trolley.messages import Imu
from trolley_base.differential import sides_of, twist_of
from trolley_base.drivers import LidarScan, MotionSample
from trolley_base.setup.drive import SetupDrive
from trolley_base.setup.findings import Findings, evaluate
from trolley_base.setup.geometry import Estimate
from trolley_base.setup.gyro import Gyro
from trolley_base.setup.record import SetupRefused
from trolley_base.setup.sight import PARAMS as SIGHT
from trolley_base.setup.sight import Beams, near_sectors, usual_ranges
from trolley_base.setup.wheels import DIRECTIONS, Seen, WheelTrial, judge_counts, judge_wiring
from trolley_base.simulation.simulated_hardware import SimulatedHardware
from trolley_base.world import LidarSpec, RobotBody, Simulation, WorldError
from trolley_base.world.floor import is_on
from trolley_base.world.scanner import Shots
from trolley_base.world.world_file import World, load_world

PERIOD_NS = 50_000_000
LEAST_M = 0.06
"""A robot that has room stays so far from everything [m]: half of the margin of its strokes."""
FOOTPRINT = footprint_from_box(0.30, 0.24)
ASSUMED_TRACK_M = 0.2
LIDARS = (
    ("as an RPLIDAR A1", LidarSpec(beams=360, rate_hz=8.0, noise_m=0.01, noise_share=0.005)),
    ("as an LD19", LidarSpec(beams=450, rate_hz=10.0, noise_m=0.006, noise_share=0.002)),
    (
        "as a URG, 240°",
        LidarSpec(
            beams=683,
            rate_hz=10.0,
            field_of_view=math.radians(240.0),
            range_max_m=5.6,
            noise_m=0.008,
            noise_share=0.003,
        ),
    ),
)


@dataclass(frozen=True)
class RandomRobot:
    """What is true of a robot."""

    lidar: str
    spec: LidarSpec
    mount: Pose2D
    left: float
    right: float
    track: float
    delay_s: float
    is_mirrored: bool
    signs: tuple[int, int]
    is_swapped: bool
    gyro_up: tuple[int, int]
    """The chip's axis that points up, and its sign."""
    gyro_scale: float
    posts: tuple[tuple[float, float], ...]
    """Direction of each post in frame `laser` [rad], and its distance [m]."""


def draw(rng: random.Random) -> RandomRobot:
    """Draw a robot."""
    name, spec = rng.choice(LIDARS)
    return RandomRobot(
        lidar=name,
        spec=spec,
        mount=Pose2D(rng.uniform(-0.13, 0.13), rng.uniform(-0.1, 0.1), rng.uniform(-3.1, 3.1)),
        left=rng.uniform(0.9, 1.1),
        right=rng.uniform(0.9, 1.1),
        track=rng.uniform(0.85, 1.15),
        delay_s=rng.uniform(0.0, 0.3),
        is_mirrored=rng.random() < 0.3,
        signs=(rng.choice((1, 1, -1)), rng.choice((1, 1, -1))),
        is_swapped=rng.random() < 0.3,
        gyro_up=(rng.randrange(3), rng.choice((1, -1))),
        gyro_scale=rng.uniform(0.97, 1.03),
        posts=((rng.uniform(-3.1, 3.1), rng.uniform(0.12, 0.2)),) if rng.random() < 0.3 else (),
    )


class OddRobot:
    """The devices of a random robot in a simulated world, one period after the other.

    Args:
        robot: what is true of it.
        simulation: the world with it.
        rng: errors of its gyro.
    """

    def __init__(
        self, robot: RandomRobot, simulation: Simulation, rng: np.random.Generator
    ) -> None:
        self.simulation = simulation
        self.signs, self.is_swapped = robot.signs, robot.is_swapped
        """How its motors are wired; a person repairs them."""
        self.is_lifted = False
        self.way_m = 0.0
        """How far it really went."""
        self.now_ns = 0
        self._robot = robot
        self._rng = rng
        self.hardware = SimulatedHardware(simulation, 0)
        self._bias = 0.01 * rng.standard_normal(3)
        self._last = simulation.truth().pose
        self._told = Twist2D.zero()
        self._air: list[MotionSample] = []

    def wired(self, twist: Twist2D) -> Twist2D:
        """Return what the motors do of what the board means, or what it counts of what they do."""
        left, right = sides_of(twist, 0.5 * ASSUMED_TRACK_M)
        if self.is_swapped:
            left, right = right, left
        left, right = self.signs[0] * left, self.signs[1] * right
        return twist_of(left, right, 0.5 * ASSUMED_TRACK_M)

    def unwired(self, twist: Twist2D) -> Twist2D:
        """Undo `wired`."""
        left, right = sides_of(twist, 0.5 * ASSUMED_TRACK_M)
        left, right = self.signs[0] * left, self.signs[1] * right
        if self.is_swapped:
            left, right = right, left
        return twist_of(left, right, 0.5 * ASSUMED_TRACK_M)

    def drive(self, twist: Twist2D) -> None:
        """Command the board."""
        self._told = twist
        self.hardware.chassis.drive(Twist2D.zero() if self.is_lifted else self.wired(twist))

    def read(self) -> tuple[list[MotionSample], list[LidarScan], list[Imu]]:
        """Let one period pass, and return what the devices said."""
        self.now_ns += PERIOD_NS
        self.hardware.advance(self.now_ns)
        motions = [self._counted(one) for one in self.hardware.chassis.read().motions]
        if self.is_lifted:
            step = exp_twist(self._told, PERIOD_NS * 1e-9)
            motions = [MotionSample(self.now_ns, step, self._told)]
        scans = [self._seen(scan) for scan in self.hardware.lidar.read().scans]
        now = self.simulation.truth().pose
        turned = angle_difference(now.yaw, self._last.yaw) / (PERIOD_NS * 1e-9)
        self.way_m += now.distance_to(self._last)
        self._last = now
        axis, sign = self._robot.gyro_up
        rates = self._bias + 0.003 * self._rng.standard_normal(3)
        rates[axis] += sign * turned / self._robot.gyro_scale
        x, y, z = rates.tolist()
        return (
            motions,
            scans,
            [
                Imu(
                    stamp_ns=self.now_ns,
                    angular_velocity=(x, y, z),
                    linear_acceleration=(0.0, 0.0, 9.8),
                )
            ],
        )

    def _counted(self, motion: MotionSample) -> MotionSample:
        if self.signs == (1, 1) and not self.is_swapped:
            return motion
        twist = self.unwired(motion.twist)
        return MotionSample(motion.stamp_ns, exp_twist(twist, 0.02), twist)

    def _seen(self, scan: LidarScan) -> LidarScan:
        ranges = scan.ranges.copy()
        angles = scan.angle_min + scan.angle_increment * np.arange(len(ranges))
        for direction, away_m in self._robot.posts:
            off = np.abs(np.angle(np.exp(1j * (angles - direction))))
            hit = off < math.atan2(0.015, away_m)
            noise = 0.004 * self._rng.standard_normal(np.count_nonzero(hit))
            ranges[hit] = (away_m + noise).astype(np.float32)
        if not self._robot.is_mirrored:
            return replace(scan, ranges=ranges)
        span_s = (len(ranges) - 1) * scan.time_increment
        return replace(
            scan,
            stamp_ns=scan.stamp_ns + round(span_s * 1e9),
            angle_min=-float(angles[-1]),
            time_increment=-scan.time_increment,
            ranges=ranges[::-1].copy(),
        )


def answer(odd: OddRobot, told: Twist2D) -> Seen:
    """Say as a person how the wheels turn when the board means this."""
    left, right = sides_of(odd.wired(told), 0.5 * ASSUMED_TRACK_M)
    signs = int(math.copysign(1, left)), int(math.copysign(1, right))
    return next(seen for seen, turned in DIRECTIONS.items() if turned == signs)


def try_wheels(odd: OddRobot) -> None:
    """Try the wheels in the air, and repair what is wrong, as often as is needed."""
    odd.is_lifted = True
    for _ in range(3):
        seen: list[Seen] = []
        ways: tuple[Literal["ahead", "left"], ...] = ("ahead", "left")
        for way in ways:
            trial = WheelTrial(way, 0.5 * ASSUMED_TRACK_M)
            while not trial.has_ended:
                motions, scans, _ = odd.read()
                odd.drive(trial.step(odd.now_ns, motions, scans))
            if trial.counted is None:
                raise SetupRefused(trial.problem or "")
            judge_counts(trial.counted)
            told = Twist2D(0.1, 0.0, 0.0) if way == "ahead" else Twist2D(0.0, 0.0, 1.0)
            seen.append(answer(odd, told))
        wiring = judge_wiring(seen[0], seen[1])
        if wiring.is_right:
            odd.is_lifted = False
            odd.drive(Twist2D.zero())
            return
        if wiring.is_swapped:
            odd.is_swapped = not odd.is_swapped
            continue
        left = -1 if wiring.left_is_reversed else 1
        right = -1 if wiring.right_is_reversed else 1
        odd.signs = odd.signs[0] * left, odd.signs[1] * right
    raise SetupRefused("the wheels were never right")


@dataclass
class Tried:
    """What became of a robot."""

    robot: RandomRobot
    findings: Findings | None = None
    refusal: str = ""
    is_true: bool = True
    """Whether the reason of the refusal is true in the world."""
    nearest_m: float = math.inf
    """How near the robot came to anything."""
    driving_s: float = 0.0
    whole_s: float = 0.0
    way_m: float = 0.0
    collisions: int = 0
    stopping_m: float = 0.0
    errors: dict[str, tuple[float, float]] | None = None
    """Error and deviation said."""


SAME_SPEED = 0.95
"""Stops count from so large a share of the highest speed: a short stroke does not reach it."""


class StopWatch:
    """Measures how far the robot really goes after each command to stop, at its highest speed."""

    def __init__(self, odd: OddRobot, least_mps: float = 0.15) -> None:
        self._odd = odd
        self._least_mps = least_mps
        self._stops: list[tuple[float, float]] = []
        """Speed at the command [m/s] and distance [m]."""
        self._before = Twist2D.zero()
        self._from_m: float | None = None
        self._speed = 0.0

    def update(self, twist: Twist2D) -> None:
        """Take each command."""
        if twist.is_zero and abs(self._before.vx) >= self._least_mps:
            speed = abs(self._odd.simulation.truth().twist.vx)
            self._from_m, self._speed = self._odd.way_m, speed
        elif not twist.is_zero and self._from_m is not None:
            self._stops.append((self._speed, self._odd.way_m - self._from_m))
            self._from_m = None
        self._before = twist

    @property
    def stopping_m(self) -> float:
        """Their mean [m]."""
        most = max(speed for speed, _ in self._stops)
        return float(np.mean([way for speed, way in self._stops if speed > SAME_SPEED * most]))


def narrow(robot: RandomRobot, view_deg: int) -> RandomRobot:
    """Return a robot with a lidar that sees so far round."""
    view_rad = math.radians(view_deg)
    spec = LidarSpec(beams=view_deg, field_of_view=view_rad, noise_m=0.01, noise_share=0.005)
    return replace(robot, lidar=f"{view_deg}°", spec=spec)


def try_robot(
    world: World, seed: int, *, rugs: bool, smooth: bool, view_deg: int | None = None
) -> Tried:
    """Let one robot set itself up."""
    rng = random.Random(seed)
    robot = draw(rng)
    if view_deg is not None:
        robot = narrow(robot, view_deg)
    simulation = place(world, robot, rng, seed, (rugs, smooth))
    odd = OddRobot(robot, simulation, np.random.default_rng(seed))
    tried = Tried(robot)
    slipped = False
    try:
        try_wheels(odd)
        begun_ns = odd.now_ns
        first = [scan for _ in range(20) for scan in odd.read()[1]]
        beams = Beams.round_about(first[0])
        own = near_sectors(beams, usual_ranges(beams, first), 2.0 * 0.193 + 0.05)
        drive = SetupDrive(FOOTPRINT, 0.5 * ASSUMED_TRACK_M, own if robot.posts else ())
        moving = 0
        watch = StopWatch(odd)
        while not drive.has_ended:
            motions, scans, imu = odd.read()
            twist = drive.step(odd.now_ns, motions, scans, imu)
            odd.drive(twist)
            watch.update(twist)
            true = simulation.truth()
            tried.nearest_m = min(tried.nearest_m, true.clearance)
            slipped |= rugs and any(is_on(rug, true.pose.x, true.pose.y) for rug in world.spec.rug)
            moving += not twist.is_zero
        tried.driving_s = moving * PERIOD_NS * 1e-9
        tried.way_m = odd.way_m
        tried.whole_s = (odd.now_ns - begun_ns) * 1e-9
        tried.collisions = simulation.truth().collisions
        tried.findings = found_by(drive)
        tried.stopping_m = watch.stopping_m
        tried.errors = errors(tried)
    except SetupRefused as refusal:
        tried.refusal = str(refusal)
        tried.is_true = is_true(tried.refusal, simulation, robot.spec.range_max_m, slipped=slipped)
    return tried


LEAST_SHARE = 0.2
"""Share of the beams of a direction; where fewer come back, a robot that refuses is right."""


def is_true(refusal: str, simulation: Simulation, reach_m: float, *, slipped: bool) -> bool:
    """Say whether the reason of a refusal is true of a robot that stands where it was refused.

    Args:
        refusal: what was said.
        simulation: the world.
        reach_m: of the lidar.
        slipped: whether it drove over a rug.
    """
    if "sees nothing at all" in refusal:
        return blind_directions(simulation, reach_m) > 0
    return slipped and "slip" in refusal


def blind_directions(simulation: Simulation, reach_m: float) -> int:
    """Return in how many of the directions in which setup looks hardly a beam comes back.

    They lead out of reach, or onto something black, shiny or mirroring.
    """
    num_rays = 20
    count = SIGHT.num_bins * num_rays
    bearings = 2.0 * math.pi * (np.arange(count) + 0.5) / count - simulation.truth().pose.yaw
    draws = np.linspace(0.0, 1.0, 50, endpoint=False).tolist()
    echoes = np.zeros(count)
    for draw in draws:
        shots = Shots(np.ones(count), bearings, np.full(count, draw), reach_m)
        echoes += np.isfinite(simulation.measure(Pose2D.identity(), shots))
    share = echoes.reshape(SIGHT.num_bins, num_rays).mean(axis=1) / len(draws)
    return int(np.count_nonzero(share < LEAST_SHARE))


def found_by(drive: SetupDrive) -> Findings:
    """Return what a drive has found, or refuse as it did."""
    if drive.problem is not None:
        raise SetupRefused(drive.problem)
    return evaluate(drive, 0.5 * ASSUMED_TRACK_M)


def place(
    world: World, robot: RandomRobot, rng: random.Random, seed: int, kind: tuple[bool, bool]
) -> Simulation:
    """Put a robot where it has room."""
    rugs, smooth = kind
    spec = world.spec
    limits = spec.limits
    slip = 0.0 if smooth else 1.0
    wheels = msgspec.structs.replace(
        spec.wheels,
        track_m=ASSUMED_TRACK_M * robot.track,
        left_scale=1.0 / robot.left,
        right_scale=1.0 / robot.right,
        turn_scale=robot.track,
        scale_std=0.0,
        turn_scale_std=0.0,
        slip_per_m=slip * spec.wheels.slip_per_m,
        yaw_slip_per_m=slip * spec.wheels.yaw_slip_per_m,
        yaw_slip_per_rad=slip * spec.wheels.yaw_slip_per_rad,
    )
    motors = msgspec.structs.replace(
        spec.motors, delay_s=robot.delay_s, castor_kick_rad=slip * spec.motors.castor_kick_rad
    )
    lidar = msgspec.structs.replace(robot.spec, faults=spec.lidar.faults)
    spec = msgspec.structs.replace(
        spec, wheels=wheels, motors=motors, person=[], rug=spec.rug if rugs else []
    )
    body = RobotBody(FOOTPRINT, robot.mount, limits=limits, lidar=lidar)
    for _ in range(2000):
        start = Pose2D(rng.uniform(-0.5, 6.5), rng.uniform(-3.5, 2.0), rng.uniform(-3.1, 3.1))
        try:
            simulation = Simulation(spec, world.grid, body, seed, start)
        except WorldError:
            continue
        if world.grid.contains(start.as_array()[None, :2])[0] and (
            simulation.truth().clearance > 0.55
        ):
            return simulation
    raise WorldError("there is no room")


def errors(tried: Tried) -> dict[str, tuple[float, float]]:
    """Return error and deviation said of each figure."""
    robot, findings = tried.robot, tried.findings
    assert findings is not None
    geometry, response = findings.geometry, findings.response
    mount = robot.mount

    def of(found: Estimate, true: float, unit: float) -> tuple[float, float]:
        return unit * (found.value - true), unit * found.std

    yaw = math.degrees(angle_difference(geometry.yaw.value, mount.yaw))
    found = {
        "yaw": (yaw, math.degrees(geometry.yaw.std)),
        "x": of(geometry.x, mount.x, 100.0),
        "y": of(geometry.y, mount.y, 100.0),
        "left": of(geometry.left, robot.left, 100.0),
        "right": of(geometry.right, robot.right, 100.0),
        "track": of(geometry.track, robot.track, 100.0),
        "delay": of(response.delay, robot.delay_s + 0.025, 1000.0),
        "stopping": of(response.stopping, tried.stopping_m, 100.0 / tried.stopping_m),
    }
    if isinstance(findings.gyro, Gyro):
        found["gyro"] = of(findings.gyro.scale, robot.gyro_scale, 100.0)
    return found


ASKED = {
    "yaw": (0.5, "°"),
    "x": (1.0, "cm"),
    "y": (1.0, "cm"),
    "left": (0.5, "%"),
    "right": (0.5, "%"),
    "track": (1.0, "%"),
    "gyro": (0.5, "%"),
    "delay": (15.0, "ms"),
    "stopping": (5.0, "%"),
}
"""What is asked of each robot that was set up, and the unit."""


def seen_posts(robot: RandomRobot) -> int:
    """Return how many posts its lidar sees; one of 240° does not see behind itself."""
    return sum(abs(direction) < 0.5 * robot.spec.field_of_view for direction, _ in robot.posts)


def wrongs(tried: Tried) -> Iterator[str]:
    """What was found that is not true, beside figures."""
    robot, findings = tried.robot, tried.findings
    if tried.collisions:
        yield "ran into something"
    if tried.nearest_m < LEAST_M:
        yield "came too near to something"
    if not tried.is_true:
        yield "the reason of the refusal"
    if findings is None:
        return
    if findings.geometry.is_mirrored is not robot.is_mirrored:
        yield "the lidar's sense of rotation"
    axis, sign = robot.gyro_up
    up = ("" if sign > 0 else "-") + "xyz"[axis]
    if not isinstance(findings.gyro, Gyro) or findings.gyro.up != up:
        yield "the gyro's axis"
    if seen_posts(robot) != len(findings.own):
        yield "what it sees of itself"


def report(all_tried: list[Tried]) -> None:
    """Print the tables."""
    done = [one for one in all_tried if one.errors is not None]
    refusals = Counter(one.refusal[:70] for one in all_tried if one.refusal)
    refused = [one for one in all_tried if one.refusal]
    falsely = sum(not one.is_true for one in refused)
    print(f"{len(all_tried)} robots: {len(done)} set up, {len(refused)} refused, ", end="")
    print(f"{falsely} of these for a reason that is not true")
    for words, count in refusals.most_common():
        print(f"  {count:3}  {words} ...")
    wrong = Counter(what for one in all_tried for what in wrongs(one))
    print(f"wrong: {dict(wrong) or 'nothing'}")
    if not done:
        return
    driving = [one.driving_s for one in done]
    whole = [one.whole_s for one in done]
    print(f"driving {np.mean(driving):.0f} s, at most {max(driving):.0f} s; ", end="")
    print(f"with standing {np.mean(whole):.0f} s, at most {max(whole):.0f} s")
    print()
    rows: list[list[str]] = []
    figures: list[Figure] = []
    values: defaultdict[str, list[tuple[float, float]]] = defaultdict(list)
    for one in done:
        for name, pair in (one.errors or {}).items():
            values[name].append(pair)
    for name, (limit, unit) in ASKED.items():
        off = np.abs([error for error, _ in values[name]])
        said = np.array([error / std for error, std in values[name]])
        met = float(np.mean(off <= limit))
        rows.append(
            [
                f"{name} {unit}",
                f"{limit:g}",
                f"{np.median(off):.2f}",
                f"{np.quantile(off, 0.9):.2f}",
                f"{off.max():.2f}",
                f"{100.0 * met:.0f}",
                f"{np.sqrt(np.mean(said**2)):.2f}",
            ]
        )
        figures.append(at_most(f"{name}, worst", float(off.max()), limit, unit, 2))
    table(["error", "asked", "median", "90 %", "worst", "met %", "honest"], rows)
    show(figures)


def main() -> None:
    """Let robots set themselves up, and print what came of it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robots", type=int, default=10)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--view", type=int, metavar="DEGREES")
    parser.add_argument("--rugs", action="store_true")
    parser.add_argument("--smooth", action="store_true")
    options = parser.parse_args()
    world = load_world(worlds.find("real.toml"))
    tried: list[Tried] = []
    for seed in range(options.seed, options.seed + options.robots):
        one = try_robot(
            world, seed, rugs=options.rugs, smooth=options.smooth, view_deg=options.view
        )
        tried.append(one)
        said = one.refusal or ", ".join(f"{k} {v[0]:.2f}" for k, v in (one.errors or {}).items())
        drove = f"{one.driving_s:.0f} s, {one.way_m:.0f} m"
        print(f"{seed:4}  {one.robot.lidar}: {said}; {drove} {' '.join(wrongs(one))}", flush=True)
    report(tried)


if __name__ == "__main__":
    main()
