"""What `trolley.Robot` and `AsyncRobot` do beyond goals, with a scripted robot over real Zenoh."""

import asyncio
import contextlib
import inspect
import math
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from support.waiting import PATIENCE_S, wait_until

from trolley import AsyncRobot, Refused, Robot, RobotUnreachable, connection, teleop, topics
from trolley.cli import cli
from trolley.geometry import Pose2D, Twist2D
from trolley.messages import (
    BaseState,
    Battery,
    GoalStatus,
    Health,
    Marker,
    OccupancyGrid,
    SavedPose,
    SavedPoses,
    Scan,
    floats_to_bytes,
)
from trolley.runtime import zenoh_bus
from trolley.runtime.zenoh_bus import open_bus
from trolley.topics import Qos

from .conftest import ScriptedRobot, running

DRIVES_ON = tuple(GoalStatus(stamp_ns=0, id=None, state="driving") for _ in range(10_000))
MAP = OccupancyGrid(
    stamp_ns=1,
    name="home",
    frame="map",
    resolution=0.5,
    width=3,
    height=2,
    origin=Pose2D.identity(),
    cells=memoryview(bytes([0, 100, 0, 255, 0, 0])),
)
SCAN = Scan(
    stamp_ns=1,
    frame="laser",
    angle_min=0.0,
    angle_increment=0.5 * math.pi,
    time_increment=0.0,
    range_min=0.1,
    range_max=8.0,
    ranges=floats_to_bytes(np.array([1.0, 2.0, math.inf, 0.0])),
)


def publish(scripted: ScriptedRobot, topic: Any, message: Any, *parts: str) -> None:
    """Let the robot publish something."""
    done = threading.Event()

    def say() -> None:
        scripted.publish(topic, message, *parts)
        done.set()

    scripted.call_soon(say)
    assert done.wait(PATIENCE_S)


def test_a_name_that_is_nearly_right_is_suggested(add_robot: Callable, endpoint: str) -> None:
    add_robot("kiwi")
    add_robot("lime")
    with pytest.raises(RobotUnreachable, match=r"no robot called kivi .* Did you mean kiwi\?"):
        Robot("kivi", connect=endpoint, connect_timeout=2.0)
    with pytest.raises(RobotUnreachable, match=r"There are kiwi, lime\."):
        Robot("nobody", connect=endpoint, connect_timeout=2.0)
    assert Robot.names(endpoint) == ["kiwi", "lime"]


def test_a_robot_that_is_just_starting_is_waited_for(endpoint: str, tmp_path: Path) -> None:
    found: list[Robot] = []
    looking = threading.Thread(
        target=lambda: found.append(Robot("late", connect=endpoint, connect_timeout=PATIENCE_S))
    )
    looking.start()
    with running(ScriptedRobot("late", ()), "late", endpoint, tmp_path):
        looking.join(PATIENCE_S)
        with found[0] as robot:
            assert robot.pose().state == "localized"


def test_maps_and_scans_are_arrays_and_a_notebook_sees_a_picture(
    add_robot: Callable, endpoint: str
) -> None:
    scripted = add_robot("one")
    with Robot(connect=endpoint) as robot:
        with pytest.raises(Refused, match="There is no map"):
            robot.map()
        assert robot._repr_png_() is None  # and Jupyter shows `repr`
        assert "one" in repr(robot)
        publish(scripted, topics.MAP, MAP)
        publish(scripted, topics.SCAN, SCAN)
        wait_until(lambda: robot.latest(topics.MAP), "the router knows who has the map")
        wait_until(lambda: robot.latest(topics.SCAN), "the router knows who has the scan")
        assert robot.map().cells.tolist() == [[0, 100, 0], [-1, 0, 0]]
        scan = robot.scan()
        assert scan.ranges.tolist() == [1.0, 2.0, math.inf, 0.0]
        assert scan.points() == pytest.approx(np.array([[1.0, 0.0], [0.0, 2.0]]))
        assert robot.places().keys() == {"kitchen"}
        picture = robot.picture(120)
        assert picture.size == (120, 80)
        png = robot._repr_png_()
        assert png is not None
        assert png.startswith(b"\x89PNG")


