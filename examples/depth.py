"""A depth camera as an extra sensor: obstacles above the floor, and where the floor ends.

    python examples/depth.py front --focal 431 431 --centre 320 200 --height 0.25 --tilt 20

Depth images come from another program, over Zenoh: an array as `numpy.save` writes it, (rows,
columns), float in metres along the optical axis or whole numbers in millimetres, 0 where nothing
was measured, put under `trolley/<robot>/depth/<name>`. What comes of them is published as
`scan/<name>`, which `[base.scans.<name>]` in robot.toml makes stop the robot
(docs/extra-sensors.md). Its
frame lies on the floor below the camera, x straight ahead.

A hole that sends nothing back, such as a deep dark stairwell, is not known to be one.
"""

import argparse
import io
import json
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley import Robot, topics
from trolley.messages import Scan, floats_to_bytes

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Camera:
    """A depth camera, and how it sits."""

    focal: tuple[float, float]
    """Focal lengths along columns and rows [pixels]."""
    centre: tuple[float, float]
    """Column and row of the optical axis."""
    height: float
    """Of the camera above the floor [m]."""
    tilt: float = 0.0
    """By how much it looks down [rad]."""
    roll: float = 0.0
    """By how much it is turned about its axis, clockwise as it sees it [rad]."""


@dataclass(frozen=True)
class Judgement:
    """What counts as an obstacle or as a cliff; set by hand for stereo cameras."""

    rough: float = 0.025
    """What lies within this of the floor is floor, at the camera's feet [m]."""
    rough_per_m2: float = 0.02
    """By how much more with the square of the distance, as errors of stereo depth grow [m/m2]."""
    cliff: float = 0.03
    """A step down of this much beyond that is a cliff [m]."""
    top: float = 0.6
    """What is higher than the robot does not count [m]."""
    far: float = 3.0
    """Farther away nothing is judged [m]."""
    least: int = 5
    """So many pixels of a direction must agree; fewer are noise."""
    known: float = 0.5
    """Share of the pixels towards the floor which must be measured for it to be known free."""
    step: float = math.radians(1.0)
    """From beam to beam [rad]."""


class DepthScanner:
    """Makes scans of depth images of one shape.

    Args:
        camera: the camera.
        shape: rows and columns of its images.
        judgement: what counts as what.
    """

    def __init__(
        self, camera: Camera, shape: tuple[int, int], judgement: Judgement | None = None
    ) -> None:
        self._camera = camera
        self._judgement = judgement or Judgement()
        rows, columns = np.mgrid[: shape[0], : shape[1]]
        right = (columns - camera.centre[0]) / camera.focal[0]
        down = (rows - camera.centre[1]) / camera.focal[1]
        cos, sin = math.cos(camera.roll), math.sin(camera.roll)
        right, down = cos * right - sin * down, sin * right + cos * down
        # Where each pixel looks for a metre of depth: ahead, left and up, the horizon level.
        ahead = math.cos(camera.tilt) - math.sin(camera.tilt) * down
        self._up = -math.sin(camera.tilt) - math.cos(camera.tilt) * down
        self._along = np.hypot(ahead, right)
        bearing = np.arctan2(-right, ahead)
        step = self._judgement.step
        self._first = math.floor(float(bearing.min()) / step) * step
        self._beam = np.rint((bearing - self._first) / step).astype(np.int64)
        self._num_beams = int(self._beam.max()) + 1
        # Where it meets the floor, if it looks down.
        with np.errstate(divide="ignore"):
            meets = np.where(self._up < 0.0, camera.height * self._along / -self._up, math.inf)
        self._floor = meets
        self._looks_at_floor = meets < self._judgement.far
        nearest = np.full(self._num_beams, math.inf)
        np.minimum.at(nearest, self._beam.ravel(), meets.ravel())
        seen = nearest[np.isfinite(nearest)]
        self.range_min = float(np.median(seen)) if len(seen) else self._judgement.far
        """The nearest floor in the picture [m]: what lies nearer may be overlooked."""

    def ranges(self, depth: Floats) -> Floats:
        """Return how far it is free in each direction [m]: +inf nothing, 0 not known.

        Args:
            depth: (rows, columns) [m] along the optical axis; 0 or not finite: not measured.
        """
        judge = self._judgement
        is_measured = np.isfinite(depth) & (depth > 0.0)
        depth = np.where(is_measured, depth, 0.0)
        away, height = depth * self._along, self._camera.height + depth * self._up
        rough = judge.rough + judge.rough_per_m2 * np.minimum(away, self._floor) ** 2
        is_thing = is_measured & (height > rough) & (height < judge.top) & (away < judge.far)
        # Seen through where the floor should be: there it ends.
        is_cliff = is_measured & self._looks_at_floor & (height < -rough - judge.cliff)
        things = self._nearest(is_thing, away)
        cliffs = self._nearest(is_cliff, self._floor)
        towards = np.bincount(self._beam[self._looks_at_floor], minlength=self._num_beams)
        is_known = self._looks_at_floor & is_measured
        known = np.bincount(self._beam[is_known], minlength=self._num_beams)
        is_free = (known >= judge.least) & (known >= judge.known * towards)
        echoes = np.minimum(things, cliffs)
        return np.where(np.isfinite(echoes), echoes, np.where(is_free, math.inf, 0.0))

    def scan(self, depth: Floats, stamp_ns: int, frame: str) -> Scan:
        """Return a depth image [m] as a scan."""
        return Scan(
            stamp_ns=stamp_ns,
            frame=frame,
            angle_min=self._first,
            angle_increment=self._judgement.step,
            time_increment=0.0,
            range_min=self.range_min,
            range_max=self._judgement.far,
            ranges=floats_to_bytes(self.ranges(depth)),
        )

    def _nearest(self, counts: NDArray[np.bool_], away: Floats) -> Floats:
        """Return the distance at which so many pixels of each beam agree, +inf for none."""
        beam, distance = self._beam[counts], away[counts]
        order = np.lexsort((distance, beam))
        beam, distance = beam[order], distance[order]
        number = np.bincount(beam, minlength=self._num_beams)
        found = np.full(self._num_beams, math.inf)
        enough = np.flatnonzero(number >= self._judgement.least)
        first = np.cumsum(number) - number
        found[enough] = distance[first[enough] + self._judgement.least - 1]
        return found


