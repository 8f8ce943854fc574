"""When a place stands out, and when a rival takes over."""

import numpy as np
import pytest
from numpy.typing import NDArray

from trolley.config.localizer import LocalizerConfig
from trolley.geometry import Pose2D
from trolley.gridmap import FREE, OCCUPIED, GridMap
from trolley_localizer.matching.global_search import Place, places_around
from trolley_localizer.matching.hypotheses import Hypotheses, Hypothesis, hypothesis_at
from trolley_localizer.matching.likelihood_field import LikelihoodField, build_field, make_lines
from trolley_localizer.matching.map_matcher import BeamSet, MapMatcher, MatchScore, read_beams
from trolley_localizer.matching.proof import PROOF, Proof, Sight, evidence_of
from trolley_localizer.matching.rivals import RIVALS, Rivals
from trolley_localizer.matching.seen_surface import NewSurface, SeenSurface
from trolley_localizer.tracking.states import Searching

from .conftest import at, make_house, make_scan

CONFIG = LocalizerConfig()
STEP = Pose2D(0.2, 0.0, 0.0)
SOFA = np.s_[90:104, 120:150]


def score_of(value: float, through: float = 0.0, astray: float = 0.0) -> MatchScore:
    """A score of which all beams end where the map knows what is there."""
    return MatchScore(
        match=value,
        through=through,
        astray=astray,
        beyond=0.0,
        known=1.0,
        beams=300,
        score=value,
        known_score=value,
    )


class View:
    """A robot in the flat that drives straight on, seen by the scan of each step.

    Args:
        grid: what stands there.
        known: the map, if it is another.
    """

    def __init__(self, grid: GridMap, known: GridMap | None = None) -> None:
        self.grid = grid
        self.field: LikelihoodField = build_field(known or grid, CONFIG)
        self.matcher = MapMatcher(self.field, make_lines(self.field, []), CONFIG)
        self.pose = at(grid, 5.0, 4.0, 0.4)

    @property
    def cells(self) -> NDArray[np.float64]:
        return self.field.to_cells(self.pose)

    def beams(self) -> BeamSet:
        scan = make_scan(self.grid, self.pose, Pose2D.identity())
        return read_beams(scan, self.field.resolution, CONFIG.max_range_m)

    def place(self, pose: NDArray[np.float64], value: float) -> Place:
        return Place(pose, score_of(value))


@pytest.fixture
def view(flat: GridMap) -> View:
    return View(flat)


def test_beams_that_end_nowhere_behind_a_wall_count_most() -> None:
    taken_away = score_of(0.85, through=0.1)
    impossible = score_of(0.85, astray=0.1)
    unexplained = score_of(0.75)
    assert taken_away.value > unexplained.value > impossible.value


def test_furniture_that_was_taken_away_is_told_from_a_wrong_place(flat: GridMap) -> None:
    without = flat.cells.copy()
    without[SOFA] = FREE
    assert (without != flat.cells).any()
    robot = View(GridMap(flat.name, flat.resolution, flat.origin, without), known=flat)
    support = robot.matcher.score(robot.cells, robot.beams())
    assert support.through > 0.02
    assert support.astray < 0.01
    beside = robot.field.to_cells(robot.pose @ Pose2D(0.0, 0.6, 0.3))
    assert robot.matcher.score(beside, robot.beams()).astray > 0.05


def test_a_place_that_is_explained_poorly_needs_twice_the_lead(view: View) -> None:
    places = Hypotheses(view.field, view.matcher, CONFIG)
    elsewhere = view.field.to_cells(view.pose @ Pose2D(2.0, 0.0, 1.0))
    lead = 1.5 * CONFIG.search_margin
    for value, stands_out in ((0.5, False), (0.7, True)):
        near, far = view.place(view.cells, value), view.place(elsewhere, value - lead)
        places.clear()
        places.add([hypothesis_at(near), hypothesis_at(far)])
        assert (places.winner() is not None) is stands_out


