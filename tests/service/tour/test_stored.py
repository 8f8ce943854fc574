"""Saved poses and tours: stored keys, requests, files."""

import json
import unicodedata
from typing import TYPE_CHECKING

import msgspec
import pytest

from trolley import codes, requests, topics
from trolley.codes import Refused
from trolley.geometry import Pose2D
from trolley.messages import SavedPose, ScheduleEntry, Stop, Tour
from trolley.messages.request_params import Named

if TYPE_CHECKING:
    from .conftest import Home

PLACE = SavedPose(name="kitchen", map="apartment", pose=Pose2D(1.0, 2.0, 0.5))
TOUR = Tour(name="evening", stops=[Stop(name="kitchen", dwell=5.0), Stop(pose=Pose2D(1, 2, 3))])


def put(home: "Home", key: str, body: object) -> None:
    home.lockstep.put(f"trolley/trolley/{key}", json.dumps(body).encode())


def get(home: "Home", key: str) -> list:
    """Answers as (key, content), or the code of the refusal."""
    replies = home.lockstep.get(f"trolley/trolley/{key}")
    return [
        json.loads(one.payload)["code"] if one.is_error else (one.key, json.loads(one.payload))
        for one in replies
    ]


@pytest.fixture
def empty(make_home) -> "Home":
    return make_home()


def test_put_on_a_key_is_stored_published_and_given(empty: "Home"):
    lists = empty.lockstep.record(topics.POSES)
    put(empty, "poses/kitchen", {"map": "apartment", "pose": {"x": 1.0, "y": 2.0, "yaw": 0.5}})
    assert [one.name for one in lists[-1].poses] == ["kitchen"]
    ((key, body),) = get(empty, "poses/kitchen")
    assert key == "trolley/trolley/poses/kitchen"
    assert body["pose"] == {"x": 1.0, "y": 2.0, "yaw": 0.5}
    ((_, listed),) = get(empty, "poses")
    assert len(listed["poses"]) == 1


def test_pose_without_a_map_belongs_to_the_present_one(empty: "Home"):
    put(empty, "poses/kitchen", {"pose": {"x": 1.0, "y": 2.0, "yaw": 4.0}})
    saved = empty.tour.places.items["kitchen"]
    assert saved.map == "apartment"
    assert saved.pose.yaw == pytest.approx(4.0 - 2 * 3.141592653589793)


def test_a_tour_with_poses_of_its_own_belongs_to_the_present_map(empty: "Home"):
    def put_on(tour: Tour, **pose: str) -> str:
        estimate = empty.localizer.estimate
        empty.localizer.estimate = msgspec.structs.replace(estimate, **pose)
        empty.lockstep.run(0.5)
        return empty.lockstep.ask(requests.TOURS_PUT, tour).map

    assert put_on(TOUR) == "apartment"
    passing = Stop(name="kitchen", via=[Pose2D(1.0, 0.0, 0.0)])
    assert put_on(Tour(name="past", stops=[passing])) == "apartment"
    assert put_on(msgspec.structs.replace(TOUR, map="cellar")) == "cellar"
    by_name = Tour(name="by name", stops=[Stop(name="kitchen")], map="cellar")
    assert put_on(by_name) == ""  # its places say for themselves where they are
    with pytest.raises(Refused):
        put_on(msgspec.structs.replace(TOUR, map="a/b"))
    empty.mapper.phase = "mapping"
    empty.lockstep.run(1.0)
    draft = msgspec.structs.replace(TOUR, name="draft")
    assert put_on(draft, map="draft", state="unsure") == ""  # the map is to get its name yet


@pytest.mark.parametrize("before", ["", "cellar"])
def test_a_tour_stays_on_its_map_until_a_spot_is_new(empty: "Home", before: str):
    def put_with(**changes: object) -> str:
        tour = msgspec.structs.replace(TOUR, **changes)
        return empty.lockstep.ask(requests.TOURS_PUT, tour).map

    empty.mapper.phase = "mapping" if before == "" else "idle"
    empty.lockstep.run(1.0)
    assert put_with(map=before) == before
    empty.mapper.phase = "idle"
    empty.lockstep.run(1.0)
    assert put_with(schedule=[ScheduleEntry(at="08:00")]) == before
    assert put_with(stops=[Stop(name="hall"), *TOUR.stops[::-1]]) == before
    assert put_with(stops=[*TOUR.stops, Stop(pose=Pose2D(4, 5, 6))]) == "apartment"


