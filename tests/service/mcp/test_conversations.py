"""What an assistant asks, and what it is told: scripts by the SDK's own client."""

import base64
import io
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import anyio
import msgspec
import pytest
from msgspec import structs
from PIL import Image, ImageColor

from trolley import codes, topics
from trolley.codes import Refused
from trolley.geometry import Pose2D
from trolley.messages import BaseState, Battery, GoalStatus, SavedPose, TourStatus
from trolley.picture import BLUE, GREEN, RED
from trolley_mcp import drives, tools
from trolley_mcp.answers import NOT_STOPPED, REMEDIES

if TYPE_CHECKING:
    from .conftest import ScriptedRobot, Talk

Converse = Callable[..., "ScriptedRobot"]
MARKUP = "<b>x</b>\x1b[2J\u202e"


def text_of(result: Any) -> str:
    return result.content[0].text


def code_of(result: Any) -> str:
    return text_of(result).partition(": ")[0] if result.is_error else ""


def data_of(result: Any) -> Any:
    return msgspec.json.decode(result.content[1].text)


@pytest.mark.parametrize(
    ("tool", "arguments", "text"),
    [
        ("status", {}, "Ready.\nIt is in Küche."),
        ("places", {}, "kitchen, hall."),
        ("where_is", {}, "The robot is at"),
        ("where_is", {"place": "hall"}, "3.0 m from the robot as the crow flies."),
        ("where_is", {"place": "KITCHEN"}, "kitchen is at"),
        ("tours", {}, "evening."),
        ("zones", {}, "Küche (room)."),
        ("history", {"limit": 3}, "evening done, 2 reached, 0 missed."),
        ("map", {}, "The map home, 6.0 x 4.0 m"),
        ("stop", {}, "Stopped."),
        ("stop", {"nonsense": 1}, "Stopped."),
        ("go", {"place": "kitchen"}, "Arrived at kitchen after 3 s."),
        ("go", {"place": "hall", "wait": False}, "On its way to hall"),
        ("history", {"limit": 3.0}, "evening done"),
        ("start_tour", {"tour": "evening"}, "The tour evening has begun"),
        ("start_tour", {"tour": "evening", "wait": True}, "The tour is done."),
        ("save_place", {"name": "desk"}, "Saved desk"),
        ("start_map", {"name": "attic"}, "The robot begins the map attic"),
        ("finish_map", {}, "The map is being saved."),
    ],
)
def test_what_is_asked_is_answered(
    converse: Converse, tool: str, arguments: dict[str, Any], text: str
) -> None:
    async def script(talk: "Talk") -> None:
        result = await talk.call(tool, **arguments)
        assert not result.is_error
        assert text in text_of(result)

    converse(script)


def test_nothing_is_said_beside_the_text_and_the_picture(converse: Converse) -> None:
    """Several assistants show their model the structured content alone where there is one."""

    async def script(talk: "Talk") -> None:
        for tool in ("map", "places", "stop", "cancel"):
            assert (await talk.call(tool)).structured_content is None
        assert data_of(await talk.call("where_is", place="hall"))["distance_m"] == 3.0

    converse(script)


def test_a_place_is_found_as_macos_writes_accents(converse: Converse) -> None:
    async def script(talk: "Talk") -> None:
        talk.robot.save([SavedPose(name="caf\u00e9", map="home", pose=Pose2D(1.0, 2.0, 0.0))])
        for name in ("cafe\u0301", " CAFE\u0301 "):
            assert text_of(await talk.call("where_is", place=name)).startswith("caf\u00e9 is at")

    converse(script)


@pytest.mark.parametrize(
    ("tool", "arguments", "code"),
    [
        ("go", {"place": "cellar"}, codes.UNKNOWN_NAME),
        ("go", {"place": MARKUP}, codes.UNKNOWN_NAME),
        ("go", {}, codes.BAD_REQUEST),
        ("go", {"place": "hall", "speed": -1}, codes.BAD_REQUEST),
        ("go", {"place": "hall", "speed": "fast"}, codes.BAD_REQUEST),
        ("go", {"place": ["hall"]}, codes.BAD_REQUEST),
        ("go", {"place": "hall", "force": True}, codes.BAD_REQUEST),
        ("go", {"place": "x" * 10_000}, codes.BAD_REQUEST),
        ("map", {"pixels": 100_000}, codes.BAD_REQUEST),
        ("history", {"limit": 10**9}, codes.BAD_REQUEST),
        ("start_tour", {"tour": "dawn"}, codes.UNKNOWN_NAME),
        ("cancel", {}, codes.NOT_DRIVING),
        ("cancel_map", {}, codes.NOT_MAPPING),
        ("resume", {}, "not_allowed"),
        ("drive_by_hand", {}, codes.UNKNOWN_NAME),
    ],
)
def test_a_refusal_has_a_code_a_sentence_and_what_to_do(
    converse: Converse, tool: str, arguments: dict[str, Any], code: str
) -> None:
    async def script(talk: "Talk") -> None:
        result = await talk.call(tool, **arguments)
        assert result.is_error
        assert code_of(result) == code
        assert text_of(result).endswith(f". {REMEDIES[code]}")
        assert text_of(result).isprintable()

    robot = converse(script)
    assert "goal/send" not in robot.names_asked()
    assert "base/resume" not in robot.names_asked()