def test_places_far_behind_the_estimate_are_no_rivals(view: View) -> None:
    rivals = Rivals(view.field, view.matcher, CONFIG)
    rivals.add([view.place(view.cells, 0.6)], 0.9)
    assert not rivals.exist
    rivals.add([view.place(view.cells, 0.85)], 0.9)
    assert rivals.exist
    assert rivals.winner() is None


def test_a_rival_that_the_next_search_overlooks_is_not_forgotten(view: View) -> None:
    rivals = Rivals(view.field, view.matcher, CONFIG)
    rivals.add([view.place(view.cells, 0.85)], 0.9)
    rivals.add([], 0.9)
    assert rivals.exist


def test_one_view_does_not_give_up_a_rival_that_was_ahead_before(view: View) -> None:
    rivals = Rivals(view.field, view.matcher, CONFIG)
    value = view.matcher.score(view.cells, view.beams()).value
    rivals.add([view.place(view.cells, value)], value)
    elsewhere = view.field.to_cells(view.pose @ Pose2D(2.0, 0.0, 1.0))

    def drive(own: float) -> None:
        rivals.predict(STEP)
        view.pose = view.pose @ STEP
        beams = view.beams()
        rivals.update(beams, elsewhere, view.matcher.score(view.cells, beams).value + own)

    drive(-0.05)
    drive(1.5 * RIVALS.margin)
    assert rivals.exist
    for _ in range(5):
        drive(2.0 * RIVALS.margin)
    assert not rivals.exist


def test_what_fits_better_for_a_while_lets_no_rival_of_hundreds_of_views_take_over(
    view: View,
) -> None:
    """Two flats alike differ by what was moved in one of them."""
    rivals = Rivals(view.field, view.matcher, CONFIG)
    value = view.matcher.score(view.cells, view.beams()).value
    rivals.add([view.place(view.cells, value)], value)
    elsewhere = view.field.to_cells(view.pose @ Pose2D(2.0, 0.0, 1.0))
    for number in range(330):
        step = Pose2D(0.4 if number % 2 else -0.4, 0.0, 0.0)
        rivals.predict(step)
        view.pose = view.pose @ step
        beams = view.beams()
        better = 0.05 if number >= 300 else 0.0
        rivals.update(beams, elsewhere, view.matcher.score(view.cells, beams).value - better)
        assert rivals.winner() is None
    assert 330 * rivals.mean_lead > 3.0 * RIVALS.take_over


def test_a_place_that_the_next_search_overlooks_is_not_forgotten(view: View) -> None:
    searching = Searching(Hypotheses(view.field, view.matcher, CONFIG))
    elsewhere = view.field.to_cells(view.pose @ Pose2D(2.0, 0.0, 1.0))
    searching.take_result([view.place(view.cells, 0.8), view.place(elsewhere, 0.8)])
    assert searching.places.winner() is None
    searching.take_result([view.place(elsewhere, 0.8)])
    assert len(searching.places.items) == 2
    assert searching.places.winner() is None


NUM_ROOMS, ROOM_M = 6, 4.0


class Rooms:
    """A row of rooms that are all alike; the robot is in the first."""

    def __init__(self) -> None:
        room = np.full((80, 80), FREE, np.int8)
        room[:2] = room[-2:] = room[:, :2] = room[:, -2:] = OCCUPIED
        room[50:60, 20:30] = OCCUPIED
        grid = GridMap("rooms", 0.05, Pose2D.identity(), np.tile(room, (1, NUM_ROOMS)))
        self.view = View(grid)
        self.view.pose = Pose2D(2.0, 1.2, 0.4)
        self.places = Hypotheses[Hypothesis](self.view.field, self.view.matcher, CONFIG)

    def pose_in(self, number: int, beside_m: float = 0.0) -> NDArray[np.float64]:
        """Where the robot would be in a room [cells, rad]."""
        x, y, yaw = self.view.pose.as_array()
        return self.view.field.to_cells(Pose2D(x + number * ROOM_M + beside_m, y, yaw))

    def place(self, pose: NDArray[np.float64], value: float) -> Hypothesis:
        return hypothesis_at(self.view.place(pose, value))

    def update(self) -> int:
        """Take one scan into account; returns with how many places it was compared."""
        before = [item.pose for item in self.places.items]
        self.places.update(self.view.beams())
        after = [id(item.pose) for item in self.places.items]
        return sum(id(pose) not in after for pose in before)


