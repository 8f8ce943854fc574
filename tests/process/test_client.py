"""`trolley.Robot` against a scripted robot over real Zenoh."""

import subprocess
import sys
import time
from collections.abc import Callable

import pytest
from click.testing import CliRunner
from support.waiting import PATIENCE_S, wait_until

from trolley import (
    Refused,
    Robot,
    RobotUnreachable,
    SeveralRobots,
    client,
    codes,
    requests,
    topics,
)
from trolley.cli import cli, exits
from trolley.connection import Connection
from trolley.geometry import Pose2D
from trolley.messages import GoalStatus, Marker, Overlay, TourStatus, request_params
from trolley.runtime import codec
from trolley.runtime.bus import Query, Sample
from trolley.runtime.zenoh_bus import ZenohBus, open_bus
from trolley.topics import Qos


def script(*steps: tuple[str, str]) -> tuple[GoalStatus, ...]:
    return tuple(
        GoalStatus(stamp_ns=0, id=None, state=state, reason=reason)  # pyrefly: ignore[bad-argument-type]
        for state, reason in steps
    )


def test_importing_trolley_loads_neither_zenoh_nor_numpy() -> None:
    program = "import sys, trolley; print(sorted({'zenoh', 'numpy', 'msgspec'} & {*sys.modules}))"
    done = subprocess.run(
        [sys.executable, "-c", program],
        capture_output=True,
        text=True,
        check=True,
        timeout=PATIENCE_S,
    )
    assert done.stdout.strip() == "[]"


def test_the_single_robot_is_found_and_says_where_it_is(add_robot: Callable, endpoint: str) -> None:
    add_robot("one")
    with Robot(connect=endpoint) as robot:
        assert robot.name == "one"
        estimate = robot.pose()
        assert estimate.state == "localized"
        assert estimate.pose == Pose2D(1.0, 2.0, 0.5)