def test_a_robot_that_does_not_measure_its_battery_says_so(
    add_robot: Callable, endpoint: str
) -> None:
    add_robot("one")
    with Robot(connect=endpoint) as robot:
        assert robot.battery() == Battery(fraction=None, voltage=None, charging=None)


def test_a_number_of_numpy_is_sent_as_any_other(add_robot: Callable, endpoint: str) -> None:
    """What could not be sent was canceled as if it had been."""
    scripted = add_robot("one")
    with Robot(connect=endpoint) as robot:
        robot.go_to("kitchen", wait=False, speed=np.float64(0.3), xy_tolerance=np.float64(0.25))
        with pytest.raises(TypeError):
            robot.go_to("kitchen", speed=object())  # pyrefly: ignore[bad-argument-type]
    assert [(goal.speed, goal.xy_tolerance) for goal in scripted.sent] == [(0.3, 0.25)]
    assert scripted.canceled == []


def test_what_could_be_no_place_is_never_sent(add_robot: Callable, endpoint: str) -> None:
    scripted = add_robot("one")
    nan = math.nan
    with Robot(connect=endpoint) as robot:
        for place in (Pose2D(nan, 0.0, 0.0), (nan, 0.0), (1.0, math.inf, 0.0), (1.0,), 5):
            with pytest.raises(ValueError, match=r"needs finite numbers|two or three numbers"):
                robot.go_to(place)  # pyrefly: ignore[bad-argument-type]
        with pytest.raises(ValueError, match="finite"):
            robot.set_pose((0.0, 0.0, nan))
        with pytest.raises(ValueError, match="finite"):
            robot.drive(Twist2D(nan, 0.0, 0.0))
        with pytest.raises(ValueError, match="BaseState"):
            robot.publish(topics.BASE, BaseState(stamp_ns=-1, mode="ok"))
    assert scripted.sent == []


def test_what_is_no_key_is_named_and_not_sent(add_robot: Callable, endpoint: str) -> None:
    """Zenoh's own exception came, or nothing at all."""
    add_robot("one")
    marker = Marker(kind="icon", icon="flag")
    with Robot(connect=endpoint) as robot:
        for name in ("", "a/b", "a?", "a#", "a$b", "a*b"):
            with pytest.raises(ValueError, match=r"markers/.*cannot stand in a key"):
                robot.put_marker(name, "flag", marker)
            with pytest.raises(ValueError, match="cannot stand in a key"):
                robot.latest(topics.TF, name)
        with pytest.raises(ValueError, match="surrogates"):  # it waited for ever
            robot.subscribe(topics.TF, "\udc80")
        with pytest.raises(ValueError, match="without a wildcard"):
            robot.put_marker("*", "flag", marker)
        with pytest.raises(ValueError, match="without a wildcard"):
            robot.publish(topics.MARKER, marker)
    for name in ("*", "a?b", "a/b"):
        with pytest.raises(RobotUnreachable, match="There is only one"):
            Robot(name, connect=endpoint)


def test_a_closed_robot_says_so(add_robot: Callable, endpoint: str) -> None:
    add_robot("one")
    robot = Robot(connect=endpoint)
    poses = robot.poses()
    next(poses)
    silent = robot.stream(topics.SCAN)
    threading.Timer(0.1, robot.close).start()
    with pytest.raises(RobotUnreachable, match="this connection to the robot is closed"):
        next(silent)  # it waits meanwhile
    for use in (robot.pose, robot.stop, robot.places, lambda: next(robot.poses()), robot.now_ns):
        with pytest.raises(RobotUnreachable, match="this connection to the robot is closed"):
            use()
    assert "closed" in repr(robot)