@pytest.mark.parametrize(
    "tool", ["go", "start_tour", "cancel", "save_place", "resume", "start_map"]
)
def test_a_viewer_looks_and_stops(converse: Converse, tool: str) -> None:
    async def script(talk: "Talk") -> None:
        listed = {one.name for one in (await talk.client.list_tools()).tools}
        assert tool not in listed
        assert {"status", "map", "stop"} <= listed
        assert code_of(await talk.call(tool, place="hall")) == "not_allowed"
        assert not (await talk.call("stop")).is_error

    assert converse(script, role="viewer", may_resume=True).names_asked() == ["base/stop"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({}, "`place` is missing"),
        ({"place": "hall", "speed": "fast"}, "`speed`: a number or nothing is needed, not text"),
        ({"place": "hall", "force": True}, "unknown field `force`"),
    ],
)
def test_wrong_arguments_are_told_in_plain_words(
    converse: Converse, arguments: dict[str, Any], words: str
) -> None:
    async def script(talk: "Talk") -> None:
        assert words in text_of(await talk.call("go", **arguments))

    converse(script)


def test_the_robots_own_refusal_is_passed_on(converse: Converse) -> None:
    async def script(talk: "Talk") -> None:
        talk.robot.refuse = Refused(codes.NO_PATH, f"No path.{MARKUP}")
        result = await talk.call("go", place="hall")
        assert code_of(result) == codes.NO_PATH
        assert "\x1b" not in text_of(result)

    converse(script)


@pytest.mark.parametrize(
    ("state", "reason"), [("failed", codes.BLOCKED), ("paused", codes.TAKEN_OVER)]
)
def test_a_drive_that_does_not_arrive_says_why(converse: Converse, state: str, reason: str) -> None:
    async def script(talk: "Talk") -> None:
        talk.robot.end = (state, reason, "Boxes stand in the hall.")
        result = await talk.call("go", place="hall")
        assert result.is_error
        assert code_of(result) == reason
        assert "Boxes stand in the hall." in text_of(result)

    converse(script)


@pytest.mark.parametrize("mode", ["auto", "legacy"])
def test_progress_is_told_and_grows(converse: Converse, mode: str) -> None:
    async def script(talk: "Talk") -> None:
        await talk.call("go", place="hall")
        steps = [progress for progress, _, _ in talk.told]
        assert len(steps) >= 2
        assert steps == sorted(set(steps))
        assert all((message or "").startswith("Driving to hall") for _, _, message in talk.told)

    converse(script, mode=mode)


@pytest.mark.parametrize("mode", ["auto", "legacy"])
def test_a_call_that_is_canceled_cancels_its_drive(converse: Converse, mode: str) -> None:
    async def script(talk: "Talk") -> None:
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(lambda: talk.call("go", place="hall"))
            await talk.until(lambda: talk.robot.goal.state == "driving")
            tasks.cancel_scope.cancel()
        await talk.until(lambda: talk.robot.goal.state == "canceled")

    converse(script, mode=mode)


def test_a_tour_whose_call_is_canceled_ends(converse: Converse) -> None:
    async def script(talk: "Talk") -> None:
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(lambda: talk.call("start_tour", tour="evening", wait=True))
            await talk.until(lambda: talk.told)
            tasks.cancel_scope.cancel()
        await talk.until(lambda: talk.robot.trip.state == "stopped")

    converse(script)


@pytest.mark.parametrize("goal_id", ["tour-t1-0-1", None])
def test_a_paused_tour_can_be_canceled(converse: Converse, goal_id: str | None) -> None:
    async def script(talk: "Talk") -> None:
        talk.robot.trip = TourStatus(stamp_ns=0, name="evening", trip="t1", state="paused")
        if goal_id is not None:
            talk.robot.goal = GoalStatus(stamp_ns=0, id=goal_id, state="paused")
        await talk.until(lambda: talk.lockstep.now_ns > 10**9)
        assert not (await talk.call("cancel")).is_error
        assert talk.robot.names_asked() == ["tour/stop"]

    converse(script)


