"""Echoes beside the surfaces that they come from: a scan's, and those of the maker's own rules.

    python -m bench.base.scan_precision [--seconds 1.5] [--places 6] [--noise 0 0.003]

Each sensor stands in a room of oblique walls with pillars and a door, and sends what it measures as
bytes. A sensor that triangulates looks beside its head by what its maker's text says. The bytes are
read three times: in plain Python by the maker's text, which leaves every sample where it was
measured; the same, each sample put into the nearest evenly spaced beam; and by Trolley's driver.

Printed for each: how far echoes are from the nearest surface, median and 95th percentile; by what
angle all of them are turned about the sensor; the share farther than 30 mm from any surface, which
stand in the air; and the share of the maker's samples beside which, within 1.5 steps, there is no
echo. Noise is a share of the range.
"""

import argparse
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from bench.base.decoding import started
from bench.base.lidars.catalogue import RECORDS
from bench.base.lidars.ld19 import ld19_frame
from bench.base.lidars.record import Frame, chunks
from bench.base.lidars.rplidar import capsule, standard_sample
from bench.base.lidars.ydlidar import x4_frame
from numpy.typing import NDArray

Floats = NDArray[np.float64]

HOUSE = (
    [(-3.1, -2.2), (3.4, -2.6), (3.9, 0.2), (3.2, 2.7), (0.9, 2.4)],
    [(0.0, 2.3), (-2.7, 2.0), (-3.1, -2.2)],
    # What is behind the door.
    [(0.9, 2.4), (1.4, 5.5), (-1.0, 5.2), (0.0, 2.3)],
    [(1.5, -0.9), (1.9, -1.1), (2.1, -0.7), (1.7, -0.5), (1.5, -0.9)],
    [(-1.8, 0.7), (-1.5, 0.8), (-1.6, 1.1), (-1.9, 1.0), (-1.8, 0.7)],
    [(-0.9, -2.1), (-0.8, -1.5), (0.3, -1.6), (0.2, -2.2)],
)
WALLS = np.array([(*a, *b) for line in HOUSE for a, b in pairwise(line)])
"""(n, 4) their ends [m]."""
ROOM_M = (-1.3, 1.3, -1.3, 1.6)
"""Where sensors stand: x and y, from and to."""
NEAREST_M = 0.4
"""No sensor stands closer to a wall."""
IN_THE_AIR_M = 0.03

Seen = Callable[[float], float]
"""What is found [m] in a direction of the sensor [deg], growing clockwise; 0: nothing."""
Beside = Callable[[float], float]
"""By how much a sensor looks beside its head [deg], of what it finds [mm]."""


@dataclass(frozen=True)
class Place:
    """Where a sensor stands, in the room."""

    x: float
    y: float
    yaw: float
    noise: float
    rng: np.random.Generator

    def seen(self, angle_deg: float) -> float:
        """How far the first wall is in a direction of the sensor."""
        along = self.yaw - math.radians(angle_deg)
        ahead = np.array([math.cos(along), math.sin(along)])
        start, edge = WALLS[:, :2] - (self.x, self.y), WALLS[:, 2:] - WALLS[:, :2]
        across = ahead[0] * edge[:, 1] - ahead[1] * edge[:, 0]
        with np.errstate(divide="ignore", invalid="ignore"):
            far = (start[:, 0] * edge[:, 1] - start[:, 1] * edge[:, 0]) / across
            part = (start[:, 0] * ahead[1] - start[:, 1] * ahead[0]) / across
        found = far[(part >= 0.0) & (part <= 1.0) & (far > 0.0)]
        exact = float(found.min()) if len(found) else 0.0
        return exact * (1.0 + self.noise * float(self.rng.standard_normal()))

    def triangulated(self, head_deg: float, beside: Beside) -> float:
        """What a sensor finds that looks beside its head by an angle that depends on it."""
        exact = Place(self.x, self.y, self.yaw, 0.0, self.rng)
        found = exact.seen(head_deg + beside(2000.0))
        for _ in range(50):
            before, found = found, exact.seen(head_deg + beside(1000.0 * found))
            if abs(found - before) < 1e-6:
                return found * (1.0 + self.noise * float(self.rng.standard_normal()))
        return 0.0  # at an edge it sees one thing or the other, and settles for neither

    def beside_walls(self, points: Floats) -> tuple[Floats, Floats]:
        """Where echoes are beside the nearest wall.

        Args:
            points: (n, 2) from the sensor, axes as the room's [m].

        Returns:
            Signed distances (n,), and by how much each would grow with a turn by 1 rad (n,).
        """
        start, edge = WALLS[:, :2] - (self.x, self.y), WALLS[:, 2:] - WALLS[:, :2]
        to_point = points[:, None] - start
        part = np.clip((to_point * edge).sum(axis=2) / (edge**2).sum(axis=1), 0.0, 1.0)
        foot = start + part[:, :, None] * edge
        wall = np.hypot(*np.moveaxis(points[:, None] - foot, 2, 0)).argmin(axis=1)
        normal = np.stack([-edge[wall, 1], edge[wall, 0]], axis=1)
        normal /= np.hypot(*normal.T)[:, None]
        away = points - foot[np.arange(len(points)), wall]
        signed = np.copysign(np.hypot(*away.T), (away * normal).sum(axis=1))
        return signed, normal[:, 1] * points[:, 0] - normal[:, 0] * points[:, 1]


