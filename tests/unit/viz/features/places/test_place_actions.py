"""What people do to saved places, and how it is taken back."""

from collections.abc import Callable
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import msgspec
import pytest

from trolley import requests, topics
from trolley.geometry import Pose2D
from trolley.messages import CapturedPose, SavedPose, SavedPoses, Stop, Tour, Tours
from trolley.messages.request_params import Capture, Named
from trolley.runtime.service import Service, answers
from trolley_viz.controls.undo import History
from trolley_viz.features.places.place_actions import PlaceActions
from trolley_viz.features.tours.tour_actions import TourActions
from trolley_viz.pointing.pointer import Pointed

if TYPE_CHECKING:
    from ...conftest import Stage

HERE = Pose2D(5.0, 5.0, 1.0)
KITCHEN = SavedPose(
    name="kitchen", map="room", pose=Pose2D(2.0, 1.0, 0.5), icon="home", note="by the oven"
)


class House:
    """A pretended tour service, the browser that asks it, and the map that is pointed at."""

    def __init__(self) -> None:
        self.poses = {"kitchen": KITCHEN}
        self.tours = {
            "round": Tour(name="round", stops=[Stop(name="kitchen"), Stop(pose=HERE)]),
            "other": Tour(name="other", stops=[Stop(pose=HERE)]),
        }
        self.asked: list[Any] = []
        self.told: list[str] = []
        self.history = History()
        self.asking: list[Any] = []
        self.pointed: Pointed | None = Pointed(1.0, 2.0, 0.25)
        self.armed = True
        streams = SimpleNamespace(latest=self._latest)
        view: Any = SimpleNamespace(streams=streams, placement=SimpleNamespace(world="map"))
        self.view = view
        actions: Any = self
        self.places = PlaceActions(actions, actions, lambda: view)

    def _latest(self, topic: Any) -> Any:
        if topic is topics.POSES:
            return SimpleNamespace(poses=list(self.poses.values()))
        return SimpleNamespace(tours=list(self.tours.values()))

    # What the actions are asked for.
    def is_asking(self, *which: Any) -> bool:
        return any(request in which for request in self.asking)

    def ask(
        self,
        request: Any,
        params: Any,
        failed: str,
        done: Callable[[Any], None] | None = None,
        then: Callable[[Any, str], None] | None = None,
        robot: str = "",
        refused: Callable[[], None] = lambda: None,
    ) -> None:
        self.asked.append(request)
        reply = params
        if request is requests.POSE_CAPTURE:
            reply = CapturedPose(
                name=params.name,
                map="room",
                pose=HERE,
                icon=params.icon,
                state="localized",
                match=1.0,
                age=0.0,
            )
            self.poses[params.name] = msgspec.convert(reply, SavedPose, from_attributes=True)
        elif request is requests.POSES_PUT:
            reply = self.poses[params.name] = msgspec.structs.replace(params, map="room")
        elif request is requests.POSES_DELETE:
            reply = self.poses.pop(params.name)
        elif request is requests.TOURS_PUT:
            self.tours[params.name] = params
        else:
            raise AssertionError(request.name)
        if then is not None:
            then(reply, robot)
        if done is not None:
            done(reply)

    def tell(self, title: str, text: str, tone: str) -> None:
        self.told.append(text)

    # What the arrow is asked for.
    def arm(self, tool: Any, hint: str) -> None:
        assert self.pointed is not None
        tool.done(self.pointed)

    def put_away(self) -> None:
        self.armed = False

    def pose_at(self, pointed: Pointed, kept: float | None = None) -> Pose2D:
        return Pose2D(pointed.x, pointed.y, pointed.yaw if pointed.yaw is not None else kept or 0.0)


class Keeper(Service):
    """Keeps places and tours as the tour service does."""

    name = "tour"

    def __init__(self) -> None:
        self.poses = {"kitchen": KITCHEN}
        self.tours = {"round": Tour(name="round", stops=[Stop(name="kitchen")])}

    def start(self) -> None:
        self.publish(topics.POSES, SavedPoses(stamp_ns=1, poses=[*self.poses.values()]))
        self.publish(topics.TOURS, Tours(stamp_ns=1, tours=[*self.tours.values()]))

    @answers(requests.POSE_CAPTURE)
    def capture(self, params: Capture) -> CapturedPose:
        assert params.name is not None
        self.poses[params.name] = SavedPose(name=params.name, map="room", pose=HERE)
        return CapturedPose(
            name=params.name, map="room", pose=HERE, state="localized", match=1.0, age=0.0
        )

    @answers(requests.POSES_PUT)
    def put(self, pose: SavedPose) -> SavedPose:
        self.poses[pose.name] = pose
        return pose

    @answers(requests.POSES_DELETE)
    def delete(self, params: Named) -> SavedPose:
        return self.poses.pop(params.name)

    @answers(requests.TOURS_PUT)
    def put_tour(self, tour: Tour) -> Tour:
        self.tours[tour.name] = tour
        return tour

    @answers(requests.TOURS_DELETE)
    def delete_tour(self, params: Named) -> Tour:
        return self.tours.pop(params.name)


