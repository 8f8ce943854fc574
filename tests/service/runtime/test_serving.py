"""How requests and reads are answered."""

import json
import unicodedata
from typing import Any

import msgspec
import pytest
from support.samples import make_goal, make_place, make_places

from trolley import codes, requests, topics
from trolley.codes import Refused
from trolley.geometry import Pose2D
from trolley.messages import BaseState, GoalStatus, Offer, SavedPose, Stop, Tour
from trolley.messages.request_params import AskOffer, Named, Nothing, SendGoal, WhichGoal
from trolley.runtime.bus import Reply
from trolley.runtime.lockstep import Lockstep
from trolley.runtime.service import Later, Service, answers, gets

NFC, NFD = "K\u00fcche", "Ku\u0308che"


class Owner(Service):
    """Answers a bit of everything."""

    name = "tour"

    def __init__(self) -> None:
        self.goals: list[SendGoal] = []
        self.stops = 0
        self.open: list[Later[Offer]] = []
        self.places = {NFC: make_place(NFC), "living room": make_place("living room")}

    def start(self) -> None:
        self.publish(topics.POSES, make_places(7, "kitchen"))

    @answers(requests.GOAL_SEND)
    def send(self, params: SendGoal) -> GoalStatus:
        self.goals.append(params)
        return make_goal(1, params.id, "planning")

    @answers(requests.GOAL_CANCEL)
    def cancel(self, params: WhichGoal) -> GoalStatus:
        raise Refused(codes.NOT_CURRENT, None, id=params.id)

    @answers(requests.BASE_STOP)
    def stop_robot(self, _params: Nothing) -> BaseState:
        self.stops += 1
        return BaseState(stamp_ns=0, mode="stopped")

    @answers(requests.TOUR_OFFER)
    def offer(self, _params: AskOffer) -> Later[Offer]:
        later: Later[Offer] = self.later()
        self.open.append(later)
        return later

    @answers(requests.POSES_PUT)
    def put(self, params: SavedPose) -> SavedPose:
        return params

    @answers(requests.TOURS_PUT)
    def put_tour(self, params: Tour) -> Tour:
        return params

    @gets(topics.SAVED_POSE)
    def get_places(self, _parameters: dict[str, str]) -> dict[tuple[str, ...], SavedPose]:
        return {(name,): place for name, place in self.places.items()}

    @gets(topics.GOAL)
    def get_goal(self, parameters: dict[str, str]) -> dict[tuple[str, ...], GoalStatus]:
        wanted = parameters.get("id", "now")
        if wanted == "refused":
            raise Refused(codes.NOT_READY)
        return {(): make_goal(1, wanted)} if wanted in ("now", "a") else {}


@pytest.fixture
def owner(lockstep: Lockstep) -> Owner:
    return lockstep.add(Owner())


def ask(lockstep: Lockstep, selector: str, payload: Any = b"", encoding: str = "") -> Any:
    """What is answered on `trolley/trolley/<selector>`, decoded; one answer or fail."""
    if not isinstance(payload, bytes):
        payload = msgspec.json.encode(payload)
    (reply,) = lockstep.get(f"trolley/trolley/{selector}", payload, encoding)
    return json.loads(reply.payload)


def code(lockstep: Lockstep, selector: str, payload: Any = b"", encoding: str = "") -> str:
    """The code of the refusal."""
    answer = ask(lockstep, selector, payload, encoding)
    assert set(answer) == {"code", "message", "details"}
    assert answer["message"]
    return answer["code"]


POSE = {"x": 1.0, "y": 2.0, "yaw": 0.5}