@pytest.mark.parametrize(
    ("tool", "arguments"),
    [("go", {"place": "hall"}), ("start_tour", {"tour": "evening", "wait": True})],
)
def test_a_long_drive_is_answered_before_clients_give_up_and_goes_on(
    converse: Converse, tool: str, arguments: dict[str, Any]
) -> None:
    async def script(talk: "Talk") -> None:
        talk.robot.drive_s = 100.0
        began_ns = talk.lockstep.now_ns
        answer = await talk.call(tool, **arguments)
        assert (talk.lockstep.now_ns - began_ns) * 1e-9 < 55.0
        assert not answer.is_error
        assert "It goes on: call `status`" in text_of(answer)
        ended = {"arrived", "done"}
        await talk.until(lambda: ended & {talk.robot.goal.state, talk.robot.trip.state})
        assert not {"goal/cancel", "tour/stop"} & set(talk.robot.names_asked())
        assert (talk.lockstep.now_ns - began_ns) * 1e-9 > 95.0

    converse(script, tick_s=0.5)


def test_a_robot_whose_time_is_slow_keeps_no_client_waiting(converse: Converse) -> None:
    async def script(talk: "Talk") -> None:
        talk.robot.rate = 0.1
        talk.robot.drive_s = 1000.0
        began_ns = talk.lockstep.now_ns
        assert "It goes on" in text_of(await talk.call("go", place="hall"))
        assert (talk.lockstep.now_ns - began_ns) * 1e-9 < 55.0

    converse(script, tick_s=0.5)


@pytest.mark.parametrize(("asked", "driven"), [(None, 0.25), (0.1, 0.1), (5.0, 0.25)])
def test_no_drive_is_faster_than_the_settings_allow(
    converse: Converse, asked: float | None, driven: float
) -> None:
    async def script(talk: "Talk") -> None:
        await talk.call("go", place="hall", speed=asked)
        await talk.call("start_tour", tour="evening", speed=asked, wait=True)
        await talk.call("start_map", name="attic")

    speeds = [params.speed for _, params in converse(script, max_speed_mps=0.25).asked]
    assert speeds == [driven, driven, 0.25]


def test_what_somebody_wanted_is_interrupted_only_on_demand(converse: Converse) -> None:
    async def script(talk: "Talk") -> None:
        talk.robot.goal = GoalStatus(stamp_ns=0, id="viz-1", state="driving")
        await anyio.sleep(0.05)
        assert code_of(await talk.call("go", place="hall")) == codes.BUSY
        talk.robot.goal = GoalStatus(stamp_ns=0, id=None, state="idle")
        talk.robot.trip = TourStatus(stamp_ns=0, name="dawn", trip="x", state="dwelling")
        await anyio.sleep(0.05)
        assert "on the tour dawn" in text_of(await talk.call("go", place="hall"))
        assert talk.robot.asked == []
        assert not (await talk.call("go", place="hall", replace=True, wait=False)).is_error

    converse(script)


def test_a_paused_tour_is_not_given_up_for_another_unasked(converse: Converse) -> None:
    async def script(talk: "Talk") -> None:
        talk.robot.trip = TourStatus(stamp_ns=0, name="dawn", trip="x", state="paused")
        await anyio.sleep(0.05)
        assert code_of(await talk.call("start_tour", tour="evening")) == codes.BUSY

    assert converse(script).asked == []