def test_requests_put_and_delete(empty: "Home"):
    assert empty.lockstep.ask(requests.POSES_PUT, PLACE) == PLACE
    tour = msgspec.structs.replace(TOUR, map="apartment")
    assert empty.lockstep.ask(requests.TOURS_PUT, TOUR) == tour
    assert empty.lockstep.ask(requests.TOURS_DELETE, Named(name="evening")) == tour
    assert empty.lockstep.ask(requests.POSES_DELETE, Named(name="kitchen")) == PLACE
    with pytest.raises(Refused) as caught:
        empty.lockstep.ask(requests.POSES_DELETE, Named(name="kitchen"))
    assert caught.value.code == codes.UNKNOWN_NAME
    assert caught.value.message.startswith("There is no saved place 'kitchen'.")
    assert get(empty, "poses/kitchen") == ["unknown_name"]
    assert get(empty, "poses/*") == []


def test_delete_of_a_key(empty: "Home"):
    empty.lockstep.ask(requests.POSES_PUT, PLACE)
    empty.lockstep.ask(requests.TOURS_PUT, TOUR)
    empty.lockstep.delete("trolley/trolley/poses/kitchen")
    empty.lockstep.delete("trolley/trolley/tours/evening")
    assert empty.tour.places.items == {}
    assert empty.tour.tours.items == {}


def test_delete_with_a_wildcard_is_dropped(empty: "Home"):
    empty.lockstep.ask(requests.POSES_PUT, PLACE)
    for key in ("poses/*", "poses/**", "**"):
        empty.lockstep.delete(f"trolley/trolley/{key}")
    assert list(empty.tour.places.items) == ["kitchen"]


def test_what_is_stored_survives_a_kill(empty: "Home"):
    empty.lockstep.ask(requests.POSES_PUT, PLACE)
    tour = empty.lockstep.ask(requests.TOURS_PUT, TOUR)
    empty.restart_tour()
    assert empty.tour.places.items == {"kitchen": PLACE}
    assert empty.tour.tours.items == {"evening": tour}
    ((_, listed),) = get(empty, "tours")
    assert listed["tours"][0]["name"] == "evening"


@pytest.mark.parametrize(
    ("key", "body"),
    [
        ("poses/kitchen", {"name": "corridor", "map": "a", "pose": {"x": 1, "y": 2, "yaw": 0}}),
        ("tours/long", {"stops": [{"name": "kitchen"}], "repeat": 1_000_001}),
        ("poses/.hidden", {"map": "a", "pose": {"x": 1, "y": 2, "yaw": 0}}),
        ("poses/..", {"map": "a", "pose": {"x": 1, "y": 2, "yaw": 0}}),
        ("poses/kitchen", {"map": "../etc", "pose": {"x": 1, "y": 2, "yaw": 0}}),
        ("poses/kitchen", {"map": "a", "pose": {"x": None, "y": 2, "yaw": 0}}),
        ("poses/kitchen", {"map": "a", "pose": {"x": 1e300, "y": 2, "yaw": 0}}),
        ("poses/kitchen", {"map": "a", "pose": {"x": 2e6, "y": 2, "yaw": 0}}),
        ("poses/kitchen", {"map": "a"}),
        ("poses/kitchen", {"map": "a", "pose": {"x": 1, "y": 2, "yaw": 0}, "saved_at": "noon"}),
        ("poses/" + 65 * "a", {"map": "a", "pose": {"x": 1, "y": 2, "yaw": 0}}),
        ("tours/evening", {"stops": []}),
        ("tours/evening", {"name": "morning", "stops": [{"name": "kitchen"}]}),
        ("tours/evening", {"stops": [{"name": "../kitchen"}]}),
        ("tours/evening", {"stops": [{}]}),
        ("tours/evening", {"stops": [{"pose": {"x": 1, "y": -2e6, "yaw": 0}}]}),
        ("tours/evening", {"stops": [{"name": "den", "via": [{"x": 2e6, "y": 2, "yaw": 0}]}]}),
    ],
)
def test_bad_wish_changes_nothing_and_is_counted(empty: "Home", key: str, body):
    before = sum(empty.lockstep.counters("tour").values())
    put(empty, key, body)
    assert empty.tour.places.items == {}
    assert empty.tour.tours.items == {}
    assert sum(empty.lockstep.counters("tour").values()) == before + 1