@pytest.mark.parametrize(
    ("selector", "payload"),
    [
        ("@do/goal/send", {"id": "g", "pose": POSE}),
        ("@do/goal/send?format=json", {"id": "g", "pose": POSE}),
        ("@do/goal/send?_time=[now(-1s)..]", {"id": "g", "pose": POSE}),
        ("@do/goal/send?x=1;y=2.0;yaw=0.5;id=g", b""),
        ("@do/goal/send?x=1&y=2.0&yaw=0.5&id=g", b""),
        ("@do/goal/send", b' \n{"id": "g", "pose": {"x": 1, "y": 2, "yaw": 0.5}}'),
        ("@do/goal/send", msgspec.msgpack.encode({"id": "g", "pose": POSE})),
    ],
)
def test_parameters_come_in_the_payload_or_in_the_selector(
    lockstep: Lockstep, owner: Owner, selector: str, payload: Any
):
    assert ask(lockstep, selector, payload)["id"] == "g"
    assert owner.goals == [SendGoal(id="g", pose=Pose2D(1.0, 2.0, 0.5))]


def test_selector_parameters_are_percent_decoded(lockstep: Lockstep, owner: Owner):
    ask(lockstep, "@do/goal/send?name=living%20room;speed=0.3")
    assert owner.goals == [SendGoal(name="living room", speed=0.3)]


def test_booleans_may_stand_in_the_selector(lockstep: Lockstep):
    class Capturing(Service):
        name = "tour"
        seen: list[Any] = []  # noqa: RUF012

        @answers(requests.POSE_CAPTURE)
        def capture(self, params: Any) -> Any:
            self.seen.append(params)
            raise Refused(codes.LOST)

    service = lockstep.add(Capturing())
    assert code(lockstep, "@do/pose/capture?name=a;replace=true") == codes.LOST
    assert service.seen[0].replace is True


@pytest.mark.parametrize(
    ("selector", "payload", "expected"),
    [
        ("@do/goal/send?id=g", {"name": "kitchen"}, "not both"),
        ("@do/goal/send", {"name": "kitchen", "colour": 1}, "colour"),
        ("@do/goal/send", {"pose": {**POSE, "z": 1.0}}, "pose.z"),
        ("@do/goal/send", {"pose": POSE, "via": [POSE, {**POSE, "w": 1}]}, "via[1].w"),
        ("@do/goal/send?name=kitchen;colour=red", b"", "colour"),
        ("@do/goal/send", {"id": "g"}, "pose or name"),
        ("@do/goal/send", {"pose": POSE, "name": "kitchen"}, "pose or name"),
        ("@do/goal/send", {"pose": {**POSE, "x": None}}, "pose.x"),
        ("@do/goal/send", {"pose": {**POSE, "x": "1"}}, "pose.x"),
        ("@do/goal/send?x=nan;y=0;yaw=0", b"", "pose"),
        ("@do/goal/send?x=1e999;y=0;yaw=0", b"", "pose"),
        ("@do/goal/send", {"name": "kitchen", "speed": -1.0}, "speed"),
        ("@do/goal/send", {"name": "kitchen", "id": "../etc"}, "id"),
        ("@do/goal/send", b'{"name": "kit', "cut short"),
        ("@do/goal/send", b"[" * 100_000, ""),
        ("@do/goal/send", b'{"via": ' + b"[" * 100_000, ""),
        ("@do/goal/send", b"[]", ""),
        ("@do/goal/send", b"null", ""),
        ("@do/goal/send", b"\xc1\xff\x00", ""),
        ("@do/tours/put", {"name": "t", "stops": []}, "stops"),
        ("@do/tours/put", {"name": "t", "stops": [{"name": "a", "x": 1}]}, "stops[0].x"),
    ],
)
def test_what_is_not_understood_is_refused_and_says_why(
    lockstep: Lockstep, owner: Owner, selector: str, payload: Any, expected: str
):
    answer = ask(lockstep, selector, payload)
    assert answer["code"] == codes.BAD_REQUEST
    assert expected in answer["message"]
    assert owner.goals == []


def test_nan_in_msgpack_is_refused(lockstep: Lockstep, owner: Owner):
    payload = msgspec.msgpack.encode({"pose": {**POSE, "yaw": float("nan")}})
    assert code(lockstep, "@do/goal/send", payload) == codes.BAD_REQUEST
    assert owner.goals == []