def test_a_pose_does_not_grow_old_while_the_clock_is_asked_for(
    add_robot: Callable, endpoint: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On a busy computer, or over a slow link, it was refused as stale."""
    add_robot("one")
    with Robot(connect=endpoint) as robot:
        now_ns = robot.connection.robot_now_ns

        def late(name: str) -> int | None:
            time.sleep(1.5 * client.STALE_AFTER_S)
            return now_ns(name)

        monkeypatch.setattr(robot.connection, "robot_now_ns", late)
        assert robot.pose().state == "localized"


@pytest.mark.parametrize(("num_unsure", "state"), [(0, "localized"), (300, "unsure")])
def test_who_was_found_is_checked_for_a_while(
    add_robot: Callable, endpoint: str, num_unsure: int, state: str
) -> None:
    add_robot("one").pose_states = ["unsure"] * num_unsure
    with Robot(connect=endpoint) as robot:
        assert robot.find().state == state


def test_a_pose_from_before_the_lidar_fell_silent_is_not_waited_for(
    add_robot: Callable, endpoint: str
) -> None:
    scripted = add_robot("one")
    with Robot(connect=endpoint) as robot:
        assert robot.wait_until_localized(PATIENCE_S).pose == Pose2D(1.0, 2.0, 0.5)
        scripted.is_blind = True

        def is_stale() -> bool:
            try:
                robot.pose()
            except Refused as refused:
                return refused.code == codes.STALE
            return False

        wait_until(is_stale, "the last pose is old")
        with pytest.raises(Refused, match="after 0 s: no pose came in that time"):
            robot.wait_until_localized(0)
        with pytest.raises(Refused, match="its pose is old") as caught:
            robot.wait_until_localized(1.1)
        assert caught.value.code == codes.NOT_LOCALIZED
        scripted.is_blind = False
        assert robot.wait_until_localized(PATIENCE_S).state == "localized"


def test_the_last_word_of_an_earlier_trip_does_not_end_the_wait_for_this_one(
    add_robot: Callable, endpoint: str
) -> None:
    add_robot("one")
    key = topics.TOUR.key("one")
    before, begun, done = (
        TourStatus(stamp_ns=stamp_ns, name="round", trip=trip, state=state)
        for stamp_ns, trip, state in (
            (50, "t1", "done"),
            (100, "t2", "driving"),
            (200, "t2", "done"),
        )
    )

    def say(bus: ZenohBus, status: TourStatus) -> None:
        bus.put(key, codec.encode(status, "msgpack"), codec.MIME["msgpack"], Qos.STATE)

    def answer(query: Query) -> None:
        query.reply(key, codec.encode(begun, "msgpack"), codec.MIME["msgpack"])
        query.finish()

    with Robot(connect=endpoint) as robot, open_bus([endpoint], PATIENCE_S) as tour:
        tour.serve(key, answer)
        wait_until(lambda: robot.latest(topics.TOUR), "the trip has begun")
        trip = robot.follow_tour("t2", PATIENCE_S)
        assert next(trip) == begun
        for status in (before, done):  # as where a link is slow, and an answer overtakes a stream
            say(tour, status)
        assert list(trip) == [done]


def test_several_robots_have_to_be_named(add_robot: Callable, endpoint: str) -> None:
    add_robot("one")
    add_robot("two")
    with pytest.raises(SeveralRobots) as several:
        Robot(connect=endpoint)
    assert several.value.names == ["one", "two"]
    with Robot("two", connect=endpoint) as robot:
        message = robot.latest(topics.ROBOT)
        assert message is not None
        assert message.name == "two"
        assert robot.connection.stop_all().keys() == {"one", "two"}


@pytest.mark.parametrize(
    "name", ["x\nlime: stopped", "\x1b[2J", "lime\u202e", "L" * 33, "Lime", "*"]
)
def test_what_no_robot_can_be_called_is_no_robot(
    add_robot: Callable, endpoint: str, trolley: Callable, name: str
) -> None:
    """A stranger may show any key, and answer whatever it likes to a stop of all robots."""
    add_robot("one")

    def answer(query: Query) -> None:
        for robot in (name, "two"):
            query.reply(requests.BASE_STOP.key(robot), b"\xc1", codec.MIME["msgpack"])
        query.finish()

    with open_bus([endpoint], PATIENCE_S) as bus, Robot("one", connect=endpoint) as robot:
        bus.declare_token(topics.ALIVE.key(name, "base", "run-1-2"))
        bus.serve(requests.BASE_STOP.key("*"), answer)
        assert robot.connection.robots() == ["one"]
        assert robot.connection.stop_all().keys() == {"one"}
        done = trolley("stop", "--all", "--connect", endpoint)
        assert (done.returncode, done.stdout, done.stderr) == (0, "one: stopped\n", "")


def test_a_router_that_is_late_is_asked_once_more(
    add_robot: Callable, endpoint: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On a busy computer an answer that came too late made it seem that nobody was there."""
    add_robot("one")
    monkeypatch.setattr("trolley.connection.TOKENS_S", (0.01, PATIENCE_S))
    with Robot("one", connect=endpoint) as robot:
        alive = robot.connection.bus.alive

        def late_at_first(key_expr: str, patience_s: float) -> list[str]:
            if patience_s == PATIENCE_S:
                return alive(key_expr, patience_s)
            time.sleep(2.0 * patience_s)
            return []

        monkeypatch.setattr(robot.connection.bus, "alive", late_at_first)
        assert robot.connection.robots() == ["one"]


def test_a_router_that_says_nothing_in_time_is_called_busy(
    add_robot: Callable,
    endpoint: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Nobody can tell then whether a robot is there: "no robot is on the network" was untrue."""
    add_robot("one")
    monkeypatch.setattr("trolley.connection.TOKENS_S", (0.01, 0.02))

    def late(_bus: ZenohBus, _key_expr: str, patience_s: float) -> list[str]:
        time.sleep(2.0 * patience_s)
        return []

    monkeypatch.setattr(ZenohBus, "alive", late)
    run = CliRunner()
    for words in (["status", "--all"], ["top", "--once"], ["stop", "--all"]):
        done = run.invoke(cli, [*words, "--connect", endpoint])
        assert done.exit_code == exits.UNREACHABLE
        assert "does not say in time who is there" in done.stderr
        assert done.stdout == ("one: stopped\n" if words[0] == "stop" else "")
    done = run.invoke(cli, ["doctor", "--connect", endpoint, "--seconds", "1"])
    assert "does not say in time who is there" in " ".join(done.stdout.split())


def test_without_a_router_or_a_robot_it_is_unreachable(endpoint: str) -> None:
    with pytest.raises(RobotUnreachable, match="no robot is on the network"):
        Robot(connect=endpoint)
    with pytest.raises(RobotUnreachable, match="no router answers"):
        Robot(connect="tcp/127.0.0.1:1")
    with pytest.raises(RobotUnreachable, match="no robot called nobody is at"):
        Robot("nobody", connect=endpoint, connect_timeout=2.0)


@pytest.mark.parametrize("address", ["kiwi.local:7448", "kiwi.local", "tls/kiwi.local", ""])
def test_what_is_no_endpoint_is_named(address: str) -> None:
    """It was called a router that does not answer."""
    with pytest.raises(ValueError, match="is not an endpoint"):
        Robot(connect=address, connect_timeout=0.1)


@pytest.mark.parametrize(
    "read",
    [Robot.pose, Robot.scan, Robot.battery, Robot.map, Robot.zones, Robot.places, Robot.tours],
)
def test_a_robot_that_is_gone_is_unreachable(read: Callable, endpoint: str) -> None:
    with (
        Connection([endpoint]) as connection,
        pytest.raises(RobotUnreachable, match="no robot called one is at"),
    ):
        read(Robot.over(connection, "one"))


@pytest.mark.parametrize("place", ["kitchen", Pose2D(1.0, 2.0, 0.3), (1.0, 2.0, 0.3), [1.0, 2.0]])
def test_a_goal_is_followed_until_it_has_arrived(
    add_robot: Callable, endpoint: str, place: object
) -> None:
    scripted = add_robot("one")
    with Robot(connect=endpoint) as robot:
        assert robot.go_to(place, timeout=PATIENCE_S).state == "arrived"  # pyrefly: ignore[bad-argument-type]
    goal = scripted.sent[0]
    assert goal.name == ("kitchen" if place == "kitchen" else None)
    assert (goal.yaw_tolerance > 3.14) == (isinstance(place, list))


def test_a_goal_that_fails_raises_its_reason(add_robot: Callable, endpoint: str) -> None:
    add_robot("one", script(("driving", ""), ("failed", "blocked")))
    with Robot(connect=endpoint) as robot:
        with pytest.raises(Refused) as refused:
            robot.go_to("kitchen", timeout=PATIENCE_S)
        assert refused.value.code == "blocked"
        with pytest.raises(Refused) as refused:
            robot.go_to("nowhere")
        assert refused.value.code == "unknown_name"
        assert "nowhere" in refused.value.message


def test_a_goal_that_takes_too_long_times_out_and_drives_on(
    add_robot: Callable, endpoint: str
) -> None:
    scripted = add_robot("one", script(*[("driving", "")] * 10_000))
    with Robot(connect=endpoint) as robot:
        with pytest.raises(Refused) as refused:
            robot.go_to("kitchen", timeout=0.5)
        assert refused.value.code == "timeout"
        wait_until(lambda: scripted.current.state == "driving", "it drives on")
    assert scripted.canceled == []


def test_a_replaced_goal_ends_even_if_its_last_status_was_missed(
    add_robot: Callable, endpoint: str
) -> None:
    scripted = add_robot("one", script(*[("driving", "")] * 100))
    with Robot(connect=endpoint) as robot:
        status = robot.go_to("kitchen", wait=False)
        follow = robot.follow(status.id, timeout=PATIENCE_S)
        next(follow)
        scripted.call_soon(scripted.replace_goal)
        assert [status.reason for status in follow][-1] == "replaced"


def test_a_goal_that_a_restarted_planner_forgot_is_over(add_robot: Callable, endpoint: str) -> None:
    scripted = add_robot("one", script(*[("driving", "")] * 100))
    with Robot(connect=endpoint) as robot:
        status = robot.go_to("kitchen", wait=False)
        follow = robot.follow(status.id, timeout=PATIENCE_S)
        next(follow)
        scripted.call_soon(scripted.forget_goals)
        with pytest.raises(Refused) as refused:
            list(follow)
        assert refused.value.code == "restarted"
        with pytest.raises(Refused, match="does not know the goal g-7: it was restarted, or never"):
            list(robot.follow("g-7"))


def test_a_lost_connection_says_that_the_robot_drives_on(
    endpoint: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(client, "SILENCE_S", 0.1)
    monkeypatch.setattr(client, "ASK_AGAIN_FOR_S", 0.1)
    with (
        Connection([endpoint]) as connection,
        pytest.raises(
            RobotUnreachable, match="if only the connection is lost, the robot drives on"
        ),
    ):
        list(Robot.over(connection, "one").follow("goal"))


def test_stop_and_resume(add_robot: Callable, endpoint: str) -> None:
    scripted = add_robot("one")
    with Robot(connect=endpoint) as robot:
        assert robot.stop().mode == "stopped"
        assert scripted.stopped
        assert robot.resume().mode == "ok"


def test_a_service_that_is_not_there_is_not_ready(add_robot: Callable, endpoint: str) -> None:
    add_robot("one")
    with Robot(connect=endpoint) as robot:
        with pytest.raises(Refused) as refused:
            robot.tour("article")
        assert refused.value.code == "not_ready"
        assert "tour" in refused.value.message
        with pytest.raises(Refused):
            robot.ask(requests.TOUR_OFFER, request_params.AskOffer(name="kitchen"), timeout=0.5)


def test_subscribe_gives_messages_and_a_time_out(add_robot: Callable, endpoint: str) -> None:
    add_robot("one")
    with Robot(connect=endpoint) as robot:
        with robot.subscribe(topics.ODOM) as odometry:
            stamps = [odometry.next(PATIENCE_S).message.stamp_ns for _ in range(3)]  # pyrefly: ignore[missing-attribute]
        assert stamps == sorted(stamps)
        with robot.subscribe(topics.SCAN) as scans:
            assert scans.next(0.2) is None
        assert robot.get(topics.TF).keys() == {("laser",), ("odom",)}


def test_markers_and_overlays_are_put_and_deleted(add_robot: Callable, endpoint: str) -> None:
    add_robot("one")
    # Zenoh keeps the order of one subscription's messages, not that among several.
    markers: list[Sample] = []
    overlays: list[Sample] = []
    with Robot(connect=endpoint) as robot:
        robot.connection.listen("*/one/markers/**", markers.append)
        robot.connection.listen("*/one/overlays/*", overlays.append)
        marker = Marker(kind="icon", icon="home", frame="base_link")
        robot.put_marker("signs", "Küche 1", marker)
        robot.delete_marker("signs", "Küche 1")
        robot.delete_marker("signs")
        robot.delete_marker()
        overlay = Overlay(kind="text", text="hello")
        robot.put_overlay("greeting", overlay)
        robot.delete_overlay("greeting")
        robot.delete_overlay()
        wait_until(lambda: len(markers) == 4 and len(overlays) == 3, "all have arrived")
    assert [_below(sample) for sample in markers] == [
        "markers/signs/Küche 1",
        "markers/signs/Küche 1",
        "markers/signs/*",
        "markers/*/*",
    ]
    assert [sample.is_delete for sample in markers] == [False, True, True, True]
    assert codec.decode(Marker, markers[0].payload, markers[0].encoding) == marker
    assert [_below(sample) for sample in overlays] == [
        "overlays/greeting",
        "overlays/greeting",
        "overlays/*",
    ]
    assert [sample.is_delete for sample in overlays] == [False, True, True]
    assert codec.decode(Overlay, overlays[0].payload, overlays[0].encoding) == overlay


def _below(sample: Sample) -> str:
    """The part of its key below the robot's name."""
    return sample.key.split("/", 2)[2]
