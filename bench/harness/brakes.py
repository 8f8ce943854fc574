"""A robot with real brakes among things that stand, as a judge of what base lets it do.

Nothing here is shared with what it judges but the parts that a running base is made of: the plant,
the floor, the lidar and the distances are its own. Each seed draws a robot, its brakes, its senses,
a room and somebody who drives it into things.

The wheels follow a command after a delay; speed and turn rate then fall each at its own rate, so
that the robot leaves its arc while it brakes. The floor slopes, the wheels slip, and the odometry
tells neither. A contact counts if the robot's own motion towards it is faster than 0.02 m/s.
"""

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import (
    Pose2D,
    Twist2D,
    exp_twist,
    footprint_from_box,
    footprint_from_polygon,
    footprint_from_radius,
)
from trolley.jit import kernel
from trolley.messages import VelocityCommand
from trolley_base.drivers import LidarScan, MotionSample
from trolley_base.odometry.track import OdometryTrack
from trolley_base.safety.motion_limits import MotionLimits
from trolley_base.safety.near_echoes import NearEchoes
from trolley_base.safety.own_pauses import OwnPauses
from trolley_base.safety.sight_distance import SightDistance
from trolley_base.safety.stop_field import StopField
from trolley_base.safety.velocity_limiter import Block, Restriction, VelocityLimiter

Floats = NDArray[np.float64]

STEP_NS, PERIOD_NS = 5_000_000, 20_000_000
STEP_S, STEPS = STEP_NS * 1e-9, PERIOD_NS // STEP_NS
GRAVITY = 9.81
COUNTS_ABOVE = 0.02
"""A contact at this speed towards it or a lower one is none [m/s]."""
LONGEST_DELAY_S = 0.3
"""No robot's wheels follow later than this [s]."""
TOLD_DELAY_S = LONGEST_DELAY_S + 0.05
"""What base is told: until the odometry shows it [s]."""
SLOPE = 0.05
"""The steepest floor: metres of height per metre."""
STANDS = Restriction(Block.ALL, "held", "", "")
STATE = ("x", "y", "yaw", "v", "wz")
"""What the plant's kernel moves: true pose [m, rad] and velocity of the wheels [m/s, rad/s]."""


@dataclass(frozen=True)
class Case:
    """What one seed draws."""

    footprint: Floats
    limits: MotionLimits
    margin: float
    base_T_laser: Pose2D
    segments: Floats
    """(n, 4) x, y, x, y [m]."""
    circles: Floats
    """(m, 3) x, y, radius [m]."""
    rates: Floats
    """(4,) acceleration, deceleration on level floor [m/s^2], angular ones [rad/s^2]."""
    slope: Floats
    """(2,) what the slope adds to a braking robot, along x and y of the room [m/s^2]."""
    slip: Floats
    """(4,) true over wheels' speed and turn rate, sideways per v wz [s], share lost in braking."""
    delay_s: float
    jitter_s: float
    odometry_ns: int
    """Period of the wheels' reports."""
    odometry_lag_ns: int
    scan_hz: float
    scan_lag_ns: int
    beams: int
    clockwise: bool
    range_min: float
    noise: float
    rudeness: float
    """How often whoever drives aims at something near."""


@dataclass(frozen=True)
class Outcome:
    """How a run ended."""

    seed: int
    closing: float | None
    """Speed towards what was touched [m/s], None where nothing was."""
    driven_m: float
    turned_rad: float
    fastest: float
    closest_m: float