@pytest.fixture
def rooms() -> Rooms:
    return Rooms()


def test_a_new_view_is_compared_with_all_places_and_other_scans_with_few_of_them_in_turn(
    rooms: Rooms,
) -> None:
    poses = [rooms.pose_in(number) for number in range(NUM_ROOMS)]
    rooms.places.add([rooms.place(pose, 0.9) for pose in poses])
    start = [item.pose for item in rooms.places.items]
    for _ in range(2 * NUM_ROOMS):
        assert rooms.update() == 3
    assert not {id(pose) for pose in start} & {id(item.pose) for item in rooms.places.items}
    rooms.places.predict(STEP)
    rooms.view.pose = rooms.view.pose @ STEP
    rooms.places.update(rooms.view.beams())
    assert [item.votes.views for item in rooms.places.items] == [2] * NUM_ROOMS


def test_the_best_two_places_have_been_compared_with_the_newest_scan(rooms: Rooms) -> None:
    """Where those that were ahead fall behind, the field is not left to what an old scan said."""
    ahead = [rooms.place(rooms.pose_in(number, beside_m=0.9), 0.95) for number in (0, 1)]
    others = [rooms.place(rooms.pose_in(number), 0.9) for number in (2, 3, 4)]
    rooms.places.add([*ahead, *others])
    rooms.update()
    best = rooms.places.items[:2]
    assert not any(item is one for item in best for one in ahead)
    supports = [rooms.view.matcher.score(item.pose, rooms.view.beams()).value for item in best]
    assert [item.votes.latest for item in best] == pytest.approx(supports)


def test_a_rival_takes_over_when_its_lead_has_added_up(view: View) -> None:
    rivals = Rivals(view.field, view.matcher, CONFIG)
    rivals.add([view.place(view.cells, 0.5)], 0.5)
    elsewhere = view.field.to_cells(view.pose @ Pose2D(2.0, 0.0, 1.0))
    views = 0
    while rivals.winner() is None:
        rivals.predict(STEP)
        view.pose = view.pose @ STEP
        rivals.update(view.beams(), elsewhere, 0.75)
        views += 1
        assert views < 5
    assert views > 1
    winner = rivals.winner()
    assert winner is not None
    assert view.field.to_map(winner.pose).distance_to(view.pose) < 0.1


def test_a_rival_takes_over_only_where_it_fits_better_than_what_says_nothing(view: View) -> None:
    rivals = Rivals(view.field, view.matcher, CONFIG)
    value = view.matcher.score(view.cells, view.beams()).value
    rivals.add([view.place(view.cells, value)], value)
    elsewhere = view.field.to_cells(view.pose @ Pose2D(2.0, 0.0, 1.0))

    def drive(step: Pose2D, better: float) -> None:
        rivals.predict(step)
        view.pose = view.pose @ step
        beams = view.beams()
        rivals.update(beams, elsewhere, view.matcher.score(view.cells, beams).value - better)

    for number in range(150):  # there and back
        drive(Pose2D(0.4 if number % 2 else -0.4, 0.0, 0.0), 0.005)
        assert rivals.winner() is None
    assert 150 * rivals.mean_lead > RIVALS.take_over
    for number in range(8):
        drive(Pose2D(0.4 if number % 2 else -0.4, 0.0, 0.0), 0.2)
    assert rivals.winner() is not None


