"""Several robots in one house: they give way to each other, and come where they are sent."""

from pathlib import Path

import pytest
from support.flatland import empty_room, two_rooms, with_block
from support.house import Household

from trolley import codes, requests
from trolley.geometry import Pose2D
from trolley.messages import Offer
from trolley.messages.request_params import AskOffer
from trolley_tour.service import TourService

WEST, EAST = Pose2D(1.5, 3.0, 0.0), Pose2D(6.5, 3.0, 3.1)
WITH_CORRIDOR = with_block(with_block(empty_room(), 2.5, 0.0, 3.0, 2.65), 2.5, 3.35, 3.0, 2.65)


def all_arrive(house: Household, seconds: float) -> None:
    ended = house.run_until_ended(seconds)
    assert set(ended.values()) == {"arrived"}, {n: house.messages(n) for n in house.names}
    assert house.touches == 0


def test_at_a_door_one_of_two_waits_and_says_for_whom(tmp_path: Path) -> None:
    house = Household(tmp_path, two_rooms(), [WEST, EAST])
    house.send("a", 6.5, 3.0)
    house.send("b", 1.5, 3.0)
    all_arrive(house, 60.0)
    # Both have about as far to the door: who goes first is a matter of millimetres.
    waiting = "b" if any("Waiting" in message for message in house.messages("b")) else "a"
    first = "a" if waiting == "b" else "b"
    assert f"Waiting for robot {first} at the door." in house.messages(waiting)
    assert not any("Waiting" in message for message in house.messages(first))
    waits = [status for status in house.said[waiting] if "Waiting" in status.message]
    assert {(status.state, status.reason) for status in waits} == {("recovering", codes.WAITING)}


def test_two_that_meet_in_a_narrow_corridor_get_out_of_it(tmp_path: Path) -> None:
    house = Household(tmp_path, WITH_CORRIDOR, [Pose2D(3.4, 3.0, 0.0), Pose2D(4.6, 3.0, 3.1)])
    house.send("a", 6.8, 3.0)
    house.send("b", 1.2, 3.0)
    all_arrive(house, 90.0)
    assert "Waiting for robot a at the narrow passage." in house.messages("b")


def test_a_robot_that_stops_or_turns_is_not_taken_for_somebody(tmp_path: Path) -> None:
    starts = [Pose2D(1.9, 2.1, -0.9), Pose2D(8.7, 3.9, 3.1)]
    corridor = with_block(with_block(empty_room(10.0), 4.0, 0.0, 2.0, 2.66), 4.0, 3.34, 2.0, 2.66)
    house = Household(tmp_path, corridor, starts)
    house.send("a", 8.5, 2.7)
    house.send("b", 1.5, 1.6)
    all_arrive(house, 90.0)
    assert not any("Somebody" in message for name in "ab" for message in house.messages(name))


@pytest.mark.slow
def test_four_come_through_a_narrow_corridor_from_both_sides(tmp_path: Path) -> None:
    starts = [WEST, EAST, Pose2D(1.5, 4.5, 0.0), Pose2D(6.5, 1.5, 3.1)]
    house = Household(tmp_path, WITH_CORRIDOR, starts)
    for name, place in zip("abcd", [(6.8, 3.0), (1.2, 3.0), (6.5, 4.5), (1.5, 1.5)], strict=True):
        house.send(name, *place)
    all_arrive(house, 180.0)


def test_a_parked_robot_stays_and_the_other_says_who_stands_there(tmp_path: Path) -> None:
    house = Household(tmp_path, two_rooms(), [WEST, Pose2D(4.0, 3.0, 1.0)])
    house.send("a", 6.8, 3.0)
    waits = "Robot b is in the way. The robot waits for it to go."
    assert house.lockstep.run_until(lambda: waits in house.messages("a"), 30.0)
    assert house.worlds[1].pose == Pose2D(4.0, 3.0, 1.0)
    assert house.touches == 0


def offers(house: Household, place: Pose2D) -> dict[str, Offer]:
    params = AskOffer(pose=place)
    return {
        name: house.lockstep.ask(requests.TOUR_OFFER, params, robot=name) for name in house.names
    }


@pytest.fixture
def three(tmp_path: Path) -> Household:
    """Two robots in the west room, the second right beside the wall, and one in the east room."""
    starts = [Pose2D(3.4, 3.0, 0.0), Pose2D(3.4, 5.3, 0.0), Pose2D(5.6, 1.0, 0.0)]
    house = Household(tmp_path, two_rooms(), starts)
    for name, config in zip(house.names, house.configs, strict=True):
        house.lockstep.add(TourService(config), name)
    house.lockstep.run(1.0)
    return house


def test_the_way_counts_and_not_the_bee_line(three: Household) -> None:
    # b is nearest through the wall, but has to drive to the door and back.
    found = offers(three, Pose2D(4.6, 5.3, 0.0))
    seconds = {name: offer.seconds or 0.0 for name, offer in found.items()}
    assert all(offer.free and offer.reason == "" for offer in found.values())
    assert seconds["a"] < seconds["b"]


def test_who_is_on_its_way_or_stopped_is_not_free_and_says_why(three: Household) -> None:
    three.send("a", 1.0, 1.0)
    three.robots["b"].say(mode="stopped")
    three.robots["c"].charge()
    three.lockstep.run(0.5)
    found = offers(three, Pose2D(2.0, 2.0, 0.0))
    assert (found["a"].free, found["a"].reason) == (False, codes.BUSY)
    assert (found["b"].seconds, found["b"].reason) == (None, codes.STOPPED)
    assert (found["c"].free, found["c"].reason) == (False, codes.CHARGING)