def draw_case(seed: int) -> Case:
    """Draw a robot, its brakes and a room."""
    rng = np.random.default_rng([seed, 0])
    footprint, middle = _draw_footprint(rng)
    speed = float(rng.choice([rng.uniform(0.2, 0.6), rng.uniform(0.4, 2.0)]))
    limits = MotionLimits(
        speed=speed,
        wz=float(rng.uniform(0.8, 3.0)),
        acceleration=float(rng.uniform(0.5, 2.0)),
        deceleration=float(rng.uniform(0.8, 3.0)),
        angular_acceleration=float(rng.uniform(2.0, 8.0)),
        slope=SLOPE,
    )
    rates = np.array(
        [
            limits.acceleration * rng.uniform(1.0, 1.5),
            limits.deceleration * rng.uniform(1.0, 1.6),
            limits.angular_acceleration * rng.uniform(1.0, 1.5),
            limits.angular_acceleration * rng.uniform(1.0, 2.5),
        ]
    )
    downhill = rng.uniform(-math.pi, math.pi)
    slope = (
        GRAVITY * SLOPE * rng.uniform(0.0, 1.0) * np.array([math.cos(downhill), math.sin(downhill)])
    )
    slip = np.array(
        [
            rng.uniform(0.97, 1.03),
            rng.uniform(0.95, 1.05),
            rng.uniform(-0.02, 0.02),
            rng.uniform(0.0, 0.1),
        ]
    )
    delay = float(rng.uniform(0.1, LONGEST_DELAY_S))
    segments, circles = _draw_room(rng, footprint)
    return Case(
        footprint=footprint,
        limits=limits,
        margin=0.05,
        base_T_laser=Pose2D(
            middle + float(rng.uniform(-0.03, 0.03)), 0.0, float(rng.uniform(-3, 3))
        ),
        segments=segments,
        circles=circles,
        rates=rates,
        slope=slope,
        slip=slip,
        delay_s=delay,
        jitter_s=float(rng.uniform(0.0, 1.0)) * min(0.04, LONGEST_DELAY_S - delay),
        odometry_ns=int(rng.choice([20, 40, 50])) * 1_000_000,
        odometry_lag_ns=int(rng.uniform(0, 30)) * 1_000_000,
        scan_hz=float(rng.uniform(5.0, 15.0)),
        scan_lag_ns=int(rng.uniform(5, 30)) * 1_000_000,
        beams=int(rng.choice([360, 450, 720])),
        clockwise=bool(rng.random() < 0.5),
        range_min=float(rng.uniform(0.02, 0.12)),
        noise=float(rng.uniform(0.003, 0.012)),
        rudeness=float(rng.uniform(0.2, 0.8)),
    )


def _draw_footprint(rng: np.random.Generator) -> tuple[Floats, float]:
    """Return a footprint whose wheels' axis may lie anywhere along it, and where its middle is."""
    length, width = rng.uniform(0.18, 0.8), rng.uniform(0.16, 0.6)
    middle = float(rng.uniform(-0.35, 0.35) * length)
    kind = rng.integers(0, 3)
    if kind == 0:
        return footprint_from_box(length, width) + np.array([middle, 0.0]), middle
    if kind == 1:
        radius = 0.5 * width
        middle = float(rng.uniform(-0.3, 0.3)) * radius
        return footprint_from_radius(radius) + np.array([middle, 0.0]), middle
    nose = [
        [middle + 0.5 * length, -0.2 * width],
        [middle + 0.5 * length, 0.2 * width],
        [middle + 0.2 * length, 0.5 * width],
        [middle - 0.5 * length, 0.4 * width],
        [middle - 0.5 * length, -0.4 * width],
        [middle + 0.2 * length, -0.5 * width],
    ]
    return footprint_from_polygon(nose), middle