def test_all_scans_of_one_view_together_have_one_vote(view: View) -> None:
    rivals = Rivals(view.field, view.matcher, CONFIG)
    rivals.add([view.place(view.cells, 0.5)], 0.5)
    elsewhere = view.field.to_cells(view.pose @ Pose2D(2.0, 0.0, 1.0))
    for _ in range(20):
        rivals.update(view.beams(), elsewhere, 0.5)
    value = view.matcher.score(view.cells, view.beams()).value
    assert rivals.mean_lead == pytest.approx(20.0 / 21.0 * (value - 0.5), abs=0.02)


def test_a_rival_that_comes_to_the_estimate_is_none(view: View) -> None:
    rivals = Rivals(view.field, view.matcher, CONFIG)
    rivals.add([view.place(view.cells, 0.9)], 0.9)
    rivals.update(view.beams(), view.cells, 0.9)
    assert not rivals.exist


def test_the_right_place_is_found_from_half_a_metre_away(view: View) -> None:
    off = view.field.to_cells(view.pose @ Pose2D(0.5, -0.4, 0.2))
    places = places_around(off, view.field, view.beams(), view.matcher)
    best = max(places, key=lambda place: place.support.value)
    assert view.field.to_map(best.pose).distance_to(view.pose) < 0.05


def drive_on(proof: Proof, support: float, views: int, pinned: float = 0.3) -> None:
    for _ in range(views):
        proof.predict(STEP)
        assert proof.is_due
        proof.add(support - PROOF.between, pinned)


def test_a_well_supported_place_is_proven_at_once_a_middling_one_by_driving_on() -> None:
    proof = Proof()
    proof.add(0.85 - PROOF.between, 0.3)
    assert proof.is_right
    proof = Proof()
    proof.add(0.72 - PROOF.between, 0.3)
    assert not proof.is_right
    assert not proof.is_due, "the same view again says nothing more"
    drive_on(proof, 0.72, 3)
    assert proof.is_right


def test_what_fits_on_foreign_maps_is_dropped_within_two_metres() -> None:
    for support in (0.47, 0.6, 0.66):
        proof = Proof()
        drive_on(proof, support, 12)
        assert not proof.is_right
        assert proof.is_against or proof.is_overdue


def robot_at(grid: GridMap, known: GridMap, x: float) -> View:
    robot = View(grid, known)
    robot.pose = Pose2D(x, 2.5, 0.0)
    return robot


def seen_room(beams: int | None = None) -> SeenSurface:
    """What a scan in the house shows, or that many of its beams."""
    robot = robot_at(make_house(), make_house(), 2.0)
    scan, seen = robot.beams(), SeenSurface(robot.field)
    seen.add(robot.cells, scan.only(scan.classes, scan.used[:beams]))
    return seen


def sights(grid: GridMap, known: GridMap) -> list[Sight]:
    """What a robot sees that drives from the left room of a house into the right one."""
    robots = [robot_at(grid, known, x) for x in np.arange(2.0, 9.0, 0.2)]
    beams = [robot.beams() for robot in robots]
    return [
        Sight(robot.matcher, robot.cells, seen, robot.matcher.score(robot.cells, seen))
        for robot, seen in zip(robots, beams, strict=True)
    ]


def first_half(house: GridMap) -> GridMap:
    """Another house: the left room is the same, the right one is not."""
    cells = house.cells.copy()
    cells[:, 132:] = OCCUPIED
    for r0, r1, c0, c1 in ((40, 60, 132, 150), (2, 98, 150, 170), (80, 98, 170, 258)):
        cells[r0:r1, c0:c1] = FREE
    return GridMap("another", house.resolution, house.origin, cells)


def on_probation(known: GridMap, passing: list[Sight]) -> Proof:
    """A proof that came out at the first sight."""
    proof = Proof(seen=SeenSurface(View(known).field))
    proof.look(passing[0])
    assert proof.is_right
    assert proof.put_on_probation()
    return proof