@pytest.mark.parametrize("payload", [b"", b"\x00", b"{" * 5000, b"[" * 5000, 2 << 20])
def test_garbage_changes_nothing(empty: "Home", payload):
    payload = bytes(payload) if isinstance(payload, int) else payload
    empty.lockstep.put("trolley/trolley/poses/kitchen", payload)
    empty.lockstep.put("trolley/trolley/tours/kitchen", payload)
    assert empty.tour.places.items == {}
    assert empty.tour.tours.items == {}
    assert empty.lockstep.ask(requests.POSES_PUT, PLACE) == PLACE


def test_the_same_name_in_another_normalization_is_the_same(empty: "Home"):
    composed, decomposed = (unicodedata.normalize(form, "Küche") for form in ("NFC", "NFD"))
    body = {"map": "a", "pose": {"x": 1, "y": 2, "yaw": 0}}
    put(empty, f"poses/{decomposed}", body)
    put(empty, f"poses/{composed}", {**body, "name": decomposed})
    assert list(empty.tour.places.items) == [composed]
    ((key, _),) = get(empty, f"poses/{decomposed}")
    assert key == f"trolley/trolley/poses/{decomposed}"
    empty.lockstep.ask(requests.POSES_DELETE, Named(name=decomposed))
    assert empty.tour.places.items == {}


def test_unnamed_tour_is_not_stored(empty: "Home"):
    with pytest.raises(Refused) as caught:
        empty.lockstep.ask(requests.TOURS_PUT, Tour(stops=[Stop(name="kitchen")]))
    assert caught.value.code == codes.BAD_REQUEST


def test_full_disk_refuses_and_keeps_what_was_saved(empty: "Home", monkeypatch):
    empty.lockstep.ask(requests.POSES_PUT, PLACE)
    health = empty.lockstep.record(topics.HEALTH, "tour")
    lists = empty.lockstep.record(topics.POSES)

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr("trolley.runtime.state.write_atomically", full)
        with pytest.raises(Refused) as caught:
            empty.lockstep.ask(requests.POSES_PUT, SavedPose(name="b", map="a", pose=PLACE.pose))
        empty.lockstep.delete("trolley/trolley/poses/kitchen")
        empty.lockstep.run(1.5)
    assert caught.value.code == codes.NOT_SAVED
    assert "No space left" in caught.value.message
    assert list(empty.tour.places.items) == ["kitchen"]
    assert lists == []
    assert health[-1].state == "degraded"
    assert empty.lockstep.ask(requests.POSES_PUT, PLACE) == PLACE
    empty.lockstep.run(1.5)
    assert health[-1].state == "ok"


def test_a_robot_that_was_renamed_is_told_where_its_places_are(
    empty: "Home", caplog: pytest.LogCaptureFixture
):
    old = empty.lockstep.state / "kiwi"
    old.mkdir()
    (old / "poses.toml").touch()
    empty.restart_tour()
    assert "Nobody has saved a place or tour for this robot" in caplog.text


def test_broken_file_is_kept_aside_and_reported(empty: "Home"):
    empty.lockstep.ask(requests.POSES_PUT, PLACE)
    folder = empty.lockstep.state / "trolley"
    (folder / "poses.toml").write_text("poses = [")
    health = empty.lockstep.record(topics.HEALTH, "tour")
    empty.restart_tour()
    empty.lockstep.run(1.5)
    assert health[-1].state == "degraded"
    assert "poses.toml" in health[-1].message
    (aside,) = folder.glob("poses.toml.broken-*")
    assert aside.read_text() == "poses = ["
    assert empty.lockstep.ask(requests.POSES_PUT, PLACE) == PLACE