def test_a_huge_request_is_refused(lockstep: Lockstep, owner: Owner):
    payload = b'{"name": "' + b"a" * (1 << 20) + b'"}'
    assert code(lockstep, "@do/goal/send", payload) == codes.TOO_LARGE
    assert owner.goals == []


@pytest.mark.parametrize("key", ["trolley/*/@do/goal/send", "trolley/trolley/@do/goal/*"])
def test_a_request_of_all_robots_is_refused(lockstep: Lockstep, owner: Owner, key: str):
    replies = lockstep.get(key, b'{"name": "kitchen"}')
    assert replies
    assert all(json.loads(reply.payload)["code"] == codes.BAD_REQUEST for reply in replies)
    assert owner.goals == []


@pytest.mark.parametrize(
    ("key", "payload"),
    [
        ("trolley/*/@do/base/stop", b""),
        ("trolley/trolley/@do/base/stop", b"\xff{[nonsense"),
        ("trolley/trolley/@do/base/stop?x=1", b"{}"),
        ("trolley/trolley/@do/base/stop", b"x" * (2 << 20)),
    ],
)
def test_a_stop_is_obeyed_whatever_it_holds(
    lockstep: Lockstep, owner: Owner, key: str, payload: bytes
):
    (reply,) = lockstep.get(key, payload)
    assert reply.key == "trolley/trolley/@do/base/stop"
    assert json.loads(reply.payload)["mode"] == "stopped"
    assert owner.stops == 1


@pytest.mark.parametrize(
    "key",
    [
        "trolley/trolley/@do/**",
        "trolley/*/@do/base/*",
        "trolley/trolley/@do/*/stop",
        "trolley/*/@do/**",
    ],
)
def test_a_stop_among_other_requests_is_refused(lockstep: Lockstep, owner: Owner, key: str):
    replies = lockstep.get(key, b"{}")
    assert replies
    assert all(json.loads(reply.payload)["code"] == codes.BAD_REQUEST for reply in replies)
    assert owner.stops == 0


def test_reading_everything_commands_nothing(lockstep: Lockstep, owner: Owner):
    for selector in ("trolley/trolley/**", "trolley/**", "**", "*/*/*"):
        replies = lockstep.get(selector)
        assert replies
        assert not any("@" in reply.key for reply in replies)
    assert owner.goals == []
    assert owner.stops == 0
    assert lockstep.counters("tour") == {}


def test_a_refusal_has_code_sentence_and_details(lockstep: Lockstep, owner: Owner):
    answer = ask(lockstep, "@do/goal/cancel", {"id": "old"})
    assert answer == {
        "code": "not_current",
        "message": codes.SENTENCES[codes.NOT_CURRENT],
        "details": {"id": "old"},
    }
    assert lockstep.counters("tour") == {"goal/cancel/not_current": 1}


def test_answers_to_requests_are_json_unless_asked_otherwise(lockstep: Lockstep, owner: Owner):
    (reply,) = lockstep.get("trolley/trolley/@do/goal/send?format=msgpack", b'{"name": "a"}')
    assert reply.encoding == "application/msgpack"
    assert msgspec.msgpack.decode(reply.payload)["state"] == "planning"
    (reply,) = lockstep.get("trolley/trolley/@do/goal/send", b'{"name": "a"}')
    assert reply.encoding == "application/json"


# Answers that come later.


def test_an_answer_may_come_later(lockstep: Lockstep, owner: Owner):
    asked = AskOffer(name="kitchen")
    replies: list[Any] = []
    other = lockstep.add(Asker())
    other.request(requests.TOUR_OFFER, asked, replies.append)
    lockstep.run(1.0)
    assert replies == []
    owner.open[0].reply(Offer(free=True, seconds=3.0))
    owner.open[0].reply(Offer(free=False))  # too late: the first counts
    owner.open[0].refuse(Refused(codes.INTERNAL))
    lockstep.run(0.1)
    assert replies == [Offer(free=True, seconds=3.0)]
    assert not owner.open[0].is_open