def test_a_stream_goes_on_when_the_robot_was_restarted(endpoint: str, tmp_path: Path) -> None:
    with running(ScriptedRobot("one", ()), "one", endpoint, tmp_path / "a"):
        robot = Robot("one", connect=endpoint, connect_timeout=PATIENCE_S)
        poses = robot.poses(timeout=PATIENCE_S)
        before = next(poses)
    with robot, running(ScriptedRobot("one", ()), "one", endpoint, tmp_path / "b"):
        assert any(
            pose.stamp_ns > before.stamp_ns + 10**8
            for _, pose in zip(range(10), poses, strict=False)
        )
    with pytest.raises(RobotUnreachable, match="this connection to the robot is closed"):
        list(poses)  # what had come before may still be read


def test_silence_ends_a_stream_that_has_a_time_limit(add_robot: Callable, endpoint: str) -> None:
    add_robot("one")
    said = r"nothing came on scan of one for 0\.2 s"
    with Robot(connect=endpoint) as robot, pytest.raises(RobotUnreachable, match=said):
        next(robot.scans(timeout=0.2))


def test_what_nobody_reads_takes_bounded_memory(
    add_robot: Callable, endpoint: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connection, "MOST_WAITING_BYTES", 3000)
    add_robot("one")
    with Robot(connect=endpoint) as robot:
        subscriptions = [robot.subscribe(topics.HEALTH, "test") for _ in range(10)]
        last = Health(stamp_ns=0, state="ok", message="x" * 1000)
        for stamp_ns in range(1, 21):
            last = Health(stamp_ns=stamp_ns, state="ok", message="x" * 1000)
            robot.publish(topics.HEALTH, last, "test")
        for one in subscriptions:
            wait_until(lambda one=one: bool(one._heard) and one._waiting[-1].message == last, "all")
            assert len(one._waiting) <= 2
            assert one._waiting_bytes <= 3000


def test_a_callback_gets_messages_until_it_is_closed(add_robot: Callable, endpoint: str) -> None:
    add_robot("one")
    heard: list[Any] = []
    with Robot(connect=endpoint) as robot:
        listening = robot.on(topics.POSES, heard.append)
        wait_until(lambda: bool(heard), "the latest value is the first")
        listening.close()
        robot.publish(topics.POSES, SavedPoses(stamp_ns=5, poses=[]))
        assert robot.latest(topics.ODOM) is not None  # what was put before has arrived
        assert len(heard) == 1
    assert isinstance(heard[0].poses[0], SavedPose)


class ShiftIsOver(Exception):
    """What only the program knows."""


@pytest.mark.parametrize("raised", [KeyboardInterrupt, SystemExit, ShiftIsOver])
def test_what_a_signal_s_handler_raises_cancels_the_goal(
    add_robot: Callable, endpoint: str, monkeypatch: pytest.MonkeyPatch, raised: type[BaseException]
) -> None:
    scripted = add_robot("one", DRIVES_ON)
    with Robot(connect=endpoint) as robot:

        def interrupted(*_: object) -> None:
            raise raised

        monkeypatch.setattr(robot, "_next", interrupted)
        with pytest.raises(raised):
            robot.go_to("kitchen")
    assert scripted.canceled == [scripted.sent[0].id]


def test_closing_the_robot_cancels_the_goal_that_a_thread_waits_for(
    add_robot: Callable, endpoint: str
) -> None:
    """The connection was closed before the goal could be canceled."""
    scripted = add_robot("one", DRIVES_ON)
    problems: list[RobotUnreachable] = []

    def go() -> None:
        try:
            robot.go_to("kitchen")
        except RobotUnreachable as closed:
            problems.append(closed)

    with Robot(connect=endpoint) as robot:
        going = threading.Thread(target=go)
        going.start()
        wait_until(lambda: bool(scripted.sent), "it drives")
    assert scripted.canceled == [scripted.sent[0].id]
    going.join(PATIENCE_S)
    assert "this connection to the robot is closed" in str(problems[0])
    assert not hasattr(problems[0], "__notes__")