class Sensor(NamedTuple):
    """A model, and how it looks beside its head."""

    title: str
    step_deg: float
    sample_s: float
    beside: Beside

    def stream(self, place: Place) -> Iterator[Frame]:
        """Write what it measures as its maker says."""
        index = 0
        while True:
            head = index * self.step_deg % 360.0
            count = {"LD19": 12, "LD14P": 12, "RPLIDAR A1 express": 32}.get(self.title, 1)
            begins = head < self.step_deg
            if self.title == "YDLIDAR X4" and not begins:
                count = min(40, math.ceil((360.0 - head) / self.step_deg - 1e-9))
            heads = [head + i * self.step_deg for i in range(count)]
            seen_m = [place.triangulated(one, self.beside) for one in heads]
            data = self._frame(index == 0, begins, heads, seen_m)
            index += count
            yield Frame((index - 1) * self.sample_s, data)

    def _frame(self, first: bool, begins: bool, heads: list[float], seen_m: list[float]) -> bytes:
        if self.title == "YDLIDAR X4":
            quarters = [round(4000 * one) for one in seen_m]
            return x4_frame(begins, heads[0], heads[-1], quarters)
        if self.title == "RPLIDAR A1 standard":
            looked = heads[0] + (self.beside(1000 * seen_m[0]) if seen_m[0] else -8.0)
            return standard_sample(begins, looked, 1000 * seen_m[0])
        if self.title == "RPLIDAR A1 express":
            # Whole eighths of a degree: the firmware measures where it then says that it looked.
            lags = [round(-8 * self.beside(1000 * one)) if one else 63 for one in seen_m]
            samples = [(round(1000 * one), lag) for one, lag in zip(seen_m, lags, strict=True)]
            return capsule(first, heads[0], samples)
        millimetres = [round(1000 * one) for one in seen_m]
        return ld19_frame(
            heads[0] % 360.0, self.step_deg, self.step_deg / self.sample_s, millimetres
        )


def slamtec(mm: float) -> float:
    """An RPLIDAR that triangulates, as the SDK has it for the ultra scan, in fine steps."""
    part = 98361 / (4.0 * max(mm, 50.0))
    return math.degrees((64 * part + part**3 / 98304) / 65536) - 8.0


def ydlidar(mm: float) -> float:
    """X4 development manual."""
    return math.degrees(math.atan(21.8 * (155.3 - mm) / (155.3 * max(mm, 1.0))))


def ldrobot(mm: float) -> float:
    """An LD14P, by its SDK."""
    return -math.degrees(math.atan((0.11923 * mm - 18.975571) / (mm + 5.9)))


SENSORS = (
    Sensor("RPLIDAR A1 standard", 360.0 * 5.5 * 508e-6, 508e-6, slamtec),
    Sensor(
        "RPLIDAR A1 express", 360.0 * 5.5 * 254e-6, 254e-6, lambda mm: round(8 * slamtec(mm)) / 8
    ),
    Sensor("YDLIDAR X4", 360.0 * 7.0 / 5000.0, 1 / 5000.0, ydlidar),
    Sensor("LD14P", 360.0 * 6.0 / 4000.0, 1 / 4000.0, ldrobot),
    Sensor("LD19", 0.8, 1 / 4500.0, lambda _: 0.0),
)


class Error(NamedTuple):
    """Of all echoes of one reading."""

    beside_m: Floats
    turned_deg: float
    missing: float

    @property
    def figures(self) -> tuple[float, float, float, float, float]:
        """Median and 95th percentile [mm], turn [deg], shares in the air and missing [%]."""
        beside = np.abs(self.beside_m)
        middle, most = np.percentile(beside[beside < IN_THE_AIR_M], [50, 95])
        in_the_air = float(np.mean(beside >= IN_THE_AIR_M))
        return 1e3 * middle, 1e3 * most, self.turned_deg, 100 * in_the_air, 100 * self.missing


def polar(angle_deg: Floats, range_m: Floats, yaw: float) -> Floats:
    """Points (n, 2) of angles that grow clockwise, in the axes of the room."""
    along = yaw - np.radians(angle_deg)
    return range_m[:, None] * np.stack([np.cos(along), np.sin(along)], axis=1)


