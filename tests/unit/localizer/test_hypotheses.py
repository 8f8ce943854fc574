"""When a place stands out, and when a rival takes over."""

import numpy as np
import pytest
from numpy.typing import NDArray

from trolley.config.localizer import LocalizerConfig
from trolley.geometry import Pose2D
from trolley.gridmap import GridMap
from trolley_localizer.core import make_lines
from trolley_localizer.field import LikelihoodField, build_field
from trolley_localizer.hypotheses import Hypotheses, Rivals
from trolley_localizer.scan import BeamSet, read_beams
from trolley_localizer.search import Place, places_around
from trolley_localizer.verify import THROUGH_WEIGHT, Support, Verifier

from .conftest import at, make_scan

CONFIG = LocalizerConfig()
STEP = Pose2D(0.2, 0.0, 0.0)


class View:
    """A robot in the flat that drives straight on, seen by the scan of each step."""

    def __init__(self, grid: GridMap) -> None:
        self.grid = grid
        self.field: LikelihoodField = build_field(grid, CONFIG)
        self.verifier = Verifier(self.field, make_lines(self.field, []), CONFIG)
        self.pose = at(grid, 5.0, 4.0, 0.4)

    @property
    def cells(self) -> NDArray[np.float64]:
        return self.field.to_cells(self.pose)

    def beams(self) -> BeamSet:
        scan = make_scan(self.grid, self.pose, Pose2D.identity())
        return read_beams(scan, self.field.resolution, CONFIG.max_range_m)

    def place(self, pose: NDArray[np.float64], value: float, match: float = 0.9) -> Place:
        return Place(pose, Support(match, 0.0, 300, value))


@pytest.fixture
def view(flat: GridMap) -> View:
    return View(flat)


def test_beams_through_walls_count_more_than_ends_that_fit() -> None:
    fits_but_contradicts = Support(0.85, 0.3, 300, 0.85)
    fits_less = Support(0.6, 0.05, 300, 0.6)
    assert fits_less.value > fits_but_contradicts.value
    assert fits_less.value == pytest.approx(0.6 - THROUGH_WEIGHT * 0.05)


def test_what_one_view_explains_poorly_needs_more_views(view: View) -> None:
    places = Hypotheses(view.field, view.verifier, CONFIG)
    places.start([view.place(view.cells, 0.65, match=0.7)])
    assert places.winner() is None
    places.start([view.place(view.cells, 0.65, match=0.9)])
    assert places.winner() is not None


def test_places_far_behind_the_estimate_are_no_rivals(view: View) -> None:
    rivals = Rivals(view.field, view.verifier, CONFIG)
    rivals.start([view.place(view.cells, 0.6)], 0.9)
    assert not rivals.exist
    rivals.start([view.place(view.cells, 0.85)], 0.9)
    assert rivals.exist
    assert rivals.winner() is None


def test_a_rival_takes_over_when_its_lead_has_added_up(view: View) -> None:
    rivals = Rivals(view.field, view.verifier, CONFIG)
    rivals.start([view.place(view.cells, 0.5)], 0.5)
    elsewhere = view.field.to_cells(view.pose @ Pose2D(2.0, 0.0, 1.0))
    views = 0
    while rivals.winner() is None:
        rivals.move(STEP)
        view.pose = view.pose @ STEP
        rivals.look(view.beams(), elsewhere, 0.75)
        views += 1
        assert views < 5
    assert views > 1
    winner = rivals.winner()
    assert winner is not None
    assert view.field.to_map(winner.pose).distance_to(view.pose) < 0.1


def test_a_standing_robot_changes_nothing_in_the_sum(view: View) -> None:
    rivals = Rivals(view.field, view.verifier, CONFIG)
    rivals.start([view.place(view.cells, 0.5)], 0.5)
    elsewhere = view.field.to_cells(view.pose @ Pose2D(2.0, 0.0, 1.0))
    for _ in range(20):
        rivals.look(view.beams(), elsewhere, 0.0)
    assert rivals.lead == pytest.approx(0.0)


def test_a_rival_that_comes_to_the_estimate_is_none(view: View) -> None:
    rivals = Rivals(view.field, view.verifier, CONFIG)
    rivals.start([view.place(view.cells, 0.9)], 0.9)
    rivals.look(view.beams(), view.cells, 0.9)
    assert not rivals.exist


def test_the_right_place_is_found_from_half_a_metre_away(view: View) -> None:
    off = view.field.to_cells(view.pose @ Pose2D(0.5, -0.4, 0.2))
    places = places_around(off, view.field, view.beams(), view.verifier)
    best = max(places, key=lambda place: place.support.value)
    assert view.field.to_map(best.pose).distance_to(view.pose) < 0.05