def _draw_room(rng: np.random.Generator, footprint: Floats) -> tuple[Floats, Floats]:
    """Return walls around, boxes and posts within, none near the robot's start."""
    half = rng.uniform([1.2, 1.2], [6.0, 4.0])
    at = rng.uniform(-0.5, 0.5, 2) * half
    low, high = at - half, at + half
    reach = float(np.hypot(footprint[:, 0], footprint[:, 1]).max()) + 0.12
    low, high = np.minimum(low, -reach - 0.05), np.maximum(high, reach + 0.05)
    walls = [
        [low[0], low[1], high[0], low[1]],
        [high[0], low[1], high[0], high[1]],
        [high[0], high[1], low[0], high[1]],
        [low[0], high[1], low[0], low[1]],
    ]
    circles: list[list[float]] = []
    for _ in range(int(rng.integers(2, 14))):
        x, y = rng.uniform(low, high)
        if rng.random() < 0.5:
            radius = float(rng.uniform(0.03, 0.3))
            if math.hypot(x, y) > reach + radius:
                circles.append([x, y, radius])
            continue
        size, yaw = rng.uniform([0.08, 0.08], [1.0, 0.5]), rng.uniform(-math.pi, math.pi)
        if math.hypot(x, y) < reach + 0.5 * float(np.hypot(*size)):
            continue
        corners = 0.5 * np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * size
        turn = np.array([[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]])
        corners = corners @ turn.T + np.array([x, y])
        walls += [[*corners[i], *corners[(i + 1) % 4]] for i in range(4)]
    return np.array(walls, dtype=np.float64), np.array(circles, dtype=np.float64).reshape(-1, 3)


@kernel
def _foot(px: float, py: float, segment: Floats) -> tuple[float, float]:
    """Return the point of a segment (4,) that is nearest to another point."""
    ex, ey = segment[2] - segment[0], segment[3] - segment[1]
    along = ((px - segment[0]) * ex + (py - segment[1]) * ey) / (ex * ex + ey * ey)
    along = min(1.0, max(0.0, along))
    return segment[0] + along * ex, segment[1] + along * ey


@kernel
def _cross(one: Floats, other: Floats) -> bool:
    """Say whether two segments (4,) cross."""
    ex, ey = one[2] - one[0], one[3] - one[1]
    a = ex * (other[1] - one[1]) - ey * (other[0] - one[0])
    b = ex * (other[3] - one[1]) - ey * (other[2] - one[0])
    fx, fy = other[2] - other[0], other[3] - other[1]
    c = fx * (one[1] - other[1]) - fy * (one[0] - other[0])
    d = fx * (one[3] - other[1]) - fy * (one[2] - other[0])
    return a * b < 0.0 and c * d < 0.0


@kernel
def nearest_gap(out_pair: Floats, outline: Floats, segments: Floats, circles: Floats) -> float:
    """Return the gap between an outline (n, 2) and all things, and write the nearest pair (4,)."""
    best = math.inf
    edge, pair = np.empty(4), np.empty(4)
    count = outline.shape[0]
    for i in range(count):
        # Element by element: numba takes seconds to compile assignments of slices.
        to = (i + 1) % count
        edge[0], edge[1] = outline[i, 0], outline[i, 1]
        edge[2], edge[3] = outline[to, 0], outline[to, 1]
        for j in range(segments.shape[0]):
            thing = segments[j]
            near = math.inf
            for end in range(4):
                if end < 2:
                    ax, ay = edge[2 * end], edge[2 * end + 1]
                    bx, by = _foot(ax, ay, thing)
                else:
                    bx, by = thing[2 * end - 4], thing[2 * end - 3]
                    ax, ay = _foot(bx, by, edge)
                if math.hypot(ax - bx, ay - by) < near:
                    near = math.hypot(ax - bx, ay - by)
                    pair[0], pair[1], pair[2], pair[3] = ax, ay, bx, by
            gap = -near if _cross(edge, thing) else near
            if gap < best:
                best = gap
                for k in range(4):
                    out_pair[k] = pair[k]
        for j in range(circles.shape[0]):
            bx, by = circles[j, 0], circles[j, 1]
            ax, ay = _foot(bx, by, edge)
            distance = math.hypot(ax - bx, ay - by)
            if distance - circles[j, 2] < best:
                best = distance - circles[j, 2]
                out_pair[0], out_pair[1] = ax, ay
                out_pair[2], out_pair[3] = bx, by
    return best