@pytest.fixture
def keepers(stage: "Stage") -> tuple[Keeper, Keeper]:
    """Of the robot that is followed, and of another one."""
    stage.runtime.add(type(stage.robot)(), robot="kart")
    both = stage.runtime.add(Keeper()), stage.runtime.add(Keeper(), robot="kart")
    stage.browse()
    stage.runtime.run(0.5)
    return both


@pytest.fixture
def house() -> House:
    return House()


def test_a_place_is_saved_where_the_robot_stands(house: House) -> None:
    saved: list[str] = []
    house.places.save_here("  sofa ", "sofa", saved.append)
    assert house.poses["sofa"].pose == HERE
    assert saved == ["sofa"]
    house.history.undo()
    assert set(house.poses) == {"kitchen"}


@pytest.mark.parametrize(("name", "why"), [(" ", "Give the place a name"), ("kitchen", "already")])
def test_a_name_is_needed_and_not_taken(house: House, name: str, why: str) -> None:
    house.places.save_here(name, "", house.told.append)
    house.places.point_new(name, "", house.told.append)
    assert len(house.told) == 2
    assert all(why in text for text in house.told)
    assert house.poses == {"kitchen": KITCHEN}


def test_a_place_is_pointed_out(house: House) -> None:
    house.places.point_new("door", "door", lambda _: None)
    assert house.poses["door"].pose == Pose2D(1.0, 2.0, 0.25)
    house.history.undo()
    assert "door" not in house.poses


def test_without_a_map_there_is_nothing_to_point_at(house: House) -> None:
    house.view.placement.world = "odom"
    house.places.point_move(KITCHEN)
    assert house.told == ["There is no map to point at."]


def test_icon_and_note_change_and_come_back(house: House) -> None:
    house.places.change(KITCHEN, "kitchen", "coffee", "")
    assert (house.poses["kitchen"].icon, house.poses["kitchen"].note) == ("coffee", "")
    house.history.undo()
    assert house.poses == {"kitchen": KITCHEN}


def test_tours_find_a_place_that_was_renamed(house: House) -> None:
    before = dict(house.tours)
    house.places.change(KITCHEN, "Küche", "home", "by the oven")
    assert house.poses == {"Küche": msgspec.structs.replace(KITCHEN, name="Küche")}
    assert [stop.name for stop in house.tours["round"].stops] == ["Küche", None]
    assert house.tours["other"] is before["other"]
    house.history.undo()
    assert house.poses == {"kitchen": KITCHEN}
    assert house.tours == before
    assert house.history.last() is None


def test_a_place_is_not_renamed_over_another(house: House) -> None:
    house.poses["door"] = msgspec.structs.replace(KITCHEN, name="door")
    house.places.change(KITCHEN, "door", "home", "")
    assert house.poses["kitchen"] is KITCHEN
    assert "already" in house.told[0]


def test_a_place_is_moved_and_keeps_its_note(house: House) -> None:
    house.places.move_here(KITCHEN)
    moved = house.poses["kitchen"]
    assert (moved.pose, moved.icon, moved.note) == (HERE, "home", "by the oven")
    house.history.undo()
    assert house.poses == {"kitchen": KITCHEN}


def test_a_place_without_a_note_is_stored_once_as_it_moves(house: House) -> None:
    house.places.move_here(msgspec.structs.replace(KITCHEN, note=""))
    assert house.asked == [requests.POSE_CAPTURE]
    assert house.poses["kitchen"].pose == HERE
    house.history.undo()
    assert house.poses["kitchen"].pose == KITCHEN.pose


def test_a_place_moved_by_a_click_keeps_its_heading(house: House) -> None:
    house.pointed = Pointed(1.0, 2.0)
    house.places.point_move(KITCHEN)
    assert house.poses["kitchen"].pose == Pose2D(1.0, 2.0, 0.5)
    assert house.poses["kitchen"].note == "by the oven"
    house.history.undo()
    assert house.poses == {"kitchen": KITCHEN}


def test_a_place_that_is_deleted_can_be_brought_back(house: House) -> None:
    house.places.delete(KITCHEN)
    assert house.poses == {}
    assert "“round”" in house.told[0]
    assert "“other”" not in house.told[0]
    house.history.undo()
    assert house.poses == {"kitchen": KITCHEN}