def test_an_answer_that_does_not_come_times_out_within_two_seconds(
    lockstep: Lockstep, owner: Owner
):
    before_s = lockstep.now_s
    with pytest.raises(Refused) as refused:
        lockstep.ask(requests.TOUR_OFFER, AskOffer(name="kitchen"))
    assert refused.value.code == codes.TIMEOUT
    assert 1.5 < lockstep.now_s - before_s < 2.0
    owner.open[0].reply(Offer(free=True))  # nobody listens any more
    lockstep.run(0.1)
    assert lockstep.counters("tour") == {"tour/offer/timeout": 1}


def test_an_answer_that_is_there_at_once_is_given_at_once(lockstep: Lockstep):
    class Quick(Service):
        name = "tour"

        @answers(requests.TOUR_OFFER)
        def offer(self, _params: AskOffer) -> Later[Offer]:
            later: Later[Offer] = self.later()
            later.refuse(Refused(codes.NO_PATH))
            return later

    lockstep.add(Quick())
    with pytest.raises(Refused) as refused:
        lockstep.ask(requests.TOUR_OFFER, AskOffer(name="kitchen"))
    assert refused.value.code == codes.NO_PATH
    assert lockstep.now_s == 0.0


class Asker(Service):
    """Asks others."""

    name = "viz"


def test_nobody_answers_means_not_ready(lockstep: Lockstep):
    asker = lockstep.add(Asker())
    results: list[Any] = []
    asker.request(requests.MAP_LIST, Nothing(), results.append)
    lockstep.run(0.1)
    (refused,) = results
    assert isinstance(refused, Refused)
    assert (refused.code, refused.details) == (codes.NOT_READY, {"service": "localizer"})


def test_a_service_that_dies_while_asked_means_timeout(lockstep: Lockstep, owner: Owner):
    asker = lockstep.add(Asker())
    results: list[Any] = []
    asker.request(requests.TOUR_OFFER, AskOffer(name="a"), results.append, timeout_s=1.0)
    lockstep.run(0.5)
    assert len(owner.open) == 1
    lockstep.kill("tour")
    lockstep.run(0.4)
    assert results == []
    lockstep.run(0.2)
    assert [result.code for result in results] == [codes.TIMEOUT]


def test_an_exception_answers_internal_and_ends_the_service(lockstep: Lockstep):
    class Faulty(Service):
        name = "tour"

        @answers(requests.POSES_DELETE)
        def delete(self, _params: Named) -> SavedPose:
            raise ZeroDivisionError

    lockstep.add(Faulty())
    replies: list[Any] = []
    lockstep.bus.get(
        requests.POSES_DELETE.key("trolley"),
        b'{"name": "a"}',
        "",
        2.0,
        replies.append,
        lambda: None,
    )
    with pytest.raises(ZeroDivisionError):
        lockstep.run(0.1)
    assert json.loads(replies[0].payload)["code"] == codes.INTERNAL


# Reads.


def test_a_read_gives_the_latest_value(lockstep: Lockstep, owner: Owner):
    assert ask(lockstep, "poses")["stamp_ns"] == 7
    owner.publish(topics.POSES, make_places(8))
    assert ask(lockstep, "poses")["stamp_ns"] == 8
    (reply,) = lockstep.get("trolley/*/poses?format=msgpack")
    assert reply.key == "trolley/trolley/poses"
    assert reply.encoding == "application/msgpack"


def test_a_stored_key_is_read_by_its_name_in_any_form(lockstep: Lockstep, owner: Owner):
    assert unicodedata.normalize("NFC", NFD) == NFC
    for name in (NFC, NFD):
        (reply,) = lockstep.get(f"trolley/trolley/poses/{name}")
        assert reply.key == f"trolley/trolley/poses/{name}"  # on the key as asked
        assert json.loads(reply.payload)["name"] == NFC


