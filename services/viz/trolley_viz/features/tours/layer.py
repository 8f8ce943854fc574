"""Tours on the map: numbered pins, the path between them, and where past trips failed."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import viser

from trolley import codes, topics
from trolley.geometry import Pose2D
from trolley.geometry.frames import MAP
from trolley.messages import Tour, TourStatus
from trolley.under_way import TRIP_UNDER_WAY
from trolley_viz.features.tours.draft import Draft, Find
from trolley_viz.graphics.pictures import pin_picture
from trolley_viz.graphics.shapes import circle, flat, open_segments
from trolley_viz.robots.past_trips import Spot, trouble_spots
from trolley_viz.robots.view import View
from trolley_viz.scene.layer import Layer
from trolley_viz.scene.map_layers import flat_quaternion
from trolley_viz.words.plain_words import said

Colour = tuple[int, int, int]

COMING: Colour = (92, 104, 122)
CURRENT: Colour = (40, 110, 245)
REACHED: Colour = (30, 158, 80)
FAILED: Colour = (214, 51, 51)
EDITED: Colour = (92, 24, 150)
CHOSEN: Colour = (226, 110, 0)
RESULT_COLOURS: Mapping[str, Colour] = {"reached": REACHED, "skipped": FAILED, "failed": FAILED}

Z_TOUR, Z_PIN = 0.05, 0.06
PIN_M, PASSED_M = 0.42, 0.07
"""Height of a numbered pin, radius of a point that is passed."""
SAME_PIN_M = 0.05
MAX_PINS = 300
SHOWN_AFTER_NS = 60_000_000_000
"""A trip that has ended stays on the map this long."""


@dataclass(frozen=True)
class Pin:
    """A stop on the map, or a point that is only passed, which has no text."""

    x: float
    y: float
    text: str
    colour: Colour


def place_finder(view: View) -> Find:
    """Where saved poses are, those of the map in use only."""
    saved, grid = view.streams.latest(topics.POSES), view.map
    poses = {
        one.name: one.pose
        for one in ([] if saved is None else saved.poses)
        if grid is None or one.map == grid.name
    }
    return poses.get


def pins_of(draft: Draft, find: Find, colour: Callable[[int, int], Colour]) -> tuple[Pin, ...]:
    """The points of a tour as pins; those whose place is unknown are left out.

    Stops in one place share a pin: "1,3", in the colour of the last.

    Args:
        draft: the tour.
        find: where places are.
        colour: the colour of a point, by its index and how many stops there are up to it.
    """
    pins: list[Pin] = []
    by_cell: dict[tuple[int, int], int] = {}
    number = 0
    for index, point in enumerate(draft.points[:MAX_PINS]):
        number += not point.passes
        where = point.where(find)
        if where is None:
            continue
        text = "" if point.passes else str(number)
        cell = round(where.x / SAME_PIN_M), round(where.y / SAME_PIN_M)
        same = by_cell.get(cell) if text else None
        if same is not None:
            pins[same] = Pin(where.x, where.y, f"{pins[same].text},{text}", colour(index, number))
            continue
        if text:
            by_cell[cell] = len(pins)
        pins.append(Pin(where.x, where.y, text, colour(index, number)))
    return tuple(pins)


def path_of(draft: Draft, find: Find) -> tuple[tuple[float, float], ...]:
    """The points of a tour in order; closed where it goes round more than once."""
    poses = [point.where(find) for point in draft.points[:MAX_PINS]]
    way = [(pose.x, pose.y) for pose in poses if pose is not None]
    if draft.repeat != 1 and not draft.there_and_back and len(way) > 2:
        way.append(way[0])
    return tuple(way)


class TourDrawing:
    """Pins and the line between them.

    Args:
        scene: says where it is drawn; None for nowhere, while a page has no picture.
        path: below which.
        raised: how far above other tours [m], so that they do not flicker into each other.
    """

    def __init__(
        self, scene: Callable[[], viser.SceneApi | None], path: str, raised: float = 0.0
    ) -> None:
        self._scene = scene
        self._path = path
        self._raised = raised
        self._nodes: list[viser.SceneNodeHandle] = []
        self._drawn: tuple[object, ...] = ()

    def show(
        self,
        pins: tuple[Pin, ...],
        way: tuple[tuple[float, float], ...],
        world_T_map: Pose2D | None,
    ) -> None:
        """Draw these; nothing where there are no pins."""
        scene = self._scene()
        now = (scene, pins, way, world_T_map)
        if now == self._drawn:
            return
        self._drawn = now
        for node in self._nodes:
            node.remove()
        self._nodes.clear()
        if scene is None or world_T_map is None or not pins:
            return
        if len(way) > 1:
            points = world_T_map.transform_points(np.array(way))
            self._nodes.append(
                scene.add_line_segments(
                    f"{self._path}/way",
                    open_segments(points, Z_TOUR + self._raised),
                    COMING,
                    thickness=0.035,
                )
            )
        for i, pin in enumerate(pins):
            x, y = world_T_map.transform_points(np.array([[pin.x, pin.y]]))[0].tolist()
            self._add(scene, i, pin, x, y)

    def _add(self, scene: viser.SceneApi, i: int, pin: Pin, x: float, y: float) -> None:
        name = f"{self._path}/pin{i}"
        if pin.text:
            self._nodes.append(
                add_pin(scene, name, pin.text, pin.colour, (x, y, Z_PIN + self._raised))
            )
            return
        disc = scene.add_mesh_simple(
            name, *flat(circle(PASSED_M)), color=pin.colour, side="double", cast_shadow=False
        )
        disc.position = (x, y, Z_PIN + self._raised)
        self._nodes.append(disc)


def add_pin(
    scene: viser.SceneApi, name: str, text: str, colour: Colour, at: tuple[float, float, float]
) -> viser.ImageHandle:
    """Add a numbered pin that lies flat at x, y, z [m]."""
    picture = pin_picture(text, colour)
    height, width = picture.shape[:2]
    return scene.add_image(
        name,
        picture,
        PIN_M * width / height,
        PIN_M,
        format="png",
        wxyz=flat_quaternion(0.0),
        position=at,
        cast_shadow=False,
        receive_shadow=False,
    )


class TripLayer(Layer):
    """The tour under way: what it reached is green, what failed is red."""

    key, title = "trip", "Tour under way"
    group = "Driving"

    def __init__(self, server: viser.ViserServer, above: str) -> None:
        super().__init__(server, above)
        self._drawing = TourDrawing(lambda: self.scene, self.root)
        self._ended: tuple[str | None, int] = (None, 0)

    def draw(self, view: View) -> None:
        """Draw the trip while it is under way, and a while longer."""
        trip = view.streams.latest(topics.TOUR)
        tour = None if trip is None else tour_of(trip, view)
        if trip is None or tour is None or not self._is_shown(trip, view.now_ns):
            self._drawing.show((), (), None)
            return
        draft, find, colours = Draft.of(tour), place_finder(view), trip_colours(trip)

        def colour(index: int, number: int) -> Colour:
            return COMING if draft.points[index].passes else colours.get(number - 1, COMING)

        pins = pins_of(draft, find, colour)
        self._drawing.show(pins, path_of(draft, find), view.placement.world_T(MAP))

    def _is_shown(self, trip: TourStatus, now_ns: int) -> bool:
        if trip.state in TRIP_UNDER_WAY:
            self._ended = (trip.trip, 0)
            return True
        known, ended_ns = self._ended
        if known != trip.trip or known is None:
            return False  # it ended before anybody looked
        if ended_ns == 0:
            ended_ns = now_ns
            self._ended = (known, now_ns)
        return now_ns - ended_ns < SHOWN_AFTER_NS


def tour_of(trip: TourStatus, view: View) -> Tour | None:
    """The tour of a trip: as it says itself, else the stored one of its name."""
    if trip.tour is not None or trip.name is None:
        return trip.tour
    tours = view.streams.latest(topics.TOURS)
    stored = [] if tours is None else tours.tours
    return next((one for one in stored if one.name == trip.name), None)


def trip_colours(trip: TourStatus) -> dict[int, Colour]:
    """The colours of the stops of a trip that have one: how each ended last, and the present."""
    colours = {result.stop: RESULT_COLOURS[result.state] for result in trip.results}
    if trip.stop is not None and trip.state in ("driving", "waiting", "paused"):
        colours[trip.stop] = CURRENT
    return colours


class TroubleLayer(Layer):
    """Where past trips failed."""

    key, title = "trouble", "Where trips failed"
    group = "Driving"
    period_s = 1.0
    on_by_default = False

    def __init__(self, server: viser.ViserServer, above: str) -> None:
        super().__init__(server, above)
        self._nodes: list[viser.SceneNodeHandle] = []

    def draw(self, view: View) -> None:
        """Draw a pin for each spot, with how often and why."""
        view.past.refresh(view.streams.latest(topics.TOUR), view.now_ns)
        grid, world_T_map = view.map, view.placement.world_T(MAP)
        if not self.changed(view.past.trips, grid, world_T_map):
            return
        for node in self._nodes:
            node.remove()
        self._nodes.clear()
        if grid is None or world_T_map is None:
            return
        for i, spot in enumerate(trouble_spots(view.past.trips or (), grid.name)):
            pose = world_T_map @ spot.pose
            at = (pose.x, pose.y, Z_PIN)
            pin = add_pin(self.scene, self.path(f"spot{i}"), str(spot.count), FAILED, at)
            label = self.scene.add_label(
                self.path(f"why{i}"),
                spot_text(spot),
                position=(pose.x, pose.y - 0.5 * PIN_M, Z_PIN),
                anchor="top-center",
                font_screen_scale=0.8,
            )
            self._nodes += [pin, label]


def spot_text(spot: Spot) -> str:
    """Say what happened last at a spot: "kitchen: There is no path there."."""
    result = spot.newest
    name = result.name or f"stop {result.stop + 1}"
    why = said("" if result.code in codes.SENTENCES else result.message, result.code)
    return f"{name}: {why}"


def edited_colours(chosen: int | None) -> Callable[[int, int], Colour]:
    """The colours of a tour that is edited."""
    return lambda index, _: CHOSEN if index == chosen else EDITED