def metres(image: NDArray[np.generic]) -> Floats:
    """Return a depth image in metres; whole numbers are millimetres.

    Raises:
        ValueError: it is no depth image.
    """
    if image.ndim != 2 or image.dtype.kind not in "uif":
        raise ValueError(f"a depth image has rows and columns of numbers, not {image.shape}")
    values = image.astype(np.float64)
    return values if image.dtype.kind == "f" else values / 1000.0


def main() -> None:
    """Turn the depth images of one camera into scans until it is ended."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("name", help="of the sensor, as in [base.scans.NAME]")
    parser.add_argument("--focal", type=float, nargs=2, required=True, help="fx fy [pixels]")
    parser.add_argument("--centre", type=float, nargs=2, required=True, help="cx cy [pixels]")
    parser.add_argument("--height", type=float, required=True, help="above the floor [m]")
    parser.add_argument("--tilt", type=float, default=0.0, help="looks down by this [degrees]")
    parser.add_argument("--roll", type=float, default=0.0, help="turned clockwise [degrees]")
    given = parser.parse_args()
    import zenoh  # what `trolley` itself talks with

    camera = Camera(
        tuple(given.focal),
        tuple(given.centre),
        given.height,
        math.radians(given.tilt),
        math.radians(given.roll),
    )
    scanners: dict[tuple[int, ...], DepthScanner] = {}
    settings = zenoh.Config()
    settings.insert_json5("mode", '"client"')
    with Robot() as robot:
        settings.insert_json5("connect/endpoints", json.dumps(robot.connection.endpoints))
        key = f"trolley/{robot.name}/depth/{given.name}"
        newest = zenoh.handlers.RingChannel(1)
        with (
            zenoh.open(settings) as session,
            session.declare_subscriber(key, newest) as images,
        ):
            for image in images:
                stamp_ns = robot.now_ns()
                try:
                    depth = metres(np.load(io.BytesIO(image.payload.to_bytes())))
                except ValueError as error:
                    print(f"{key}: {error}")
                    continue
                if depth.shape not in scanners:
                    scanners[depth.shape] = DepthScanner(camera, depth.shape)
                if stamp_ns is not None:
                    scan = scanners[depth.shape].scan(depth, stamp_ns, given.name)
                    robot.publish(topics.EXTRA_SCAN, scan, given.name)


if __name__ == "__main__":
    main()
