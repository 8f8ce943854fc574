"""People and movers of the judge: along paths, polite, as a social-force crowd, or as recorded.

They are moved by the program that judges, 50 times a second, and stand in the simulated world as
solid outlines, round bodies or pairs of swinging legs. Nothing stops who does not see the robot:
they walk on through it, as recorded people do, and the judge counts the contact.

Source:
    Helbing and Molnar, Social Force Model for Pedestrian Dynamics (1995); Johansson, Helbing,
    Shukla, Specification of the Social Force Pedestrian Model (2007): strength, range, anisotropy.
    Nair et al., DynaBARN (2022): movers of 0.5 m radius along polynomials across 20 x 20 m.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D

Floats = NDArray[np.float64]
Point = tuple[float, float]

FAR_M = 1000.0
"""Where those are who are not there [m]."""
LONGEST_GAP_S = 2.0
"""Who is not recorded for longer was not there meanwhile [s]."""


@dataclass(frozen=True)
class Seen:
    """What people can see of the robot: its pose, and the radius of a circle around it [m]."""

    pose: Pose2D
    radius: float


class Motion(Protocol):
    """How people move."""

    at: Floats
    """(n, 2) where they are [m]; `FAR_M` away those who are not there."""
    velocity: Floats
    """(n, 2) [m/s]."""

    def step(self, dt: float, robot: Seen) -> None:
        """Let `dt` seconds pass."""
        ...


@dataclass(frozen=True)
class Gait:
    """How legs look to a low lidar: as of `GaitParams` of the simulated world, by hand."""

    side_m: float = 0.1
    """Half the distance of the legs sideways."""
    swing_m: float = 0.15
    """How far they swing ahead and back."""
    radius_m: float = 0.06
    stride_m: float = 1.2
    """Both legs have swung once after this distance."""


GAIT = Gait()


class Crowd:
    """People: how they move, and what is solid of them.

    Args:
        motion: how they move.
        radius_m: of a body.
        legs: two legs are solid instead of the body.
    """

    def __init__(self, motion: Motion, radius_m: float, *, legs: bool) -> None:
        self._motion = motion
        self._legs = legs
        self.radius_m = radius_m
        self._walked = np.zeros(len(motion.at))
        self._heading = np.zeros(len(motion.at))

    def step(self, dt: float, robot: Seen) -> None:
        """Let `dt` seconds pass."""
        before = self._motion.at.copy()
        self._motion.step(dt, robot)
        moved = self._motion.at - before
        far = np.hypot(*moved.T)
        walked = (far > 1e-4) & (far < 1.0)  # not who has just come or gone
        self._walked[walked] += far[walked]
        self._heading[walked] = np.arctan2(moved[walked, 1], moved[walked, 0])

    @property
    def at(self) -> Floats:
        """Where they are (n, 2) [m]."""
        return self._motion.at

    @property
    def velocity(self) -> Floats:
        """How they move (n, 2) [m/s]."""
        return self._motion.velocity

    def solids(self) -> Floats:
        """What is solid: (n, k, 3) x, y, radius of the circles of each [m]."""
        if not self._legs:
            radius = np.full(len(self.at), self.radius_m)
            return np.column_stack([self.at, radius])[:, None, :]
        ahead = np.column_stack([np.cos(self._heading), np.sin(self._heading)])
        left = np.column_stack([-ahead[:, 1], ahead[:, 0]])
        swing = GAIT.swing_m * np.sin(2.0 * math.pi * self._walked / GAIT.stride_m)
        off = swing[:, None] * ahead + GAIT.side_m * left
        circles = np.full((len(self.at), 2, 3), GAIT.radius_m)
        circles[:, 0, :2], circles[:, 1, :2] = self.at + off, self.at - off
        return circles


@dataclass(frozen=True)
class Route:
    """A path (m, 2) [m], and at which times (m,) its points are reached [s]."""

    points: Floats
    times: Floats
    returns: bool = False
    """There and back forever; else who has arrived stays."""

    @classmethod
    def at_speed(cls, points: Sequence[Point], speed: float, starts_s: float = 0.0) -> "Route":
        """At one speed [m/s], after standing at its first point for `starts_s`."""
        places = np.array(points, dtype=np.float64)
        along = np.append(0.0, np.hypot(*np.diff(places, axis=0).T).cumsum())
        return cls(places, starts_s + along / speed)


class Paths:
    """Walks along paths that see nobody."""

    def __init__(self, paths: Sequence[Route], now_s: float = 0.0) -> None:
        self._paths = paths
        self._now_s = now_s
        self.at = self._places(now_s)
        self.velocity = np.zeros_like(self.at)

    def step(self, dt: float, robot: Seen) -> None:
        """Let `dt` seconds pass."""
        del robot
        self._now_s += dt
        at = self._places(self._now_s)
        self.velocity = (at - self.at) / dt
        self.at = at

    def _places(self, now_s: float) -> Floats:
        found = np.empty((len(self._paths), 2))
        for index, path in enumerate(self._paths):
            now, end = now_s, float(path.times[-1])
            if path.returns:
                now = end - abs(now % (2.0 * end) - end)
            for k in (0, 1):
                found[index, k] = np.interp(now, path.times, path.points[:, k])
        return found


Manner = Literal["walks", "waits", "stands"]
"""What a polite person does: walks on along the side, waits there until the robot has passed, or
stands still in the middle before it and leaves it to the robot to pass."""


@dataclass(frozen=True)
class Manners:
    """How a polite person behaves in a corridor; by hand."""

    sees_m: float = 3.5
    """From this far they make room."""
    aside_mps: float = 0.4
    wall_m: float = 0.05
    """They keep this from the wall."""
    keeps_m: float = 0.25
    """They stop rather than come nearer to the robot than this [m]."""
    waits_m: float = 1.5
    """People who wait stop at this distance [m]."""


MANNERS = Manners()


class Polite:
    """Somebody in a corridor along x who sees the robot, and gives way to the right.

    Args:
        start: where they begin [m].
        end_x: where they walk to.
        speed: [m/s].
        sizes: half of the corridor's width, whose middle is y = 0, and their radius [m].
        how: they give way.
    """

    def __init__(
        self, start: Point, end_x: float, speed: float, sizes: tuple[float, float], how: Manner
    ) -> None:
        self.at = np.array([start])
        self.velocity = np.zeros((1, 2))
        self._end_x, self._speed, self._how = end_x, speed, how
        self._way = math.copysign(1.0, end_x - start[0])
        half_m, self._radius_m = sizes
        self._usual_y = start[1]
        self._side_y = -self._way * (half_m - self._radius_m - MANNERS.wall_m)
        if how == "stands":
            self._side_y = self._usual_y

    def step(self, dt: float, robot: Seen) -> None:
        """Let `dt` seconds pass."""
        x, y = self.at[0].tolist()
        ahead = self._way * (robot.pose.x - x)
        apart = robot.radius + self._radius_m
        sees = -apart < ahead < MANNERS.sees_m
        aside = (self._side_y if sees else self._usual_y) - y
        vy = float(np.clip(aside / dt, -MANNERS.aside_mps, MANNERS.aside_mps))
        vx = self._way * self._speed
        gap = math.dist((x, y), (robot.pose.x, robot.pose.y)) - apart
        if sees and ahead > 0.0:
            in_the_way = abs(robot.pose.y - y) - apart < 0.5 * MANNERS.keeps_m
            is_aside = abs(self._side_y - y) < 0.02
            waits = self._how != "walks" and is_aside and gap < MANNERS.waits_m
            vx = 0.0 if waits or (in_the_way and gap < MANNERS.keeps_m) else vx
        if self._way * (self._end_x - x) <= 0.0:
            vx = 0.0
        # Nobody steps into the robot.
        after = math.dist((x + vx * dt, y + vy * dt), (robot.pose.x, robot.pose.y)) - apart
        is_stepping_into = after < 0.02 and after < gap
        self.velocity[0] = (0.0, 0.0) if is_stepping_into else (vx, vy)
        self.at = self.at + self.velocity * dt


class Chaser:
    """Somebody who walks up to the robot wherever it goes, and leaves it alone after a while.

    Args:
        start: where they begin [m].
        speed: [m/s].
        keeps_m: they stand this far before it.
        until_s: then they stay where they are.
    """

    def __init__(self, start: Point, speed: float, keeps_m: float, until_s: float) -> None:
        self.at = np.array([start])
        self.velocity = np.zeros((1, 2))
        self._speed, self._keeps_m, self._left_s = speed, keeps_m, until_s

    def step(self, dt: float, robot: Seen) -> None:
        """Let `dt` seconds pass."""
        self._left_s -= dt
        towards = np.array([robot.pose.x, robot.pose.y]) - self.at[0]
        far = float(np.hypot(*towards))
        walks = self._left_s > 0.0 and far - robot.radius > self._keeps_m
        self.velocity[0] = self._speed * towards / far if walks else 0.0
        self.at = self.at + self.velocity * dt


@dataclass(frozen=True)
class SocialForces:
    """Of Helbing and Molnar, with the values of Johansson et al. for circles; walls by hand."""

    relax_s: float = 0.5
    strength_mps2: float = 2.1
    range_m: float = 0.3
    behind: float = 0.3
    """Weight of who is behind."""
    contact_per_s2: float = 200.0
    """Bodies that would overlap push each other apart by this times the overlap (by hand)."""
    seen_robot_m: float = 0.05
    """Who sees the robot takes it for larger by this."""
    wall_mps2: float = 3.0
    wall_m: float = 0.15
    fastest: float = 1.3
    """Nobody walks faster than so many times the wanted speed."""


FORCES = SocialForces()


@dataclass(frozen=True)
class Stream:
    """Where some people of a crowd walk: from one box to another, over and over.

    Attributes:
        count: of people.
        start: low and high corner of where they begin [m].
        end: of where each chooses a place to walk to.
        begins_anywhere: they are on their way when it begins.
    """

    count: int
    start: tuple[Point, Point]
    end: tuple[Point, Point]
    begins_anywhere: bool = True


class SocialForceCrowd:
    """People who keep apart by social forces, and who may or may not see the robot.

    Args:
        streams: who walks where.
        boxes: walls (n, 4): x, y of the centre, length along x, width along y [m].
        radius_m: of the bodies.
        rng: draws speeds, starts and ends.
        keep_off: nobody begins this near to it: x, y, radius [m].
        sees_robot: they keep off the robot as off each other.
    """

    def __init__(
        self,
        streams: Sequence[Stream],
        boxes: Floats,
        radius_m: float,
        rng: np.random.Generator,
        keep_off: tuple[float, float, float],
        *,
        sees_robot: bool,
    ) -> None:
        self._streams = [stream for stream in streams for _ in range(stream.count)]
        self._boxes, self._radius_m, self._rng = boxes, radius_m, rng
        self._sees_robot = sees_robot
        count = len(self._streams)
        self._speeds = np.clip(rng.normal(1.1, 0.25, count), 0.5, 1.7)
        self.at, self._ends = np.empty((count, 2)), np.empty((count, 2))
        for index, stream in enumerate(self._streams):
            self._send(index)
            while stream.begins_anywhere:
                share = rng.random()
                at = (1.0 - share) * self.at[index] + share * self._ends[index]
                if math.dist(at, keep_off[:2]) > keep_off[2]:
                    self.at[index] = at
                    break
                self._send(index)
        towards = self._ends - self.at
        away = np.hypot(*towards.T)[:, None]
        self.velocity = self._speeds[:, None] * towards / np.maximum(away, 1e-9)

    def step(self, dt: float, robot: Seen) -> None:
        """Let `dt` seconds pass."""
        towards = self._ends - self.at
        away = np.hypot(*towards.T)
        for index in np.flatnonzero(away < 0.5).tolist():
            self._send(index)
        wanted = self._speeds[:, None] * towards / np.maximum(away, 1e-9)[:, None]
        force = (wanted - self.velocity) / FORCES.relax_s
        others = self.at
        if self._sees_robot:
            others = np.vstack([self.at, (robot.pose.x, robot.pose.y)])
        off = self.at[:, None] - others[None]
        far = np.maximum(np.hypot(off[..., 0], off[..., 1]), 1e-6)
        np.fill_diagonal(far[:, : len(self.at)], np.inf)
        sizes = np.full(len(others), 2.0 * self._radius_m)
        sizes[len(self.at) :] = self._radius_m + robot.radius + FORCES.seen_robot_m
        heading = wanted / np.maximum(np.hypot(*wanted.T), 1e-9)[:, None]
        # 1 for who is straight ahead, -1 for who is behind.
        cos = -np.einsum("ik,ijk->ij", heading, off) / far
        weight = FORCES.behind + (1.0 - FORCES.behind) * 0.5 * (1.0 + cos)
        push = FORCES.strength_mps2 * weight * np.exp((sizes - far) / FORCES.range_m)
        push += FORCES.contact_per_s2 * np.maximum(0.0, sizes - far)
        force += np.einsum("ij,ijk->ik", push / far, np.where(np.isfinite(off), off, 0.0))
        force += self._wall_forces()
        self.velocity = self.velocity + force * dt
        speed = np.hypot(*self.velocity.T)
        most = FORCES.fastest * self._speeds
        self.velocity *= np.minimum(1.0, most / np.maximum(speed, 1e-9))[:, None]
        self.at = self.at + self.velocity * dt

    def _wall_forces(self) -> Floats:
        if len(self._boxes) == 0:
            return np.zeros_like(self.at)
        centre, half = self._boxes[None, :, :2], 0.5 * self._boxes[None, :, 2:]
        nearest = np.clip(self.at[:, None], centre - half, centre + half)
        off = self.at[:, None] - nearest
        far = np.maximum(np.hypot(off[..., 0], off[..., 1]), 1e-6)
        push = FORCES.wall_mps2 * np.exp((self._radius_m - far) / FORCES.wall_m)
        return np.einsum("ij,ijk->ik", push / far, off)

    def _send(self, index: int) -> None:
        """Let somebody begin again."""
        stream = self._streams[index]
        for place, (low, high) in ((self.at, stream.start), (self._ends, stream.end)):
            place[index] = self._rng.uniform(low, high)


class Recorded:
    """People as they were recorded; who is not in sight is not there."""

    def __init__(self, tracks: Sequence[Floats], now_s: float) -> None:
        self._tracks = tracks
        self._now_s = now_s
        self.at = self._places(now_s)
        self.velocity = np.zeros_like(self.at)

    def step(self, dt: float, robot: Seen) -> None:
        """Let `dt` seconds pass."""
        del robot
        self._now_s += dt
        at = self._places(self._now_s)
        moved = np.hypot(*(at - self.at).T) < 1.0
        self.velocity = np.where(moved[:, None], (at - self.at) / dt, 0.0)
        self.at = at

    def _places(self, now_s: float) -> Floats:
        found = np.full((len(self._tracks), 2), FAR_M)
        for index, track in enumerate(self._tracks):
            if track[0, 0] <= now_s <= track[-1, 0]:
                found[index] = [np.interp(now_s, track[:, 0], track[:, k]) for k in (1, 2)]
        return found


def read_tracks(file: Path, second: float) -> list[Floats]:
    """Read recorded people: tracks (n, 3) of t [s], x, y [m], each sorted by time.

    The file has one line for each sight of somebody, `t id x y`, with any space or commas between,
    as ETH's and UCY's recordings are passed on; what follows on a line is left alone, `#` begins a
    comment. Who was away for more than 2 s comes again as somebody else.

    Args:
        file: to read.
        second: how much t grows in a second: 1 where it is in seconds, 25 where it counts the
            frames of a film.

    Raises:
        ValueError: a line does not hold four numbers, or nobody is there twice.
    """
    rows: list[list[float]] = []
    for number, line in enumerate(file.read_text().splitlines(), 1):
        words = line.partition("#")[0].replace(",", " ").split()
        if not words:
            continue
        try:
            row = [float(word) for word in words[:4]]
        except ValueError as error:
            raise ValueError(f"{file}:{number}: expected t id x y, found {line!r}") from error
        if len(row) < 4 or not all(map(math.isfinite, row)):
            raise ValueError(f"{file}:{number}: expected t id x y, found {line!r}")
        rows.append(row)
    table = np.array(rows).reshape(-1, 4)
    tracks: list[Floats] = []
    for who in np.unique(table[:, 1]).tolist():
        track = table[table[:, 1] == who][:, [0, 2, 3]] / (second, 1.0, 1.0)
        track = track[np.argsort(track[:, 0], kind="stable")]
        gaps = np.flatnonzero(np.diff(track[:, 0]) > LONGEST_GAP_S) + 1
        tracks += [part for part in np.split(track, gaps) if len(part) > 1]
    if not tracks:
        raise ValueError(f"{file}: nobody is there twice")
    return tracks


def polynomial_path(
    rng: np.random.Generator, order: int, speeds: tuple[float, float], half_m: float
) -> Route:
    """A way there and back along a random polynomial across a square, each piece at its own speed.

    Args:
        rng: draws it.
        order: of the polynomial.
        speeds: slowest and fastest [m/s].
        half_m: half of the square's edge.
    """
    while True:
        known = rng.uniform(-half_m, half_m, (order + 1, 2))
        if np.diff(np.sort(known[:, 0])).min() < 0.1 * half_m:
            continue  # next to a pole
        along = np.linspace(-half_m, half_m, 41)
        across = np.polynomial.Polynomial.fit(known[:, 0], known[:, 1], order)(along)
        points = np.column_stack([along, across])[np.abs(across) <= half_m]
        if len(points) > 10:
            break
    if rng.random() < 0.5:
        points = points[:, ::-1]
    if rng.random() < 0.5:
        points = points[::-1]
    lengths = np.hypot(*np.diff(points, axis=0).T)
    pace = np.repeat(rng.uniform(*speeds, len(lengths) // 8 + 1), 8)[: len(lengths)]
    return Route(points, np.append(0.0, (lengths / pace).cumsum()), returns=True)