DOOR = SavedPose(name="door", pose=HERE)
DONE: dict[str, Callable[[PlaceActions], None]] = {
    "save": lambda places: places.put_new(DOOR, lambda _: None),
    "save here": lambda places: places.save_here("door", "", lambda _: None),
    "change": lambda places: places.change(KITCHEN, "kitchen", "coffee", ""),
    "move": lambda places: places.move_here(KITCHEN),
    "point": lambda places: places.point_move(KITCHEN),
    "rename": lambda places: places.change(KITCHEN, "Küche", "home", "by the oven"),
    "delete": lambda places: places.delete(KITCHEN),
}


@pytest.mark.parametrize(
    ("mine", "name"),
    [
        ("save", "door"),
        ("save here", "door"),
        ("change", "kitchen"),
        ("move", "kitchen"),
        ("point", "kitchen"),
        ("rename", "Küche"),
        ("rename", "kitchen"),
        ("delete", "kitchen"),
    ],
)
def test_undo_leaves_what_somebody_else_did_since(house: House, mine: str, name: str) -> None:
    DONE[mine](house.places)
    theirs = SavedPose(name=name, map="room", pose=Pose2D(-2.0, 1.0, 0.0), note="mind the cable")
    house.poses[name] = theirs
    before = dict(house.poses)
    house.history.undo()
    assert house.poses == before
    assert house.told[-1] == f"Somebody else has changed “{name}” since then."
    assert house.history.last() is None


@pytest.mark.parametrize("mine", ["save here", "change", "move", "rename"])
def test_undo_blames_nobody_for_what_the_mapper_moved(house: House, mine: str) -> None:
    before = dict(house.poses)
    DONE[mine](house.places)
    for name, place in house.poses.items():
        moved = Pose2D(place.pose.x + 0.02, place.pose.y, place.pose.yaw)
        house.poses[name] = msgspec.structs.replace(place, pose=moved, map="home")
    house.history.undo()
    assert house.poses.keys() == before.keys()
    assert not [text for text in house.told if "Somebody" in text]


@pytest.mark.parametrize("mine", ["change", "rename"])
def test_undo_of_a_name_or_icon_leaves_a_place_where_the_mapper_moved_it(
    house: House, mine: str
) -> None:
    DONE[mine](house.places)
    (name,) = house.poses
    moved = msgspec.structs.replace(house.poses[name], pose=Pose2D(7.0, 8.0, 1.0))
    house.poses[name] = moved
    house.history.undo()
    assert house.poses == {"kitchen": msgspec.structs.replace(KITCHEN, pose=moved.pose)}


@pytest.mark.parametrize("request_", [requests.POSES_PUT, requests.POSE_CAPTURE])
def test_undo_pressed_twice_at_once_blames_nobody(house: House, request_: Any) -> None:
    DONE["change"](house.places)
    house.asking = [requests.TOURS_PUT, request_]
    house.history.undo()
    assert house.told == ["The last change has not been saved yet."]
    house.asking = [requests.TOURS_PUT]
    house.history.undo()
    assert house.poses == {"kitchen": KITCHEN}


def test_undo_does_not_bring_back_what_somebody_else_deleted(house: House) -> None:
    DONE["change"](house.places)
    del house.poses["kitchen"]
    house.history.undo()
    assert house.poses == {}
    assert house.told == ["Somebody else has changed “kitchen” since then."]


def test_who_follows_another_robot_meanwhile_leaves_no_rename_half_done(
    stage: "Stage", keepers: tuple[Keeper, Keeper]
) -> None:
    mine, other = keepers
    stage.session.place_actions.change(KITCHEN, "den", "home", "by the oven")
    stage.session.follow("kart")  # before it is answered
    stage.runtime.run(0.5)
    assert list(mine.poses) == ["den"]
    assert [stop.name for stop in mine.tours["round"].stops] == ["den"]
    assert list(other.poses) == ["kitchen"]
    assert stage.session.actions.history.last() is None


def test_who_follows_another_robot_meanwhile_leaves_no_two_names_of_a_tour(
    stage: "Stage", keepers: tuple[Keeper, Keeper]
) -> None:
    mine, other = keepers
    actions, tour = stage.session.actions, mine.tours["round"]
    tours = TourActions(actions, lambda: stage.session.view)
    tours.save(msgspec.structs.replace(tour, name="night"), tour, lambda: None)
    stage.session.follow("kart")
    stage.runtime.run(0.5)
    assert list(mine.tours) == ["night"]
    assert list(other.tours) == ["round"]


def test_who_follows_another_robot_meanwhile_loses_no_note(
    stage: "Stage", keepers: tuple[Keeper, Keeper]
) -> None:
    stage.session.place_actions.move_here(KITCHEN)
    stage.session.follow("kart")
    stage.runtime.run(0.5)
    moved, untouched = (one.poses["kitchen"] for one in keepers)
    assert (moved.pose, moved.note) == (HERE, "by the oven")
    assert untouched == KITCHEN
