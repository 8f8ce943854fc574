"""What the lidar has seen, against a twin that walks along beams one cell's thought at a time."""

import math
from dataclasses import dataclass

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from support.cases import cases

from trolley.geometry import Pose2D, Twist2D, footprint_from_box
from trolley.sight import SIGHT
from trolley_base.drivers import LidarScan, MotionSample
from trolley_base.odometry.track import OdometryTrack
from trolley_base.safety.observed_space import PARAMS, ObservedSpace

S = 1_000_000_000
HALF_LENGTH, HALF_WIDTH = 0.15, 0.12
FOOTPRINT = footprint_from_box(2 * HALF_LENGTH, 2 * HALF_WIDTH)
REACH = 0.8
NEVER = -math.inf
SEEN, FREE_BEFORE, UNSEEN = "seen", "free a while ago", "unseen"
# Where a rounding error could decide, both may be right [m, rad].
BLUR_M, BLUR_RAD = 1e-3, 2.0 * math.pi / PARAMS.bearings


@dataclass
class Cell:
    """When the twin saw a cell, was there, and had an echo there [s]; whether it is sure."""

    seen: float = NEVER
    trail: float = NEVER
    echo: float = NEVER
    unsure_until: float = NEVER


class Twin:
    """The same by plain loops, for a robot that stands still during each scan."""

    def __init__(self) -> None:
        self.cells: dict[tuple[int, int], Cell] = {}

    def update(
        self,
        ranges: list[float],
        first: float,
        step: float,
        pose: Pose2D,
        laser: Pose2D,
        now: float,
    ) -> None:
        eye = pose @ laser
        beams = [
            (math.remainder(eye.yaw + first + i * step, 2.0 * math.pi), r)
            for i, r in enumerate(ranges)
            if r > 0.0 and self._has_company(ranges, i, step)
        ]
        for x in range(-26, 26):
            for y in range(-26, 26):
                cell = self.cells.setdefault((x, y), Cell())
                middle = (x + 0.5) * PARAMS.cell_m, (y + 0.5) * PARAMS.cell_m
                self._look(cell, middle, eye, beams, (first, step, len(ranges)), now)
                here = pose.inverse().transform_points(np.array([middle]))[0]
                if abs(here[0]) < HALF_LENGTH and abs(here[1]) < HALF_WIDTH:
                    cell.trail = now

    def _has_company(self, ranges: list[float], i: int, step: float) -> bool:
        count = len(ranges)
        half = min(count // 2, max(1, round(0.5 * PARAMS.crowd_width / step)))
        is_round = (count + 2) * step > 2.0 * math.pi
        around = range(i - half, i + half + 1)
        if is_round:
            good = [ranges[k % count] > 0.0 for k in around]
        else:
            good = [ranges[min(max(k, 0), count - 1)] > 0.0 for k in around]
        return sum(good) >= PARAMS.crowd_share * (2 * half + 1)

    def _look(
        self,
        cell: Cell,
        middle: tuple[float, float],
        eye: Pose2D,
        beams: list[tuple[float, float]],
        fan: tuple[float, float, int],
        now: float,
    ) -> None:
        first, step, count = fan
        far = math.hypot(middle[0] - eye.x, middle[1] - eye.y)
        bearing = math.atan2(middle[1] - eye.y, middle[0] - eye.x)
        along = (bearing - eye.yaw - first) % (2.0 * math.pi)
        is_round = (count + 2) * step > 2.0 * math.pi
        width = 2.0 * math.pi if is_round else (count - 1) * step
        looks = along <= width
        unsure = min(abs(along - width), along, 2.0 * math.pi - along) < BLUR_RAD
        if len(beams) < 2:
            self._note(cell, False, False, looks, unsure, now)
            return
        # The beams next to it on both sides.
        left = min(beams, key=lambda beam: (beam[0] - bearing) % (2.0 * math.pi))
        right = min(beams, key=lambda beam: (bearing - beam[0]) % (2.0 * math.pi))
        gap = (left[0] - right[0]) % (2.0 * math.pi)
        edges = [abs(math.remainder(beam[0] - bearing, 2.0 * math.pi)) for beam in (left, right)]
        unsure = unsure or min(edges) < BLUR_RAD
        nearer = min(left[1], right[1])
        is_gap = gap > PARAMS.adjacent * step
        limit = min(nearer, PARAMS.hidden_m / gap) if is_gap else nearer
        is_seen = far <= limit
        is_echo = not is_seen and not is_gap and far <= nearer + PARAMS.behind_echo_m
        unsure = unsure or abs(far - limit) < BLUR_M
        unsure = unsure or abs(far - nearer - PARAMS.behind_echo_m) < BLUR_M
        self._note(cell, is_seen, is_echo, looks and is_gap, unsure, now)

    def _note(
        self, cell: Cell, is_seen: bool, is_echo: bool, is_dark: bool, unsure: bool, now: float
    ) -> None:
        if unsure:
            cell.unsure_until = now + SIGHT.trail_s
        if is_seen:
            cell.seen = now
        elif is_echo:
            cell.seen = cell.trail = NEVER
            cell.echo = now
        elif is_dark and cell.seen < now - PARAMS.dark_s:
            cell.seen = NEVER

    def knowledge(self, cell: Cell, now: float) -> str:
        if now - cell.echo <= PARAMS.dark_s or now - max(cell.seen, cell.trail) <= SIGHT.fresh_s:
            return SEEN
        if now - cell.seen <= SIGHT.memory_s or now - cell.trail <= SIGHT.trail_s:
            return FREE_BEFORE
        return UNSEEN


@st.composite
def beams(draw: st.DrawFn, count: int) -> list[float]:
    """A room with a dark sector, a thing, and beams that fail here and there."""
    wall = draw(st.floats(0.6, 3.0))
    ranges = [wall] * count
    for _ in range(draw(st.integers(0, 2))):
        start, length = draw(st.integers(0, count - 1)), draw(st.integers(1, count // 3))
        what = draw(st.sampled_from([0.0, 0.0, math.inf, 0.3, 0.5, 0.9]))
        for i in range(start, start + length):
            ranges[i % count] = what
    failing = draw(st.sampled_from([0.0, 0.05, 0.3, 0.9]))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    for i in np.flatnonzero(rng.random(count) < failing).tolist():
        ranges[i] = 0.0
    return ranges


@settings(max_examples=cases(20), deadline=None)
@given(st.data())
def test_it_sees_and_forgets_what_the_twin_does(data: st.DataObject) -> None:
    count = data.draw(st.sampled_from([60, 90, 180]))
    view = data.draw(st.sampled_from([2.0 * math.pi, 1.5 * math.pi, math.pi]))
    laser = Pose2D(data.draw(st.sampled_from([0.0, 0.1])), 0.0, data.draw(st.sampled_from([0, 1])))
    step, first = view / count, -0.5 * view
    track, twin = OdometryTrack(0), Twin()
    space = ObservedSpace(FOOTPRINT, laser, REACH)
    for _ in range(data.draw(st.integers(1, 5))):
        seconds = data.draw(st.sampled_from([0.1, 0.3, 0.7, 4.1, 40.0]))
        motion = Pose2D(
            data.draw(st.floats(-0.05, 0.1)), 0.0, data.draw(st.sampled_from([0.0, 0.3, -1.0, 3.0]))
        )
        stamp_ns = track.stamp_ns + round(seconds * S)
        track.add(MotionSample(stamp_ns, motion, Twist2D.zero()))
        ranges = np.array(data.draw(beams(count)), dtype=np.float32)
        scan = LidarScan(stamp_ns, first, step, 0.0, 0.05, 8.0, ranges)
        space.update(scan, track)
        twin.update(ranges.tolist(), first, step, track.odom_T_base, laser, stamp_ns / S)
    base, now = track.odom_T_base, track.stamp_ns / S
    unseen = space.unseen(base)
    told = {
        (math.floor(x / PARAMS.cell_m), math.floor(y / PARAMS.cell_m)): (
            FREE_BEFORE if may_creep else UNSEEN
        )
        for (x, y), may_creep in zip(
            base.transform_points(unseen.points), unseen.may_creep, strict=True
        )
    }
    for (x, y), cell in twin.cells.items():
        middle = (x + 0.5) * PARAMS.cell_m, (y + 0.5) * PARAMS.cell_m
        away = math.hypot(middle[0] - base.x, middle[1] - base.y)
        if abs(away - REACH) < BLUR_M or cell.unsure_until > now:
            continue
        expected = twin.knowledge(cell, now) if away < REACH else SEEN
        assert told.get((x, y), SEEN) == expected, ((x, y), cell)