@pytest.mark.parametrize(
    "content", ["", "[[songs]]\n", "schema = 2\nplaces = []\n"], ids=["empty", "foreign", "newer"]
)
def test_a_file_of_nothing_known_is_not_taken_for_no_places(empty: "Home", content: str):
    empty.lockstep.ask(requests.POSES_PUT, PLACE)
    folder = empty.lockstep.state / "trolley"
    for name in ("poses.toml", "tours.toml"):
        (folder / name).write_text(content)
    health = empty.lockstep.record(topics.HEALTH, "tour")
    empty.restart_tour()
    empty.lockstep.run(1.5)
    assert health[-1].state == "degraded"
    assert "poses.toml" in health[-1].message
    assert empty.lockstep.ask(requests.POSES_PUT, PLACE) == PLACE
    asides = [*folder.glob("*.toml.broken-*"), *folder.glob("*.toml.newer-*")]
    assert [aside.read_text() for aside in asides] == [content] * 2


def test_of_places_with_one_name_none_is_lost(empty: "Home"):
    empty.lockstep.ask(requests.POSES_PUT, PLACE)
    file = empty.lockstep.state / "trolley" / "poses.toml"
    schema, entry = file.read_text().split("\n", 1)
    other, third = entry.replace("x = 1.0", "x = 3.0"), entry.replace("kitchen", "kitchen-2")
    file.write_text("\n".join([schema, entry, other, third]))
    health = empty.lockstep.record(topics.HEALTH, "tour")
    empty.restart_tour()
    empty.lockstep.run(1.5)
    items = empty.tour.places.items
    assert {name: place.pose.x for name, place in items.items()} == {
        "kitchen": 1.0,
        "kitchen-3": 3.0,
        "kitchen-2": 1.0,
    }
    assert health[-1].state == "degraded"
    assert "poses.toml has several entries called 'kitchen'" in health[-1].message
    empty.lockstep.ask(requests.POSES_DELETE, Named(name="kitchen-3"))
    empty.lockstep.run(1.5)
    assert health[-1].state == "ok"
    assert "3.0" not in file.read_text()


def test_file_that_cannot_be_opened_is_kept_aside_too(empty: "Home"):
    path = empty.lockstep.state / "trolley" / "poses.toml"
    path.unlink(missing_ok=True)
    path.mkdir(parents=True)
    empty.restart_tour()
    assert empty.lockstep.ask(requests.POSES_PUT, PLACE) == PLACE
    (aside,) = path.parent.glob("poses.toml.broken-*")
    assert aside.is_dir()
    assert path.is_file()


def test_tours_never_outgrow_a_message_in_either_encoding(empty: "Home"):
    via = [Pose2D(0.5, 1.5, 0.25)] * 1000  # 28 bytes each as JSON, 36 as msgpack
    stops = [Stop(pose=PLACE.pose, via=via)] * 10
    lists = empty.lockstep.record(topics.TOURS)
    for name in ("t0", "t1"):
        empty.lockstep.ask(requests.TOURS_PUT, Tour(name=name, stops=stops))
    with pytest.raises(Refused) as caught:
        empty.lockstep.ask(requests.TOURS_PUT, Tour(name="t2", stops=stops))
    assert caught.value.code == codes.TOO_LARGE
    assert len(msgspec.msgpack.encode(lists[-1])) <= topics.TOURS.max_bytes
    assert [tour.name for tour in lists[-1].tours] == ["t0", "t1"]


def test_list_never_outgrows_a_message(empty: "Home", monkeypatch):
    monkeypatch.setattr("trolley.messages.types.MAX_LIST_BYTES", 3000)
    note = "n" * 1000
    for name in ("one", "two"):
        empty.lockstep.ask(
            requests.POSES_PUT, SavedPose(name=name, map="a", pose=PLACE.pose, note=note)
        )
    with pytest.raises(Refused) as caught:
        empty.lockstep.ask(
            requests.POSES_PUT, SavedPose(name="three", map="a", pose=PLACE.pose, note=note)
        )
    assert caught.value.code == codes.TOO_LARGE
    assert list(empty.tour.places.items) == ["one", "two"]