@kernel
def _towards(now: float, wanted: float, faster: float, slower: float) -> float:
    """Return the next speed: brakes first where the sign changes."""
    if now * wanted < 0.0:
        wanted = 0.0
    limit = faster if abs(wanted) > abs(now) else slower
    return now + max(-limit, min(limit, wanted - now))


@kernel
def _cast(x: float, y: float, angle: float, segments: Floats, circles: Floats) -> float:
    """Return the distance to the first thing in a direction."""
    best = math.inf
    dx, dy = math.cos(angle), math.sin(angle)
    for j in range(segments.shape[0]):
        ex, ey = segments[j, 2] - segments[j, 0], segments[j, 3] - segments[j, 1]
        across = dx * ey - dy * ex
        if across == 0.0:
            continue
        ox, oy = segments[j, 0] - x, segments[j, 1] - y
        t, s = (ox * ey - oy * ex) / across, (ox * dy - oy * dx) / across
        if 0.0 <= t < best and 0.0 <= s <= 1.0:
            best = t
    for j in range(circles.shape[0]):
        ox, oy = circles[j, 0] - x, circles[j, 1] - y
        along = ox * dx + oy * dy
        rest = circles[j, 2] ** 2 - (ox * ox + oy * oy - along * along)
        if along > 0.0 and rest >= 0.0:
            best = min(best, max(0.0, along - math.sqrt(rest)))
    return best


@kernel
def _move(state: Floats, command: Floats, plant: tuple[Floats, Floats, Floats]) -> Floats:
    """Move the robot by a step.

    Args:
        state: (5,) as in `STATE`, moved.
        command: (2,) what reaches the motors.
        plant: rates, slope and slip of the case.

    Returns:
        (5,) true vx, vy [m/s] and turn rate [rad/s], and what the wheels report.
    """
    rates, slope, slip = plant
    v, wz, yaw = state[3], state[4], state[2]
    # On a slope the brakes hold that much less, going down.
    downhill = slope[0] * math.cos(yaw) + slope[1] * math.sin(yaw)
    brakes = rates[1] - math.copysign(1.0, v) * downhill
    state[3] = _towards(v, command[0], rates[0] * STEP_S, brakes * STEP_S)
    state[4] = _towards(wz, command[1], rates[2] * STEP_S, rates[3] * STEP_S)
    motion = np.empty(5)
    motion[0] = state[3] * slip[0]
    motion[1] = slip[2] * state[3] * state[4]
    motion[2] = state[4] * slip[1]
    motion[3] = state[3] * (1.0 - slip[3] if abs(state[3]) < abs(v) else 1.0)
    motion[4] = state[4]
    heading = yaw + 0.5 * motion[2] * STEP_S
    cos, sin = math.cos(heading), math.sin(heading)
    state[0] += (motion[0] * cos - motion[1] * sin) * STEP_S
    state[1] += (motion[0] * sin + motion[1] * cos) * STEP_S
    state[2] += motion[2] * STEP_S
    return motion


@kernel
def _closing(state: Floats, motion: Floats, pair: Floats, gap: float) -> float:
    """Return how fast the touching point of the robot moves to the thing [m/s]."""
    cos, sin = math.cos(state[2]), math.sin(state[2])
    ux = motion[0] * cos - motion[1] * sin - motion[2] * (pair[1] - state[1])
    uy = motion[0] * sin + motion[1] * cos + motion[2] * (pair[0] - state[0])
    nx, ny = pair[2] - pair[0], pair[3] - pair[1]
    length = math.hypot(nx, ny)
    closing = (ux * nx + uy * ny) / length if length > 0.0 else math.hypot(ux, uy)
    return abs(closing) if gap < 0.0 else closing