def test_a_room_alike_is_taken_back_for_what_comes_into_view_behind_its_door() -> None:
    house = make_house()
    known = first_half(house)
    passing = sights(house, known)
    proof = on_probation(known, passing)
    supports: list[float] = []
    for sight in passing[1:]:
        proof.inspect(sight)
        supports.append(sight.score.tracked)
        if proof.is_taken_back:
            break
    assert proof.is_taken_back
    assert min(supports) > CONFIG.poor_support, "by its support it would be believed"


def test_the_right_place_passes_though_furniture_was_moved() -> None:
    house = make_house()
    cells = house.cells.copy()
    for r0, r1, c0, c1 in ((2, 22, 30, 50), (70, 98, 200, 214), (2, 30, 160, 175)):
        cells[r0:r1, c0:c1] = FREE
        cells[r0:r1, c0 + 12 : c1 + 12] = OCCUPIED
    known = GridMap("before", house.resolution, house.origin, cells)
    passing = sights(house, known)
    proof = on_probation(known, passing)
    for sight in passing[1:]:
        proof.inspect(sight)
        assert not proof.is_taken_back
    assert proof.has_passed


def test_one_look_at_what_is_not_as_the_map_says_takes_no_place_back() -> None:
    """Furniture that was moved shows behind it what none has seen."""
    house = make_house()
    proof = on_probation(house, sights(house, house))
    proof.inspect_new(NewSurface(amount=0.2, agreement=0.0))
    assert not proof.is_taken_back
    proof.inspect_new(NewSurface(amount=0.2, agreement=0.0))
    assert proof.is_taken_back


def test_who_stands_in_front_of_a_wall_that_was_seen_shows_nothing_new() -> None:
    house = make_house()
    crowded = GridMap("crowded", house.resolution, house.origin, house.cells.copy())
    crowded.cells[40:60, 70:74] = OCCUPIED
    field = View(house).field
    seen = SeenSurface(field)
    for grid in (house, crowded):
        robot = robot_at(grid, house, 2.0)
        new = seen.add(robot.cells, robot.beams())
    assert new.amount == 0.0


def test_views_of_the_same_walls_add_up_to_no_more_than_the_best_of_them() -> None:
    """A room of the same shape in another house had a support of 0.79, with a usual lead."""
    proof = Proof(seen=seen_room())
    drive_on(proof, 0.79, 50)
    assert not proof.is_right


def test_the_lead_over_a_place_that_was_given_up_is_the_one_it_had(view: View) -> None:
    far = view.cells + np.array([40.0, 0.0, 0.0])
    places = Hypotheses[Hypothesis](view.field, view.matcher, CONFIG)
    for support in (0.6, 0.45):
        places.clear()
        places.add(
            [hypothesis_at(view.place(view.cells, 0.8)), hypothesis_at(view.place(far, support))]
        )
        assert places.lead == pytest.approx(0.8 - support)


def test_two_walls_and_their_corner_prove_no_place() -> None:
    """They fit into any corner of any house."""
    for beams, is_right in ((None, True), (60, False)):
        proof = Proof(seen=seen_room(beams))
        proof.begin(0.98 - PROOF.between, pinned=0.26)
        assert proof.is_right is is_right


def test_a_place_that_stands_alone_is_proven_at_once_though_much_stands_about() -> None:
    seen = seen_room()
    for lead, is_right in ((0.35, True), (0.1, False)):
        proof = Proof(seen=seen, lead=lead)
        proof.begin(0.79 - PROOF.between, pinned=0.14)
        assert proof.is_right is is_right


def test_a_room_proves_a_place_without_any_like_it_and_none_with_others_close_behind() -> None:
    seen = seen_room()
    alone, among = Proof(seen=seen, lead=0.7), Proof(seen=seen, lead=0.11)
    drive_on(alone, support=0.72, views=6)
    assert alone.is_right
    # A room of another floor between the same outer walls had this much, scan after scan.
    drive_on(among, support=0.79, views=20)
    assert not among.is_right