def test_a_signal_that_closes_the_robot_cancels_the_goal_that_it_interrupts(
    add_robot: Callable, endpoint: str
) -> None:
    scripted = add_robot("one", DRIVES_ON)
    program = f"""
import signal
from trolley import Robot, RobotUnreachable
robot = Robot(connect={endpoint!r})
signal.signal(signal.SIGTERM, lambda *_: robot.close())
try:
    robot.go_to("kitchen")
except RobotUnreachable as closed:
    print(closed, *getattr(closed, "__notes__", ()))
"""
    command = [sys.executable, "-c", program]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as going:
        wait_until(lambda: bool(scripted.sent), "it drives")
        going.terminate()
        said, _ = going.communicate(timeout=PATIENCE_S)
    assert scripted.canceled == [scripted.sent[0].id]
    assert re.fullmatch("this connection to the robot is closed; .*\n", said)


def test_a_goal_that_closing_has_canceled_says_that_the_robot_is_closed(
    add_robot: Callable, endpoint: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where the answer was on its way, it said that the goal was canceled."""
    add_robot("one", DRIVES_ON)
    robot = Robot(connect=endpoint)

    def interrupted(goal: str, _: None) -> Iterator[GoalStatus]:
        robot.close()
        yield GoalStatus(stamp_ns=0, id=goal, state="canceled")

    monkeypatch.setattr(robot, "follow", interrupted)
    with pytest.raises(RobotUnreachable, match="this connection to the robot is closed"):
        robot.go_to("kitchen")


def test_a_signal_may_close_the_robot_that_begins_to_listen(
    add_robot: Callable, endpoint: str
) -> None:
    """It waited for ever for what it had interrupted."""
    add_robot("one")
    robot = Robot(connect=endpoint)
    subscribe = robot.connection.subscribe

    def interrupted(*which: Any, **how: Any) -> Any:
        robot.close()
        return subscribe(*which, **how)

    def listen() -> None:
        with contextlib.suppress(RobotUnreachable):
            robot.subscribe(topics.ODOM)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(robot.connection, "subscribe", interrupted)
        listening = threading.Thread(target=listen, daemon=True)
        listening.start()
        listening.join(PATIENCE_S)
    assert not listening.is_alive()


def test_a_signal_may_close_the_session_that_is_just_asked_to_listen(
    endpoint: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It waited 5 s for calls back that had not begun."""
    monkeypatch.setattr(zenoh_bus, "CALLBACK_S", 10.0 * PATIENCE_S)
    as_daemon = zenoh_bus._as_daemon

    def interrupted(declare: Callable) -> Any:
        bus.close()
        return as_daemon(declare)

    with open_bus([endpoint], PATIENCE_S) as bus:
        monkeypatch.setattr(zenoh_bus, "_as_daemon", interrupted)
        with pytest.raises(zenoh_bus.ZenohError):
            bus.subscribe("trolley/one/odom", lambda _: None)


def test_a_signal_s_handler_may_halt_the_drive_that_it_interrupts(
    add_robot: Callable, endpoint: str
) -> None:
    """It waited for ever for what it had interrupted."""
    add_robot("one")
    with Robot(connect=endpoint) as robot, robot.subscribe(topics.COMMAND, teleop.SOURCE) as heard:
        publish = robot.connection.publish

        def interrupted(*what: Any) -> None:
            patch.setattr(robot.connection, "publish", publish)
            robot.drive(Twist2D.zero())
            publish(*what)

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(robot._hand, "_now_ns", time.time_ns)
            patch.setattr(robot.connection, "publish", interrupted)
            driving = threading.Thread(
                target=robot.drive, args=(Twist2D(0.1, 0.0, 0.0),), daemon=True
            )
            driving.start()
            driving.join(PATIENCE_S)
        assert not driving.is_alive()
        first, last = heard.next(PATIENCE_S), heard.next(PATIENCE_S)
        assert first is not None
        assert last is not None
        assert first.message.twist.is_zero
        assert first.message.stamp_ns > last.message.stamp_ns  # so base drops the one after it


@pytest.mark.parametrize(
    "use",
    [
        lambda robot: robot.subscribe(topics.ODOM).close(),
        lambda robot: robot.put_marker("a", "b", Marker(kind="icon", icon="flag")),
        Robot.delete_marker,
        Robot.pose,
        Robot.resume,
    ],
)
def test_what_goes_on_while_the_robot_is_closed_says_so(
    add_robot: Callable, endpoint: str, use: Callable
) -> None:
    """Zenoh's own exception came."""
    add_robot("one")
    closed = threading.Event()

    def go_on(robot: Robot) -> None:
        while not closed.is_set():
            try:
                use(robot)
            except RobotUnreachable:
                closed.set()

    for _ in range(10):
        closed.clear()
        robot = Robot(connect=endpoint)
        going_on = threading.Thread(target=go_on, args=(robot,))
        going_on.start()
        time.sleep(0.005)
        robot.close()
        going_on.join(PATIENCE_S)
        assert closed.is_set()


def test_a_robot_closed_within_its_look_at_the_connection_says_so(
    add_robot: Callable, endpoint: str
) -> None:
    """AttributeError came: 'NoneType' object has no attribute 'delete'."""
    add_robot("one")
    robot = Robot(connect=endpoint)

    def closed_meanwhile() -> bool:
        patch.undo()
        robot.close()
        return False

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(connection, "is_forked", closed_meanwhile)
        with pytest.raises(RobotUnreachable, match="this connection to the robot is closed"):
            robot.delete_marker()


def test_asyncio_has_all_that_threads_have() -> None:
    for_threads = {"apart", "close", "connection", "names", "on", "over", "subscribe"}
    public = {name for name in dir(Robot) if not name.startswith("_")}
    missing = public - for_threads - {name for name in dir(AsyncRobot) if name[0] != "_"}
    assert missing == set()
    assert inspect.signature(AsyncRobot.go_to) == inspect.signature(Robot.go_to)
    assert AsyncRobot.poses.__doc__ == Robot.poses.__doc__


def test_asyncio_drives_streams_and_stops(add_robot: Callable, endpoint: str) -> None:
    scripted = add_robot("one")

    async def drive() -> None:
        async with AsyncRobot("one", connect=endpoint) as robot:
            assert robot.name == "one"
            assert (await robot.go_to("kitchen", timeout=PATIENCE_S)).state == "arrived"
            stamps = []
            async for pose in robot.poses():
                stamps.append(pose.stamp_ns)
                if len(stamps) == 3:
                    break
            assert stamps == sorted(set(stamps))
            # Ten that wait for what never comes hold nobody up.
            silent = [asyncio.ensure_future(anext(robot.scans())) for _ in range(10)]
            await asyncio.sleep(0)
            assert (await robot.stop()).mode == "stopped"
            for one in silent:
                one.cancel()
            ended = await asyncio.gather(*silent, return_exceptions=True)
            assert all(isinstance(one, asyncio.CancelledError) for one in ended)
            waiting = asyncio.ensure_future(anext(robot.scans()))
            await robot.pose()
        with pytest.raises(RobotUnreachable, match="this connection to the robot is closed"):
            await waiting
        with pytest.raises(RobotUnreachable, match="this AsyncRobot is not open"):
            await robot.pose()

    asyncio.run(drive())
    assert scripted.stopped


def test_an_async_robot_may_be_opened_again(add_robot: Callable, endpoint: str) -> None:
    """As a program does that waits for a robot to come back."""
    add_robot("one")

    async def twice() -> None:
        one = AsyncRobot("one", connect=endpoint)
        for _ in range(2):
            async with one:
                assert (await one.pose()).state == "localized"

    asyncio.run(twice())


def test_a_cancelled_task_cancels_the_goal_that_it_waits_for(
    add_robot: Callable, endpoint: str
) -> None:
    scripted = add_robot("one", DRIVES_ON)

    async def give_up() -> None:
        async with AsyncRobot("one", connect=endpoint) as robot:
            going = asyncio.ensure_future(robot.go_to("kitchen"))
            while not scripted.sent:  # else the goal before it, none, is followed
                await asyncio.sleep(0.01)
            async for status in robot.follow():
                if status.state == "driving":
                    break
            going.cancel()
            with pytest.raises(asyncio.CancelledError):
                await going
            assert scripted.canceled == [scripted.sent[0].id]

    asyncio.run(give_up())


def test_ask_and_pub_speak_the_wire_from_the_shell(add_robot: Callable, endpoint: str) -> None:
    scripted = add_robot("one")

    def run(*arguments: str) -> tuple[int, str]:
        done = CliRunner().invoke(cli, [*arguments, "--connect", endpoint])
        return done.exit_code, done.output

    code, said = run("ask", "goal/send", '{"name": "kitchen", "id": "from-shell"}')
    assert code == 0
    assert "id: from-shell" in said
    assert [goal.id for goal in scripted.sent] == ["from-shell"]
    code, said = run("ask", "goal/sent", "{}")
    assert code == 2
    assert "there is no request 'goal/sent'. Did you mean goal/send" in said
    code, said = run("ask", "goal/send", '{"name": "nowhere"}')
    assert (code, "no saved place called nowhere" in said) == (1, True)
    with Robot("one", connect=endpoint) as robot:
        heard: list[Any] = []
        robot.on(topics.COMMAND, heard.append, "me")
        assert robot.latest(topics.ROBOT) is not None  # so the router knows by now that it listens
        command = '{"twist": {"vx": 0.1, "vy": 0, "wz": 0}, "valid_for": 0.3}'
        code, said = run("topic", "pub", "cmd_vel/me", command, "-n", "2", "--hz", "20")
        assert (code, said) == (0, "sent 2 messages on cmd_vel/me\n")
        wait_until(lambda: len(heard) == 2, "both arrive")
        assert 0 < heard[0].stamp_ns < heard[1].stamp_ns
    code, said = run("topic", "pub", "base", '{"mode": "ok"}')
    assert (code, "base is published by base, which is running" in said) == (1, True)
    code, said = run("topic", "pub", "cmd_vel/me", '{"valid_for": 0.3}')
    assert (code, "cmd_vel/me: `twist` is missing" in said) == (2, True)
    assert run("topic", "pub", "tf/*", "{}")[0] == 2


def robot_of_a_late_thread(late_s: float, endpoint: str) -> str:
    """How a program begins whose threads go on a while after they told that they are over."""
    return f"""
import threading, time
tell = threading.Event.set

def tell_and_be_late(event):
    tell(event)
    time.sleep({late_s})

threading.Event.set = tell_and_be_late
from trolley import Robot, topics
robot = Robot(connect={endpoint!r})
"""


@pytest.mark.parametrize("late_s", [0.0, 0.005, 0.01, 0.015])
def test_a_robot_that_nobody_closes_neither_hangs_nor_aborts_python_s_end(
    add_robot: Callable, endpoint: str, late_s: float
) -> None:
    """A thread of Zenoh's that had said its last word, and was late to end, crashed it."""
    add_robot("one")
    program = f"""{robot_of_a_late_thread(late_s, endpoint)}robot.on(topics.ODOM, id)
waits = robot.subscribe(topics.POSE)
robot.now_ns()
print(robot.pose(), robot)
"""
    done = subprocess.run(
        [sys.executable, "-c", program],
        capture_output=True,
        text=True,
        check=True,
        timeout=PATIENCE_S,
    )
    assert "Robot one" in done.stdout


@pytest.mark.parametrize("late_s", [0.005, 0.02, 0.06])
def test_daemons_that_go_on_asking_do_not_abort_python_s_end(
    add_robot: Callable, endpoint: str, late_s: float
) -> None:
    add_robot("one")
    program = f"""{robot_of_a_late_thread(late_s, endpoint)}asked = threading.Barrier(6)

def ask():
    robot.latest(topics.POSE)
    asked.wait()
    while True:
        robot.latest(topics.POSE)
        robot.subscribe(topics.POSE).close()
        robot.connection.services()

threading.excepthook = lambda _: None  # it is closed
for _ in range(5):
    threading.Thread(target=ask, daemon=True).start()
asked.wait()
"""
    command = [sys.executable, "-c", program]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def test_a_process_that_was_forked_says_so_and_ends(add_robot: Callable, endpoint: str) -> None:
    """One that was forked just as a message was taken in, or as it drove, waited for ever."""
    add_robot("one")
    program = f"""
import os, threading
from trolley import Robot, topics
from trolley.geometry import Twist2D
robot = Robot(connect={endpoint!r})
heard = robot.on(topics.ODOM, id)
begun, over = threading.Event(), threading.Event()

def take():
    with heard._condition, robot._hand._lock:
        begun.set()
        over.wait()

threading.Thread(target=take).start()
begun.wait()
child = os.fork()
if child:
    over.set()
    print("child:", os.waitpid(child, 0)[1])
else:
    begin = lambda _: Robot(connect={endpoint!r})
    drive = lambda _: robot.drive(Twist2D.zero())
    for what in (robot.latest, robot.subscribe, lambda _: heard.next(), drive, begin):
        try:
            what(topics.POSE)
        except Exception as error:
            print(type(error).__name__, error)
robot.close()
"""
    command = [sys.executable, "-c", program]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=PATIENCE_S)
    said = "RobotUnreachable this process was forked from one"
    assert [line[: len(said)] for line in done.stdout.splitlines()] == [said] * 5 + ["child: 0"]


