"""What the robot senses and believes: the scan, the particles, places it might be at."""

import numpy as np
import viser
from numpy.typing import NDArray

from trolley import topics
from trolley.messages import BeamClasses, Scan, floats_from_bytes
from trolley_viz.graphics.shapes import arrow_outline, flat, particle_segments, place
from trolley_viz.robots.view import View
from trolley_viz.scene.layer import Z_LABEL, Z_PARTICLES, Z_SCAN, Layer
from trolley_viz.words.sentences import percent

BEAM_COLOURS = np.array(
    [(255, 62, 32), (190, 20, 220), (0, 150, 190), (255, 170, 0), (150, 150, 150)], np.uint8
)
"""By class: on the map, not on the map, behind a mirror or glass, suspected, unused."""
PLAIN_SCAN = BEAM_COLOURS[0]
OUT_OF_SIGHT = np.full((2, 3), -1e6, np.float32)
"""Farther away than cameras see [m]."""

MAX_PARTICLES = 500
"""More say nothing more to the eye, and fill a phone's radio."""
PARTICLE_LENGTH_M = 0.12
TAIL = 0.7
"""How pale the end of a particle is that lies behind; the dark one shows where it looks."""
FAINT, STRONG = np.array((150, 214, 150)), np.array((0, 110, 20))
HEADS = np.rint(np.linspace(FAINT, STRONG, 256))
STROKES = np.stack([np.rint((1.0 - TAIL) * HEADS + TAIL * 255.0), HEADS], axis=1).astype(np.uint8)
"""Tail and head of a particle by its share of the heaviest's weight, from 0 to 255: (256, 2, 3)."""
CANDIDATE = (240, 140, 0)


class ScanLayer(Layer):
    """The echoes of the lidar, coloured by what the localizer makes of them."""

    key, title = "scan", "Laser scan"
    group = "Sensing"
    source = topics.SCAN
    needs = (topics.SCAN, topics.BEAMS)
    period_s = 0.0  # whenever one came: a pause of its own would now and then skip a scan

    def __init__(self, server: viser.ViserServer, above: str) -> None:
        super().__init__(server, above)
        self._points: viser.PointCloudHandle | None = None

    def draw(self, view: View) -> None:
        """Draw the newest scan whose beams are classified, or the newest one."""
        scan, beams = _choose(view)
        if scan is None:
            if self._points is not None:
                self._points.visible = False
            self._drawn = ()
            return
        if not self.changed(scan, beams):
            return
        ranges = floats_from_bytes(scan.ranges)
        points = view.placement.scan_points(scan, ranges)
        if points is None:
            return
        # No comparison with a range that is not a number is true.
        good = (ranges > 0.0) & (ranges >= scan.range_min) & (ranges <= scan.range_max)
        seen = np.flatnonzero(good & (ranges < np.inf))
        raised = np.full((len(seen), 3), Z_SCAN, np.float32)
        raised[:, :2] = points[seen]
        self._show(raised, _beam_colours(beams, len(ranges), seen))

    def _show(self, points: NDArray[np.float32], colours: NDArray[np.uint8]) -> None:
        if self._points is None:
            # For other colours viser makes another material, and browsers link a program for each
            # unless something else uses the same one.
            self._add("program", OUT_OF_SIGHT, BEAM_COLOURS[:2])
            self._points = self._add("points", points, colours)
            return
        with self.server.atomic():
            if len(points):
                self._points.points = points
                self._points.colors = colours
            self._points.visible = len(points) > 0

    def _add(
        self, name: str, points: NDArray[np.float32], colours: NDArray[np.uint8]
    ) -> viser.PointCloudHandle:
        return self.scene.add_point_cloud(
            self.path(name),
            points,
            colours,
            point_size=0.024,
            point_shape="circle",
            point_shading="flat",
            precision="float32",
        )