@pytest.mark.parametrize(
    ("support", "lead"), [(0.76, 0.45), (0.84, 0.35), (0.94, 0.17), (0.95, 0.23), (0.96, 0.18)]
)
def test_the_half_of_a_room_that_another_house_has_as_well_proves_no_place(
    support: float, lead: float
) -> None:
    """With 180 degrees of view that much spoke for places on maps of other houses."""
    proof = Proof(seen=seen_room(118), lead=lead)
    proof.begin(support - PROOF.between, pinned=0.3)
    assert not proof.is_right
    drive_on(proof, support, 20)
    assert not proof.is_right
    proof.add_new(NewSurface(amount=0.5, agreement=0.9))
    assert proof.is_right


def test_after_a_metre_without_a_proof_the_walls_of_a_room_alike_prove_nothing() -> None:
    """A room of another floor between the same outer walls had a support of 0.87."""
    proof = Proof(unproven_m=2.4, seen=seen_room())
    drive_on(proof, 0.87, 50)
    assert not proof.is_right


def test_one_look_at_a_wall_that_is_where_the_map_says_proves_no_place() -> None:
    """On the map of another floor of the house a wall that comes into view may be right, too."""
    proof = Proof(seen=seen_room())
    drive_on(proof, PROOF.between, 1)
    proof.add_new(NewSurface(amount=1.0, agreement=1.0))
    assert not proof.is_right
    proof.add_new(NewSurface(amount=1.0, agreement=1.0))
    assert proof.is_right


def test_what_fitted_as_well_elsewhere_has_to_be_proven_anew() -> None:
    proof = Proof(seen=seen_room())
    proof.add(0.75 - PROOF.between, 0.3)
    for _ in range(2):
        proof.add_new(NewSurface(1.0, 0.9))
    assert proof.is_right
    proof.reopen()
    assert not proof.is_right
    drive_on(proof, 0.85, 5)
    assert proof.is_right


def test_views_that_do_not_pin_the_pose_prove_nothing_and_do_not_hurry() -> None:
    proof = Proof()
    drive_on(proof, 0.98, 40, pinned=0.0)
    assert not proof.is_right
    assert not proof.is_overdue
    drive_on(proof, 0.98, 2)
    assert proof.is_right


def test_turning_on_the_spot_and_standing_prove_next_to_nothing() -> None:
    proof = Proof()
    proof.add(0.75 - PROOF.between, 0.3)
    for turn in 3 * [0.25, -0.25]:
        proof.predict(Pose2D(0.0, 0.0, turn))
        proof.add(0.75 - PROOF.between, 0.3)
    assert not proof.is_right
    drive_on(proof, 0.75, 2)
    assert proof.is_right


def test_the_longer_no_place_was_proven_the_more_it_takes() -> None:
    early, late = Proof(), Proof(unproven_m=3.0)
    for proof in (early, late):
        drive_on(proof, 0.9, 1)
    assert early.is_right
    assert not late.is_right
    drive_on(late, 0.9, 3)
    assert late.is_right


def test_the_unknown_counts_neither_for_nor_against_a_place() -> None:
    proof = Proof(has_prior=True)
    for support in (0.0, 1.0):
        unknown = MatchScore(0.0, 0.0, 0.0, 0.0, 0.0, 180, support, support)
        for _ in range(50):
            proof.predict(STEP)
            proof.add(evidence_of(unknown, is_led=True), 0.3)
    assert not proof.is_right
    assert not proof.is_against


def test_a_room_pins_a_pose_and_a_bare_corridor_does_not(flat: GridMap) -> None:
    room = View(flat)
    assert room.matcher.pinned(room.cells, room.beams()) > 0.2
    cells = np.full((60, 600), OCCUPIED, np.int8)
    cells[18:42, 2:-2] = FREE
    corridor = View(GridMap("corridor", flat.resolution, Pose2D(0.0, 0.0, 0.0), cells))
    corridor.pose = Pose2D(15.0, 1.5, 0.0)
    assert corridor.matcher.score(corridor.cells, corridor.beams()).value > 0.9
    assert corridor.matcher.pinned(corridor.cells, corridor.beams()) < 0.03