def judge(points: list[Floats], maker: list[Floats], place: Place, step_deg: float) -> Error:
    """Compare the echoes of each turn with the walls, and with the maker's of that turn."""
    beside, lever = place.beside_walls(np.concatenate(points))
    near = np.abs(beside) < IN_THE_AIR_M
    turned = (beside[near] @ lever[near]) / (lever[near] @ lever[near])
    missing = []
    for ours, theirs in zip(points, maker, strict=True):
        apart = np.hypot(*np.moveaxis(theirs[:, None] - ours, 2, 0))
        allowed = np.hypot(*theirs.T)[:, None] * math.radians(1.5 * step_deg) + 0.01
        # Along a wall seen at a flat angle two neighbours are farther apart than that.
        around = np.abs(np.angle(np.exp(1j * (_angles(theirs)[:, None] - _angles(ours)))))
        has = (apart < allowed) | (around < math.radians(0.75 * step_deg))
        missing.append(1.0 - float(has.any(axis=1).mean()))
    return Error(beside, math.degrees(turned), float(np.mean(missing)))


def _angles(points: Floats) -> Floats:
    return np.arctan2(points[:, 1], points[:, 0])


def read(sensor: Sensor, place: Place, seconds: float) -> dict[str, Error]:
    """Read one stream three times; the first and the last turn are not judged."""
    record = RECORDS[sensor.title]
    arrivals = chunks(sensor.stream(place), record.baud, seconds, 0.02)
    finder, samples = record.finder(), record.reader()
    rows = [one for _, data in arrivals for frame in finder.feed(data) for one in samples(frame)]
    angle_deg, range_m = (np.array(column, np.float64) for column in zip(*rows, strict=True))
    range_m /= 1000.0
    turn = np.cumsum(np.diff(angle_deg, prepend=angle_deg[0]) < -180.0)
    lidar = started(sensor.title)
    scans = []
    for at_s, data in arrivals:
        lidar.receive(data, round(at_s * 1e9))
        scans += lidar.take(round(at_s * 1e9)).scans
    found: dict[str, list[Floats]] = {"maker": [], "nearest beam": [], "Trolley": []}
    # A scan's beams are the sensor's turn, so the maker's samples of whole turns are those around.
    for number, scan in enumerate(scans[1:-1], start=1):
        own = range_m[turn == number + int(turn[0])], angle_deg[turn == number + int(turn[0])]
        echo = own[0] > 0.0
        found["maker"].append(polar(own[1][echo], own[0][echo], place.yaw))
        beams_deg = -np.degrees(scan.angle_min + scan.angle_increment * np.arange(len(scan.ranges)))
        apart = np.abs((own[1][:, None] - beams_deg + 180.0) % 360.0 - 180.0)
        snapped = own[0][apart.argmin(axis=0)]
        found["nearest beam"].append(
            polar(beams_deg[snapped > 0.0], snapped[snapped > 0.0], place.yaw)
        )
        ranges = scan.ranges.astype(np.float64)
        echo = np.isfinite(ranges) & (ranges > 0.0)
        found["Trolley"].append(polar(beams_deg[echo], ranges[echo], place.yaw))
    return {
        name: judge(points, found["maker"], place, sensor.step_deg)
        for name, points in found.items()
    }


def places(count: int, noise: float, seed: int = 3) -> list[Place]:
    """Random places in the room, away from walls."""
    rng = np.random.default_rng(seed)
    found: list[Place] = []
    while len(found) < count:
        x, y = rng.uniform(*ROOM_M[:2]), rng.uniform(*ROOM_M[2:])
        place = Place(x, y, rng.uniform(-math.pi, math.pi), noise, rng)
        if abs(float(place.beside_walls(np.zeros((1, 2)))[0][0])) > NEAREST_M:
            found.append(place)
    return found


def measure(sensor: Sensor, count: int, noise: float, seconds: float) -> dict[str, Error]:
    """Put the errors of one sensor in several places together."""
    errors = [read(sensor, place, seconds) for place in places(count, noise)]
    return {
        name: Error(
            np.concatenate([one[name].beside_m for one in errors]),
            float(np.mean([one[name].turned_deg for one in errors])),
            float(np.mean([one[name].missing for one in errors])),
        )
        for name in errors[0]
    }


def main() -> None:
    """Measure each sensor."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=1.5, help="of each stream")
    parser.add_argument("--places", type=int, default=6)
    parser.add_argument("--noise", type=float, nargs="+", default=[0.0, 0.003])
    options = parser.parse_args()
    for noise in options.noise:
        for sensor in SENSORS:
            found = measure(sensor, options.places, noise, options.seconds)
            for name, error in found.items():
                middle, most, turned, in_the_air, missing = error.figures
                print(
                    f"{sensor.title:20s} noise {100 * noise:.1f} %  {name:12s}"
                    f" {middle:5.2f} mm, p95 {most:5.2f} mm, turned {turned:+.3f} deg,"
                    f" in the air {in_the_air:.2f} %, missing {missing:.2f} %",
                    flush=True,
                )


if __name__ == "__main__":
    main()