@kernel
def _measure(
    out_ranges: Floats,
    beams: tuple[int, int, int],
    poses: tuple[Floats, Floats],
    scene: tuple[Floats, Floats, Floats, Floats],
) -> None:
    """Measure the beams of a step, each from where the robot was at its moment.

    Args:
        out_ranges: (2 * beams,) as fired, two turns; only those of this step are written.
        beams: first beam, the one behind the last, and beams in a turn; negative: clockwise.
        poses: states at the start and the end of the step.
        scene: footprint, base_T_laser, segments and circles.
    """
    first, behind, turn = beams
    laser = scene[1]
    for fired in range(first, behind):
        part = (fired - first + 0.5) / (behind - first)
        at_x = poses[0][0] + part * (poses[1][0] - poses[0][0])
        at_y = poses[0][1] + part * (poses[1][1] - poses[0][1])
        yaw = poses[0][2] + part * (poses[1][2] - poses[0][2])
        cos, sin = math.cos(yaw), math.sin(yaw)
        x = at_x + cos * laser[0] - sin * laser[1]
        y = at_y + sin * laser[0] + cos * laser[1]
        angle = (fired % abs(turn)) * 2.0 * math.pi / turn - math.pi
        distance = _cast(x, y, yaw + laser[2] + angle, scene[2], scene[3])
        out_ranges[fired % out_ranges.shape[0]] = distance


@kernel
def advance(
    state: Floats,
    out_twists: Floats,
    out_ranges: Floats,
    out_pair: Floats,
    commands: Floats,
    plant: tuple[Floats, Floats, Floats],
    scene: tuple[Floats, Floats, Floats, Floats],
    beams: tuple[int, int, int],
) -> tuple[float, float]:
    """Move the robot for one period of base, and measure the beams that fall into it.

    Args:
        state: (5,) as in `STATE`, moved.
        out_twists: (steps, 2) what the wheels report in each step.
        out_ranges: as in `_measure`.
        out_pair: (4,) the nearest points of robot and things at the end.
        commands: (steps, 2) what reaches the motors.
        plant: rates, slope and slip of the case.
        scene: footprint (n, 2), base_T_laser x, y, yaw, segments and circles.
        beams: as in `_measure`, of the whole period.

    Returns:
        The smallest gap [m], and the speed towards what was met [m/s], NaN if nothing was.
    """
    outline = np.empty_like(scene[0])
    smallest = math.inf
    first, behind, turn = beams
    steps = commands.shape[0]
    for step in range(steps):
        before = state.copy()
        motion = _move(state, commands[step], plant)
        out_twists[step, 0], out_twists[step, 1] = motion[3], motion[4]
        cos, sin = math.cos(state[2]), math.sin(state[2])
        for i in range(outline.shape[0]):
            x, y = scene[0][i, 0], scene[0][i, 1]
            outline[i, 0] = state[0] + cos * x - sin * y
            outline[i, 1] = state[1] + sin * x + cos * y
        gap = nearest_gap(out_pair, outline, scene[2], scene[3])
        smallest = min(smallest, gap)
        if gap <= 0.001:
            closing = _closing(state, motion, out_pair, gap)
            if closing > COUNTS_ABOVE:
                return smallest, closing
            if closing > 0.0:  # it rubs, and is held
                for i in range(3):
                    state[i] = before[i]
        last = first + (behind - first) * (step + 1) // steps
        at = first + (behind - first) * step // steps
        _measure(out_ranges, (at, last, turn), (before, state), scene)
    return smallest, math.nan