def test_a_wildcard_read_is_answered_on_the_owners_keys(lockstep: Lockstep, owner: Owner):
    replies = lockstep.get("trolley/*/poses/*")
    assert {reply.key for reply in replies} == {
        f"trolley/trolley/poses/{NFC}",
        "trolley/trolley/poses/living room",
    }
    (reply,) = lockstep.get("trolley/trolley/poses/living$*")
    assert reply.key == "trolley/trolley/poses/living room"


def test_a_wildcard_read_of_a_name_in_another_form_ends_nobody(lockstep: Lockstep, owner: Owner):
    assert lockstep.get(f"trolley/*/poses/{NFD}") == []  # Zenoh takes no answer on another key
    assert lockstep.get(f"trolley/trolley/poses/{NFD}$*") == []
    (reply,) = lockstep.get(f"trolley/*/poses/{NFC}")
    assert reply.key == f"trolley/trolley/poses/{NFC}"


def test_an_unknown_name_is_an_error_and_a_wildcard_leaves_it_out(lockstep: Lockstep, owner: Owner):
    assert code(lockstep, "poses/attic") == codes.UNKNOWN_NAME
    assert code(lockstep, "goal?id=unknown") == codes.UNKNOWN_NAME
    assert "'unknown'" in ask(lockstep, "goal?id=unknown")["message"]
    assert lockstep.get("trolley/*/goal?id=unknown") == []
    assert lockstep.get("trolley/trolley/poses/x$*") == []
    assert code(lockstep, "goal?id=refused") == codes.NOT_READY
    assert lockstep.get("trolley/*/goal?id=refused") == []
    assert ask(lockstep, "goal?id=a")["id"] == "a"
    assert ask(lockstep, "goal")["id"] == "now"


def test_a_name_that_would_cut_the_selector_is_never_asked_for(lockstep: Lockstep, owner: Owner):
    owner.places["a"] = make_place("a")
    asker = lockstep.add(Asker())
    found: list[Any] = []
    asker.get(topics.SAVED_POSE, "a?b", then=found.append)
    asker.get(topics.SAVED_POSE, "a#b", then=found.append)
    asker.get(topics.SAVED_POSE, "a", then=found.append)
    lockstep.run(0.1)
    assert found == [{}, {}, {("a",): make_place("a")}]


def test_stored_values_may_come_without_the_name(lockstep: Lockstep, owner: Owner):
    stop = {"name": "kitchen"}
    assert ask(lockstep, "@do/tours/put", {"stops": [stop]})["name"] == ""
    assert Tour(stops=[Stop(name="kitchen")]).repeat == 1


def test_a_flood_is_refused_and_leaves_room_for_others():
    owner = Owner()
    with Lockstep("tester") as lockstep:
        lockstep.add(owner)
        lockstep.run(0.1)
        replies: list[Reply] = []
        stops: list[Reply] = []
        key = "trolley/tester/@do/goal/cancel"
        for _ in range(5000):
            lockstep.bus.get(key, b"", "", 2.0, replies.append, lambda: None)
        assert {json.loads(reply.payload)["code"] for reply in replies} == {codes.NOT_READY}
        refused = len(replies)
        assert 4000 < refused < 5000
        lockstep.bus.get("trolley/*/@do/base/stop", b"", "", 2.0, stops.append, lambda: None)
        assert lockstep.ask(requests.GOAL_SEND, SendGoal(name="kitchen")).state == "planning"
        assert owner.stops == len(stops) == 1
        assert len(replies) == 5000
        assert {json.loads(reply.payload)["code"] for reply in replies[refused:]} == {
            codes.NOT_CURRENT
        }
        assert lockstep.counters("tour")["requests/too_many"] == refused


def test_what_is_withdrawn_is_answered_no_more_until_it_is_published_again(
    lockstep: Lockstep, owner: Owner
):
    assert ask(lockstep, "poses")["stamp_ns"] == 7
    owner.withdraw(topics.POSES)
    assert lockstep.get(topics.POSES.key("trolley")) == []
    owner.withdraw(topics.POSES)
    owner.publish(topics.POSES, make_places(8, "kitchen"))
    assert ask(lockstep, "poses")["stamp_ns"] == 8