def test_ctrl_c_ends_the_search_for_a_router() -> None:
    program = """
from trolley import Robot
print("looking", flush=True)
Robot("one", connect="tcp/127.0.0.1:1", connect_timeout=1000.0)
"""
    with subprocess.Popen(
        [sys.executable, "-c", program], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "looking\n"
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=PATIENCE_S)
    assert said.endswith("KeyboardInterrupt\n")


@pytest.mark.parametrize(
    "interrupt",
    [
        pytest.param("os.kill(os.getpid(), signal.SIGINT)", id="at once"),
        pytest.param("signal.raise_signal(signal.SIGINT)", id="as the search ends"),
    ],
)
def test_python_does_not_end_just_as_the_search_for_a_router_does(interrupt: str) -> None:
    """A thread that comes back from Zenoh while Python ends aborts it."""
    program = f"""
import os, signal, time
import zenoh
from trolley import Robot

def give_up(_):
    {interrupt}
    time.sleep(0.4)
    print("it gave up", flush=True)
    raise zenoh.ZError("no router")

zenoh.open = give_up
Robot("one", connect="tcp/127.0.0.1:1", connect_timeout=0.5)
"""
    command = [sys.executable, "-c", program]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S, check=False)
    assert done.stderr.endswith("KeyboardInterrupt\n")
    assert done.stdout == "it gave up\n"


def test_a_session_may_be_closed_where_it_calls_back(
    endpoint: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(zenoh_bus, "CALLBACK_S", 10.0 * PATIENCE_S)
    is_closed = threading.Event()
    with open_bus([endpoint], PATIENCE_S) as bus, open_bus([endpoint], PATIENCE_S) as other:

        def close(_sample: object) -> None:
            bus.close()
            is_closed.set()

        bus.subscribe("trolley/one/close", close)

        def heard() -> bool:
            other.put("trolley/one/close", b"1", "", Qos.STATE)
            return is_closed.is_set()

        wait_until(heard, "it is closed")