class Run:
    """One case, driven.

    Args:
        decides_ns: time between two decisions of base, which is longer on a busy computer [ns].
    """

    def __init__(self, case: Case, seed: int, decides_ns: int = PERIOD_NS) -> None:
        self._case = case
        self._decides_ns, self._next_ns = decides_ns, 0
        self._pauses = OwnPauses()
        self._rng = np.random.default_rng([seed, 1])
        self.now_ns = 0
        self.state = np.zeros(len(STATE))
        self.closest, self.fastest, self.driven, self.turned = math.inf, 0.0, 0.0, 0.0
        self._track = OdometryTrack(0)
        field = StopField(case.footprint, case.limits, case.margin, TOLD_DELAY_S)
        self._echoes = NearEchoes(case.base_T_laser, field.reach)
        sight = SightDistance(case.footprint, case.limits, TOLD_DELAY_S)
        self._limiter = VelocityLimiter({"teleop": 20}, case.limits, field, sight)
        self._under_way: deque[tuple[int, float, float]] = deque([(0, 0.0, 0.0)])
        self._reports: deque[tuple[int, MotionSample]] = deque()
        self._scans: deque[tuple[int, LidarScan]] = deque()
        self._motion, self._moved_ns = Pose2D.identity(), 0
        self._turn = -case.beams if case.clockwise else case.beams
        self._ranges = np.zeros(2 * case.beams)
        self._fired = 0
        self._wish, self._wish_until_ns = Twist2D.zero(), 0
        self._points = np.empty((0, 2))
        self._has_scan = False
        self._pair = np.empty(4)

    def drive(self, seconds: float) -> float | None:
        """Drive for so long; return the speed of the first contact, None without one."""
        end_ns = self.now_ns + round(seconds * 1e9)
        while self.now_ns < end_ns:
            closing = self._step()
            if closing is not None:
                return closing
        return None

    def _step(self) -> float | None:
        """One period of base: senses, decision, motion."""
        if self.now_ns >= self._next_ns:
            self._next_ns += self._decides_ns
            self._decide()
        return self._move()

    def _decide(self) -> None:
        self._take_reports()
        restriction = STANDS if self._pauses.note(self.now_ns) else None
        if self._has_scan:
            self._want()
            decision = self._limiter.decide(self.now_ns, self._points, restriction).twist
            jitter = self._case.jitter_s * self._rng.random()
            acts_ns = self.now_ns + round((self._case.delay_s + jitter) * 1e9)
            acts_ns = max(acts_ns, self._under_way[-1][0])
            self._under_way.append((acts_ns, decision.vx, decision.wz))

    def _take_reports(self) -> None:
        while self._reports and self._reports[0][0] <= self.now_ns:
            self._track.add(self._reports.popleft()[1])
        while self._scans and self._scans[0][0] <= self.now_ns:
            self._echoes.update(self._scans.popleft()[1], self._track)
            self._has_scan = True
        self._points = self._echoes.points(self._track.odom_T_base)

    def _want(self) -> None:
        """Somebody drives by hand, at random and often at what is near."""
        if self.now_ns >= self._wish_until_ns:
            self._wish = self._draw_wish()
            self._wish_until_ns = self.now_ns + round(self._rng.uniform(0.2, 1.8) * 1e9)
        if self._wish.is_zero and self._rng.random() < 0.5:
            return  # silence, as when the radio is gone
        command = VelocityCommand(stamp_ns=self.now_ns, twist=self._wish, valid_for=0.1)
        self._limiter.offer("teleop", command, self.now_ns, self.now_ns)

    def _draw_wish(self) -> Twist2D:
        limits, rng = self._case.limits, self._rng
        if rng.random() < 0.08:
            return Twist2D.zero()
        vx = limits.speed * float(rng.choice([1.0, rng.uniform(0.1, 1.0)]))
        wz = limits.wz * float(rng.uniform(-1.0, 1.0))
        kind = rng.random()
        if kind < self._case.rudeness and len(self._points):
            # An arc through something near: the circle through the origin and that point.
            x, y = self._points[int(rng.integers(len(self._points)))]
            curvature = 2.0 * y / max(1e-6, x * x + y * y)
            forward = 1.0 if x > 0.0 else -1.0
            vx = min(vx, limits.wz / max(1e-6, abs(curvature)))
            return Twist2D(forward * vx, 0.0, forward * vx * curvature)
        forward = 1.0 if rng.random() < 0.75 else -1.0
        if kind < self._case.rudeness + 0.1:
            return Twist2D(0.0, 0.0, wz)
        if rng.random() < 0.3:
            return Twist2D(forward * vx, 0.0, 0.0)
        return Twist2D(forward * vx, 0.0, wz)

    def _commands(self) -> Floats:
        """What reaches the motors in each step of this period, (steps, 2)."""
        commands = np.empty((STEPS, 2))
        for step in range(STEPS):
            at_ns = self.now_ns + step * STEP_NS
            while len(self._under_way) > 1 and self._under_way[1][0] <= at_ns:
                self._under_way.popleft()
            commands[step] = self._under_way[0][1:]
        return commands

    def _move(self) -> float | None:
        case = self._case
        twists = np.empty((STEPS, 2))
        next_ns = self.now_ns + PERIOD_NS
        turn_ns = 1e9 / case.scan_hz
        behind = math.floor(next_ns / turn_ns * case.beams)
        number = self._fired // case.beams
        laser = case.base_T_laser.as_array()
        gap, closing = advance(
            self.state, twists, self._ranges, self._pair, self._commands(),
            (case.rates, case.slope, case.slip),
            (case.footprint, laser, case.segments, case.circles),
            (self._fired, behind, self._turn),
        )  # fmt: skip
        self._fired = behind
        self.closest = min(self.closest, gap)
        self.fastest = max(self.fastest, abs(float(self.state[3])))
        self.driven += float(np.abs(twists[:, 0]).sum()) * STEP_S
        self.turned += float(np.abs(twists[:, 1]).sum()) * STEP_S
        if not math.isnan(closing):
            return closing
        self._report(twists, next_ns)
        if behind // case.beams > number:
            self._finish_turn(number, next_ns)
        self.now_ns = next_ns
        return None

    def _report(self, twists: Floats, next_ns: int) -> None:
        """Let the wheels report, now and then, what they believe."""
        for v, wz in twists.tolist():
            self._motion = self._motion @ exp_twist(Twist2D(v, 0.0, wz), STEP_S)
        if next_ns - self._moved_ns >= self._case.odometry_ns:
            twist = Twist2D(float(twists[-1, 0]), 0.0, float(twists[-1, 1]))
            sample = MotionSample(next_ns, self._motion, twist)
            self._reports.append((next_ns + self._case.odometry_lag_ns, sample))
            self._motion, self._moved_ns = Pose2D.identity(), next_ns

    def _finish_turn(self, number: int, next_ns: int) -> None:
        case, count = self._case, self._case.beams
        between, increment = 1.0 / (case.scan_hz * count), 2.0 * math.pi / count
        ranges = self._ranges.reshape(2, count)[number % 2].copy()
        ranges += case.noise * self._rng.standard_normal(count)
        ranges[ranges < case.range_min] = 0.0
        ranges[self._rng.random(count) < 0.01] = np.inf
        angle_min, stamp_s = -math.pi, number / case.scan_hz
        if case.clockwise:  # as its driver sorts them: by ascending angle
            ranges, angle_min = ranges[::-1], angle_min + increment
            stamp_s, between = stamp_s + (count - 1) * between, -between
        scan = LidarScan(
            stamp_ns=round(stamp_s * 1e9),
            angle_min=angle_min,
            angle_increment=increment,
            time_increment=between,
            range_min=case.range_min,
            range_max=20.0,
            ranges=ranges.astype(np.float32),
        )
        self._scans.append((next_ns + case.scan_lag_ns, scan))


def drive_case(seed: int, seconds: float = 8.0, decides_ns: int = PERIOD_NS) -> Outcome:
    """Draw a case and drive it."""
    case = draw_case(seed)
    run = Run(case, seed, decides_ns)
    closing = run.drive(seconds)
    return Outcome(seed, closing, run.driven, run.turned, run.fastest, run.closest)