class ParticleLayer(Layer):
    """The localizer's hypotheses: the darker, the likelier."""

    key, title = "particles", "Particles"
    group = "Sensing"
    source = topics.PARTICLES
    needs = (topics.PARTICLES,)

    def __init__(self, server: viser.ViserServer, above: str) -> None:
        super().__init__(server, above)
        self._arrows: viser.LineSegmentsHandle | None = None

    def draw(self, view: View) -> None:
        """Draw the newest cloud, thinned evenly where it is very large."""
        estimate = view.streams.latest(topics.POSE)
        # While a map is made there are none, and the last ones are of another map.
        is_over = view.is_away or (estimate is not None and estimate.state == "mapping")
        cloud = None if is_over else view.streams.latest(topics.PARTICLES)
        world_T_map = view.placement.world_T("map")
        if not self.changed(cloud, world_T_map):
            return
        if cloud is None or world_T_map is None or not len(cloud.weights):
            if self._arrows is not None:
                self._arrows.visible = False
            return
        poses = floats_from_bytes(cloud.poses, 3)
        weights = floats_from_bytes(cloud.weights)
        step = -(-len(poses) // MAX_PARTICLES)
        placed = world_T_map.transform_poses(poses[::step])
        segments = particle_segments(placed, PARTICLE_LENGTH_M, Z_PARTICLES)
        colours = stroke_colours(weights[::step])
        if self._arrows is None:
            self._arrows = self.scene.add_line_segments(
                self.path("arrows"), segments, colours, thickness=1.5, thickness_units="screen"
            )
            return
        with self.server.atomic():
            self._arrows.points = segments
            self._arrows.colors = colours
            self._arrows.visible = True


class CandidateLayer(Layer):
    """The places between which a search cannot decide, with how well each matches."""

    key, title = "candidates", "Possible places"
    group = "Sensing"
    source = topics.POSE

    def __init__(self, server: viser.ViserServer, above: str) -> None:
        super().__init__(server, above)
        self._nodes: list[viser.SceneNodeHandle] = []

    def draw(self, view: View) -> None:
        """Draw an arrow and a label for each candidate."""
        estimate = view.streams.latest(topics.POSE)
        candidates = estimate.candidates if estimate is not None and not view.is_away else []
        world_T_map = view.placement.world_T("map")
        if not self.changed(world_T_map, *(_rounded(one.pose, one.match) for one in candidates)):
            return
        for node in self._nodes:
            node.remove()
        self._nodes.clear()
        if world_T_map is None:
            return
        vertices, faces = flat(arrow_outline(0.5, 0.3))
        for i, candidate in enumerate(candidates):
            pose = world_T_map @ candidate.pose
            arrow = self.scene.add_mesh_simple(
                self.path(f"arrow{i}"), vertices, faces, color=CANDIDATE, side="double"
            )
            place(arrow, pose, Z_PARTICLES)
            label = self.scene.add_label(
                self.path(f"label{i}"), percent(candidate.match), anchor="bottom-center"
            )
            place(label, pose, Z_LABEL)
            self._nodes += [arrow, label]


def stroke_colours(weights: NDArray[np.floating]) -> NDArray[np.uint8]:
    """Colour strokes by weight (n,) relative to the heaviest: tail and head, (n, 2, 3)."""
    heaviest = float(weights.max(initial=0.0))
    share = weights / heaviest if heaviest > 0.0 else np.ones_like(weights)
    return STROKES[np.nan_to_num(255.0 * np.clip(share, 0.0, 1.0)).astype(np.uint8)]


def _choose(view: View) -> tuple[Scan | None, BeamClasses | None]:
    """The scan to draw and its classes: classified ones while they keep coming."""
    if not view.is_fresh(topics.SCAN) or view.is_away:
        return None, None
    beams = view.streams.latest(topics.BEAMS) if view.is_fresh(topics.BEAMS, 0.5) else None
    if beams is not None:
        for scan in reversed(view.streams.history(topics.SCAN)):
            if scan.stamp_ns == beams.stamp_ns:
                return scan, beams
    return view.streams.latest(topics.SCAN), None


def _beam_colours(
    beams: BeamClasses | None, count: int, seen: NDArray[np.intp]
) -> NDArray[np.uint8]:
    """The colours of those of `count` beams that are seen, (n, 3)."""
    classes = None if beams is None else np.frombuffer(beams.classes, np.uint8)
    if classes is None or len(classes) != count:
        return np.broadcast_to(PLAIN_SCAN, (len(seen), 3))
    return BEAM_COLOURS[np.minimum(classes[seen], len(BEAM_COLOURS) - 1)]


def _rounded(pose: object, match: float) -> tuple[object, ...]:
    """What makes it worth drawing a candidate again."""
    return (pose, round(match, 2))