def test_a_drive_whose_planner_falls_silent_does_not_go_on_later(
    converse: Converse, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(drives, "SILENCE_S", 0.05)
    monkeypatch.setattr(drives, "AGAIN_S", 0.05)

    async def script(talk: "Talk") -> None:
        results: list[Any] = []

        async def drive() -> None:
            results.append(await talk.call("go", place="hall"))

        talk.robot.drive_s = 1e6
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(drive)
            await talk.until(lambda: talk.told)
            talk.lockstep.kill("base")
        assert code_of(results[0]) == codes.NOT_READY
        assert code_of(await talk.call("cancel")) == codes.NOT_READY
        talk.lockstep.add(talk.robot)
        await talk.until(lambda: talk.robot.goal.state == "canceled")

    converse(script)


@pytest.mark.parametrize("wait", [True, False])
def test_a_drive_whose_start_is_not_answered_is_canceled(converse: Converse, wait: bool) -> None:
    async def script(talk: "Talk") -> None:
        talk.robot.answers_goals = False
        result = await talk.call("go", place="hall", wait=wait)
        assert code_of(result) == codes.TIMEOUT
        await talk.until(lambda: talk.robot.goal.state == "canceled")

    converse(script)


@pytest.mark.parametrize("wait", [True, False])
def test_a_tour_whose_start_is_not_answered_is_ended(converse: Converse, wait: bool) -> None:
    async def script(talk: "Talk") -> None:
        talk.robot.answers_goals = False
        result = await talk.call("start_tour", tour="evening", wait=wait)
        assert code_of(result) == codes.TIMEOUT
        await talk.until(lambda: talk.robot.trip.state == "stopped")

    converse(script)


def test_a_tour_that_a_restarted_service_has_forgotten_is_said_to_be(converse: Converse) -> None:
    async def script(talk: "Talk") -> None:
        results: list[Any] = []

        async def drive() -> None:
            results.append(await talk.call("start_tour", tour="evening", wait=True))

        async with anyio.create_task_group() as tasks:
            tasks.start_soon(drive)
            await talk.until(lambda: talk.told)
            talk.robot.trip = TourStatus(stamp_ns=0, name=None, trip=None, state="idle")
        assert code_of(results[0]) == codes.RESTARTED

    converse(script)


def test_two_sessions_do_not_fight(converse: Converse) -> None:
    async def script(talk: "Talk") -> None:
        (other,) = talk.others
        results: dict[str, Any] = {}

        async def first() -> None:
            results["first"] = await talk.call("go", place="hall")

        async with anyio.create_task_group() as tasks:
            tasks.start_soon(first)
            await talk.until(lambda: talk.robot.goal.state == "driving")
            refused = await talk.call("go", other, place="kitchen")
            assert code_of(refused) == codes.BUSY
            await talk.call("go", other, place="kitchen", replace=True)
        assert code_of(results["first"]) == codes.REPLACED

    converse(script, sessions=2)


def test_a_stopped_robot_is_released_only_where_the_settings_allow_it(converse: Converse) -> None:
    async def script(talk: "Talk") -> None:
        await talk.call("stop")
        refused = await talk.call("go", place="hall")
        assert code_of(refused) == codes.STOPPED
        assert "trolley resume" in text_of(refused)
        assert not (await talk.call("resume")).is_error
        assert not (await talk.call("go", place="hall")).is_error

    converse(script, may_resume=True)


def test_a_stop_ends_the_wait_for_a_drive(converse: Converse) -> None:
    async def script(talk: "Talk") -> None:
        results: list[Any] = []

        async def drive() -> None:
            results.append(await talk.call("go", place="hall"))

        async with anyio.create_task_group() as tasks:
            tasks.start_soon(drive)
            await talk.until(lambda: talk.robot.goal.state == "driving")
            await talk.call("stop")
        assert code_of(results[0]) == codes.STOPPED

    converse(script)


def test_a_stop_that_is_not_answered_is_told_as_such(converse: Converse) -> None:
    async def script(talk: "Talk") -> None:
        talk.robot.is_deaf = True
        result = await talk.call("stop")
        assert code_of(result) == NOT_STOPPED
        assert text_of(result).endswith("Tell a person at once, and call `stop` again.")

    converse(script)


def test_a_stop_goes_on_trying_while_the_connection_is_down(
    converse: Converse, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tools, "STOP_AGAIN_S", 0.0)

    async def script(talk: "Talk") -> None:
        talk.lockstep.kill("base")
        results: list[Any] = []

        async def stop() -> None:
            results.append(await talk.call("stop"))

        async with anyio.create_task_group() as tasks:
            tasks.start_soon(stop)
            began_ns = talk.lockstep.now_ns
            await talk.until(lambda: talk.lockstep.now_ns > began_ns + 300_000_000)
            talk.lockstep.add(talk.robot)
        assert not results[0].is_error
        assert talk.robot.base.mode == "stopped"

    converse(script)


def test_no_tour_is_begun_while_the_robot_is_stopped(converse: Converse) -> None:
    async def script(talk: "Talk") -> None:
        await talk.call("stop")
        assert code_of(await talk.call("start_tour", tour="evening")) == codes.STOPPED

    converse(script)


def test_a_robot_that_may_still_move_is_not_called_stopped(converse: Converse) -> None:
    async def script(talk: "Talk") -> None:
        halted = BaseState(
            stamp_ns=0, mode="fault", reason=codes.DOES_NOT_OBEY, not_stopped=True, message="No!"
        )
        talk.robot.halt = lambda params: halted
        talk.lockstep.kill("base")
        talk.lockstep.add(talk.robot)
        result = await talk.call("stop")
        assert code_of(result) == codes.DOES_NOT_OBEY

    converse(script)


@pytest.mark.parametrize("tool", ["status", "go"])
def test_a_thousand_calls_delay_no_stop_and_hardly_reach_the_robot(
    converse: Converse, tool: str
) -> None:
    arguments = {"place": "hall", "replace": True} if tool == "go" else {}
    codes_told: list[str] = []

    async def script(talk: "Talk") -> None:
        async def ask() -> None:
            result = await talk.call(tool, **arguments)
            codes_told.append(code_of(result))

        async with anyio.create_task_group() as tasks:
            for _ in range(1000):
                tasks.start_soon(ask)
            await anyio.sleep(0)
            assert not (await talk.call("stop")).is_error

    robot = converse(script, tick_s=0.001)
    assert codes_told.count("too_many") >= 900
    assert robot.names_asked().count("goal/send") <= 6


def test_an_assistant_that_loops_is_slowed_down(converse: Converse) -> None:
    async def script(talk: "Talk") -> None:
        for _ in range(100):
            await talk.call("go", place="hall", wait=False, replace=True)
        elapsed_s = talk.lockstep.now_s - 0.5
        assert talk.robot.names_asked().count("goal/send") <= 7 + 0.5 * elapsed_s

    converse(script)


def test_the_map_is_a_picture_of_a_bounded_size(converse: Converse) -> None:
    async def script(talk: "Talk") -> None:
        result = await talk.call("map", pixels=300)
        png = base64.b64decode(result.content[-1].data)
        image = Image.open(io.BytesIO(png))
        assert image.format == "PNG"
        assert max(image.size) <= 300
        assert len(png) < 100_000
        colours = {colour for _, colour in image.convert("RGB").getcolors() or []}
        assert {ImageColor.getrgb(one) for one in (RED, GREEN, BLUE)} <= colours

    converse(script)


def test_a_stale_pose_and_a_silent_base_are_said(converse: Converse) -> None:
    async def script(talk: "Talk") -> None:
        talk.lockstep.kill("base")
        await anyio.sleep(0.2)
        assert "No contact with the robot." in text_of(await talk.call("status"))

    converse(script)


def test_the_status_says_which_services_are_silent(converse: Converse) -> None:
    async def script(talk: "Talk") -> None:
        robot = talk.robot
        talk.lockstep.kill("base")
        # As if the planner, the tour service and the localizer were programs of their own.
        robot.silent = {topics.GOAL.name, topics.TOUR.name, topics.POSE.name, topics.POSES.name}
        talk.lockstep.add(robot)
        await anyio.sleep(0.05)
        told = text_of(await talk.call("status"))
        assert "Ready" not in told
        assert all(f"{name} is not running" in told for name in ("localizer", "planner"))
        assert "tour service, which keeps the places, is not running" in told
        robot.goal = GoalStatus(stamp_ns=0, id="viz-1", state="driving")
        robot.silent = {topics.TOUR.name, topics.POSES.name}
        await anyio.sleep(0.05)
        assert text_of(await talk.call("status")).startswith("Driving to its goal")
        # What needs no places goes on without them.
        assert not (await talk.call("map")).is_error
        robot.silent = {topics.TOUR.name, topics.POSES.name}
        await anyio.sleep(0.05)
        assert text_of(await talk.call("where_is")).startswith("The robot is at")

    converse(script)


def test_the_status_says_why_the_robot_does_not_drive(converse: Converse) -> None:
    async def script(talk: "Talk") -> None:
        talk.robot.base = BaseState(
            stamp_ns=0, mode="held", reason=codes.STOP_FIELD, battery=Battery(fraction=0.4)
        )
        await anyio.sleep(0.05)
        result = await talk.call("status")
        assert "Waiting: Something is too close" in text_of(result)
        assert data_of(result)["battery"] == 0.4
        assert data_of(result)["reason"] == codes.STOP_FIELD

    converse(script)


def test_names_from_others_are_made_harmless(converse: Converse) -> None:
    async def script(talk: "Talk") -> None:
        place = SavedPose(name=f"a{MARKUP}", map="home", pose=Pose2D(0.0, 0.0, 0.0), note="\x07")
        talk.robot.publish(topics.POSES, structs.replace(await latest_of(talk), poses=[place]))
        result = await talk.call("places")
        assert text_of(result).isprintable()
        assert "\x07" not in data_of(result)["places"][0]["note"]

    async def latest_of(talk: "Talk") -> Any:
        from trolley.messages import SavedPoses

        return SavedPoses(stamp_ns=0, poses=[])

    converse(script)
